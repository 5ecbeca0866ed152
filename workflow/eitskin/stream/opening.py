"""Electrodes that are dead before anything is measured, told by the opening frames alone."""

import numpy as np

RECIPROCAL = 0.25  # two readings of one reciprocal pair differ by less, of the larger one
MOST = 0.5  # of an electrode's channels that may be silent or break reciprocity


def dead(frames: np.ndarray, table: np.ndarray) -> list[int]:
    """Electrodes to which more than half of their channels point, the worst first.

    Of opening frames (n, M) by a table of channels (M, 4). A channel is suspect where it is never
    read, where it stands still although most others do not, and where its reciprocal one, the two
    pairs exchanged, reads something else (Geselowitz 1971). What points to one electrode points to
    no other any more.
    """
    suspect = silent(frames) | unreciprocal(frames, table)
    users = np.array([(table == k).any(axis=1) for k in range(int(table.max()) + 1)])
    counted = np.ones(len(table), dtype=bool)
    found: list[int] = []
    while True:
        shares = (users & suspect & counted).sum(axis=1) / (users & counted).sum(axis=1).clip(1)
        worst = int(shares.argmax())
        if shares[worst] <= MOST:
            return found
        found.append(worst)
        counted &= ~users[worst]


def silent(frames: np.ndarray) -> np.ndarray:
    """(M,): channels that are never read, and those without any noise where most others have it."""
    there = np.isfinite(frames)
    highest = np.where(there, frames, -np.inf).max(axis=0)
    lowest = np.where(there, frames, np.inf).min(axis=0)
    still = highest - lowest == 0.0
    if len(frames) < 2 or np.median(still) == 1.0:
        still = np.zeros_like(still)
    return ~there.any(axis=0) | still


def unreciprocal(frames: np.ndarray, table: np.ndarray) -> np.ndarray:
    """(M,): channels whose size is not that of the reciprocal one; False where there is none."""
    size = np.abs(np.nanmean(np.where(np.isfinite(frames).any(axis=0), frames, 0.0), axis=0))
    pairs = [tuple(sorted(pair)) for pair in table[:, :2].tolist()]
    others = [tuple(sorted(pair)) for pair in table[:, 2:].tolist()]
    place = {both: k for k, both in enumerate(zip(pairs, others, strict=True))}
    twin = np.array(
        [place.get((b, a), k) for k, (a, b) in enumerate(zip(pairs, others, strict=True))]
    )
    return np.abs(size - size[twin]) > RECIPROCAL * np.maximum(size, size[twin])
