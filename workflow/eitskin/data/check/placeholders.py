"""Numbers in the place of readings: what instruments and programs write where nothing was read.

Such a number recurs exactly, and far from all that is read: SCPI's 9.9e37, -9999, a register's
highest value, or 0 in a channel that never comes near it. So do the channels of an electrode whose
wire is unplugged: all that it takes part in is one constant, or nothing.
"""

from dataclasses import dataclass, replace

import numpy as np

from eitskin.data.recording import Recording

SCPI = (9.9e37, 9.91e37)  # infinity and not a number (SCPI 1999, 7.2.1.4)
MAX_VALUES = 8  # placeholders of one recording
FAR, FARTHEST = 2.0, 100.0  # times the largest other reading: of two equal ones, of a single one
MAX_SHARE = 0.5  # of a channel's frames: a reading that is usual is none's placeholder
MIN_OTHERS = 3  # frames of a recording whose channels may all be silent
MIN_RANGE = 8  # readings of a channel beside its zeros, for their range
MIN_DISTINCT = 20  # readings of a channel, none like another: no digit is too few for a 0
MIN_ZERO_GAP = 0.1  # of the median |reading|: a smaller channel may read 0
SILENT = 0.01  # of the median |reading|: all of a channel below it is no reading
MIN_CHANNELS = 3  # of an electrode
MAX_ELECTRODES = 0.25  # of all: with more unplugged, it is the recording that is dead


@dataclass(frozen=True)
class Placeholder:
    """A number in the place of readings, of either sign, and where it is (N, M) bool."""

    value: float
    mask: np.ndarray


@dataclass(frozen=True)
class Unplugged:
    """An electrode whose channels are all constant or silent, and their one reading; None where
    they have several, NaN where they are lost."""

    electrode: int
    channels: np.ndarray
    reading: float | None


def placeholders(recording: Recording) -> list[Placeholder]:
    """Numbers that stand for readings that there are not; none of a query."""
    if recording.voltage is None:
        return []
    values, stand_ins = recording.voltage, []
    is_read = np.isfinite(values)
    for _ in range(MAX_VALUES):
        far = _far(values, is_read)
        if far is None:
            break
        stand_ins.append(far)
        is_read = is_read & ~far.mask
    if recording.metadata["values"] == "absolute":
        zero_mask = _zeros(values, is_read)
        if zero_mask.any():
            stand_ins.append(Placeholder(0.0, zero_mask))
    return stand_ins


def _far(values: np.ndarray, is_read: np.ndarray) -> Placeholder | None:
    """The largest |value| of (N, M), where it is no reading."""
    if not is_read.any():
        return None
    size = max(_largest(values, is_read), _largest(-values, is_read))
    mask = is_read & ((values == size) | (values == -size))
    if size in SCPI:
        return Placeholder(float(values[mask][0]), mask)
    is_other = is_read & ~mask
    if not is_other.any():
        return None
    other_size = max(_largest(values, is_other), _largest(-values, is_other))
    count = mask[:, mask.mean(axis=0) <= MAX_SHARE].sum()
    is_far = size > FARTHEST * other_size if count == 1 else size > FAR * other_size
    if not count or not is_far or other_size == 0.0:
        return None
    return Placeholder(float(values[mask][0]), mask)


def _largest(values: np.ndarray, where: np.ndarray) -> float:
    return float(values.max(where=where, initial=-np.inf))


def _zeros(values: np.ndarray, is_read: np.ndarray) -> np.ndarray:
    """(N, M) bool: zeros of channels that never come near 0, and of those whose readings else never
    repeat, MIN_DISTINCT or more; none where fewer than two are of the former."""
    mask = is_read & (values == 0.0)
    share = mask.mean(axis=0)
    rows = np.flatnonzero((share > 0.0) & (share <= MAX_SHARE))
    is_other = is_read[:, rows] & ~mask[:, rows]
    rows, is_other = (
        rows[is_other.sum(axis=0) >= MIN_RANGE],
        is_other[:, is_other.sum(axis=0) >= MIN_RANGE],
    )
    if not len(rows):
        return np.zeros_like(mask)
    others = values[:, rows]
    low = others.min(axis=0, where=is_other, initial=np.inf)
    high = others.max(axis=0, where=is_other, initial=-np.inf)
    gap = np.maximum(low, -high)
    usual_size = np.median(np.abs(values[is_read & ~mask]))
    is_apart = (gap > high - low) & (gap > MIN_ZERO_GAP * usual_size)
    if mask[:, rows[is_apart]].sum() < 2:
        return np.zeros_like(mask)
    is_continuous = np.array(
        [
            len(np.unique(column[read])) == read.sum() >= MIN_DISTINCT
            for column, read in zip(others.T, is_other.T, strict=True)
        ]
    )
    mask[:, np.setdiff1d(np.arange(mask.shape[1]), rows[is_apart | is_continuous])] = False
    return mask


def unplugged(recording: Recording) -> list[Unplugged]:
    """Electrodes whose channels all read nothing, the one with most of them first; none of
    differences, of queries, and where such channels are left that no electrode has in common."""
    values = recording.voltage
    if values is None or recording.metadata["values"] == "difference" or len(values) < MIN_OTHERS:
        return []
    is_read = np.isfinite(values)
    low = values.min(axis=0, where=is_read, initial=np.inf)
    high = values.max(axis=0, where=is_read, initial=-np.inf)
    is_constant = high <= low
    if is_constant.all():
        return []
    usual_size = np.median(np.abs(values[:, ~is_constant][is_read[:, ~is_constant]]))
    is_dead = is_constant | (np.maximum(high, -low) < SILENT * usual_size)
    uses = (recording.channels[None] == np.arange(recording.n_electrodes)[:, None, None]).any(2)
    is_silent = (uses.sum(axis=1) >= MIN_CHANNELS) & ~(uses & ~is_dead).any(axis=1)
    electrodes, is_left = [], is_dead.copy()
    while (uses[is_silent] & is_left).any():
        electrode = int(np.argmax((uses & is_left).sum(axis=1) * is_silent))
        rows = np.flatnonzero(uses[electrode])
        readings = np.unique(np.r_[low[rows], high[rows]])
        reading = float(readings[0]) if len(readings) == 1 else None
        if not is_read[:, rows].any():
            reading = np.nan
        electrodes.append(Unplugged(electrode, rows, reading))
        is_left &= ~uses[electrode]
    return electrodes if len(electrodes) <= MAX_ELECTRODES * recording.n_electrodes else []


def measured(recording: Recording) -> Recording:
    """A recording with NaN in place of what is no reading; itself where all are readings."""
    masks = [placeholder.mask for placeholder in placeholders(recording)]
    rows = [electrode.channels for electrode in unplugged(recording)]
    if not masks and not rows:
        return recording
    is_lost = np.zeros(recording.readings.shape, bool)
    for mask in masks:
        is_lost |= mask
    for channels in rows:
        is_lost[:, channels] = True
    voltage = np.where(is_lost, np.nan, recording.readings)
    if np.isnan(voltage).all():
        return recording
    quadrature = recording.quadrature
    if quadrature is not None:
        quadrature = np.where(is_lost, np.nan, quadrature)
    return replace(recording, voltage=voltage, quadrature=quadrature)
