"""Measures of a recording: counts, faults of channels, noise, drift and reciprocity."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from eitskin.data.channel_order import relative_change
from eitskin.data.check.finding import ERROR, WARNING
from eitskin.data.check.placeholders import unplugged
from eitskin.data.recording import Recording, presses
from eitskin.physics.protocol import reciprocal_channels

NORMAL = 1.4826  # standard deviation of a normal variable over its median absolute deviation
MAX_FRAMES = 500  # of differences: enough for an rms, and quick
CLIPPED_FRAMES = 3  # at the ceiling: fewer may be equal by chance
MAX_REPEATED_SHARE = 0.5  # of the table's rows: beyond, it is no table of a measurement
MIN_NOISE_SHARE = 0.3  # of the median channel's noise: a floor for quantised channels
MIN_REPEATS = 4  # frames of one state, for the noise of each reading
UNKNOWNS = 3  # x, y and F of a touch
MAX_CHANCE = 1e-6  # that a channel which is read gives one value all along
MAX_NOISE = 1.5  # of a drift over that which noise makes: less, and nothing else is seen
OFF_GRID = 0.01  # of a step, at most, of readings that are rounded to it
MIN_STEP = 1e-6  # of the largest reading: finer steps are the rounding of a computation
MAX_GAP = 10  # steps between the two nearest readings, of those of few digits
TIED_CHANNELS = 0.9  # quantile of the channels' shares of ties
MAX_TIES = 0.5  # of successive readings: of more, the digits hide what a ceiling would


@dataclass(frozen=True)
class Contents:
    """Numbers of frames of each kind; `presses` and `places` are None without touches, `seconds`
    without a measured clock."""

    frames: int
    untouched: int
    touched: int
    presses: int | None
    places: int | None
    seconds: float | None


def contents(recording: Recording) -> Contents:
    """Counts of a recording or query."""
    frames = recording.frames
    touch = frames["touch"].to_numpy(dtype=bool)
    is_timed = recording.metadata["clock"] == "measured" and len(frames) > 1
    return Contents(
        frames=len(frames),
        untouched=int((~touch).sum()),
        touched=int(touch.sum()),
        presses=int(presses(recording).max()) + 1 if touch.any() else None,
        places=len(frames.loc[touch, ["x_mm", "y_mm"]].drop_duplicates()) if touch.any() else None,
        seconds=float(np.ptp(frames["time_s"])) if is_timed else None,
    )


def levels(recording: Recording, column: str) -> tuple[float, float, int] | None:
    """Smallest and largest value of a column in touched frames, and the number of distinct values;
    None where none is known."""
    values = recording.frames.loc[recording.frames["touch"].to_numpy(dtype=bool), column].dropna()
    return (values.min(), values.max(), values.nunique()) if len(values) else None


def pattern(recording: Recording, column: int) -> str:
    """The pattern of the pairs in columns `column`, `column` + 1 of the channel table (0: drives,
    2: measurements), as `protocol` names it."""
    n = recording.n_electrodes
    pair = recording.channels[:, column : column + 2]
    steps = {min(step, n - step) for step in ((pair[:, 1] - pair[:, 0]) % n).tolist()}
    if len(steps) > 1:
        return "mixed"
    step = steps.pop()
    names = {1: "adjacent", n // 2: "opposite"}
    return names.get(step, f"skip-{step - 1}")


def measure_setting(recording: Recording) -> str | None:
    """The value of the setting `measure` for pairs with plus and minus exchanged; None where the
    pairs have no common pattern."""
    name = pattern(recording, 2)
    plus, minus = recording.channels[:, 2:].T
    is_reversed = (minus - plus) % recording.n_electrodes > recording.n_electrodes / 2
    if name == "mixed" or is_reversed.any() != is_reversed.all():
        return None
    return name if is_reversed.all() else f"{name}-reversed"


@dataclass(frozen=True)
class RepeatedChannels:
    """Rows of the channel table that repeat an earlier row, and their share of all rows."""

    rows: np.ndarray
    share: float

    @property
    def severity(self) -> str:
        """An error where most rows are repeats: that is no table of a measurement."""
        return ERROR if self.share > MAX_REPEATED_SHARE else WARNING


def repeated_channels(recording: Recording) -> RepeatedChannels | None:
    """Channels repeated in the table; None without any."""
    _, first_rows = np.unique(recording.channels, axis=0, return_index=True)
    repeated_rows = np.setdiff1d(np.arange(len(recording.channels)), first_rows)
    return (
        RepeatedChannels(repeated_rows, len(repeated_rows) / len(recording.channels))
        if len(repeated_rows)
        else None
    )


@dataclass(frozen=True)
class DeadChannels:
    """Numbers of channels with readings other than 0 in every state of the skin, of all channels,
    and of those needed; and whether there are two states, untouched and touched."""

    n_live: int
    channels: int
    n_needed: int
    has_both_states: bool


def dead_channels(recording: Recording) -> DeadChannels | None:
    """Counts of live channels where they are fewer than the unknowns of a touch, else None."""
    touch = recording.frames["touch"].to_numpy(dtype=bool)
    is_nonzero = (recording.readings != 0) & ~np.isnan(recording.readings)
    difference = recording.metadata["values"] == "difference"
    states = [touch] if difference and touch.any() else [~touch, touch]
    is_live = np.logical_and.reduce(
        [is_nonzero[state].any(axis=0) for state in states if state.any()]
    )
    needed = min(UNKNOWNS, len(is_live))
    if is_live.sum() >= needed:
        return None
    return DeadChannels(
        int(is_live.sum()), len(is_live), needed, bool(len(states) > 1 and touch.any())
    )


@dataclass(frozen=True)
class LostReadings:
    """Channels lost in every frame, but those of unplugged electrodes, lost in some frames, and
    stuck at one value while others vary.

    `share` is the share of all readings lost, `share_of_partly_lost` that of the partly lost
    channels.
    """

    always_lost: np.ndarray
    partly_lost: np.ndarray
    stuck: np.ndarray
    channels: int
    share: float
    share_of_partly_lost: float


def lost_readings(recording: Recording) -> LostReadings:
    """Channels with lost readings and channels that never change, though by the ties of others they
    should: rounded readings repeat."""
    values, is_lost = recording.readings, np.isnan(recording.readings)
    is_partly_lost = is_lost.any(axis=0) & ~is_lost.all(axis=0)
    is_stuck = ~is_lost.any(axis=0) & (values == values[:1]).all(axis=0)
    is_stuck &= tie_share(values) ** (len(values) - 1) <= MAX_CHANCE
    of_unplugged = np.zeros(is_lost.shape[1], bool)
    for electrode in unplugged(recording):
        of_unplugged[electrode.channels] = True
    return LostReadings(
        always_lost=np.flatnonzero(is_lost.all(axis=0) & ~of_unplugged),
        partly_lost=np.flatnonzero(is_partly_lost),
        stuck=np.flatnonzero(is_stuck),
        channels=is_lost.shape[1],
        share=float(is_lost.mean()),
        share_of_partly_lost=float(is_lost[:, is_partly_lost].mean())
        if is_partly_lost.any()
        else 0.0,
    )


def tie_share(values: np.ndarray) -> float:
    """Probability that a channel reads the same twice in a row: that of the channels (N, M) with
    most ties among those that change, their share of ties by Laplace's rule; 1 where none changes.
    """
    is_changing = (values != values[:1]).any(axis=0) & np.isfinite(values).all(axis=0)
    if not is_changing.any():
        return 1.0
    ties = (values[1:, is_changing] == values[:-1, is_changing]).sum(axis=0)
    return float(np.quantile((ties + 1) / (len(values) + 1), TIED_CHANNELS))


@dataclass(frozen=True)
class ClippedChannels:
    """Channels clipped at a ceiling, the ceiling, and their share of all channels."""

    channels: np.ndarray
    ceiling: float
    share: float


def clipped_channels(recording: Recording) -> ClippedChannels | None:
    """Channels clipped at a ceiling.

    The largest |reading| must recur exactly in CLIPPED_FRAMES different frames, and more than twice
    as often as any other reading above 90 % of it; none where rounding makes other channels repeat
    as well. None for recordings of differences.
    """
    if recording.metadata["values"] == "difference":
        return None
    sizes = np.unique(np.abs(recording.readings), axis=0)
    if not np.isfinite(sizes).any():
        return None
    ceiling = np.nanmax(sizes)
    at_ceiling = sizes == ceiling
    channels = np.flatnonzero(at_ceiling.any(axis=0))
    channel_sizes = sizes[:, channels]
    large_sizes, counts = np.unique(
        channel_sizes[(channel_sizes < ceiling) & (channel_sizes > 0.9 * ceiling)],
        return_counts=True,
    )
    max_repeats = counts.max() if len(large_sizes) else 0
    is_varying = (channel_sizes < ceiling).any() or len(channels) > 1
    is_frequent = at_ceiling.any(axis=1).sum() >= CLIPPED_FRAMES
    below_ceiling = recording.readings[:, ~at_ceiling.any(axis=0)]
    is_resolved = not below_ceiling.size or tie_share(below_ceiling) <= MAX_TIES
    if not (is_frequent and is_resolved and is_varying and at_ceiling.sum() > 2 * max_repeats):
        channels = channels[:0]
    return ClippedChannels(channels, float(ceiling), len(channels) / sizes.shape[1])


@dataclass(frozen=True)
class Noise:
    """Standard deviation of the median channel's noise, the number of untouched frames used, and
    whether presses lie between them."""

    sigma: float
    frames: int
    between_presses: bool


def noise(recording: Recording) -> Noise | None:
    """Noise by successive untouched frames, None without any.

    The median absolute difference of successive frames / sqrt(2), scaled to a standard deviation,
    is hardly affected by drift.
    """
    rows = np.flatnonzero(~recording.frames["touch"].to_numpy(dtype=bool))
    is_consecutive = np.diff(rows) == 1
    differences = np.diff(recording.readings[rows], axis=0)
    if is_consecutive.any():
        differences = differences[is_consecutive]
    if not np.isfinite(differences).any():
        return None
    channel_sd = successive_noise(differences)
    return Noise(float(np.nanmedian(channel_sd)), len(differences) + 1, not is_consecutive.any())


def successive_noise(differences: np.ndarray) -> np.ndarray:
    """(M,): sd of each channel's noise from successive differences (K, M), as in `noise`; NaN
    without any."""
    return NORMAL * column_statistic(np.nanmedian, np.abs(differences)) / np.sqrt(2.0)


def channel_noise(values: np.ndarray) -> np.ndarray:
    """(M,): sd of each channel's noise from successive untouched frames (U, M).

    At least MIN_NOISE_SHARE of the median channel's; 1 where no reading ever changes.
    """
    differences = np.diff(values, axis=0)
    differences[:, ~np.isfinite(differences).any(axis=0)] = 0.0
    channel_sd = successive_noise(differences)
    if not channel_sd.any():
        channel_sd[:] = np.sqrt(np.nanmean(differences**2) / 2.0)
    median_sd = np.median(channel_sd[channel_sd > 0]) if channel_sd.any() else 1.0
    return np.maximum(channel_sd, MIN_NOISE_SHARE * median_sd)


def reading_variance(recording: Recording) -> np.ndarray:
    """(M,): variance of one reading by noise, from successive untouched frames, else from
    successive frames of a press; 0 where neither tells."""
    press = presses(recording)
    rows = np.flatnonzero(press < 0)
    if len(rows) < MIN_REPEATS:
        rows = np.arange(len(press))
    is_repeat = press[rows[1:]] == press[rows[:-1]]
    differences = np.diff(recording.readings[rows], axis=0)[is_repeat]
    if len(differences) < MIN_REPEATS - 1:
        return np.zeros(recording.readings.shape[1])
    return np.asarray(np.nan_to_num(successive_noise(differences)) ** 2)


def noise_bound(recording: Recording) -> float | None:
    """Upper bound of the noise by the odd half of reciprocal pairs; None without pairs."""
    pairs, signs = reciprocal_channels(recording.channels)
    values, signs = identity_readings(recording, signs)
    odd_half = np.abs(values[:, pairs[:, 1]] - signs * values[:, pairs[:, 0]])
    return (
        float(NORMAL * np.nanmedian(odd_half) / np.sqrt(2.0))
        if np.isfinite(odd_half).any()
        else None
    )


def resolution(recording: Recording) -> float | None:
    """The step of which all readings are multiples, as rounding makes them; None without one, and
    where it is below MIN_STEP of the largest reading."""
    sizes = np.unique(np.abs(recording.readings[np.isfinite(recording.readings)]))
    if len(sizes) < 2:
        return None
    for step in np.diff(sizes).min() / np.arange(1, MAX_GAP + 1):
        off_grid = np.abs(sizes / step - np.round(sizes / step))
        if off_grid.max() < OFF_GRID and step >= MIN_STEP * sizes[-1]:
            return float(step)
    return None


def median_reading(recording: Recording) -> float:
    """The median |reading| of the untouched skin."""
    untouched = recording.readings[~recording.frames["touch"].to_numpy(dtype=bool)]
    return float(np.nanmedian(np.abs(untouched)))


@dataclass(frozen=True)
class Drift:
    """Median relative change of a channel, the share of the change that one common factor does not
    explain (None without change), and whether noise alone changes readings as much."""

    change: float
    residual_share: float | None
    is_noise: bool = False


def drift(recording: Recording) -> Drift | None:
    """Change of the untouched readings from their first tenth to their last; None for fewer than
    two frames."""
    untouched_readings = recording.readings[~recording.frames["touch"].to_numpy(dtype=bool)]
    if len(untouched_readings) < 2:
        return None
    n_frames = max(1, len(untouched_readings) // 10)
    early_level = column_statistic(np.nanmean, untouched_readings[:n_frames])
    late_level = column_statistic(np.nanmean, untouched_readings[-n_frames:])
    is_usable = np.isfinite(early_level) & np.isfinite(late_level) & (early_level != 0)
    noise_sd = channel_noise(untouched_readings)[is_usable]
    early_level, late_level = early_level[is_usable], late_level[is_usable]
    if not len(early_level):
        return None
    residual_share = None
    if np.any(late_level != early_level):
        factor = early_level @ late_level / (early_level @ early_level)
        residual_share = float(
            np.linalg.norm(late_level - factor * early_level)
            / np.linalg.norm(late_level - early_level)
        )
    scores = (late_level - early_level) / (noise_sd * np.sqrt(2.0 / n_frames))
    return Drift(
        float(np.median(np.abs(late_level - early_level) / np.abs(early_level))),
        residual_share,
        len(untouched_readings) >= MIN_REPEATS and NORMAL * np.median(np.abs(scores)) < MAX_NOISE,
    )


@dataclass(frozen=True)
class Reciprocity:
    """Relative difference of reciprocal pairs: median, rms and number of pairs."""

    median: float
    rms: float
    pairs: int


def reciprocity(recording: Recording) -> Reciprocity | None:
    """Differences of untouched readings (their modulus where there is a quadrature) with drive and
    measurement exchanged; None without pairs and where all are 0."""
    pairs, signs = reciprocal_channels(recording.channels)
    if not len(pairs):
        return None
    values, signs = identity_readings(recording, signs)
    forward, reciprocal = signs * values[:, pairs[:, 0]], values[:, pairs[:, 1]]
    mean_size = (np.abs(forward) + np.abs(reciprocal)) / 2.0
    is_usable = np.isfinite(mean_size) & (mean_size > 0)
    if not is_usable.any():
        return None
    median_error = float(np.median(np.abs(forward - reciprocal)[is_usable] / mean_size[is_usable]))
    rms = relative_change(values, pairs, signs)
    return None if rms is None else Reciprocity(median_error, rms, len(pairs))


def identity_readings(recording: Recording, signs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Readings (K, M) for which the channel table's identities should hold, and the signs to use.

    The mean untouched frame, or some frames of differences; the modulus, with signs 1, where there
    is a quadrature; signs 1 for magnitudes.
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
        rows = np.linspace(0, len(values) - 1, min(len(values), MAX_FRAMES)).astype(int)
        return values[rows]
    untouched = ~recording.frames["touch"].to_numpy(dtype=bool)
    return column_statistic(np.nanmean, values[untouched])[None]


def column_statistic(statistic: Callable, values: np.ndarray) -> np.ndarray:
    """A statistic of each column (M,), NaN for a column without readings."""
    column_values = np.full(values.shape[1], np.nan)
    has_readings = np.isfinite(values).any(axis=0)
    column_values[has_readings] = statistic(values[:, has_readings], axis=0)
    return column_values
