"""What a fit has not seen, whole presses or channels left out: predictive density.

Twice. Before anything is looked at some are put aside, which no search sees: they tell before from
after. The rest is parted into folds, by which the search itself judges what it lets in.
"""

from dataclasses import dataclass

import numpy as np

from eitskin.data.recording import TOUCH_KEYS, Recording, presses
from eitskin.diagnose.fitting.fit import ENOUGH, FARTHEST, Fit, inverse_root
from eitskin.errors import InputError
from eitskin.physics.protocol import tied_channels

FOLDS = 5
ASIDE = 5  # one of so many is put aside
LEAST_PRESSES = 4  # with fewer, channels are put aside
REFITS = 6  # steps of a fit without a fold, at most


def aside(recorded: Recording, seed: int) -> np.ndarray:
    """(N, M): readings put aside before anything is looked at. One in ASIDE of the presses, each
    with the untouched frames before it, the last with those after it too; with fewer than
    LEAST_PRESSES of which all is known, one in ASIDE of the channels, reciprocal ones together. Of
    fewer than ASIDE channels none."""
    touched, press = recorded.frames["touch"].to_numpy(bool), presses(recorded)
    known = recorded.frames[list(TOUCH_KEYS)].notna().all(axis=1).to_numpy()
    labels = np.unique(press[touched & known & (press >= 0)])
    rng = np.random.default_rng([seed, len(press)])
    if len(labels) >= LEAST_PRESSES:
        chosen = rng.permutation(labels)[: max(1, round(len(labels) / ASIDE))]
        rows = np.isin(with_frames_before(np.where(touched, press, -1)), chosen)
        rows[: np.flatnonzero(touched)[0]] = False
        return np.repeat(rows[:, None], len(recorded.channels), axis=1)
    group = reciprocal_groups(recorded.channels)
    labels = rng.permutation(np.unique(group))
    columns = np.isin(group, labels[: round(len(labels) / ASIDE)])
    return np.repeat(columns[None], len(press), axis=0)


def units(recorded: Recording) -> np.ndarray:
    """(N, M) int: readings of one label err together. A press with the untouched frames before it;
    channels tied by reciprocity where there are fewer than two presses."""
    press = presses(recorded)
    if press.max(initial=-1) < 1:
        return np.repeat(reciprocal_groups(recorded.channels)[None], len(press), axis=0)
    return np.repeat(with_frames_before(press)[:, None], len(recorded.channels), axis=1)


def reciprocal_groups(channels: np.ndarray) -> np.ndarray:
    """(M,): one label for channels (M, 4) that reciprocity ties together."""
    return tied_channels(channels)[0]


def with_frames_before(press: np.ndarray) -> np.ndarray:
    """(N,): the press of a frame, of one that is of none (-1) that which follows, at the end the
    last."""
    of_some = np.flatnonzero(press >= 0)
    following = np.searchsorted(of_some, np.arange(len(press)))
    return press[of_some[np.minimum(following, len(of_some) - 1)]]


def folds(touched: np.ndarray, press: np.ndarray, channels: np.ndarray, seed: int) -> np.ndarray:
    """(N,): the fold of each frame. Whole presses stay together, untouched frames go with the
    press that follows; without presses, folds are stretches of time.

    (1, M): where nobody touches, frames are repeats and tell nothing new of each other: folds are
    of channels (M, 4) then, reciprocal ones together.
    """
    if not touched.any():
        fold = np.random.default_rng(seed).permutation(len(channels)) % FOLDS
        return fold[reciprocal_groups(channels)][None]
    count = int(press.max(initial=-1)) + 1
    if count < 2:
        return np.arange(len(press)) * FOLDS // len(press)
    order = np.random.default_rng(seed).permutation(count)
    of_press = np.empty(count, int)
    of_press[order] = np.arange(count) % FOLDS
    found = of_press[with_frames_before(np.where(touched, press, -1))]
    first = np.flatnonzero(touched)[0]
    found[:first] = np.arange(first) % FOLDS
    return found


@dataclass(frozen=True)
class HeldOut:
    """What frames cost when they are left out: chi2 (N,) and log density (N,) in nats, up to a
    constant; error (N, M): in noise units; plain (N, M): in the recording's unit; readings: how
    many there are."""

    chi2: np.ndarray
    density: np.ndarray
    error: np.ndarray
    plain: np.ndarray
    readings: int

    @property
    def rms(self) -> float:
        """Root mean square error of a reading, in the recording's unit."""
        return float(np.sqrt((self.plain**2).sum() / max(self.readings, 1)))

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
    (1, M), the fit made anew for each; the coordinates' own uncertainty is in the density, to first
    order. What is left out is what a frame has of its own once whitening has taken out what it
    shares with others."""
    size, by_channel = len(fit.theta), fold.ndim == 2
    turned = np.swapaxes(fit.jacobian, 1, 2) if by_channel else None
    label = fold[0] if by_channel else fold
    total = fit.information + np.diag(fit.prior)
    density, chi2 = np.zeros(len(label)), np.zeros(len(label))
    errors, plain = np.zeros((2, *(fit.residual.T if by_channel else fit.residual).shape))
    whitening = fit.problem.whitening
    for b in np.unique(label):
        rows = label == b
        jacobian = fit.slopes.full(rows) if turned is None else turned[:, rows]
        own = jacobian.reshape(size, -1)
        root = inverse_root(total - own @ own.T + 1e-12 * np.diag(np.diag(total)))
        left = _refitted(fit, rows[None] if by_channel else rows[:, None], root)
        error = (left.T if by_channel else left)[rows]
        undone = whitening.unwhitened(left)
        plain[rows] = (undone.T if by_channel else undone)[rows]
        spread = jacobian.transpose(1, 2, 0) @ root
        chi2[rows] = (error**2).sum(axis=1)
        errors[rows] = error
        gram = spread.transpose(0, 2, 1) @ spread + np.eye(size)
        slope = np.einsum("nmp,nm->np", spread, error)
        solved = np.linalg.solve(gram, slope[..., None])[..., 0]
        density[rows] = -0.5 * (
            chi2[rows] - (slope * solved).sum(axis=1) + np.linalg.slogdet(gram)[1]
        )
    plain = plain.T if by_channel else plain
    return HeldOut(chi2, density, errors, plain, whitening.size)


def _refitted(fit: Fit, out: np.ndarray, root: np.ndarray) -> np.ndarray:
    """(N, M): the residual of a fit to all but `out`, (N, 1) or (1, M), by Gauss and Newton's steps
    with the whole fit's slopes; root (P, P): of its coordinates' covariance without `out`."""
    theta, left, prior = fit.theta, fit.residual, fit.prior
    cost = float((np.where(out, 0.0, left) ** 2).sum() + prior @ theta**2)
    for _ in range(REFITS):
        slope = fit.slopes.against(np.where(out, 0.0, left)) - prior * theta
        step = np.clip(root @ (root.T @ slope), -FARTHEST, FARTHEST)
        if step @ slope < ENOUGH:
            break
        try:
            moved = fit.problem.residual(theta + step, fit.effects)
        except InputError:
            break
        there = float((np.where(out, 0.0, moved) ** 2).sum() + prior @ (theta + step) ** 2)
        if there >= cost:
            break
        theta, left, cost = theta + step, moved, there
    return left


def put_aside(fit: Fit) -> HeldOut:
    """What a fit predicts for the readings of its problem, which it has not seen, in their
    covariance."""
    recorded, whitening = fit.problem.recorded, fit.problem.whitening
    plain = np.where(whitening.mask, recorded - fit.voltage(), 0.0)
    error = whitening(plain)
    free = np.isinf(whitening.offset_ratio)
    if free.any():
        level = plain.sum(axis=0) / np.maximum(whitening.mask.sum(axis=0), 1)
        plain = np.where(whitening.mask & free, plain - level, plain)
    chi2 = (error**2).sum(axis=1)
    density = -0.5 * (chi2 + whitening.log_determinant / len(chi2))
    return HeldOut(chi2, density, error, plain, whitening.size)
