"""What is measured of a recording's frames and readings: counts, faults of channels, noise, drift
and reciprocity.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from eitskin.data.channel_order import relative_change
from eitskin.data.check.finding import ERROR, WARNING
from eitskin.data.recording import Recording, presses
from eitskin.physics.protocol import reciprocal_channels

NORMAL = 1.4826  # standard deviation of a normal variable over its median distance from its median
MOST_FRAMES = 500
CLIPPED_FRAMES = 3
MOST_REPEATED = 0.5
QUIET = 0.3  # of the median channel's noise; no channel is taken for quieter
UNKNOWNS = 3  # x, y and F of a touch


@dataclass(frozen=True)
class Contents:
    """How many frames of each kind there are; `presses` and `places` None where nobody touches,
    `seconds` where times were not measured.
    """

    frames: int
    untouched: int
    touched: int
    presses: int | None
    places: int | None
    seconds: float | None


def contents(recording: Recording) -> Contents:
    """What a recording or query holds."""
    frames = recording.frames
    touch = frames["touch"].to_numpy(dtype=bool)
    timed = recording.metadata["clock"] == "measured" and len(frames) > 1
    return Contents(
        frames=len(frames),
        untouched=int((~touch).sum()),
        touched=int(touch.sum()),
        presses=int(presses(recording).max()) + 1 if touch.any() else None,
        places=len(frames.loc[touch, ["x_mm", "y_mm"]].drop_duplicates()) if touch.any() else None,
        seconds=float(np.ptp(frames["time_s"])) if timed else None,
    )


def levels(recording: Recording, column: str) -> tuple[float, float, int] | None:
    """The least and the largest value of a column where the skin is touched, and how many differ;
    None where none is known.
    """
    values = recording.frames.loc[recording.frames["touch"].to_numpy(dtype=bool), column].dropna()
    return (values.min(), values.max(), values.nunique()) if len(values) else None


def pattern(recording: Recording, first: int) -> str:
    """The pattern of the drives (first = 0) or measurements (2), as `protocol` names it."""
    n = recording.n_electrodes
    pair = recording.channels[:, first : first + 2]
    steps = {min(step, n - step) for step in ((pair[:, 1] - pair[:, 0]) % n).tolist()}
    if len(steps) > 1:
        return "mixed"
    step = steps.pop()
    names = {1: "adjacent", n // 2: "opposite"}
    return names.get(step, f"skip-{step - 1}")


def turned_pairs(recording: Recording) -> str | None:
    """The name, for the setting `measure`, of the measured pairs with plus and minus exchanged;
    None where they have no one pattern."""
    name = pattern(recording, 2)
    plus, minus = recording.channels[:, 2:].T
    backwards = (minus - plus) % recording.n_electrodes > recording.n_electrodes / 2
    if name == "mixed" or backwards.any() != backwards.all():
        return None
    return name if backwards.all() else f"{name}-reversed"


@dataclass(frozen=True)
class Repeated:
    """Rows of the channel table that repeat an earlier one, and their share of all."""

    rows: np.ndarray
    share: float

    @property
    def severity(self) -> str:
        """Most of them make a table that no skin was read by."""
        return ERROR if self.share > MOST_REPEATED else WARNING


def repeated(recording: Recording) -> Repeated | None:
    """Channels that stand in the table more than once; None without any."""
    _, first = np.unique(recording.channels, axis=0, return_index=True)
    again = np.setdiff1d(np.arange(len(recording.channels)), first)
    return Repeated(again, len(again) / len(recording.channels)) if len(again) else None


@dataclass(frozen=True)
class Dead:
    """How many of the channels ever read a number other than 0 in each state of the skin, how many
    are needed, and whether there were two states, untouched and touched.
    """

    live: int
    channels: int
    needed: int
    both_states: bool


def dead(recording: Recording) -> Dead | None:
    """The channels that read, where they are too few to tell where and how hard a skin is touched;
    else None.
    """
    touch = recording.frames["touch"].to_numpy(dtype=bool)
    reads = np.nan_to_num(recording.readings) != 0
    difference = recording.metadata["values"] == "difference"
    states = [touch] if difference and touch.any() else [~touch, touch]
    live = np.logical_and.reduce([reads[state].any(axis=0) for state in states if state.any()])
    needed = min(UNKNOWNS, len(live))
    if live.sum() >= needed:
        return None
    return Dead(int(live.sum()), len(live), needed, bool(len(states) > 1 and touch.any()))


@dataclass(frozen=True)
class Lost:
    """Channels without a reading in every frame and in some, those that never change where others
    do, and the share of readings lost: of all, and of the channels lost in some frames.
    """

    always: np.ndarray
    sometimes: np.ndarray
    stuck: np.ndarray
    channels: int
    share: float
    share_of_sometimes: float


def lost(recording: Recording) -> Lost:
    """Channels with lost readings and channels that never change."""
    values, missing = recording.readings, np.isnan(recording.readings)
    partly = missing.any(axis=0) & ~missing.all(axis=0)
    still = ~missing.any(axis=0) & (values == values[:1]).all(axis=0)
    stuck = still & (len(values) > 2 and not still.all())
    return Lost(
        always=np.flatnonzero(missing.all(axis=0)),
        sometimes=np.flatnonzero(partly),
        stuck=np.flatnonzero(stuck),
        channels=missing.shape[1],
        share=float(missing.mean()),
        share_of_sometimes=float(missing[:, partly].mean()) if partly.any() else 0.0,
    )


@dataclass(frozen=True)
class Clipped:
    """The channels that stop at a ceiling, that ceiling, and their share of all channels."""

    channels: np.ndarray
    ceiling: float
    share: float


def clipped(recording: Recording) -> Clipped | None:
    """Channels at a ceiling: the largest |reading| comes back exactly, in several different frames,
    and more than twice as often as any other large reading. None for differences.
    """
    if recording.metadata["values"] == "difference":
        return None
    size = np.unique(np.abs(recording.readings), axis=0)
    if not np.isfinite(size).any():
        return None
    ceiling = np.nanmax(size)
    at_ceiling = size == ceiling
    channels = np.flatnonzero(at_ceiling.any(axis=0))
    near = size[:, channels]
    others, counts = np.unique(near[(near < ceiling) & (near > 0.9 * ceiling)], return_counts=True)
    commonest = counts.max() if len(others) else 0
    varies = (near < ceiling).any() or len(channels) > 1
    enough = at_ceiling.any(axis=1).sum() >= CLIPPED_FRAMES
    if not (enough and varies and at_ceiling.sum() > 2 * commonest):
        channels = channels[:0]
    return Clipped(channels, float(ceiling), len(channels) / size.shape[1])


@dataclass(frozen=True)
class Noise:
    """Standard deviation of the median channel's noise, from how many untouched frames, and whether
    presses lie between them.
    """

    sigma: float
    frames: int
    between_presses: bool


def noise(recording: Recording) -> Noise | None:
    """Noise from one untouched frame to the next: the median absolute successive difference / sqrt
    2, scaled to a standard deviation; drift hardly enters it. None without repeats.
    """
    rows = np.flatnonzero(~recording.frames["touch"].to_numpy(dtype=bool))
    follow = np.diff(rows) == 1
    steps = np.diff(recording.readings[rows], axis=0)
    if follow.any():
        steps = steps[follow]
    if not np.isfinite(steps).any():
        return None
    spread = successive_noise(steps)
    return Noise(float(np.nanmedian(spread)), len(steps) + 1, not follow.any())


def successive_noise(steps: np.ndarray) -> np.ndarray:
    """(M,): sd of each channel's noise that successive differences (K, M) show, as of `noise`; NaN
    where there are none."""
    return NORMAL * _columns(np.nanmedian, np.abs(steps)) / np.sqrt(2.0)


def channel_noise(values: np.ndarray) -> np.ndarray:
    """(M,): sd of each channel's noise, from the successive differences of untouched frames (U, M);
    at the least QUIET of the median channel's, and 1 where nothing ever changes.
    """
    change = np.diff(values, axis=0)
    change[:, ~np.isfinite(change).any(axis=0)] = 0.0
    spread = successive_noise(change)
    if not spread.any():
        spread[:] = np.sqrt(np.nanmean(change**2) / 2.0)
    middle = np.median(spread[spread > 0]) if spread.any() else 1.0
    return np.maximum(spread, QUIET * middle)


def noise_bound(recording: Recording) -> float | None:
    """The odd half of reciprocity, which bounds the noise from above; None without pairs."""
    pairs, signs = reciprocal_channels(recording.channels)
    values, signs = identity_readings(recording, signs)
    odd = np.abs(values[:, pairs[:, 1]] - signs * values[:, pairs[:, 0]])
    return float(NORMAL * np.nanmedian(odd) / np.sqrt(2.0)) if np.isfinite(odd).any() else None


def median_reading(recording: Recording) -> float:
    """The median |reading| of the untouched skin."""
    untouched = recording.readings[~recording.frames["touch"].to_numpy(dtype=bool)]
    return float(np.nanmedian(np.abs(untouched)))


@dataclass(frozen=True)
class Drift:
    """Median relative change of a channel, and the share of all change that is left when one common
    factor is taken out (None where nothing changes).
    """

    change: float
    uncommon: float | None


def drift(recording: Recording) -> Drift | None:
    """How the untouched readings change from their first tenth to their last."""
    untouched = recording.readings[~recording.frames["touch"].to_numpy(dtype=bool)]
    if len(untouched) < 2:
        return None
    tenth = max(1, len(untouched) // 10)
    first = _columns(np.nanmean, untouched[:tenth])
    last = _columns(np.nanmean, untouched[-tenth:])
    kept = np.isfinite(first) & np.isfinite(last) & (first != 0)
    first, last = first[kept], last[kept]
    if not len(first):
        return None
    uncommon = None
    if np.any(last != first):
        factor = first @ last / (first @ first)
        uncommon = float(np.linalg.norm(last - factor * first) / np.linalg.norm(last - first))
    return Drift(float(np.median(np.abs(last - first) / np.abs(first))), uncommon)


@dataclass(frozen=True)
class Reciprocity:
    """Relative difference of reciprocal pairs: its median, its rms, how many pairs there are."""

    median: float
    rms: float
    pairs: int


def reciprocity(recording: Recording) -> Reciprocity | None:
    """How well the untouched readings, or their modulus where there is a quadrature, stay the same
    when drive and measurement are exchanged; None without pairs and where their squares vanish.
    """
    pairs, signs = reciprocal_channels(recording.channels)
    if not len(pairs):
        return None
    values, signs = identity_readings(recording, signs)
    first, second = signs * values[:, pairs[:, 0]], values[:, pairs[:, 1]]
    size = (np.abs(first) + np.abs(second)) / 2.0
    kept = np.isfinite(size) & (size > 0)
    if not kept.any():
        return None
    error = float(np.median(np.abs(first - second)[kept] / size[kept]))
    rms = relative_change(values, pairs, signs)
    return None if rms is None else Reciprocity(error, rms, len(pairs))


def identity_readings(recording: Recording, signs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Readings (K, M) on which a channel table's identities should hold, and the signs to use: the
    mean untouched frame, or some frames of differences; the modulus where there is a quadrature.
    """
    values = recording.readings
    if recording.quadrature is not None:
        values = np.hypot(values, recording.quadrature)
    if recording.metadata["voltage"] == "magnitude" or recording.quadrature is not None:
        signs = np.ones_like(signs)
    return untouched_readings(values, recording), signs


def untouched_readings(values: np.ndarray, recording: Recording) -> np.ndarray:
    """(K, M): the mean over untouched frames, or some frames of a recording of differences."""
    if recording.metadata["values"] == "difference":
        rows = np.linspace(0, len(values) - 1, min(len(values), MOST_FRAMES)).astype(int)
        return values[rows]
    untouched = ~recording.frames["touch"].to_numpy(dtype=bool)
    return _columns(np.nanmean, values[untouched])[None]


def _columns(statistic: Callable, values: np.ndarray) -> np.ndarray:
    """A statistic of each column (M,); NaN for a column without any reading."""
    result = np.full(values.shape[1], np.nan)
    some = np.isfinite(values).any(axis=0)
    result[some] = statistic(values[:, some], axis=0)
    return result
