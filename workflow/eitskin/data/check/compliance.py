"""Drives whose current is too low: a source at its compliance limit, or a bad contact.

Reciprocity equates the reading of a pair b under a drive a with that of the pair a under the drive
b. A drive that gives the share f of its current lowers all its readings by f, and none of those
that its electrodes measure: log |v_ab / v_ba| = log f_a - log f_b. An amplifier that reads the pair
a too high has the same effect.
"""

from dataclasses import dataclass

import numpy as np

from eitskin.data.check.measures import NORMAL, channel_noise, identity_readings
from eitskin.data.recording import Recording
from eitskin.physics.protocol import reciprocal_channels

MIN_LOSS = 0.03  # of the current; boards' drives differ by less
MIN_TOTAL_SD = 6.0  # standard deviations of a drive's loss: one of some hundred drives by chance
MIN_EXPLAINED = 0.5  # of the squared misfit of reciprocity
ROUNDS = 20  # of reweighting, beyond convergence
MIN_DRIVES = 6  # for a median drive


@dataclass(frozen=True)
class WeakDrives:
    """Drives (source, sink) of low current, the lowest first.

    `shares` are their currents over the median drive's; `explained` is the share of the squared
    misfit of reciprocity, in units of its noise, that the drives' currents explain.
    """

    drives: tuple[tuple[int, int], ...]
    shares: tuple[float, ...]
    explained: float


def weak_drives(recording: Recording) -> WeakDrives | None:
    """The weak drives; None without any, without reciprocal pairs, and where weak drives do not
    explain most of the misfit of reciprocity."""
    channels = recording.channels
    pairs, signs = reciprocal_channels(channels)
    if not len(pairs) or recording.metadata["values"] == "difference":
        return None
    sizes = np.abs(identity_readings(recording, signs)[0][0])
    forward_size, reciprocal_size = sizes[pairs[:, 0]], sizes[pairs[:, 1]]
    is_usable = (
        np.isfinite(forward_size + reciprocal_size) & (forward_size > 0) & (reciprocal_size > 0)
    )
    forward_size, reciprocal_size, pairs = (
        forward_size[is_usable],
        reciprocal_size[is_usable],
        pairs[is_usable],
    )
    drives, drive = np.unique(np.sort(channels[:, :2], axis=1), axis=0, return_inverse=True)
    if len(drives) < MIN_DRIVES or len(pairs) < 2 * len(drives):
        return None
    log_ratios = np.log(forward_size / reciprocal_size)
    design = np.zeros((len(pairs), len(drives)))
    pair_rows = np.arange(len(pairs))
    design[pair_rows, drive[pairs[:, 0]]] += 1.0
    design[pair_rows, drive[pairs[:, 1]]] -= 1.0
    precision = _precision(recording, pairs, forward_size, reciprocal_size)
    log_shares, log_share_sd = _least_absolute_deviations(design, log_ratios, precision)
    relative_log_shares = log_shares - np.median(log_shares)
    weak_rows = np.flatnonzero(
        (relative_log_shares < np.log1p(-MIN_LOSS))
        & (relative_log_shares < -MIN_TOTAL_SD * log_share_sd)
    )
    usual_log_shares = np.delete(relative_log_shares, weak_rows)
    if not len(weak_rows) or relative_log_shares[
        weak_rows
    ].max() > -MIN_TOTAL_SD * NORMAL * np.median(np.abs(usual_log_shares)):
        return None
    residuals = (log_ratios - design @ log_shares) * precision
    explained = 1.0 - float((residuals**2).sum() / ((log_ratios * precision) ** 2).sum())
    if explained < MIN_EXPLAINED:
        return None
    weak_rows = weak_rows[np.argsort(relative_log_shares[weak_rows], kind="stable")]
    weak_pairs = tuple((int(a), int(b)) for a, b in drives[weak_rows])
    return WeakDrives(weak_pairs, tuple(np.exp(relative_log_shares[weak_rows]).tolist()), explained)


def _precision(
    recording: Recording, pairs: np.ndarray, forward_size: np.ndarray, reciprocal_size: np.ndarray
) -> np.ndarray:
    """(P,): 1 / sd of each log ratio by noise, at most 1000 (0.1 % noise)."""
    untouched_readings = recording.readings[~recording.frames["touch"].to_numpy(dtype=bool)]
    noise = np.zeros(untouched_readings.shape[1])
    if len(untouched_readings) > 2:
        noise = channel_noise(untouched_readings) / np.sqrt(len(untouched_readings))
    relative_sd = np.hypot(noise[pairs[:, 0]] / forward_size, noise[pairs[:, 1]] / reciprocal_size)
    return 1.0 / np.hypot(relative_sd, 1e-3)


def _least_absolute_deviations(
    design: np.ndarray, values: np.ndarray, precision: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients (D,) of a Huber-like regression by iterative reweighting, and their standard
    deviations (D,)."""
    weight = precision**2
    for _ in range(ROUNDS):
        normal_matrix = design.T @ (weight[:, None] * design)
        inverse = np.linalg.pinv(normal_matrix, hermitian=True)
        coefficients = inverse @ (design.T @ (weight * values))
        deviations = np.abs(values - design @ coefficients) * precision
        scale = max(NORMAL * float(np.median(deviations)), 1e-6)
        weight = precision**2 / np.maximum(deviations / scale, 1.0)
    return coefficients, scale * np.sqrt(np.maximum(np.diag(inverse), 0.0))
