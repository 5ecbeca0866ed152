"""Predictive density of readings that a fit has not seen: whole presses, or whole channels.

There are two kinds. The reserve is drawn before anything is looked at and read after the last
decision: it decides nothing. The other readings are split into folds for cross-validation, by which
everything is decided.
"""

from dataclasses import dataclass

import numpy as np
from scipy.stats import f

from eitskin.data.recording import TOUCH_KEYS, Recording, presses
from eitskin.diagnose.fitting.fit import (
    DAMPING_UP,
    MAX_STEP,
    MIN_REJECTED_DAMPING,
    OPTIMUM_TOLERANCE,
    Fit,
    inverse_root,
)
from eitskin.errors import InputError
from eitskin.physics.protocol import tied_channels

FOLDS = 5  # usual for cross-validation: Hastie, Tibshirani, Friedman 2009, section 7.10
RESERVE_DIVISOR = 5  # one press in so many is reserved, as large as a fold
MIN_PRESSES = 4  # with fewer, channels are reserved
MAX_REFIT_STEPS = 6  # of Gauss and Newton without a fold: each is one more simulation
RIDGE = 1e-12  # of the information's diagonal: keeps it positive where a fold has all of it


def draw_reserve_mask(recording: Recording, seed: int) -> np.ndarray:
    """(N, M) bool: True at the reserved readings, drawn before anything is looked at.

    One in RESERVE_DIVISOR of the presses, each with the untouched frames before it, the last with
    those after it too; with fewer than MIN_PRESSES presses whose states are all stated, one in
    RESERVE_DIVISOR of the channels, reciprocal ones together, and none of fewer channels than that.
    """
    touched, press = recording.frames["touch"].to_numpy(bool), presses(recording)
    fully_known = recording.frames[list(TOUCH_KEYS)].notna().all(axis=1).to_numpy()
    labels = np.unique(press[touched & fully_known & (press >= 0)])
    rng = np.random.default_rng([seed, len(press)])
    if len(labels) >= MIN_PRESSES:
        reserved_presses = rng.permutation(labels)[: max(1, round(len(labels) / RESERVE_DIVISOR))]
        rows = np.isin(with_frames_before(np.where(touched, press, -1)), reserved_presses)
        rows[: np.flatnonzero(touched)[0]] = False
        return np.repeat(rows[:, None], len(recording.channels), axis=1)
    group = reciprocal_groups(recording.channels)
    labels = rng.permutation(np.unique(group))
    columns = np.isin(group, labels[: round(len(labels) / RESERVE_DIVISOR)])
    return np.repeat(columns[None], len(press), axis=0)


def error_units(recording: Recording) -> np.ndarray:
    """(N, M) int: labels of independent units, within which readings err together: a press with the
    untouched frames before it; where there are fewer than two presses, channels tied by
    reciprocity."""
    press = presses(recording)
    if press.max(initial=-1) < 1:
        return np.repeat(reciprocal_groups(recording.channels)[None], len(press), axis=0)
    return np.repeat(with_frames_before(press)[:, None], len(recording.channels), axis=1)


def reciprocal_groups(channels: np.ndarray) -> np.ndarray:
    """(M,): labels of channels (M, 4); channels tied by reciprocity have one label."""
    return tied_channels(channels)[0]


def with_frames_before(press: np.ndarray) -> np.ndarray:
    """(N,): the press of every frame; outside presses (-1) the next one, after the last press the
    last."""
    press_frames = np.flatnonzero(press >= 0)
    following = np.searchsorted(press_frames, np.arange(len(press)))
    return press[press_frames[np.minimum(following, len(press_frames) - 1)]]


def folds(touched: np.ndarray, press: np.ndarray, channels: np.ndarray, seed: int) -> np.ndarray:
    """(N,): the fold of each frame; (1, M): of each channel, where nobody touches.

    Whole presses stay together, and untouched frames go with the press that follows; without
    presses, folds are stretches of time. Frames of an untouched skin are repeats, which predict
    each other whatever the model is: their folds are of channels (M, 4), reciprocal ones together.
    """
    if not touched.any():
        fold = np.random.default_rng(seed).permutation(len(channels)) % FOLDS
        return fold[reciprocal_groups(channels)][None]
    count = int(press.max(initial=-1)) + 1
    if count < 2:
        return np.arange(len(press)) * FOLDS // len(press)
    order = np.random.default_rng(seed).permutation(count)
    press_fold = np.empty(count, int)
    press_fold[order] = np.arange(count) % FOLDS
    frame_fold = press_fold[with_frames_before(np.where(touched, press, -1))]
    first_touched = np.flatnonzero(touched)[0]
    frame_fold[:first_touched] = np.arange(first_touched) % FOLDS
    return frame_fold


@dataclass(frozen=True)
class HeldOut:
    """A prediction of readings that were left out: chi2 (N,) and log_density (N,) of every frame,
    in nats up to a constant; error (N, M): observed less predicted, whitened; residual (N, M): the
    same in the recording's unit; reading_count: the number of readings."""

    chi2: np.ndarray
    log_density: np.ndarray
    error: np.ndarray
    residual: np.ndarray
    reading_count: int

    @property
    def rms(self) -> float:
        """Root mean square error of a reading, in the recording's unit."""
        return float(np.sqrt((self.residual**2).sum() / max(self.reading_count, 1)))

    @property
    def chi2_per_dof(self) -> float:
        """Chi squared over the number of readings."""
        return float(self.chi2.sum() / max(self.reading_count, 1))

    def gain(self, rival: "HeldOut") -> tuple[float, float]:
        """Log density above a rival's, and its standard error by noise alone: |d| for predictions
        whose whitened difference has the length |d|."""
        difference = self.error - rival.error
        return float((self.log_density - rival.log_density).sum()), float(
            np.sqrt((difference**2).sum())
        )


@dataclass(frozen=True)
class CrossValidation(HeldOut):
    """Readings predicted in turn, each fold by a fit to the others.

    predictive_chi2: sum over the folds of the squared error in the covariance of its prediction,
    that of the readings and of the coordinates fitted to the others, for a fit that is linear in
    its coordinates and at its optimum; predictive_dof: degrees of freedom of the chi squared
    distribution that, scaled to the mean `reading_count`, has the variance of this sum.
    """

    predictive_chi2: float
    predictive_dof: float

    def p_value(self, noise_dof: float) -> float:
        """Probability of a `predictive_chi2` at least as large, if the fit is right.

        noise_dof: degrees of freedom of the noise's scale. The covariance of the readings must hold
        no discrepancy, with which any misfit is probable. Two approximations: the fit is taken as
        linear; and the sum, whose terms have chi squared distributions but correlate, as every
        reading is both predicted and fitted, as having the one that its mean and variance suggest,
        so that its ratio to the noise's scale has Fisher's.
        """
        ratio = self.predictive_chi2 / max(self.reading_count, 1)
        return float(f.sf(ratio, self.predictive_dof, max(noise_dof, 1.0)))


def held_out(fit: Fit, fold: np.ndarray) -> CrossValidation:
    """Cross-validation: every frame predicted by a fit to the other folds (N,), or every channel by
    one to the other folds (1, M).

    The density includes the uncertainty of the coordinates to first order. A frame's error is that
    of its whitened readings, from which its correlation with other frames is removed.
    """
    size, by_channel = len(fit.theta), fold.ndim == 2
    jacobian_by_channel = np.swapaxes(fit.jacobian, 1, 2) if by_channel else None
    label = fold[0] if by_channel else fold
    total = fit.information + np.diag(fit.prior)
    log_density, chi2 = np.zeros(len(label)), np.zeros(len(label))
    error, plain_error = np.zeros((2, *(fit.residual.T if by_channel else fit.residual).shape))
    whitening = fit.problem.whitening
    predictive_chi2, precisions = 0.0, []
    for fold_label in np.unique(label):
        rows = label == fold_label
        jacobian = (
            fit.slopes.full(rows) if jacobian_by_channel is None else jacobian_by_channel[:, rows]
        )
        fold_columns = jacobian.reshape(size, -1)
        information = fold_columns @ fold_columns.T
        precision = total - information + RIDGE * np.diag(np.diag(total))
        root = inverse_root(precision)
        residual = _refitted(fit, rows[None] if by_channel else rows[:, None], precision)
        fold_residual = (fit.residual.T if by_channel else fit.residual)[rows]
        deleted_slope = root.T @ (fold_columns @ fold_residual.ravel())
        predictive_chi2 += (fold_residual**2).sum() + deleted_slope @ deleted_slope
        precisions.append(information + information @ root @ root.T @ information)
        fold_error = (residual.T if by_channel else residual)[rows]
        plain_residual = whitening.unwhitened(residual)
        plain_error[rows] = (plain_residual.T if by_channel else plain_residual)[rows]
        error_columns = jacobian.transpose(1, 2, 0) @ root
        chi2[rows] = (fold_error**2).sum(axis=1)
        error[rows] = fold_error
        gram = error_columns.transpose(0, 2, 1) @ error_columns + np.eye(size)
        slope = np.einsum("nmp,nm->np", error_columns, fold_error)
        solution = np.linalg.solve(gram, slope[..., None])[..., 0]
        log_density[rows] = -0.5 * (
            chi2[rows] - (slope * solution).sum(axis=1) + np.linalg.slogdet(gram)[1]
        )
    return CrossValidation(
        chi2,
        log_density,
        error,
        plain_error.T if by_channel else plain_error,
        whitening.size,
        float(predictive_chi2),
        _predictive_dof(whitening.size, precisions, fit.covariance),
    )


def _predictive_dof(count: int, precisions: list[np.ndarray], covariance: np.ndarray) -> float:
    """`predictive_dof` of a linear fit to `count` readings; covariance (P, P): of its coordinates;
    precisions: of every fold, G + G C G (P, P) with its information G and the covariance C of the
    coordinates without it.

    Errors of folds k and l correlate by minus the product of their slopes with the covariance of
    the coordinates, so that the variance of the sum is 2 (count + sum of tr(K_k S K_l S) over
    pairs), K these precisions and S the covariance.
    """
    scaled = [precision @ covariance for precision in precisions]
    total = np.sum(scaled, axis=0)
    shared = np.sum(total * total.T) - sum(np.sum(matrix * matrix.T) for matrix in scaled)
    return float(count / (1.0 + max(shared, 0.0) / max(count, 1)))


def _refitted(fit: Fit, held_out_mask: np.ndarray, precision: np.ndarray) -> np.ndarray:
    """(N, M): the residual of a fit to all readings but those of a mask, (N, 1) or (1, M), by steps
    of Gauss and Newton, damped by Marquardt's method where these fail, with the slopes of the whole
    fit; precision (P, P): of theta without these readings."""
    theta, residual, prior = fit.theta, fit.residual, fit.prior
    cost = float((np.where(held_out_mask, 0.0, residual) ** 2).sum() + prior @ theta**2)
    root, damping = inverse_root(precision), 0.0
    for _ in range(MAX_REFIT_STEPS):
        slope = fit.slopes.products_with(np.where(held_out_mask, 0.0, residual)) - prior * theta
        step = np.clip(root @ (root.T @ slope), -MAX_STEP, MAX_STEP)
        if step @ slope < OPTIMUM_TOLERANCE:
            break
        trial_theta = theta + step
        try:
            trial_residual = fit.problem.residual(trial_theta, fit.effects)
            trial_cost = float(
                (np.where(held_out_mask, 0.0, trial_residual) ** 2).sum() + prior @ trial_theta**2
            )
        except InputError:
            trial_cost = np.inf
        if trial_cost < cost:
            theta, residual, cost = trial_theta, trial_residual, trial_cost
            continue
        damping = max(damping * DAMPING_UP, MIN_REJECTED_DAMPING)
        root = inverse_root(precision + damping * np.diag(np.diag(precision)))
    return residual


def gain_over_presses(
    prediction: HeldOut, baseline: HeldOut, units: np.ndarray, pressed: np.ndarray
) -> float:
    """Gain of log density of a prediction over a baseline, less its standard error by the scatter
    over presses, in nats.

    units (N,) int: the press with which a frame counts (`error_units`); pressed (N,) bool: frames
    of touches whose state is known, by which presses count. The gain is negative where some presses
    lose what others gain, and 0 where one press has all of it: the next press may go either way.
    Infinite with fewer than two presses: folds are of channels or of stretches of time then.
    """
    presses = np.unique(units[pressed])
    if len(presses) < 2:
        return np.inf
    frame_gain = prediction.log_density - baseline.log_density
    gain = np.array([frame_gain[units == press].sum() for press in presses])
    return float(gain.sum() - np.sqrt(len(gain) * gain.var(ddof=1)))


def predict_unseen(fit: Fit) -> HeldOut:
    """The prediction of the readings of a fit's problem by theta, which was fitted to others, in
    their covariance. A channel of unknown offset has the mean of its residual removed."""
    readings, whitening = fit.problem.readings, fit.problem.whitening
    residual = np.where(whitening.mask, readings - fit.voltage(), 0.0)
    error = whitening(residual)
    unknown_offset = np.isinf(whitening.offset_ratio)
    if unknown_offset.any():
        level = residual.sum(axis=0) / np.maximum(whitening.mask.sum(axis=0), 1)
        residual = np.where(whitening.mask & unknown_offset, residual - level, residual)
    chi2 = (error**2).sum(axis=1)
    log_density = -0.5 * (chi2 + whitening.log_determinant / len(chi2))
    return HeldOut(chi2, log_density, error, residual, whitening.size)
