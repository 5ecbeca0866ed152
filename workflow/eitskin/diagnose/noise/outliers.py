"""Readings that are none: loud frames, in which every channel shouts, and single spikes.

Both are told from what is left of residuals beside the courses that skin and instrument take: the
worst first, each time with what is left anew, and scales by medians, which strays do not move.
"""

import numpy as np

MAD = 0.6745  # median absolute deviation of a normal variate, in sd
LOUD = 4.0  # times the typical size of a frame
MOST_LOUD = 0.1  # of the frames
SPIKE = 6.0  # sd
ALONE = 5.0  # times the largest of its frame that is none, of a spike that misfit might be
MOST_TOGETHER = 3  # such spikes, in one frame
MOST_SPIKES = 0.02  # of the readings
BESIDE = 0.5  # of the largest in a group of channels, from which another is a spike as well
FREE = 0.02  # least share of a reading that the courses leave; one with less is not judged


def loud_frames(values: np.ndarray, courses: np.ndarray) -> np.ndarray:
    """(N,) bool: frames of values (N, C), NaN where lost, that are several times as large as the
    typical one beside the courses (N, K), orthonormal. None where more than a tenth would be."""
    count = len(values)
    scale = spread(values - np.nanmedian(values, axis=0))
    scaled = np.where(np.isfinite(values), values, 0.0) / scale
    lost = np.isnan(values)
    bare = lost.all(axis=1)
    quiet = ~bare
    while True:
        basis = np.linalg.qr(courses[quiet])[0]
        free = 1.0 - np.sum(basis**2, axis=1)
        left = scaled[quiet] - basis @ (basis.T @ scaled[quiet])
        left[lost[quiet]] = np.nan
        size = np.full(count, np.nan)
        with np.errstate(invalid="ignore"):
            median = np.nanmedian(np.abs(left), axis=1) / np.sqrt(np.maximum(free, FREE))
        size[quiet] = np.where(free > FREE, median, np.nan)
        worst = int(np.nanargmax(size))
        if not size[worst] > LOUD * np.nanmedian(size):
            return ~quiet & ~bare
        quiet[worst] = False
        if np.sum(~quiet & ~bare) > MOST_LOUD * count:
            return np.zeros(count, bool)


def spikes(values: np.ndarray, courses: np.ndarray, alone: bool = False) -> np.ndarray:
    """(N, C) bool: values (N, C), NaN where lost, that stand far above what is left of their column
    and of their frame beside the courses (N, K), orthonormal; no more than two in a row.

    alone: of what misfit might be as well, only few in a frame, far above all else there.
    """
    hat = np.eye(len(values)) - courses @ courses.T
    lost = np.isnan(values)
    filled = np.where(lost, 0.0, values)
    aside = lost.copy()
    left = np.empty_like(values)
    free = np.empty_like(values)
    for k in range(values.shape[1]):
        left[:, k], free[:, k] = _beside(hat, filled[:, k], aside[:, k])
    there = np.where(lost, np.nan, left)
    loudness = np.maximum(1.0, spread((there / spread(there)).T))[:, None]
    changed = np.arange(values.shape[1])
    while len(changed):
        there = np.where(aside[:, changed], np.nan, left[:, changed])
        height = np.abs(there) / (loudness * spread(there))
        height[np.isnan(height) | (free[:, changed] < FREE)] = 0.0
        worst = np.argmax(height, axis=0)
        high = height[worst, np.arange(len(changed))] > SPIKE
        changed, worst = changed[high], worst[high]
        aside[worst, changed] = True
        for k in changed:
            left[:, k], free[:, k] = _beside(hat, filled[:, k], aside[:, k])
    found = aside & ~lost
    if alone:
        height = np.where(lost, 0.0, np.abs(left)) / spread(np.where(aside, np.nan, left))
        others = np.where(aside, 0.0, height).max(axis=1, keepdims=True)
        found &= (height > ALONE * others) & (found.sum(axis=1, keepdims=True) <= MOST_TOGETHER)
    run = found[:-2] & found[1:-1] & found[2:]
    for shift in range(3):
        found[shift : len(found) - 2 + shift] &= ~run
    return found


def spiked(
    values: np.ndarray, odd: np.ndarray, even: np.ndarray, courses: np.ndarray
) -> np.ndarray:
    """(N, M) bool: readings that are spikes, of residuals (N, M), NaN where lost.

    odd (M, P), even (M, M - P): as `parity` gives them; spikes show in the odd half, to which no
    misfit of the skin's physics gets, and the channels that it ties tell whose they are. Without an
    odd half they show in the channels. None where too many readings look like spikes.
    """
    if odd.shape[1] == 0:
        found = spikes(values, courses, alone=True)
    else:
        lost = np.isnan(values)
        filled = np.where(lost, 0.0, values)
        contrasts = filled @ odd
        contrasts[(lost.astype(float) @ (odd != 0.0)) > 0] = np.nan
        suspect = spikes(contrasts, courses)
        hat = np.eye(len(values)) - courses @ courses.T
        label = np.argmax(np.abs(even), axis=1)
        sign = np.sign(even[np.arange(len(even)), label])
        found = np.zeros(values.shape, bool)
        for one in np.unique(label[(odd[:, suspect.any(axis=0)] != 0.0).any(axis=1)]):
            group = np.flatnonzero(label == one)
            rows = suspect[:, (odd[group] != 0.0).any(axis=0)].any(axis=1)
            left = [_beside(hat, filled[:, k], rows | lost[:, k])[0][rows] for k in group]
            signed = np.array(left).T * sign[group]
            # Two channels differ from their mean alike: then the smaller one is the one at rest.
            middle = np.median(signed, axis=1, keepdims=True) if len(group) > 2 else 0.0
            away = signed - middle
            struck = np.abs(away) > BESIDE * np.abs(away).max(axis=1, keepdims=True)
            # What is in both with opposite signs is no spike but how they differ.
            one_sign = (away > 0.0).any(axis=1, where=struck) != (away < 0.0).any(
                axis=1, where=struck
            )
            found[np.ix_(rows, group)] = struck & one_sign[:, None]
        found &= ~lost
    return found if found.mean() <= MOST_SPIKES else np.zeros_like(found)


def _beside(
    hat: np.ndarray, values: np.ndarray, aside: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(N,) what values (N,) have beside the courses that those not set aside take, in units of what
    the courses leave free, which is the other (N,). hat (N, N): the courses' complement."""
    left, free = hat @ values, np.diag(hat).copy()
    rows = np.flatnonzero(aside)
    if len(rows):
        own = hat[np.ix_(rows, rows)] + 1e-9 * np.eye(len(rows))
        away = np.linalg.solve(own, np.column_stack([left[rows], hat[rows]]))
        left = left - hat[:, rows] @ away[:, 0]
        free = free - np.sum(hat[:, rows] * away[:, 1:].T, axis=1)
        left[rows], free[rows] = away[:, 0], 1.0
    return left / np.sqrt(np.maximum(free, FREE)), free


def spread(values: np.ndarray) -> np.ndarray:
    """(C,): sd of each column of (N, C), NaN where lost, by its median, never 0."""
    values = np.where(np.isnan(values).all(axis=0), 0.0, values)
    size = np.nanmedian(np.abs(values), axis=0) / MAD
    return np.maximum(size, 1e-9 * np.nanmax(size))
