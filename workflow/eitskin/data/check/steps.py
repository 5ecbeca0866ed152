"""Steps in time: a wire moved, a gain switched, a recording pasted together.

Between two untouched frames stands a split. The frames beside it give the change twice, with noise
of its own each: x[k+1] - x[k] and x[k+2] - x[k-1]. Noise, loud frames and spikes make the two
unlike, a lasting change alike. It is set against the recording's other splits, so that walks, drift
and recovery, which are in them all, are no steps. A factor common to all channels is looked at
apart from the rest, for sources wander.
"""

from dataclasses import dataclass

import numpy as np

from eitskin.data.baseline import sessions
from eitskin.data.check.measures import NORMAL, channel_noise
from eitskin.data.recording import Recording, presses

LEAST_SPLITS = 8  # of a kind, to know what is ordinary
# In energy, over that of an ordinary split; `python -m calibration.steps` has the false alarms. One
# number of a wandering source varies more than the sum over many channels does.
LARGER, LARGER_COMMON = 20.0, 40.0
SPIKE = 5.0  # standard deviations
IN_FEW = 0.02  # of the channels: no step, if it is in them alone
COVERED = 0.8  # of a change's energy: what a few electrodes have in common
FEW = 3
NAMED = 3


@dataclass(frozen=True)
class Step:
    """A lasting change between two untouched frames.

    frame: the first frame after it; between: the untouched frames beside it, within which `frame`
    is the likeliest; size: length of the change, of all channels together, over one frame's noise
    in one channel; factor: by which all channels changed alike, None where the step is no such;
    electrodes: at most three whose channels hold most of the change, none where it is everywhere;
    channels: the rows that changed most, in units of their noise, the largest first.
    """

    frame: int
    between: tuple[int, int]
    size: float
    factor: float | None
    electrodes: tuple[int, ...]
    channels: tuple[int, ...]


def steps(recording: Recording) -> list[Step]:
    """Every step, in order of time; none of differences, which have no untouched skin.

    A step needs two untouched frames before and two after it in its session, and LEAST_SPLITS
    splits of its kind, across presses or within untouched frames in a row.
    """
    if recording.voltage is None or recording.metadata["values"] == "difference":
        return []
    rows = np.flatnonzero(~recording.frames["touch"].to_numpy(dtype=bool))
    rows = rows[(np.nan_to_num(recording.voltage[rows]) != 0).any(axis=1)]
    if len(rows) < LEAST_SPLITS + 3:
        return []
    scale = channel_noise(recording.voltage[rows])
    white = recording.voltage / scale
    calm = _calm(white[rows])
    mean = np.median(calm, axis=0)
    along = calm @ mean / max(float(mean @ mean), np.finfo(float).tiny)
    rest = calm - along[:, None] * mean
    kept, across, gap = _splits(recording, rows)
    alike = _alike(rest, kept)
    several = alike / _ordinary(alike, across, gap, len(scale)) / LARGER
    wander = np.diff(along)[kept] ** 2
    common = _alike(along[:, None], kept) / _ordinary(wander, across, gap, 0) / LARGER_COMMON
    largest = np.maximum(several, common)
    found = []
    for i in np.flatnonzero(largest > 1.0):
        if largest[i] < largest[np.abs(kept - kept[i]) <= 1].max():
            continue
        k = kept[i]
        before, after = along[k - 1 : k + 1].mean(), along[k + 1 : k + 3].mean()
        factor = float(after / before) if several[i] <= 1.0 and before else None
        found.append(_step(recording, rows, white, calm, k, factor))
    return found


def _calm(white: np.ndarray) -> np.ndarray:
    """(U, M): frames in noise units, spikes and lost readings replaced by the median of a frame and
    the two beside it."""
    channel = np.nanmedian(np.where(np.isfinite(white).any(axis=0), white, 0.0), axis=0)
    around = np.stack([white[:-2], white[1:-1], white[2:]])
    around = np.concatenate([around[:, :1], around, around[:, -1:]], axis=1)
    known = np.isfinite(around).any(axis=0)
    median = np.nanmedian(np.where(known, around, channel), axis=0)
    return np.where(np.abs(white - median) <= SPIKE, white, median)


def _splits(recording: Recording, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Splits after the k-th of the untouched frames, with two frames on either side in a session:
    k (K,), whether touched frames lie between (K,), and how far apart its frames are (K,), over
    the usual distance where that is less.
    """
    session = sessions(recording.frames)[rows]
    k = np.arange(1, len(rows) - 2)
    k = k[session[k - 1] == session[k + 2]]
    across = rows[k + 1] - rows[k] > 1
    time = recording.frames["time_s"].to_numpy(float)
    if recording.metadata["clock"] == "index":
        time = np.arange(len(time), dtype=float)
    gap = time[rows[k + 1]] - time[rows[k]]
    for kind in (across, ~across):
        if kind.any():
            gap[kind] = np.maximum(gap[kind] / np.median(gap[kind]), 1.0)
    return k, across, gap


def _alike(series: np.ndarray, k: np.ndarray) -> np.ndarray:
    """(K,): squared length that the two measurements of a change have in common, at most that of
    the shorter; without the few channels that have most, for two spikes may meet in one.
    """
    near, far = series[k + 1] - series[k], series[k + 2] - series[k - 1]
    product = np.sort(near * far, axis=1)
    counted = product.shape[1] - int(IN_FEW * product.shape[1])
    length = np.linalg.norm(near, axis=1), np.linalg.norm(far, axis=1)
    longer = np.maximum(*length)
    ratio = np.minimum(*length) / np.where(longer > 0, longer, 1.0)
    return ratio * product[:, :counted].sum(axis=1)


def _ordinary(alike: np.ndarray, across: np.ndarray, gap: np.ndarray, noises: int) -> np.ndarray:
    """(K,): what `alike` is of an ordinary split of its kind; infinite where too few tell.

    noises: channels whose independent noise of sd 1 it contains, at the least.
    """
    size = np.abs(alike)
    result = np.full(len(alike), np.inf)
    if across.sum() >= LEAST_SPLITS:
        result[across] = gap[across] * NORMAL * np.median(size[across] / gap[across])
    if len(alike) >= LEAST_SPLITS:
        result[~across] = gap[~across] * NORMAL * np.median(size)
    return np.maximum(result, max(np.sqrt(noises), np.finfo(float).tiny))


def _step(
    recording: Recording,
    rows: np.ndarray,
    white: np.ndarray,
    calm: np.ndarray,
    k: int,
    factor: float | None,
) -> Step:
    before, after = calm[k - 1 : k + 1].mean(axis=0), calm[k + 1 : k + 3].mean(axis=0)
    change = after - before
    span = np.arange(rows[k] + 1, rows[k + 1] + 1)
    first = _first_after(white[span[:-1]], presses(recording)[span[:-1]], before, after)
    return Step(
        frame=int(span[first]),
        between=(int(rows[k]), int(rows[k + 1])),
        size=float(np.linalg.norm(change)),
        factor=factor,
        electrodes=() if factor is not None else _electrodes(recording, change),
        channels=tuple(np.argsort(-np.abs(change), kind="stable")[:NAMED].tolist()),
    )


def _first_after(
    touched: np.ndarray, press: np.ndarray, before: np.ndarray, after: np.ndarray
) -> int:
    """Which of touched frames (K, M) between two untouched ones is the first after a step, K for
    none: with the right one the changes of a press are nearest to one pattern of varying strength.
    """
    cost = []
    for first in range(len(touched) + 1):
        late = np.arange(len(touched))[:, None] >= first
        change = np.nan_to_num(touched - np.where(late, after, before))
        left = 0.0
        for one in np.unique(press):
            strength = np.linalg.svd(change[press == one], compute_uv=False)
            left += (strength[1:] ** 2).sum()
        cost.append(left)
    return int(np.argmin(cost))


def _electrodes(recording: Recording, change: np.ndarray) -> tuple[int, ...]:
    """At most FEW electrodes whose channels hold COVERED of a change beyond noise."""
    energy = np.maximum(change**2 - 1.0, 0.0)
    channels, electrodes = recording.channels, np.arange(recording.n_electrodes)
    own = (channels[None] == electrodes[:, None, None]).any(axis=2).astype(float)
    total, found = energy.sum(), []
    for _ in range(FEW):
        share = own @ energy
        found.append(int(np.argmax(share)))
        energy = np.where(own[found[-1]] > 0, 0.0, energy)
        if energy.sum() <= (1.0 - COVERED) * total:
            return tuple(found)
    return ()
