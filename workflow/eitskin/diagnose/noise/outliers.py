"""Readings that measure nothing: loud frames, in which every channel is far off, and single spikes.

Both stand out of the residuals beside the time series that skin and instrument take: the largest is
rejected first, each time by the residuals of the rest, and scales are medians, which outliers do
not move.
"""

import numpy as np

MAD = 0.6745  # median absolute deviation of a normal variate, in sd
LOUD = 4.0  # times the typical size of a frame: the median of tens of channels scatters by tenths
MOST_LOUD = 0.1  # of the frames: more are no exception
SPIKE = 6.0  # sd: two in 10^9 normal readings
ISOLATED = 5.0  # times the largest regular reading of its frame, of a spike that misfit might be
MOST_ISOLATED = 3  # such spikes, in one frame
MOST_SPIKES = 0.04  # of the readings: more are no exception
COMPARABLE = 0.5  # of the largest in a group of channels, from which another is a spike as well
LEAST_FREE = 0.02  # of a reading, that the time series leave free; one with less is not tested
RIDGE = 1e-9  # of a unit diagonal, for readings that the time series explain wholly
LEAST_SD = 1e-9  # of the largest in all columns, for a column without scatter


def loud_frames(values: np.ndarray, time_modes: np.ndarray) -> np.ndarray:
    """(N,) bool: frames of values (N, C), NaN where lost, that are LOUD times as large as the
    typical one beside time modes (N, K), orthonormal. None where more than MOST_LOUD would be."""
    count = len(values)
    scale = robust_sd(values - np.nanmedian(values, axis=0))
    scaled = np.where(np.isfinite(values), values, 0.0) / scale
    lost = np.isnan(values)
    empty = lost.all(axis=1)
    quiet = ~empty
    while True:
        basis = np.linalg.qr(time_modes[quiet])[0]
        free = 1.0 - np.sum(basis**2, axis=1)
        residual = scaled[quiet] - basis @ (basis.T @ scaled[quiet])
        residual[lost[quiet]] = np.nan
        size = np.full(count, np.nan)
        with np.errstate(invalid="ignore"):
            median = np.nanmedian(np.abs(residual), axis=1) / np.sqrt(np.maximum(free, LEAST_FREE))
        size[quiet] = np.where(free > LEAST_FREE, median, np.nan)
        loudest = int(np.nanargmax(size))
        if not size[loudest] > LOUD * np.nanmedian(size):
            return ~quiet & ~empty
        quiet[loudest] = False
        if np.sum(~quiet & ~empty) > MOST_LOUD * count:
            return np.zeros(count, bool)


def reading_spikes(
    residual: np.ndarray, odd: np.ndarray, even: np.ndarray, time_modes: np.ndarray
) -> np.ndarray:
    """(N, M) bool: spikes of residuals (N, M), NaN where lost, beside time modes (N, K).

    odd (M, P), even (M, M - P): the halves of reciprocity (`parity`); spikes show in the odd half,
    to which no misfit of the skin's physics gets, and the channels that it ties tell whose they
    are. Without an odd half they show in the channels. None where more than MOST_SPIKES would be.
    """
    if odd.shape[1] == 0:
        spikes = column_spikes(residual, time_modes, isolated=True)
    else:
        lost = np.isnan(residual)
        filled = np.where(lost, 0.0, residual)
        contrasts = filled @ odd
        contrasts[(lost.astype(float) @ (odd != 0.0)) > 0] = np.nan
        suspect = column_spikes(contrasts, time_modes)
        hat = np.eye(len(residual)) - time_modes @ time_modes.T
        label = np.argmax(np.abs(even), axis=1)
        sign = np.sign(even[np.arange(len(even)), label])
        spikes = np.zeros(residual.shape, bool)
        for group_label in np.unique(label[(odd[:, suspect.any(axis=0)] != 0.0).any(axis=1)]):
            group = np.flatnonzero(label == group_label)
            rows = suspect[:, (odd[group] != 0.0).any(axis=0)].any(axis=1)
            deviation = [
                _deleted_residual(hat, filled[:, k], rows | lost[:, k])[0][rows] for k in group
            ]
            signed = np.array(deviation).T * sign[group]
            spikes[np.ix_(rows, group)] = _spikes_in_group(signed)
        spikes &= ~lost
    return spikes if spikes.mean() <= MOST_SPIKES else np.zeros_like(spikes)


def _spikes_in_group(deviation: np.ndarray) -> np.ndarray:
    """(R, G) bool: which of G channels, tied to one value, are spikes in R suspect frames;
    deviation (R, G): of each, with the sign that ties it."""
    # Two channels differ from their mean alike: then the smaller one is the one at rest.
    middle = np.median(deviation, axis=1, keepdims=True) if deviation.shape[1] > 2 else 0.0
    distance = deviation - middle
    large = np.abs(distance) > COMPARABLE * np.abs(distance).max(axis=1, keepdims=True)
    # What is in both with opposite signs is no spike but how they differ.
    positive = (distance > 0.0).any(axis=1, where=large)
    negative = (distance < 0.0).any(axis=1, where=large)
    return large & (positive != negative)[:, None]


def column_spikes(values: np.ndarray, time_modes: np.ndarray, isolated: bool = False) -> np.ndarray:
    """(N, C) bool: values (N, C), NaN where lost, that stand SPIKE sd above the residuals of their
    column and of their frame beside time modes (N, K), orthonormal; no more than two in a row.

    isolated: of what misfit might be as well, only few in a frame, far above all else there.
    """
    hat = np.eye(len(values)) - time_modes @ time_modes.T
    lost = np.isnan(values)
    filled = np.where(lost, 0.0, values)
    rejected = lost.copy()
    residual = np.empty_like(values)
    free = np.empty_like(values)
    for k in range(values.shape[1]):
        residual[:, k], free[:, k] = _deleted_residual(hat, filled[:, k], rejected[:, k])
    regular = np.where(lost, np.nan, residual)
    loudness = np.maximum(1.0, robust_sd((regular / robust_sd(regular)).T))[:, None]
    columns = np.arange(values.shape[1])
    while len(columns):
        regular = np.where(rejected[:, columns], np.nan, residual[:, columns])
        height = np.abs(regular) / (loudness * robust_sd(regular))
        height[np.isnan(height) | (free[:, columns] < LEAST_FREE)] = 0.0
        rows = np.argmax(height, axis=0)
        high = height[rows, np.arange(len(columns))] > SPIKE
        columns, rows = columns[high], rows[high]
        rejected[rows, columns] = True
        for k in columns:
            residual[:, k], free[:, k] = _deleted_residual(hat, filled[:, k], rejected[:, k])
    spikes = rejected & ~lost
    if isolated:
        sd = robust_sd(np.where(rejected, np.nan, residual))
        height = np.where(lost, 0.0, np.abs(residual)) / sd
        regular_height = np.where(rejected, 0.0, height).max(axis=1, keepdims=True)
        rare = spikes.sum(axis=1, keepdims=True) <= MOST_ISOLATED
        spikes &= (height > ISOLATED * regular_height) & rare
    run = spikes[:-2] & spikes[1:-1] & spikes[2:]
    for shift in range(3):
        spikes[shift : len(spikes) - 2 + shift] &= ~run
    return spikes


def _deleted_residual(
    hat: np.ndarray, values: np.ndarray, rejected: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(N,): residuals of values (N,) beside time modes that are fitted to those not rejected (N,),
    over the root of the share that the modes leave free, and (N,): this share. hat (N, N): the
    projection on the complement of the modes."""
    residual, free = hat @ values, np.diag(hat).copy()
    rows = np.flatnonzero(rejected)
    if len(rows):
        block = hat[np.ix_(rows, rows)] + RIDGE * np.eye(len(rows))
        solution = np.linalg.solve(block, np.column_stack([residual[rows], hat[rows]]))
        residual = residual - hat[:, rows] @ solution[:, 0]
        free = free - np.sum(hat[:, rows] * solution[:, 1:].T, axis=1)
        residual[rows], free[rows] = solution[:, 0], 1.0
    return residual / np.sqrt(np.maximum(free, LEAST_FREE)), free


def robust_sd(values: np.ndarray) -> np.ndarray:
    """(C,): sd of each column of (N, C), NaN where lost, by its median, never 0."""
    values = np.where(np.isnan(values).all(axis=0), 0.0, values)
    sd = np.nanmedian(np.abs(values), axis=0) / MAD
    return np.maximum(sd, LEAST_SD * np.nanmax(sd))
