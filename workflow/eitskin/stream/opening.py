"""What the opening frames say of themselves: dead electrodes, a skin that is being touched."""

import numpy as np

from eitskin.errors import InputError
from eitskin.exported.electrodes import channels_using
from eitskin.exported.predictor import Predictor
from eitskin.stream.untouched import Untouched

RECIPROCAL = 0.25  # two readings of one reciprocal pair differ by less, of the larger one
MOST = 0.5  # of an electrode's channels that may be silent or break reciprocity
STEADY = 1.5  # gates: noise of 208 channels exceeds it never, a moving finger does at once


def dead(frames: np.ndarray, table: np.ndarray) -> list[int]:
    """Electrodes to which more than half of their channels point, the worst first.

    Of opening frames (n, M) by a table of channels (M, 4). A channel is suspect where it is never
    read or always 0, and where its reciprocal one, the two pairs exchanged, reads something else
    (Geselowitz 1971); a reading that stands still may be a quiet one within a converter's step.
    What points to one electrode points to no other any more.
    """
    suspect = silent(frames) | unreciprocal(frames, table)
    users = np.array([channels_using(table, [k]) for k in range(int(table.max()) + 1)])
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
    """(M,): channels that are never read, or always 0."""
    return np.asarray((~np.isfinite(frames) | (frames == 0.0)).all(axis=0))


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


def check(frames: np.ndarray, predictor: Predictor) -> None:
    """Raise InputError where opening frames (n, M), NaN where not read, move, and where they differ
    from the untouched skin trained on as a touch does."""
    expected = "an untouched skin: let go of it and start anew"
    if np.isnan(frames).all(axis=1).any():
        raise InputError("recording", "opening frames", "one without a reading", expected)
    own = Untouched(frames, 0.0, predictor.channels, predictor.scale)
    for number, frame in enumerate(frames):
        if predictor.touched(own.change(frame), STEADY):
            found = f"frame {number} unlike the others"
            raise InputError("recording", "opening frames", found, expected)
    if predictor.untouched is None:
        return
    trained = Untouched(predictor.untouched[None], 0.0, predictor.channels, predictor.scale)
    change = trained.change(own.level)
    change -= trained.moved(change) * trained.level
    if predictor.activity(change) < predictor.weakest:
        return
    whole, missing = predictor.filled(change)
    if predictor.familiar(whole) and not predictor.out_of_range(predictor.estimate(whole, missing)):
        raise InputError("recording", "opening frames", "a touch like those trained on", expected)
