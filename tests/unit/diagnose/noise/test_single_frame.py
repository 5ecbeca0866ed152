"""The noise of a single frame follows the law of its readings."""

import numpy as np
import pytest

from eitskin.data.recording import Recording, frames_table
from eitskin.diagnose.noise.estimate import estimate_noise
from eitskin.diagnose.noise.single_frame import single_frame_law
from proof.drawing import draw

LEVEL = np.geomspace(0.1, 10.0, 104)


def relative_sd(sd, seed, outliers=0):
    """(104,): the sd found of contrasts of sd (104,), over the true one."""
    draws = np.random.default_rng(seed)
    contrasts = sd * draws.standard_normal(len(sd))
    contrasts[draws.choice(len(sd), outliers, replace=False)] += 30.0 * sd.max()
    law, dof = single_frame_law(contrasts, LEVEL**2)
    return law(LEVEL) / sd, dof


@pytest.mark.parametrize("sd", [0.02 * LEVEL, np.full(104, 0.02), np.hypot(0.02, 0.02 * LEVEL)])
@pytest.mark.parametrize("outliers", [0, 10])
def test_the_law_is_found_through_outliers(sd, outliers):
    found = [relative_sd(sd, seed, outliers) for seed in range(20)]
    ratio = np.exp(np.mean([np.log(ratio) for ratio, _ in found], axis=0))
    if outliers:  # a tenth of the contrasts, which the bound from above has to hold
        assert (ratio > 0.9).all() and np.median(ratio) < 1.6
    else:
        assert ratio == pytest.approx(1.0, abs=0.35) and np.median(ratio) == pytest.approx(
            1, abs=0.1
        )
    assert all(10.0 < dof < 104.0 for _, dof in found)


def test_the_degrees_of_freedom_are_those_of_the_scale():
    found = [relative_sd(np.full(104, 0.02), seed) for seed in range(200)]
    scatter = np.var([np.log(ratio[52] ** 2) for ratio, _ in found])
    assert 2.0 / scatter == pytest.approx(np.mean([dof for _, dof in found]), rel=0.35)


def test_few_contrasts_and_differences_have_a_law_too():
    law, dof = single_frame_law(np.array([0.1, -0.3]), np.zeros(2))
    assert law.growth == 0.0 and 0.1 < np.sqrt(law.constant) < 0.4 and dof < 2.0
    law, dof = single_frame_law(np.array([0.1]), np.ones(1))
    assert law.growth == 0.0 and dof < 1.0


@pytest.mark.parametrize("seed", [0, 3, 10, 12])
def test_a_drawn_frame_has_its_noise(seed):
    case = draw("null", seed)
    row = int(np.flatnonzero(~case.states["touch"].to_numpy(bool))[0])
    frames = frames_table(np.zeros(1), np.zeros(1, bool))
    alone = Recording(frames, case.voltage[row : row + 1], None, None, case.metadata)
    noise = estimate_noise(alone)
    assert np.mean((case.noise_V / noise.sd) ** 2) == pytest.approx(1.0, abs=0.4)
    assert noise.law is not None and "only frame" in noise.source
