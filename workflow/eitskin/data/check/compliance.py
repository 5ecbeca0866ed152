"""Drives whose current is too low: a source at its compliance, or with a bad contact.

Reciprocity ties the reading of a pair b under a drive a to that of the pair a under the drive b. A
drive that gives the share f of its current makes all its readings low by f, and none of those that
its electrodes measure: log |v_ab / v_ba| = log f_a - log f_b. An amplifier that reads the pair a
too high leaves the same mark.
"""

from dataclasses import dataclass

import numpy as np

from eitskin.data.check.measures import NORMAL, channel_noise, identity_readings
from eitskin.data.recording import Recording
from eitskin.physics.protocol import reciprocal_channels

LOW = 0.03  # of the current; boards' drives differ by less
CLEAR = 6.0  # standard deviations
EXPLAINED = 0.5  # of the break of reciprocity
ROUNDS = 20
LEAST_DRIVES = 6


@dataclass(frozen=True)
class Weak:
    """Drives (source, sink) lower than the others, the lowest first; the share of the median
    drive's current that each gives; how much of the break of reciprocity, squared and in units of
    its noise, the drives explain.
    """

    drives: tuple[tuple[int, int], ...]
    shares: tuple[float, ...]
    explained: float


def weak(recording: Recording) -> Weak | None:
    """The weak drives; None without any, without reciprocal pairs or where other things break it
    more.
    """
    channels = recording.channels
    pairs, signs = reciprocal_channels(channels)
    if not len(pairs) or recording.metadata["values"] == "difference":
        return None
    size = np.abs(identity_readings(recording, signs)[0][0])
    first, second = size[pairs[:, 0]], size[pairs[:, 1]]
    kept = np.isfinite(first + second) & (first > 0) & (second > 0)
    first, second, pairs = first[kept], second[kept], pairs[kept]
    drives, drive = np.unique(np.sort(channels[:, :2], axis=1), axis=0, return_inverse=True)
    if len(drives) < LEAST_DRIVES or len(pairs) < 2 * len(drives):
        return None
    broken = np.log(first / second)
    design = np.zeros((len(pairs), len(drives)))
    at = np.arange(len(pairs))
    design[at, drive[pairs[:, 0]]] += 1.0
    design[at, drive[pairs[:, 1]]] -= 1.0
    precision = _precision(recording, pairs, first, second)
    share, spread = _robust(design, broken, precision)
    low = share - np.median(share)
    chosen = np.flatnonzero((low < np.log1p(-LOW)) & (low < -CLEAR * spread))
    others = np.delete(low, chosen)
    if not len(chosen) or low[chosen].max() > -CLEAR * NORMAL * np.median(np.abs(others)):
        return None
    left = (broken - design @ share) * precision
    explained = 1.0 - float((left**2).sum() / ((broken * precision) ** 2).sum())
    if explained < EXPLAINED:
        return None
    chosen = chosen[np.argsort(low[chosen], kind="stable")]
    named = tuple((int(a), int(b)) for a, b in drives[chosen])
    return Weak(named, tuple(np.exp(low[chosen]).tolist()), explained)


def _precision(
    recording: Recording, pairs: np.ndarray, first: np.ndarray, second: np.ndarray
) -> np.ndarray:
    """(P,): 1 / sd of each logarithm by noise, at the most that of 0.1 % noise."""
    untouched = recording.readings[~recording.frames["touch"].to_numpy(dtype=bool)]
    noise = np.zeros(untouched.shape[1])
    if len(untouched) > 2:
        noise = channel_noise(untouched) / np.sqrt(len(untouched))
    relative = np.hypot(noise[pairs[:, 0]] / first, noise[pairs[:, 1]] / second)
    return 1.0 / np.hypot(relative, 1e-3)


def _robust(
    design: np.ndarray, values: np.ndarray, precision: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Least absolute deviations by reweighting: (D,) and its standard deviations (D,)."""
    weight = precision**2
    for _ in range(ROUNDS):
        normal = design.T @ (weight[:, None] * design)
        inverse = np.linalg.pinv(normal, hermitian=True)
        found = inverse @ (design.T @ (weight * values))
        off = np.abs(values - design @ found) * precision
        scale = max(NORMAL * float(np.median(off)), 1e-6)
        weight = precision**2 / np.maximum(off / scale, 1.0)
    return found, scale * np.sqrt(np.maximum(np.diag(inverse), 0.0))
