"""Frames as bare vectors: what each number reads, by its count, the pairs and the order alone.

Pairs are steps round the ring: drive k is (k, k + step), measurement j is u[j] - u[j + step], and
with `-reversed` after its name u[j + step] - u[j]. A frame of n electrodes then has a number for
each drive and measurement (n n, among them those at driven electrodes, which hold no measurement
and are left out) or for those away from the drive alone: n (n - 3) where both are adjacent, mostly
n (n - 4) else; or, of those, for the first of every two that reciprocity makes alike (EIDORS
`no_redundant`: 104 of 16 electrodes). They stand drive by drive, j ascending from electrode 0
(EIDORS `no_rotate_meas`, pyEIT `std`), unless an order of `channel_order` is named.
"""

from dataclasses import dataclass
from math import isqrt
from pathlib import Path

import numpy as np

from eitskin.data.channel_order import ORDERS, in_order, misfit
from eitskin.data.check.wiring import DOUBTFUL_MISFIT, MIN_IMPROVEMENT
from eitskin.data.importers.description import describe, swap_measured
from eitskin.data.recording import MAX_ELECTRODES, Recording, frames_table
from eitskin.errors import InputError
from eitskin.physics.geometry import even_angles
from eitskin.physics.protocol import every_channel, reciprocal_channels, undriven
from eitskin.quantities import percent

REVERSED = "-reversed"
FEWEST_GUESSED = 8  # fewer electrodes must be stated: 16 numbers may be a frame or a column
ENOUGH_FRAMES = 20  # to see whether reciprocity holds
ONCE_GUESSED = (16, 32)  # among all rings, half of some has as many readings as another
MOST_TOUCHED = 4  # measured pairs of a drive that touch one of its two electrodes
UNTOUCHED = "no touches are said: taken for untouched"


@dataclass(frozen=True)
class Layout:
    """What the numbers of a frame read: `channels` (M, 4), those of `columns` (M,) int; the frame
    has `width` numbers, and those in no column are left out."""

    n_electrodes: int
    channels: np.ndarray
    columns: np.ndarray
    width: int

    @property
    def left_out(self) -> str:
        """What a `source` says of numbers that are not read."""
        n = self.width - len(self.columns)
        return f"{n} numbers a frame at driven electrodes left out" if n else ""


def pairs(file: str | Path, n_electrodes: int, drive: str, measure: str) -> np.ndarray:
    """(n n, 4): every channel of the patterns, `measure` perhaps reversed.

    Raises InputError, with `file`, for an unknown pattern.
    """
    try:
        channels = every_channel(n_electrodes, drive, measure.removesuffix(REVERSED))
    except InputError as error:
        found = f"{error.found} of drive {drive!r}, measure {measure!r}"
        expected = f"{error.expected}; of measure also with {REVERSED}"
        raise InputError(file, "drive, measure", found, expected) from error
    return swap_measured(channels) if measure.endswith(REVERSED) else channels


def stepped(
    file: str | Path,
    width: int,
    drive: str,
    measure: str,
    order: str | None = None,
    n_electrodes: int | None = None,
) -> Layout:
    """The layout of frames of `width` numbers, pairs being steps.

    The number of electrodes follows from the width where it is not given; readings that stand once
    are told then of 16 and 32 electrodes alone. Raises InputError where none fits.
    """
    sizes, refusal = [], None
    least = max(FEWEST_GUESSED, isqrt(width))
    guesses = [*range(least, least + MOST_TOUCHED + 1), *ONCE_GUESSED]
    for n in guesses if n_electrodes is None else [n_electrodes]:
        try:
            every = pairs(file, n, drive, measure)
        except InputError as error:  # opposite pairs of an odd ring, a step round a small one
            refusal = error
            continue
        tables = [every, every[undriven(every)]]
        if n_electrodes is not None or n in ONCE_GUESSED:
            tables.append(_once(tables[1]))
        counts = dict.fromkeys(str(len(one)) for one in tables[::-1])
        sizes.append(f"{' or '.join(counts)} of {n} electrodes")
        for channels in tables:
            if width == len(channels) and undriven(channels).any():
                return _kept(n, in_order(file, order, channels, n) if order else channels)
    if refusal and not sizes:
        raise refusal
    expected = f"{', '.join(dict.fromkeys(sizes))} for drive {drive!r}, measure {measure!r}"
    raise InputError(file, "numbers a frame", width, expected)


def _once(channels: np.ndarray) -> np.ndarray:
    """Of channels that reciprocity makes alike the first."""
    alike, _ = reciprocal_channels(channels)
    return np.delete(channels, alike[:, 1], axis=0)


def listed(
    file: str | Path,
    width: int,
    channels: list,
    order: str | None = None,
    n_electrodes: int | None = None,
) -> Layout:
    """The layout where `channels` lists [source, sink, plus, minus] of every number.

    Raises InputError where it has another length, names electrodes that are not there, or has
    nothing away from driven electrodes.
    """
    if len(channels) != width:
        raise InputError(file, "measurement", f"{len(channels)} channels", f"{width}, one a number")
    for row, one in enumerate(channels):
        whole = isinstance(one, list) and [type(each) for each in one] == [int] * 4
        if not whole or not 0 <= min(one) <= max(one) < (n_electrodes or MAX_ELECTRODES):
            expected = f"[source, sink, plus, minus], 0 to {(n_electrodes or MAX_ELECTRODES) - 1}"
            raise InputError(file, f"measurement, row {row}", one, expected)
        if one[0] == one[1] or one[2] == one[3]:
            raise InputError(file, f"measurement, row {row}", one, "two electrodes a pair")
    table = np.array(channels)
    n = n_electrodes or int(table.max()) + 1
    if not undriven(table).any():
        found = "every measured pair at a driven electrode"
        raise InputError(file, "measurement", found, "four different electrodes a channel")
    return _kept(n, in_order(file, order, table, n) if order else table)


def _kept(n_electrodes: int, channels: np.ndarray) -> Layout:
    columns = np.flatnonzero(undriven(channels))
    return Layout(n_electrodes, channels[columns], columns, len(channels))


def refuse_other_order(
    file: str | Path, frames: np.ndarray, drive: str, measure: str, layout: Layout
) -> None:
    """Of frames (F, n n) that hold numbers at driven electrodes, refuse an order in which
    exchanging drive and measurement and going round by one electrode change much, though in another
    known one they do not: there numbers at driven electrodes stand elsewhere, and what is left out
    would be wrong. (Without them `check` says so.)
    """
    n, frames = layout.n_electrodes, frames[:ENOUGH_FRAMES]
    if frames.shape[1] != n * n or len(layout.columns) == n * n:
        return
    channels, signed = pairs(file, n, drive, measure), voltage_kind(frames) == "signed"

    def broken(order: str | None) -> float:
        kept = _kept(n, channels if order is None else in_order(file, order, channels, n))
        values = frames[:, kept.columns].real
        found = misfit(values, kept.channels, n, signed)
        known = [one for one in (found.reciprocity, found.rotation) if one is not None]
        return float(np.linalg.norm(known)) if known else np.inf

    own = broken(None)
    if not DOUBTFUL_MISFIT < own < np.inf:
        return
    best = min(ORDERS, key=broken)
    if broken(best) < own / MIN_IMPROVEMENT:
        turned, then = percent(own), percent(broken(best))
        found = f"one in which exchanging drive and measurement, or going round, changes {turned}"
        expected = f"--order {best} ({ORDERS[best].sentence}), in which {then} change"
        raise InputError(file, "order", found, expected)


def voltage_kind(frames: np.ndarray) -> str:
    """`signed` where a number is complex or below 0; numbers that are all 0 or more may have lost
    their sign: `magnitude`."""
    return "signed" if np.iscomplexobj(frames) or (frames < 0).any() else "magnitude"


def untouched(frames: np.ndarray, layout: Layout, source: str) -> Recording:
    """A recording of frames (F, width), real or complex, that nobody touches and nobody timed, in
    an arbitrary unit, electrodes even round the rim."""
    readings = frames[:, layout.columns]
    metadata = describe(
        layout.channels, even_angles(layout.n_electrodes), source, voltage_kind(readings)
    )
    table = frames_table(np.arange(len(frames)), np.zeros(len(frames), dtype=bool))
    quadrature = readings.imag.astype(float) if np.iscomplexobj(readings) else None
    return Recording(table, readings.real.astype(float), quadrature, None, metadata)


def said(*parts: str) -> str:
    """The parts that say something, one after the other."""
    return "; ".join(part for part in parts if part)
