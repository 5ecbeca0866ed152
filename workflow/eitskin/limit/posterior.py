"""Inference with a standard normal prior: modes, Laplace's approximation, importance sampling.

Draws come from the mixture of the modes' Gaussians, each a little widened and in pairs on either
side of its mode, which cancels what is odd about it: where the posterior is a Gaussian, the mean
has no sampling error. Weights are the exact posterior over the mixture's density, normalised to 1
(self-normalised importance sampling; Owen 2013, Monte Carlo theory, chapter 9).
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.special import logsumexp

WIDER = 1.1  # than the modes' Gaussians, in each direction, for the posterior's tails
MOST_STEPS = 30
LONGEST = 1.0  # step in any unknown, in the prior's standard deviations
STILL = 0.1  # length of the last step, in the posterior's standard deviations
SAME = 1.0  # modes nearer than this, in their standard deviations, are one
LEAST_SHARE = 1e-4  # of the evidence; modes with less are left out


class Likelihood(Protocol):
    """Of `size` unknowns whose prior is standard normal."""

    @property
    def size(self) -> int:
        """How many unknowns."""

    def log(self, z: np.ndarray) -> float:
        """Logarithm of the likelihood at z (size,), up to a constant."""

    def local(self, z: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """`log`, its gradient (size,) and an information matrix (size, size), 0 or more."""


@dataclass(frozen=True)
class Mode:
    """Where a posterior is largest, the lower Cholesky factor of its precision there (information
    and the prior's 1), and the logarithm of Laplace's evidence."""

    z: np.ndarray
    factor: np.ndarray
    log_evidence: float


def find_mode(likelihood: Likelihood, start: np.ndarray) -> Mode:
    """The mode that Fisher scoring, damped where a step does not climb, reaches from `start`."""
    z, damping = np.asarray(start, float), 0.0
    log, gradient, information = likelihood.local(z)
    height = log - 0.5 * z @ z
    for _ in range(MOST_STEPS):
        precision = information + np.eye(len(z))
        damped = precision + damping * np.diag(np.diag(precision))
        step = cho_solve(cho_factor(damped, lower=True), gradient - z)
        step /= max(1.0, np.abs(step).max() / LONGEST)
        length = np.sqrt(step @ precision @ step)
        ahead = likelihood.local(z + step)
        risen = ahead[0] - 0.5 * (z + step) @ (z + step)
        if risen >= height:
            z, (log, gradient, information), height = z + step, ahead, risen
            damping *= 0.1 if damping > 1e-3 else 0.0
        else:
            damping = max(10.0 * damping, 0.1)
        if length < STILL:
            break
    factor = np.linalg.cholesky(information + np.eye(len(z)))
    return Mode(z, factor, float(height - np.log(np.diag(factor)).sum()))


def different(modes: list[Mode]) -> list[Mode]:
    """The modes, highest evidence first, without those met before and those of no weight."""
    kept: list[Mode] = []
    for mode in sorted(modes, key=lambda mode: -mode.log_evidence):
        apart = [np.linalg.norm(other.factor.T @ (mode.z - other.z)) for other in kept]
        heavy = not kept or mode.log_evidence > kept[0].log_evidence + np.log(LEAST_SHARE)
        if heavy and min(apart, default=np.inf) > SAME * np.sqrt(len(mode.z)):
            kept.append(mode)
    return kept


@dataclass(frozen=True)
class Draws:
    """z (n, size) and their weights (n,), which sum to 1."""

    z: np.ndarray
    weight: np.ndarray

    @property
    def effective(self) -> float:
        """How many independent draws from the posterior these are worth (Kish)."""
        return float(1.0 / (self.weight**2).sum())


def draw(likelihood: Likelihood, modes: list[Mode], pairs: int, rng: np.random.Generator) -> Draws:
    """2 `pairs` weighted draws from each of the modes' Gaussians."""
    share = np.array([mode.log_evidence for mode in modes])
    share = np.exp(share - logsumexp(share))
    count = np.maximum(np.round(pairs * share).astype(int), 1)
    parts = []
    for mode, n in zip(modes, count, strict=True):
        normal = rng.standard_normal((n, len(mode.z)))
        off = WIDER * solve_triangular(mode.factor.T, normal.T).T
        parts += [mode.z + off, mode.z - off]
    z = np.concatenate(parts)
    proposed = np.array([_log_density(z, mode) for mode in modes])
    log_share = np.log(count / count.sum())[:, None]
    log = np.array([likelihood.log(one) - 0.5 * one @ one for one in z])
    log -= logsumexp(proposed + log_share, axis=0)
    return Draws(z, np.exp(log - logsumexp(log)))


def _log_density(z: np.ndarray, mode: Mode) -> np.ndarray:
    """(n,): of the mode's widened Gaussian, up to a constant that all modes share."""
    off = (z - mode.z) @ mode.factor / WIDER
    return np.log(np.diag(mode.factor)).sum() - 0.5 * (off**2).sum(axis=1)
