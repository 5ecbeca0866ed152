"""Frames that a fit has not seen, whole presses or channels left out: predictive density."""

from dataclasses import dataclass

import numpy as np

from eitskin.diagnose.fit import Fit, inverse_root
from eitskin.physics.protocol import reciprocal_channels

FOLDS = 5


def folds(touched: np.ndarray, press: np.ndarray, channels: np.ndarray, seed: int) -> np.ndarray:
    """(N,): the fold of each frame. Whole presses stay together, untouched frames go with the
    press that follows; without presses, folds are stretches of time.

    (1, M): where nobody touches, frames are repeats and tell nothing new of each other: folds are
    of channels (M, 4) then, reciprocal ones together.
    """
    if not touched.any():
        first = np.arange(len(channels))
        for k, other in reciprocal_channels(channels)[0]:
            first[other] = first[k]
        fold = np.random.default_rng(seed).permutation(len(channels)) % FOLDS
        return fold[first][None]
    count = int(press.max(initial=-1)) + 1
    if count < 2:
        return np.arange(len(press)) * FOLDS // len(press)
    order = np.random.default_rng(seed).permutation(count)
    of_press = np.empty(count, int)
    of_press[order] = np.arange(count) % FOLDS
    following = np.full(len(press), -1)
    latest = -1
    for row in range(len(press) - 1, -1, -1):
        latest = press[row] if touched[row] and press[row] >= 0 else latest
        following[row] = latest
    following[following < 0] = press.max()
    found = of_press[following]
    first = np.flatnonzero(touched)[0]
    found[:first] = np.arange(first) % FOLDS
    return found


@dataclass(frozen=True)
class HeldOut:
    """What frames cost when they are left out: chi2 (N,) and log density (N,) in nats, up to a
    constant; error (N, M): in noise units; sd (M,): of the noise; readings: how many there are."""

    chi2: np.ndarray
    density: np.ndarray
    error: np.ndarray
    sd: np.ndarray
    readings: int

    @property
    def rms(self) -> float:
        """Root mean square error of a reading, in the recording's unit."""
        return float(np.sqrt(((self.error * self.sd) ** 2).sum() / max(self.readings, 1)))

    @property
    def chi2_per_dof(self) -> float:
        """Chi squared over the readings."""
        return float(self.chi2.sum() / max(self.readings, 1))

    def gain(self, other: "HeldOut") -> tuple[float, float]:
        """Log density above `other`'s, and its standard error: what noise alone makes of the same
        difference between the two predictions, |d| for a difference of length |d| in noise units.
        """
        apart = self.error - other.error
        return float((self.density - other.density).sum()), float(np.sqrt((apart**2).sum()))


def held_out(fit: Fit, fold: np.ndarray) -> HeldOut:
    """Every frame predicted from the folds (N,) it does not belong to, or every channel from folds
    (1, M), to first order about the fit; the coordinates' own uncertainty is in the density."""
    size = len(fit.theta)
    residual, sd, part = fit.residual, fit.problem.whitening.sd, fit.slopes.full
    if fold.ndim == 2:
        turned = np.swapaxes(fit.jacobian, 1, 2)
        residual, sd, fold, part = residual.T, sd[:, None], fold[0], lambda rows: turned[:, rows]
    total = fit.information + np.diag(fit.prior)
    density, chi2 = np.zeros(len(residual)), np.zeros(len(residual))
    errors = np.zeros_like(residual)
    for b in np.unique(fold):
        rows = fold == b
        jacobian = part(rows)
        own = jacobian.reshape(size, -1)
        root = inverse_root(total - own @ own.T + 1e-12 * np.diag(np.diag(total)))
        moved = root @ (root.T @ (own @ residual[rows].ravel()))
        error = residual[rows] + np.tensordot(moved, jacobian, 1)
        spread = jacobian.transpose(1, 2, 0) @ root
        chi2[rows] = (error**2).sum(axis=1)
        errors[rows] = error
        gram = spread.transpose(0, 2, 1) @ spread + np.eye(size)
        slope = np.einsum("nmp,nm->np", spread, error)
        solved = np.linalg.solve(gram, slope[..., None])[..., 0]
        density[rows] = -0.5 * (
            chi2[rows] - (slope * solved).sum(axis=1) + np.linalg.slogdet(gram)[1]
        )
    readings = int(fit.problem.whitening.mask.sum())
    return HeldOut(chi2, density, errors, sd, readings)
