"""The posterior against analytic answers."""

import numpy as np
import pytest
from scipy.special import logsumexp

from eitskin.limit import posterior


class Linear:
    """data = slope z + noise: a Gaussian posterior, known in closed form."""

    def __init__(self, seed: int, size: int = 5, values: int = 8, noise: float = 0.3):
        rng = np.random.default_rng(seed)
        self.size, self.noise = size, noise
        self.slope = rng.standard_normal((values, size))
        self.data = self.slope @ rng.standard_normal(size) + noise * rng.standard_normal(values)
        self.information = self.slope.T @ self.slope / noise**2
        self.covariance = np.linalg.inv(self.information + np.eye(size))
        self.mean = self.covariance @ self.slope.T @ self.data / noise**2

    def log(self, z):
        return float(-0.5 * ((self.data - self.slope @ z) ** 2).sum() / self.noise**2)

    def local(self, z):
        gradient = self.slope.T @ (self.data - self.slope @ z) / self.noise**2
        return self.log(z), gradient, self.information


class Folded:
    """data = |z| + noise: two modes, mirrored, the second `tilt` times as likely."""

    size = 1

    def __init__(self, data: float, noise: float, tilt: float):
        self.data, self.noise, self.tilt = data, noise, tilt

    def log(self, z):
        tilted = np.log(self.tilt) if z[0] < 0 else 0.0
        return float(-0.5 * ((self.data - abs(z[0])) / self.noise) ** 2 + tilted)

    def local(self, z):
        gradient = np.sign(z) * (self.data - abs(z)) / self.noise**2
        return self.log(z), gradient, np.array([[self.noise**-2]])


@pytest.mark.parametrize("seed", range(5))
def test_a_gaussian_posterior_is_met_exactly(seed):
    linear = Linear(seed)
    mode = posterior.find_mode(linear, np.zeros(5))
    assert np.allclose(mode.z, linear.mean, atol=1e-9)
    assert np.allclose(mode.factor @ mode.factor.T @ linear.covariance, np.eye(5))
    total = linear.slope @ linear.slope.T + linear.noise**2 * np.eye(8)
    evidence = -0.5 * linear.data @ np.linalg.solve(total, linear.data)
    evidence -= 0.5 * np.linalg.slogdet(total / linear.noise**2)[1]
    assert mode.log_evidence == pytest.approx(evidence)
    draws = posterior.draw(linear, [mode], 4000, np.random.default_rng(seed))
    assert np.allclose(draws.weight @ draws.z, linear.mean, atol=1e-9)
    deviations = draws.z - linear.mean
    assert np.allclose((draws.weight * deviations.T) @ deviations, linear.covariance, atol=0.02)
    assert draws.effective_size == pytest.approx(8000 * (1.42**0.5 / 1.21) ** 5, rel=0.05)


def test_errors_of_the_mean_are_as_large_as_the_posterior_says():
    pulls = []
    for seed in range(400):
        rng, linear = np.random.default_rng([7, seed]), Linear(seed, size=2, values=3, noise=0.8)
        truth = rng.standard_normal(2)
        linear.data = linear.slope @ truth + 0.8 * rng.standard_normal(3)
        mode = posterior.find_mode(linear, np.zeros(2))
        draws = posterior.draw(linear, [mode], 50, rng)
        mean = draws.weight @ draws.z
        sd = np.sqrt(draws.weight @ (draws.z - mean) ** 2)
        pulls.append((truth - mean) / sd)
    assert np.mean(np.square(pulls)) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("tilt", [1.0, 0.25])
def test_two_modes_are_both_counted(tilt):
    folded = Folded(1.5, 0.1, tilt)
    modes_of_starts = [
        posterior.find_mode(folded, np.array([start])) for start in (1.0, -0.7, 2.0, -3.0)
    ]
    modes = posterior.distinct_modes(modes_of_starts)
    assert len(modes) == 2
    draws = posterior.draw(folded, modes, 2000, np.random.default_rng(1))
    grid = np.linspace(-5.0, 5.0, 20_001)
    log = np.array([folded.log([z]) for z in grid]) - 0.5 * grid**2
    mean = np.exp(log - logsumexp(log)) @ grid
    assert (draws.weight @ draws.z)[0] == pytest.approx(mean, abs=0.03)


def test_a_mode_without_weight_is_left_out():
    folded = Folded(1.5, 0.1, 1e-6)
    modes_of_starts = [posterior.find_mode(folded, np.array([start])) for start in (1.0, -1.0)]
    assert [mode.z[0] > 0 for mode in posterior.distinct_modes(modes_of_starts)] == [True]
