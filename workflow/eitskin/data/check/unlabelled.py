"""Touches without a label: stretches of frames, labelled untouched, in which somebody touched.

In such a stretch the readings leave the level of the untouched frames before it and come back to
that level after it, and the change is a touch's: that of the conductivity at one place of the disc
(`alignment.sensitivity`), of any size but of a touch's sign. A step does not come back; a source's
gain is taken out; loud frames, noise and drift of single channels are at no place; a loose wire
changes the channels of one electrode alone.
"""

from collections.abc import Iterator
from functools import cached_property
from itertools import pairwise, product

import numpy as np

from eitskin.data import alignment, subset
from eitskin.data.baseline import sessions
from eitskin.data.check.measures import channel_noise
from eitskin.data.check.second_touches import second_touches
from eitskin.data.recording import Recording
from eitskin.physics.outline import not_simulated

FEWEST_FRAMES = 5  # untouched: before a stretch, in it and after it
MOST_LOST = 0.5  # of a channel's untouched frames, else it is left out
FEWEST_CHANNELS = 16  # of fewer, one place explains too much by chance
ROUNDS = 4  # in which the noise and the touches found follow each other
MOST_COMPARED = 400  # frames among which the usual level is sought
# Mean square of a change, over that of noise or of the usual wander: with which frames differ, and
# with which one that is at no place is loud, not touched.
BREAK, LOUD = 1.5, 3.0
MOST_LOUD_SHARE = 0.4  # of a loud frame's change, that a touch at one place explains
MOST_LOUD = 0.2  # of the frames: more are no exception
MOST_OFF = 0.5  # of the frames, off the usual level: of more, loud ones are not sought
MOST_BREAKS = 24  # in a stretch, beyond its first one
MARGINS = (0, 1, 2, 4)  # frames beside those that differ clearly, that may be the stretch's
MOST_RUNS = 200  # of frames that differ clearly, that are tried with these margins
LEVEL_FRAMES = 3  # at most, whose mean is the level before a stretch, or after it
MOST_RETURN = 0.1  # of a stretch's mean square, by which the levels beside it may differ
RETURN_SD = 4.0  # or as much, in sd of the mean square of noise
MOST_REST = 0.7  # of what the levels differ by, that is along the stretch's change: else it lasts
AMPLITUDE_SD = 4.0  # of a frame's part of the change that all of a stretch share, at least
POWER_STEPS = 8  # to the pattern of a change, which a touch makes along one direction
LEAST_ENERGY = 100.0  # squared length of the change beyond noise, in units of it
# Of the square of a change beyond noise, that a touch at one place must explain; and how much more
# than the channels of one electrode hold of it. Touches of `witness` reach 0.78 to 0.99 and exceed
# them by 0.05; faults of electrodes reach 0.75 where they are most like a touch.
MIN_EXPLAINED, MIN_MARGIN = 0.78, 0.02
MAX_LABELLED = 0.8  # of it, that the labelled press beside it explains: then it is that press's end
MAX_REFERENCES = 200  # labelled frames, that tell whether touches raise the conductivity
WANDER = 3.0  # times the difference of the levels beside a stretch, that an edge of it exceeds
BLOCK_FRAMES = 1000  # compared with all places at once: 20 MB


def unlabelled_touches(recording: Recording) -> list[tuple[int, int]]:
    """First and last row of each stretch of frames that are labelled untouched and hold a touch.

    None of differences, of queries and of skins that are no disc, and where there are fewer than
    FEWEST_FRAMES untouched frames or FEWEST_CHANNELS channels.
    """
    if recording.voltage is None or recording.metadata["values"] == "difference":
        return []
    stated = recording.skin
    if stated.rim is not None or not_simulated(stated) is not None:
        return []
    return [
        (first + start, last + start)
        for start, answered, part in subset.blocks(recording)
        for first, last in _stretches(part)
        if first + start in answered
    ]


def _stretches(recording: Recording) -> list[tuple[int, int]]:
    """First and last row of the stretches within a block of a recording."""
    voltage = recording.readings
    touched = recording.frames["touch"].to_numpy(bool)
    rows = np.flatnonzero(~touched & (np.nan_to_num(voltage) != 0).any(axis=1))
    if len(rows) < FEWEST_FRAMES:
        return []
    usable = np.isnan(voltage[rows]).mean(axis=0) <= MOST_LOST
    if usable.sum() < FEWEST_CHANNELS:
        return []
    hidden = np.zeros(len(touched), bool)
    for _ in range(ROUNDS):
        untouched_rows = rows[~hidden[rows]]
        if len(untouched_rows) < FEWEST_FRAMES:
            break
        stretches = _Untouched(recording, untouched_rows, usable).stretches()
        for stretch in stretches:
            hidden[stretch] = True
        if not stretches:
            break
    ends = np.flatnonzero(np.diff(np.concatenate([[False], hidden, [False]]).astype(int)))
    return [(int(first), int(end) - 1) for first, end in ends.reshape(-1, 2)]


def labelled(recording: Recording) -> tuple[Recording, list[tuple[int, int]]]:
    """A recording without the frames in which somebody touched though no label tells, beside a
    labelled touch or without one, itself where there are none; and the numbers of the first and
    last frame of each stretch of these."""
    seconds = [(int(rows[0]), int(rows[-1])) for rows in second_touches(recording)]
    stretches = sorted(unlabelled_touches(recording) + seconds)
    if not stretches:
        return recording, []
    keeps = np.ones(len(recording.frames), bool)
    for first, last in stretches:
        keeps[first : last + 1] = False
    number = recording.frames["frame"].to_numpy()
    frames = [(int(number[first]), int(number[last])) for first, last in stretches]
    return subset.of_frames(recording, keeps), frames


def stretch_text(frames: tuple[int, int] | list[int]) -> str:
    """A stretch of frames, by its first and its last: `frames 3 to 60`, `frame 3`."""
    first, last = frames
    return f"frame {first}" if first == last else f"frames {first} to {last}"


class _Untouched:
    """Frames that count as untouched, U of M usable channels, in units of each channel's noise and
    across a common factor and a common offset of readings, from the level that most frames share.

    rows (U,): of the recording, without loud ones; readings (U, M).
    """

    def __init__(self, recording: Recording, rows: np.ndarray, usable: np.ndarray):
        self.recording, self.usable = recording, usable
        values = recording.readings[np.ix_(rows, usable)]
        median = np.nanmedian(values, axis=0)
        self.sd = channel_noise(values)
        self.width = values.shape[1]
        self.scatter = np.sqrt(2.0 / self.width)  # sd of the mean square of noise
        scaled = np.where(np.isfinite(values), values, median) / self.sd
        self.level = _usual_level(scaled)
        common = np.column_stack([self.level, 1.0 / self.sd])
        self.directions = np.linalg.qr(common)[0]
        readings = self._across(scaled)
        self.is_quiet = self._quiet(readings)
        self.rows, self.readings = rows[self.is_quiet], readings[self.is_quiet]
        press = np.cumsum(recording.frames["touch"].to_numpy(bool))
        self.run = press[self.rows]
        self.session = sessions(recording.frames)[self.rows]
        self.time = recording.frames["time_s"].to_numpy(float)[self.rows]

    def _across(self, scaled: np.ndarray) -> np.ndarray:
        """Values (K, M) in noise units, less the level, across a common factor and offset."""
        change = scaled - self.level
        return change - (change @ self.directions) @ self.directions.T

    def _quiet(self, readings: np.ndarray) -> np.ndarray:
        """(U,) bool: frames of readings (U, M) that are not loud."""
        size = (readings**2).mean(axis=1)
        loud = size > LOUD * max(1.0, np.quantile(size, 0.25))
        if loud.mean() > MOST_OFF:
            return np.ones(len(size), bool)
        amplitudes = self._amplitudes(readings[loud])
        loud[loud] = np.abs(amplitudes) < MOST_LOUD_SHARE * self.width * size[loud]
        return ~loud if loud.mean() <= MOST_LOUD else np.ones(len(size), bool)

    @cached_property
    def _projection(self) -> np.ndarray:
        """(M, G): unit changes by a rise of the conductivity at each of G places."""
        channels = self.recording.channels[self.usable]
        angles = self.recording.skin.electrode_deg
        n = self.recording.n_electrodes
        electrode_deg = np.arange(n) * 360.0 / n if angles is None else np.array(angles)
        turns = np.exp(2j * np.pi * np.arange(alignment.GRID_ANGLES) / alignment.GRID_ANGLES)
        places = (alignment.GRID_RADII[:, None] * turns).ravel()
        change = alignment.sensitivity(channels, electrode_deg, places).T
        if self.recording.metadata["voltage"] == "magnitude":
            sign = np.sign(alignment.homogeneous_readings(channels, electrode_deg))
            change *= np.where(np.isfinite(sign), sign, 1.0)[:, None]
        change /= self.sd[:, None]
        change -= self.directions @ (self.directions.T @ change)
        length = np.linalg.norm(change, axis=0)
        return change / np.where(length > 0.0, length, 1.0)

    @cached_property
    def _touch_sign(self) -> float:
        """1 where touches raise the conductivity, -1 where they lower it, 0 where nobody knows."""
        rows = np.flatnonzero(self.recording.frames["touch"].to_numpy(bool))
        if len(rows):
            rows = rows[np.linspace(0, len(rows) - 1, min(len(rows), MAX_REFERENCES)).astype(int)]
            return float(np.sign(self._amplitudes(self._labelled(rows)).sum()))
        return float(np.sign(self.recording.skin.contrast_per_N or 0.0))

    def _labelled(self, rows: np.ndarray) -> np.ndarray:
        """(K, M): the changes of touched frames; 0 where lost."""
        values = self.recording.readings[np.ix_(rows, self.usable)] / self.sd
        return self._across(np.where(np.isfinite(values), values, self.level))

    def _amplitudes(self, changes: np.ndarray) -> np.ndarray:
        """(K,): signed squares of the touch at one place that explains most of each change."""
        amplitude = np.zeros(len(changes))
        for start in range(0, len(changes), BLOCK_FRAMES):
            products = changes[start : start + BLOCK_FRAMES] @ self._projection
            best = np.argmax(np.abs(products), axis=1)
            amplitude[start : start + BLOCK_FRAMES] = products[np.arange(len(best)), best]
        return amplitude * np.abs(amplitude)

    @cached_property
    def _is_break(self) -> np.ndarray:
        """(U - 1,) bool: whether frame and next differ by more than noise and usual wander."""
        steps = 0.5 * (np.diff(self.readings, axis=0) ** 2).mean(axis=1)
        return steps > BREAK * max(1.0, np.quantile(steps, 0.25))

    @cached_property
    def _levels(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """The means (U, M) of each frame and of those before it, up to LEVEL_FRAMES without a
        break, and of each and those after it; and the numbers (U,) of these frames."""
        count = len(self.rows)
        means, numbers = np.zeros((2, *self.readings.shape)), np.zeros((2, count))
        steady = ~self._is_break & (np.diff(self.session) == 0)
        for frame in range(count):
            first, last = frame, frame
            while first > 0 and frame - first < LEVEL_FRAMES - 1 and steady[first - 1]:
                first -= 1
            while last < count - 1 and last - frame < LEVEL_FRAMES - 1 and steady[last]:
                last += 1
            for k, span in enumerate((slice(first, frame + 1), slice(frame, last + 1))):
                means[k, frame] = self.readings[span].mean(axis=0)
                numbers[k, frame] = span.stop - span.start
        return means[0], numbers[0], means[1], numbers[1]

    def _proposals(self) -> Iterator[tuple[int, int]]:
        """Stretches, first and last of U, between whose neighbours there may be a return: those
        that begin and end with a break, and those of frames off the usual level; each within one
        run of untouched frames, with a frame on either side."""
        before, _, after, _ = self._levels
        breaks = np.flatnonzero(self._is_break)
        for k, start in enumerate(breaks):
            ends = breaks[k + 1 : k + 1 + MOST_BREAKS]
            ends = ends[self.run[ends] == self.run[start + 1]]
            if not len(ends):
                continue
            gap = ((after[ends + 1] - before[start]) ** 2).mean(axis=1)
            size = ((self.readings[start + 1 : ends[-1] + 1] - before[start]) ** 2).mean(axis=1)
            mean_size = (np.cumsum(size) / np.arange(1, len(size) + 1))[ends - start - 1]
            for end in ends[gap < mean_size]:
                yield int(start) + 1, int(end)
        size = (self.readings**2).mean(axis=1)
        off = size > BREAK * max(1.0, np.quantile(size, 0.25))
        turns = np.flatnonzero((np.diff(off.astype(int)) != 0) | (np.diff(self.run) != 0)) + 1
        margins = MARGINS if len(turns) <= 2 * MOST_RUNS else MARGINS[:1]
        for first, end in pairwise([0, *turns.tolist(), len(off)]):
            for margin, end_margin in product(margins, margins):
                begin, last = first - margin, end - 1 + end_margin
                inside = begin > 0 and last < len(off) - 1
                if off[first] and inside and self.run[begin] == self.run[last]:
                    yield begin, last

    def _change(self, first: int, last: int) -> tuple[np.ndarray, float] | None:
        """The change (K, M) of a stretch from the levels beside it, and its noise's variance; None
        where these levels do not agree, or a frame has no part in it."""
        before, before_number, after, after_number = self._levels
        if self.session[first - 1] != self.session[last + 1]:
            return None
        number = before_number[first - 1], after_number[last + 1]
        level_noise = 1.0 / number[0] + 1.0 / number[1]
        gap = after[last + 1] - before[first - 1]
        time = self.time[first - 1 : last + 2]
        share = ((time - time[0]) / ((time[-1] - time[0]) or 1.0))[1:-1, None]
        level = (1.0 - share) * before[first - 1] + share * after[last + 1]
        change = self.readings[first : last + 1] - level
        noise = float(1.0 + ((1.0 - share) ** 2 / number[0] + share**2 / number[1]).mean())
        excess = (change**2).mean() - noise
        if excess * change.size < LEAST_ENERGY:
            return None
        gap_excess = (gap**2).mean() - level_noise
        if gap_excess > max(MOST_RETURN * excess, RETURN_SD * self.scatter * level_noise):
            return None
        pattern = _pattern(change)
        gap_along = abs(float(gap @ pattern))
        if gap_along > max(AMPLITUDE_SD * np.sqrt(level_noise), MOST_REST * np.linalg.norm(gap)):
            return None
        for beside in (before[first - 1], after[last + 1]):
            if beside @ pattern > max(AMPLITUDE_SD, MOST_REST * np.linalg.norm(beside)):
                return None
        if (change @ pattern < AMPLITUDE_SD * np.sqrt(noise)).any():
            return None
        gap_energy = gap_excess * self.width
        if gap_energy > LEAST_ENERGY:
            of_touch = np.abs(self._amplitudes(gap[None])[0])
            if of_touch > MIN_EXPLAINED * gap_energy:
                return None
        return change, noise

    def _is_touch(self, change: np.ndarray, noise: float, rows: np.ndarray) -> bool:
        """Whether the change (K, M) of frames of some rows is a touch's, and not that of the
        labelled press beside them."""
        energy = (change**2).sum() - noise * change.size
        amplitudes = self._amplitudes(change)
        channels = self.recording.channels[self.usable]
        electrodes = np.arange(self.recording.n_electrodes)
        uses_electrode = (channels[None] == electrodes[:, None, None]).any(axis=2)
        of_electrode = (uses_electrode @ (change**2 - noise).sum(axis=0)).max()
        least = max(MIN_EXPLAINED * energy, of_electrode + MIN_MARGIN * energy)
        if np.abs(amplitudes).sum() < least:
            return False
        if np.sign(amplitudes.sum()) == -self._touch_sign:
            return False
        touched = self.recording.frames["touch"].to_numpy(bool)
        beside = [row for row in (rows[0] - 1, rows[-1] + 1) if 0 <= row < len(touched)]
        labelled_changes = self._labelled(np.array([row for row in beside if touched[row]], int))
        length = np.linalg.norm(labelled_changes, axis=1)
        shared = change @ (labelled_changes / np.where(length > 0.0, length, 1.0)[:, None]).T
        return bool(((shared**2).sum(axis=0) <= MAX_LABELLED * energy).all())

    def stretches(self) -> list[np.ndarray]:
        """Rows of the stretches that hold a touch, the longest first, none in two."""
        taken = np.zeros(len(self.rows), bool)
        stretches = []
        for first, last in sorted(set(self._proposals()), key=lambda ends: ends[0] - ends[1]):
            if taken[first - 1 : last + 2].any():
                continue
            difference = self._change(first, last)
            if difference is None or not self._is_touch(*difference, self.rows[[first, last]]):
                continue
            first, last = self._extended(first, last, difference[0])
            taken[first : last + 1] = True
            stretches.append(np.arange(self.rows[first], self.rows[last] + 1))
        return stretches

    def _extended(self, first: int, last: int, change: np.ndarray) -> tuple[int, int]:
        """A stretch with the frames beside it in which its touch is weaker, but there."""
        pattern = _pattern(change)
        before, _, after, _ = self._levels
        levels = before[first - 1] @ pattern, after[last + 1] @ pattern
        amplitude = self.readings @ pattern - 0.5 * sum(levels)
        limit = max(AMPLITUDE_SD, WANDER * abs(levels[1] - levels[0]))

        def belongs(frame: int) -> bool:
            inside = 0 < frame < len(self.rows) - 1 and self.run[frame] == self.run[first]
            return bool(inside and amplitude[frame] > limit)

        while belongs(first - 1):
            first -= 1
        while belongs(last + 1):
            last += 1
        return first, last


def _pattern(change: np.ndarray) -> np.ndarray:
    """(M,): the unit vector that most of a change (K, M) is along, by the power method."""
    pattern = change[np.argmax((change**2).sum(axis=1))]
    for _ in range(POWER_STEPS):
        pattern = change.T @ (change @ (pattern / np.linalg.norm(pattern)))
    pattern = pattern / np.linalg.norm(pattern)
    return pattern if (change @ pattern).sum() > 0.0 else -pattern


def _usual_level(scaled: np.ndarray) -> np.ndarray:
    """(M,): the mean of the frames of (U, M), in noise units, that are like one frame, which is the
    one that most are like."""
    count = len(scaled)
    compared = scaled[np.linspace(0, count - 1, min(count, MOST_COMPARED)).astype(int)]
    square = (compared**2).sum(axis=1)
    distance = (square[:, None] + square - 2.0 * compared @ compared.T) / (2 * scaled.shape[1])
    np.fill_diagonal(distance, np.inf)
    nearest = distance.min(axis=1)
    np.fill_diagonal(distance, 0.0)
    alike = distance < BREAK * max(1.0, np.quantile(nearest, 0.25))
    return compared[alike[np.argmax(alike.sum(axis=1))]].mean(axis=0)
