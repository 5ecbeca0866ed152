"""Frames as bare vectors: the channel of each number, by their count, the pairs and the order.

Pairs are steps round the ring: drive k is (k, k + step), measurement j is u[j] - u[j + step], and
with `-reversed` after its name u[j + step] - u[j]. A frame of n electrodes then has a number for
each drive and measurement (n n, among them those at driven electrodes, which hold no measurement
and are left out) or for those away from the drive alone: n (n - 3) where both are adjacent, mostly
n (n - 4) else; or, of those, for the first of every two that reciprocity makes alike (EIDORS
`no_redundant`: 104 of 16 electrodes). They stand drive by drive, j ascending from electrode 0
(EIDORS `no_rotate_meas`, pyEIT `std`), unless an order of `channel_order` is named.

Measured against `ground`, a frame has the potential of every electrode for each drive, n n numbers;
u[j] - u[j + 1] round the ring are its readings.
"""

from dataclasses import dataclass
from math import isqrt
from pathlib import Path

import numpy as np

from eitskin.data.channel_order import ORDERS, in_order, misfit
from eitskin.data.check.wiring import DOUBTFUL_MISFIT, MIN_IMPROVEMENT
from eitskin.data.importers.description import describe, swap_measured
from eitskin.data.recording import Recording, frames_table
from eitskin.errors import InputError
from eitskin.physics.geometry import even_angles
from eitskin.physics.protocol import every_channel, reciprocal_channels, undriven
from eitskin.physics.skin import MAX_ELECTRODES
from eitskin.quantities import percent

REVERSED = "-reversed"
GROUND = "ground"  # as measurement: potentials of all electrodes
MIN_GUESSED_ELECTRODES = 8  # fewer must be stated: 16 numbers may be a frame or a column
MAX_CHECKED_FRAMES = 20  # enough for the misfit of reciprocity
# Among all rings they would be ambiguous: half of one ring's readings are as many as another's.
RINGS_WITHOUT_RECIPROCALS = (16, 32)
MAX_DRIVEN_PAIRS = 4  # measured pairs of a drive that touch one of its two electrodes
UNTOUCHED = "no touches are said: taken for untouched"


@dataclass(frozen=True)
class Layout:
    """The channels (M, 4) of the `columns` (M,) int of a frame of `width` numbers; numbers in other
    columns are left out. Where `subtrahends` (M,) are columns too, theirs are subtracted."""

    n_electrodes: int
    channels: np.ndarray
    columns: np.ndarray
    width: int
    subtrahends: np.ndarray | None = None

    def readings(self, frames: np.ndarray) -> np.ndarray:
        """(F, M): the channels' readings in frames (F, width)."""
        readings = frames[:, self.columns]
        return readings if self.subtrahends is None else readings - frames[:, self.subtrahends]

    @property
    def left_out(self) -> str:
        """The remark in `source` about numbers that are left out."""
        if self.subtrahends is not None:
            return "potentials against ground: differences round the ring made"
        n = self.width - len(self.columns)
        return f"{n} numbers a frame at driven electrodes left out" if n else ""


def pattern_channels(file: str | Path, n_electrodes: int, drive: str, measure: str) -> np.ndarray:
    """All channels (n n, 4) of the patterns; `measure` may end in REVERSED.

    Raises InputError naming `file` for an unknown pattern.
    """
    try:
        channels = every_channel(n_electrodes, drive, measure.removesuffix(REVERSED))
    except InputError as error:
        violation = f"{error.actual} of drive {drive!r}, measure {measure!r}"
        expected = f"{error.expected}; of measure also with {REVERSED}"
        raise InputError(file, "drive, measure", violation, expected) from error
    return swap_measured(channels) if measure.endswith(REVERSED) else channels


def pattern_layout(
    file: str | Path,
    width: int,
    drive: str,
    measure: str,
    order: str | None = None,
    n_electrodes: int | None = None,
) -> Layout:
    """The layout of frames of `width` numbers by the patterns of drive and measurement.

    The number of electrodes follows from the width where it is None; frames without reciprocal
    readings are then recognised for 16 and 32 electrodes alone. Raises InputError where none fits.
    """
    if measure == GROUND:
        return _ground_layout(file, width, drive, order, n_electrodes)
    size_texts, refusal = [], None
    min_electrodes = max(MIN_GUESSED_ELECTRODES, isqrt(width))
    guesses = [
        *range(min_electrodes, min_electrodes + MAX_DRIVEN_PAIRS + 1),
        *RINGS_WITHOUT_RECIPROCALS,
    ]
    for n_ring in guesses if n_electrodes is None else [n_electrodes]:
        try:
            all_channels = pattern_channels(file, n_ring, drive, measure)
        except InputError as error:  # opposite pairs of an odd ring, a step round a small one
            refusal = error
            continue
        tables = [all_channels, all_channels[undriven(all_channels)]]
        if n_electrodes is not None or n_ring in RINGS_WITHOUT_RECIPROCALS:
            tables.append(_without_reciprocals(tables[1]))
        counts = dict.fromkeys(str(len(table)) for table in tables[::-1])
        size_texts.append(f"{' or '.join(counts)} of {n_ring} electrodes")
        for channels in tables:
            if width == len(channels) and undriven(channels).any():
                return _undriven_layout(
                    n_ring, in_order(file, order, channels, n_ring) if order else channels
                )
    if refusal and not size_texts:
        raise refusal
    expected = f"{', '.join(dict.fromkeys(size_texts))} for drive {drive!r}, measure {measure!r}"
    raise InputError(file, "numbers a frame", width, expected)


def _ground_layout(
    file: str | Path, width: int, drive: str, order: str | None, n_electrodes: int | None
) -> Layout:
    """The layout of potentials against ground, drive by drive; raises InputError for another number
    of them than n n, and for an order."""
    n = isqrt(width) if n_electrodes is None else n_electrodes
    if width != n * n or n < 4:
        expected = f"{n * n} of {n} electrodes, potentials against ground, drive by drive"
        raise InputError(file, "numbers a frame", width, expected)
    if order is not None:
        raise InputError(file, "order", repr(order), "none: potentials stand drive by drive")
    channels = pattern_channels(file, n, drive, "adjacent")
    columns = np.flatnonzero(undriven(channels))
    row = columns - columns % n
    return Layout(n, channels[columns], columns, width, row + (columns + 1) % n)


def _without_reciprocals(channels: np.ndarray) -> np.ndarray:
    """The channels (M, 4) without the second of each reciprocal pair."""
    reciprocal_pairs, _ = reciprocal_channels(channels)
    return np.delete(channels, reciprocal_pairs[:, 1], axis=0)


def channel_layout(
    file: str | Path,
    width: int,
    channels: list,
    order: str | None = None,
    n_electrodes: int | None = None,
) -> Layout:
    """The layout of frames of `width` numbers whose `channels` are listed.

    Each is [source, sink, plus, minus]. Raises InputError for another number of channels, unknown
    electrodes, and where every measured pair has a driven electrode.
    """
    if len(channels) != width:
        raise InputError(file, "measurement", f"{len(channels)} channels", f"{width}, one a number")
    for row, channel in enumerate(channels):
        is_channel = (
            isinstance(channel, list) and [type(electrode) for electrode in channel] == [int] * 4
        )
        if not is_channel or not 0 <= min(channel) <= max(channel) < (
            n_electrodes or MAX_ELECTRODES
        ):
            expected = f"[source, sink, plus, minus], 0 to {(n_electrodes or MAX_ELECTRODES) - 1}"
            raise InputError(file, f"measurement, row {row}", channel, expected)
        if channel[0] == channel[1] or channel[2] == channel[3]:
            raise InputError(file, f"measurement, row {row}", channel, "two electrodes a pair")
    table = np.array(channels)
    n_ring = n_electrodes or int(table.max()) + 1
    if not undriven(table).any():
        violation = "every measured pair at a driven electrode"
        raise InputError(file, "measurement", violation, "four different electrodes a channel")
    return _undriven_layout(n_ring, in_order(file, order, table, n_ring) if order else table)


def _undriven_layout(n_electrodes: int, channels: np.ndarray) -> Layout:
    columns = np.flatnonzero(undriven(channels))
    return Layout(n_electrodes, channels[columns], columns, len(channels))


def refuse_other_order(
    file: str | Path, frames: np.ndarray, drive: str, measure: str, layout: Layout
) -> None:
    """Raise InputError where frames (F, n n) fit another known order far better.

    Frames with numbers at driven electrodes have these at other columns in another order, so that
    the wrong numbers would be left out. Without such numbers `check` finds a wrong order. The
    misfit is that of reciprocity and rotation.
    """
    n_electrodes, frames = layout.n_electrodes, frames[:MAX_CHECKED_FRAMES]
    if (
        frames.shape[1] != n_electrodes * n_electrodes
        or len(layout.columns) == n_electrodes * n_electrodes
    ):
        return
    channels, signed = (
        pattern_channels(file, n_electrodes, drive, measure),
        voltage_kind(frames) == "signed",
    )

    def order_misfit(order: str | None) -> float:
        layout_of_order = _undriven_layout(
            n_electrodes,
            channels if order is None else in_order(file, order, channels, n_electrodes),
        )
        values = frames[:, layout_of_order.columns].real
        layout_misfit = misfit(values, layout_of_order.channels, n_electrodes, signed)
        misfits = [
            value
            for value in (layout_misfit.reciprocity, layout_misfit.rotation)
            if value is not None
        ]
        return float(np.linalg.norm(misfits)) if misfits else np.inf

    table_misfit = order_misfit(None)
    if not DOUBTFUL_MISFIT < table_misfit < np.inf:
        return
    best = min(ORDERS, key=order_misfit)
    if order_misfit(best) < table_misfit / MIN_IMPROVEMENT:
        table_percent = percent(table_misfit)
        best_percent = percent(order_misfit(best))
        changes = f"exchanging drive and measurement, or going round, changes {table_percent}"
        expected = f"--order {best} ({ORDERS[best].sentence}), in which {best_percent} change"
        raise InputError(file, "order", f"one in which {changes}", expected)


def voltage_kind(frames: np.ndarray) -> str:
    """`signed` where a number is complex or negative, else `magnitude`: the sign may be lost."""
    return "signed" if np.iscomplexobj(frames) or (frames < 0).any() else "magnitude"


def untouched_recording(frames: np.ndarray, layout: Layout, source: str) -> Recording:
    """A recording of untouched frames (F, width), real or complex, without times, in an arbitrary
    unit, with evenly spaced electrodes."""
    readings = layout.readings(frames)
    metadata = describe(
        layout.channels, even_angles(layout.n_electrodes), source, voltage_kind(readings)
    )
    table = frames_table(np.arange(len(frames)), np.zeros(len(frames), dtype=bool))
    quadrature = readings.imag.astype(float) if np.iscomplexobj(readings) else None
    return Recording(table, readings.real.astype(float), quadrature, None, metadata)


def join_remarks(*parts: str) -> str:
    """The parts that are not empty, joined by semicolons."""
    return "; ".join(part for part in parts if part)
