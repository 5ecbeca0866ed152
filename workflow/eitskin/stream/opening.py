"""Checks of the opening frames: dead electrodes, and a skin that is being touched."""

import numpy as np

from eitskin.errors import InputError
from eitskin.exported.electrodes import channels_using
from eitskin.exported.predictor import Predictor
from eitskin.stream.baseline import Baseline

MAX_RECIPROCITY_ERROR = 0.25  # of the larger reading of a pair; working boards stay below
MAX_SUSPECT_SHARE = 0.5  # of an electrode's channels: an electrode's partner is suspect in fewer
STEADY_GATES = 1.5  # gates: noise of 208 channels never exceeds it, a moving finger does at once


def find_dead_electrodes(frames: np.ndarray, table: np.ndarray) -> list[int]:
    """Electrodes of which more than half of the channels are suspect, the worst first.

    `frames` (n, M) are opening frames of the channels `table` (M, 4). A channel is suspect where it
    is never read or always 0, and where its reciprocal channel, drive and measurement exchanged,
    reads something else (Geselowitz 1971). A reading that never changes is not suspect: noise may
    be smaller than a step of the converter. Each suspect channel counts for one electrode only.
    """
    suspect = silent(frames) | unreciprocal(frames, table)
    electrode_channels = np.array([channels_using(table, [k]) for k in range(int(table.max()) + 1)])
    unassigned = np.ones(len(table), dtype=bool)
    electrodes: list[int] = []
    while True:
        suspect_shares = (electrode_channels & suspect & unassigned).sum(axis=1) / (
            electrode_channels & unassigned
        ).sum(axis=1).clip(1)
        worst_electrode = int(suspect_shares.argmax())
        if suspect_shares[worst_electrode] <= MAX_SUSPECT_SHARE:
            return electrodes
        electrodes.append(worst_electrode)
        unassigned &= ~electrode_channels[worst_electrode]


def silent(frames: np.ndarray) -> np.ndarray:
    """(M,) bool: channels of frames (n, M) that are never read, or always 0."""
    return np.asarray((~np.isfinite(frames) | (frames == 0.0)).all(axis=0))


def unreciprocal(frames: np.ndarray, table: np.ndarray) -> np.ndarray:
    """(M,) bool: channels whose mean size differs from that of their reciprocal channel.

    By MAX_RECIPROCITY_ERROR of the larger; False where the table (M, 4) has no reciprocal.
    """
    mean_size = np.abs(np.nanmean(np.where(np.isfinite(frames).any(axis=0), frames, 0.0), axis=0))
    drive_pairs = [tuple(sorted(pair)) for pair in table[:, :2].tolist()]
    measured_pairs = [tuple(sorted(pair)) for pair in table[:, 2:].tolist()]
    channel_of = {
        pair_of_pairs: k
        for k, pair_of_pairs in enumerate(zip(drive_pairs, measured_pairs, strict=True))
    }
    reciprocal_channel = np.array(
        [
            channel_of.get((b, a), k)
            for k, (a, b) in enumerate(zip(drive_pairs, measured_pairs, strict=True))
        ]
    )
    return np.abs(mean_size - mean_size[reciprocal_channel]) > MAX_RECIPROCITY_ERROR * np.maximum(
        mean_size, mean_size[reciprocal_channel]
    )


def check(frames: np.ndarray, predictor: Predictor) -> None:
    """Raise InputError where the skin is touched during the opening frames (n, M).

    That is where a frame differs from their mean, and where the mean differs from the untouched
    skin trained on as a touch does. NaN: not read.
    """
    expected = "an untouched skin: let go of it and start anew"
    if np.isnan(frames).all(axis=1).any():
        raise InputError("recording", "opening frames", "one without a reading", expected)
    baseline = Baseline(frames, 0.0, predictor.channels, predictor.scale)
    for number, frame in enumerate(frames):
        if predictor.touched(baseline.change(frame), STEADY_GATES):
            description = f"frame {number} unlike the others"
            raise InputError("recording", "opening frames", description, expected)
    if predictor.untouched is None:
        return
    trained_baseline = Baseline(predictor.untouched[None], 0.0, predictor.channels, predictor.scale)
    change = trained_baseline.change(baseline.level)
    change -= trained_baseline.common_gain(change) * trained_baseline.level
    if predictor.activity(change) < predictor.weakest:
        return
    imputed, missing = predictor.filled(change)
    if predictor.familiar(imputed) and not predictor.out_of_range(
        predictor.estimate(imputed, missing)
    ):
        raise InputError("recording", "opening frames", "a touch like those trained on", expected)
