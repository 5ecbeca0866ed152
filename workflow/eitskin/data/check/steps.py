"""Steps in time: a wire moved, a gain switched, a recording pasted together.

A split lies between two untouched frames. The frames beside it give the change across it twice,
with independent noise: x[k+1] - x[k] and x[k+2] - x[k-1]. Noise, outlying frames and spikes differ
between the two, a lasting change is common to both. Their similarity is compared with that of the
recording's other splits, so that random walks, drift and recovery, which are in all splits, are no
steps. A factor common to all channels is tested separately, because sources drift.
"""

from dataclasses import dataclass, replace

import numpy as np

from eitskin.data import subset
from eitskin.data.baseline import sessions
from eitskin.data.check.measures import NORMAL, channel_noise
from eitskin.data.check.unlabelled import unlabelled_touches
from eitskin.data.recording import Recording, presses

WIDTHS, WINDOWS_PER_WIDTH = (2, 4, 8, 16), 4  # frames on either side; least frames over a width
MIN_SPLITS = 8  # of a kind, for a median of ordinary splits
# In energy, over that of an ordinary split; `python -m proof.steps` has the false alarms. One
# number of a wandering source varies more than the sum over many channels does.
MIN_RATIO, MIN_COMMON_RATIO = 20.0, 40.0
SPIKE_SD = 5.0  # standard deviations; normal noise passes it once in two million readings
SPIKE_CHANNEL_SHARE = 0.02  # of the channels: a change in these alone is two spikes
MIN_ENERGY_SHARE = 0.8  # of a change's energy in the channels of a few electrodes
MAX_ELECTRODES = 3  # of one moved wire or bundle
MAX_NAMED_CHANNELS = 3  # more make a sentence unreadable


@dataclass(frozen=True)
class Step:
    """A lasting change between two untouched frames.

    `frame` is the likeliest first frame after it, within the untouched frames `between`; `size` the
    norm of the change over all channels in units of the channels' noise; `factor` the common factor
    of all channels, None where it is no common one; `electrodes` at most MAX_ELECTRODES whose
    channels hold most of the change, none where it is everywhere; `channels` the rows that changed
    most in units of their noise, the largest first.
    """

    frame: int
    between: tuple[int, int]
    size: float
    factor: float | None
    electrodes: tuple[int, ...]
    channels: tuple[int, ...]


def steps(recording: Recording) -> list[Step]:
    """All steps in order of time; none of differences, which have no untouched readings.

    A step needs two untouched frames before and two after it in its session, and MIN_SPLITS splits
    of its kind, across presses or within a run of untouched frames. Frames in which somebody
    touched though no label tells (`unlabelled`) count as touched.
    """
    if recording.voltage is None or recording.metadata["values"] == "difference":
        return []
    return [
        replace(step, frame=step.frame + start, between=(before + start, after + start))
        for start, answered, part in subset.blocks(recording)
        for step in _steps(part)
        for before, after in [step.between]
        if step.frame + start in answered
    ]


def _steps(recording: Recording) -> list[Step]:
    """The steps within a block of a recording."""
    rows = np.flatnonzero(~recording.frames["touch"].to_numpy(dtype=bool))
    rows = rows[(np.nan_to_num(recording.readings[rows]) != 0).any(axis=1)]
    for first, last in unlabelled_touches(recording):
        rows = rows[(rows < first) | (rows > last)]
    if len(rows) < MIN_SPLITS + 3:
        return []
    scaled = recording.readings / channel_noise(recording.readings[rows])
    rows = rows[~_is_loud(scaled[rows])]
    if len(rows) < MIN_SPLITS + 3:
        return []
    smoothed = _smoothed(scaled[rows])
    level = np.median(smoothed, axis=0)
    level_norm = max(float(np.linalg.norm(level)), np.finfo(float).tiny)
    common_part = smoothed @ level / level_norm  # its noise has sd 1, as a channel's
    residual = smoothed - common_part[:, None] * level / level_norm
    factors: dict[int, float | None] = {}
    for width in WIDTHS:
        if width == WIDTHS[0] or len(rows) >= WINDOWS_PER_WIDTH * width:
            factors |= _outlying_splits(recording, rows, common_part, residual, width, factors)
    return [
        _step(recording, rows, scaled, smoothed, k, factor) for k, factor in sorted(factors.items())
    ]


def _outlying_splits(
    recording: Recording,
    rows: np.ndarray,
    common_part: np.ndarray,
    residual: np.ndarray,
    width: int,
    earlier_splits: dict[int, float | None],
) -> dict[int, float | None]:
    """Outlying splits k of one window width, away from `earlier_splits`, with the common factor
    where the common part alone is outlying."""
    splits, is_across, gap = _splits(recording, rows, width)
    if not len(splits):
        return {}
    similarity = _similarity(*_changes(residual, splits, width))
    residual_ratio = (
        similarity
        / _ordinary_similarity(similarity, is_across, gap, 2.0 / width * np.sqrt(residual.shape[1]))
        / MIN_RATIO
    )
    max_ratio = residual_ratio
    if width == WIDTHS[0]:  # in wide windows one number wanders too much
        near_change, far_change = _changes(common_part[:, None], splits, width)
        ordinary = _ordinary_similarity(near_change[:, 0] ** 2, is_across, gap, 2.0)
        max_ratio = np.maximum(
            residual_ratio, _similarity(near_change, far_change) / ordinary / MIN_COMMON_RATIO
        )
    outlying: dict[int, float | None] = {}
    for i in np.flatnonzero(max_ratio > 1.0):
        k = int(splits[i])
        local_max = max_ratio[np.abs(splits - k) < width].max()
        if max_ratio[i] < local_max or any(
            abs(k - other_split) < width for other_split in (*earlier_splits, *outlying)
        ):
            continue
        level_before, level_after = (
            common_part[k - 1 : k + 1].mean(),
            common_part[k + 1 : k + 3].mean(),
        )
        outlying[k] = (
            float(level_after / level_before) if residual_ratio[i] <= 1.0 and level_before else None
        )
    return outlying


def _changes(series: np.ndarray, k: np.ndarray, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Two changes (K, M) across splits k: by every other of `width` frames on either side, from the
    nearest on, and by the remaining ones."""
    changes = []
    for start in (0, 1):
        offsets = np.arange(start, width, 2)
        after = series[k[:, None] + 1 + offsets].mean(axis=1)
        changes.append(after - series[k[:, None] - offsets].mean(axis=1))
    return changes[0], changes[1]


def _median(scaled: np.ndarray) -> np.ndarray:
    """(U, M): running median of three frames, of the whole channel where all three are lost; it
    keeps steps sharp."""
    channel_median = np.nanmedian(np.where(np.isfinite(scaled).any(axis=0), scaled, 0.0), axis=0)
    neighbourhood = np.stack([scaled[:-2], scaled[1:-1], scaled[2:]])
    neighbourhood = np.concatenate(
        [neighbourhood[:, :1], neighbourhood, neighbourhood[:, -1:]], axis=1
    )
    has_readings = np.isfinite(neighbourhood).any(axis=0)
    return np.nanmedian(np.where(has_readings, neighbourhood, channel_median), axis=0)


def _is_loud(scaled: np.ndarray) -> np.ndarray:
    """(U,) bool: frames (U, M), in noise units, unlike their neighbours in most channels."""
    deviation = np.nanmedian(np.abs(scaled - _median(scaled)), axis=1)
    return deviation > SPIKE_SD * np.maximum(np.median(deviation), 1.0 / SPIKE_SD)


def _smoothed(scaled: np.ndarray) -> np.ndarray:
    """(U, M): frames in noise units, spikes and lost readings replaced by the running median."""
    median = _median(scaled)
    return np.where(np.abs(scaled - median) <= SPIKE_SD, scaled, median)


def _splits(
    recording: Recording, rows: np.ndarray, width: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Splits with `width` untouched frames on either side in one session.

    k (K,), the number of the untouched frame before the split; whether touched frames lie between
    (K,); and the time across it over the median time of its kind (K,), at least 1.
    """
    session = sessions(recording.frames)[rows]
    k = np.arange(width - 1, len(rows) - width)
    k = k[session[k - width + 1] == session[k + width]]
    n_touched = np.cumsum(recording.frames["touch"].to_numpy(dtype=bool))
    is_across = n_touched[rows[k + 1]] > n_touched[rows[k]]
    time = recording.frames["time_s"].to_numpy(float)
    if recording.metadata["clock"] == "index":
        time = np.arange(len(time), dtype=float)
    gap = time[rows[k + 1]] - time[rows[k]]
    for kind_mask in (is_across, ~is_across):
        if kind_mask.any():
            gap[kind_mask] = np.maximum(gap[kind_mask] / np.median(gap[kind_mask]), 1.0)
    return k, is_across, gap


def _similarity(near_change: np.ndarray, far_change: np.ndarray) -> np.ndarray:
    """(K,): squared length that two measurements (K, M) of a change have in common, at most that
    of the shorter; without the few channels that have most, for two spikes may meet in one.
    """
    product = np.sort(near_change * far_change, axis=1)
    n_counted = product.shape[1] - int(SPIKE_CHANNEL_SHARE * product.shape[1])
    norms = np.linalg.norm(near_change, axis=1), np.linalg.norm(far_change, axis=1)
    longer_norm = np.maximum(*norms)
    ratio = np.minimum(*norms) / np.where(longer_norm > 0, longer_norm, 1.0)
    return ratio * product[:, :n_counted].sum(axis=1)


def _ordinary_similarity(
    similarity: np.ndarray, is_across: np.ndarray, gap: np.ndarray, white_level: float
) -> np.ndarray:
    """(K,): what `similarity` is of an ordinary split of its kind; infinite where too few tell.

    least: what white noise alone makes of it.
    """
    sizes = np.abs(similarity)
    ordinary = np.full(len(similarity), np.inf)
    if is_across.sum() >= MIN_SPLITS:
        ordinary[is_across] = gap[is_across] * NORMAL * np.median(sizes[is_across] / gap[is_across])
    if len(similarity) >= MIN_SPLITS:
        ordinary[~is_across] = gap[~is_across] * NORMAL * np.median(sizes)
    return np.maximum(ordinary, max(white_level, np.finfo(float).tiny))


def _step(
    recording: Recording,
    rows: np.ndarray,
    scaled: np.ndarray,
    smoothed: np.ndarray,
    k: int,
    factor: float | None,
) -> Step:
    level_before, level_after = (
        smoothed[k - 1 : k + 1].mean(axis=0),
        smoothed[k + 1 : k + 3].mean(axis=0),
    )
    change = level_after - level_before
    span = np.arange(rows[k] + 1, rows[k + 1] + 1)
    first_after = _first_after(
        scaled[span[:-1]], presses(recording)[span[:-1]], level_before, level_after
    )
    return Step(
        frame=int(span[first_after]),
        between=(int(rows[k]), int(rows[k + 1])),
        size=float(np.linalg.norm(change)),
        factor=factor,
        electrodes=() if factor is not None else _electrodes(recording, change),
        channels=tuple(np.argsort(-np.abs(change), kind="stable")[:MAX_NAMED_CHANNELS].tolist()),
    )


def _first_after(
    touched: np.ndarray, press: np.ndarray, level_before: np.ndarray, level_after: np.ndarray
) -> int:
    """Which of touched frames (K, M) between two untouched ones is the first after a step, K for
    none: with the right one the changes of a press are nearest to one pattern of varying strength.
    """
    costs = []
    for first_late in range(len(touched) + 1):
        is_late = np.arange(len(touched))[:, None] >= first_late
        change = np.nan_to_num(touched - np.where(is_late, level_after, level_before))
        residual_power = 0.0
        for press_number in np.unique(press):
            strength = np.linalg.svd(change[press == press_number], compute_uv=False)
            residual_power += (strength[1:] ** 2).sum()
        costs.append(residual_power)
    return int(np.argmin(costs))


def _electrodes(recording: Recording, change: np.ndarray) -> tuple[int, ...]:
    """At most FEW electrodes whose channels hold COVERED of a change beyond noise."""
    energy = np.maximum(change**2 - 1.0, 0.0)
    channels, electrodes = recording.channels, np.arange(recording.n_electrodes)
    uses_electrode = (channels[None] == electrodes[:, None, None]).any(axis=2).astype(float)
    total_energy, electrodes_with_most = energy.sum(), []
    for _ in range(MAX_ELECTRODES):
        electrode_energy = uses_electrode @ energy
        electrodes_with_most.append(int(np.argmax(electrode_energy)))
        energy = np.where(uses_electrode[electrodes_with_most[-1]] > 0, 0.0, energy)
        if energy.sum() <= (1.0 - MIN_ENERGY_SHARE) * total_energy:
            return tuple(electrodes_with_most)
    return ()
