"""Two columns of a table that stand in each other's place.

Reciprocity ties each column to another. Where two are exchanged, two of these pairs break and the
rest hold, and each pair holds again with the other's reading. That the partners were exchanged in
place of the two looks the same; so do two columns of one level that are off alike.
"""

from itertools import product

import numpy as np

from eitskin.data.check.measures import clipped, identity_readings, lost
from eitskin.data.recording import Recording
from eitskin.physics.protocol import reciprocal_channels

LEAST_PAIRS = 10
CLEAR, ALIKE = 5.0, 2.0  # times what the next pair is off by


def exchanged(recording: Recording) -> list[tuple[int, int]]:
    """The rows of the channel table of which two, any one of these, seem to be exchanged; none
    where reciprocity holds, is broken in other ways too, or by channels that are stuck or clipped.
    """
    pairs, signs = reciprocal_channels(recording.channels)
    if len(pairs) < LEAST_PAIRS or recording.metadata["values"] == "difference":
        return []
    values, signs = identity_readings(recording, signs)

    def off(values: np.ndarray) -> np.ndarray:
        return np.nan_to_num(np.abs(signs * values[pairs[:, 0]] - values[pairs[:, 1]]))

    broken = off(values[0])
    *_, third, second, first = np.argsort(broken, kind="stable")
    most = broken[third]
    if broken[second] <= CLEAR * most:
        return []
    stop, stuck = clipped(recording), lost(recording).stuck
    faulty = stuck if stop is None else np.union1d(stuck, stop.channels)
    if np.isin(pairs[[first, second]], faulty).any():
        return []
    found = []
    for rows in product(pairs[first], pairs[second]):
        mended = values[0].copy()
        mended[list(rows)] = mended[list(rows[::-1])]
        if off(mended)[[first, second]].max() <= ALIKE * most:
            found.append((int(min(rows)), int(max(rows))))
    return sorted(found)
