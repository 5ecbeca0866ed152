"""Two exchanged columns of a recording.

Reciprocity relates each column to a partner. Where two columns are exchanged, two pairs of partners
mismatch and all others match, and both match again after the exchange. An exchange of the partners
in place of the two looks the same; so do two columns of one level with the same error.
"""

from itertools import product

import numpy as np

from eitskin.data.check.measures import clipped_channels, identity_readings, lost_readings
from eitskin.data.recording import Recording
from eitskin.physics.protocol import reciprocal_channels

MIN_PAIRS = 10  # of reciprocal channels, for the third largest mismatch to be a usual one
BROKEN_FACTOR, MENDED_FACTOR = 5.0, 2.0  # times the third largest mismatch: before and after


def exchanged_channels(recording: Recording) -> list[tuple[int, int]]:
    """Pairs of rows of the channel table of which one pair seems to be exchanged.

    None where reciprocity holds, mismatches in other ways too, or because of stuck or clipped
    channels.
    """
    pairs, signs = reciprocal_channels(recording.channels)
    if len(pairs) < MIN_PAIRS or recording.metadata["values"] == "difference":
        return []
    values, signs = identity_readings(recording, signs)

    def pair_mismatch(values: np.ndarray) -> np.ndarray:
        return np.nan_to_num(np.abs(signs * values[pairs[:, 0]] - values[pairs[:, 1]]))

    mismatch = pair_mismatch(values[0])
    *_, third_pair, second_pair, worst_pair = np.argsort(mismatch, kind="stable")
    usual_mismatch = mismatch[third_pair]
    if mismatch[second_pair] <= BROKEN_FACTOR * usual_mismatch:
        return []
    ceiling, stuck = clipped_channels(recording), lost_readings(recording).stuck
    faulty_channels = stuck if ceiling is None else np.union1d(stuck, ceiling.channels)
    if np.isin(pairs[[worst_pair, second_pair]], faulty_channels).any():
        return []
    exchanges = []
    for rows in product(pairs[worst_pair], pairs[second_pair]):
        swapped = values[0].copy()
        swapped[list(rows)] = swapped[list(rows[::-1])]
        if (
            pair_mismatch(swapped)[[worst_pair, second_pair]].max()
            <= MENDED_FACTOR * usual_mismatch
        ):
            exchanges.append((int(min(rows)), int(max(rows))))
    return sorted(exchanges)
