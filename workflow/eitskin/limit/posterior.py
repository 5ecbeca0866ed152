"""Inference with a standard normal prior: modes, Laplace's approximation, importance sampling.

Draws come from the mixture of the modes' Gaussians, each slightly widened, in antithetic pairs
about its mode, which cancels odd terms: where the posterior is Gaussian, the mean has no sampling
error. Weights are the posterior over the mixture's density, normalised to 1 (self-normalised
importance sampling; Owen 2013, Monte Carlo theory, chapter 9).
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.special import logsumexp

WIDENING = 1.1  # of the modes' Gaussians in each direction, for the posterior's tails
MAX_STEPS = 30  # of one search: scoring converges in a few from a nearby start
LONGEST_STEP = 1.0  # in any unknown, in the prior's standard deviations: within the linear range
CONVERGED = 0.1  # length of the last step, in the posterior's sd: the draws correct the remainder
MERGED = 1.0  # modes nearer than this, in their standard deviations, count as one
MIN_EVIDENCE = 1e-4  # of the best mode's: modes with less do not change the mean visibly


class Likelihood(Protocol):
    """A likelihood of `size` unknowns with a standard normal prior."""

    @property
    def size(self) -> int:
        """The number of unknowns."""

    def log(self, z: np.ndarray) -> float:
        """Logarithm of the likelihood at z (size,), up to a constant."""

    def local(self, z: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """The log-likelihood at z, its gradient (size,) and a positive semidefinite information
        matrix (size, size)."""


@dataclass(frozen=True)
class Mode:
    """A maximum of the posterior, the lower Cholesky factor of its precision there (information + 1
    of the prior), and the logarithm of Laplace's approximation of the evidence."""

    z: np.ndarray
    factor: np.ndarray
    log_evidence: float


def find_mode(likelihood: Likelihood, start: np.ndarray) -> Mode:
    """The mode that Fisher scoring reaches from `start`, damped (Levenberg-Marquardt) where a step
    would lower the posterior."""
    z, damping = np.asarray(start, float), 0.0
    log, gradient, information = likelihood.local(z)
    height = log - 0.5 * z @ z
    for _ in range(MAX_STEPS):
        precision = information + np.eye(len(z))
        damped = precision + damping * np.diag(np.diag(precision))
        step = cho_solve(cho_factor(damped, lower=True), gradient - z)
        step /= max(1.0, np.abs(step).max() / LONGEST_STEP)
        length = np.sqrt(step @ precision @ step)
        candidate = likelihood.local(z + step)
        candidate_height = candidate[0] - 0.5 * (z + step) @ (z + step)
        if candidate_height >= height:
            z, (log, gradient, information), height = z + step, candidate, candidate_height
            damping *= 0.1 if damping > 1e-3 else 0.0
        else:
            damping = max(10.0 * damping, 0.1)
        if length < CONVERGED:
            break
    factor = np.linalg.cholesky(information + np.eye(len(z)))
    return Mode(z, factor, float(height - np.log(np.diag(factor)).sum()))


def distinct_modes(modes: list[Mode]) -> list[Mode]:
    """The modes in falling order of evidence, without duplicates and those of negligible weight."""
    distinct: list[Mode] = []
    for mode in sorted(modes, key=lambda mode: -mode.log_evidence):
        distances = [
            np.linalg.norm(accepted.factor.T @ (mode.z - accepted.z)) for accepted in distinct
        ]
        has_weight = not distinct or mode.log_evidence > distinct[0].log_evidence + np.log(
            MIN_EVIDENCE
        )
        if has_weight and min(distances, default=np.inf) > MERGED * np.sqrt(len(mode.z)):
            distinct.append(mode)
    return distinct


@dataclass(frozen=True)
class Draws:
    """Draws z (n, size) and their weights (n,), which sum to 1."""

    z: np.ndarray
    weight: np.ndarray

    @property
    def effective_size(self) -> float:
        """Kish's effective sample size, 1 / Σ w²."""
        return float(1.0 / (self.weight**2).sum())


def draw(likelihood: Likelihood, modes: list[Mode], pairs: int, rng: np.random.Generator) -> Draws:
    """About 2 `pairs` weighted draws, shared among the modes' Gaussians by their evidence."""
    share = np.array([mode.log_evidence for mode in modes])
    share = np.exp(share - logsumexp(share))
    count = np.maximum(np.round(pairs * share).astype(int), 1)
    parts = []
    for mode, n in zip(modes, count, strict=True):
        normal = rng.standard_normal((n, len(mode.z)))
        deviations = WIDENING * solve_triangular(mode.factor.T, normal.T).T
        parts += [mode.z + deviations, mode.z - deviations]
    z = np.concatenate(parts)
    mode_log_density = np.array([_log_density(z, mode) for mode in modes])
    log_share = np.log(count / count.sum())[:, None]
    log_weight = np.array([likelihood.log(point) - 0.5 * point @ point for point in z])
    log_weight -= logsumexp(mode_log_density + log_share, axis=0)
    return Draws(z, np.exp(log_weight - logsumexp(log_weight)))


def _log_density(z: np.ndarray, mode: Mode) -> np.ndarray:
    """(n,): log density of the mode's widened Gaussian, up to a constant common to all modes."""
    whitened = (z - mode.z) @ mode.factor / WIDENING
    return np.log(np.diag(mode.factor)).sum() - 0.5 * (whitened**2).sum(axis=1)
