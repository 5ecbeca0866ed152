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

WIDTHS, MANY = (2, 4, 8, 16), 4  # frames on either side; so many times as many in all
LEAST_SPLITS = 8  # of a kind, to know what is ordinary
# In energy, over that of an ordinary split; `python -m proof.steps` has the false alarms. One
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
    white = recording.voltage / channel_noise(recording.voltage[rows])
    rows = rows[~_loud(white[rows])]
    if len(rows) < LEAST_SPLITS + 3:
        return []
    calm = _calm(white[rows])
    mean = np.median(calm, axis=0)
    length = max(float(np.linalg.norm(mean)), np.finfo(float).tiny)
    along = calm @ mean / length  # its noise has sd 1, as a channel's
    rest = calm - along[:, None] * mean / length
    found: dict[int, float | None] = {}
    for width in WIDTHS:
        if width == WIDTHS[0] or len(rows) >= MANY * width:
            found |= _outlying(recording, rows, along, rest, width, found)
    return [_step(recording, rows, white, calm, k, factor) for k, factor in sorted(found.items())]


def _outlying(
    recording: Recording,
    rows: np.ndarray,
    along: np.ndarray,
    rest: np.ndarray,
    width: int,
    known: dict[int, float | None],
) -> dict[int, float | None]:
    """The k of splits that stand out among those of windows of one width, clear of the known ones,
    with the factor where the common part alone stands out."""
    kept, across, gap = _splits(recording, rows, width)
    if not len(kept):
        return {}
    alike = _alike(*_changes(rest, kept, width))
    several = alike / _ordinary(alike, across, gap, 2.0 / width * np.sqrt(rest.shape[1])) / LARGER
    largest = several
    if width == WIDTHS[0]:  # in wide windows one number wanders too much
        near, far = _changes(along[:, None], kept, width)
        usual = _ordinary(near[:, 0] ** 2, across, gap, 2.0)
        largest = np.maximum(several, _alike(near, far) / usual / LARGER_COMMON)
    found: dict[int, float | None] = {}
    for i in np.flatnonzero(largest > 1.0):
        k = int(kept[i])
        beside = largest[np.abs(kept - k) < width].max()
        if largest[i] < beside or any(abs(k - other) < width for other in (*known, *found)):
            continue
        before, after = along[k - 1 : k + 1].mean(), along[k + 1 : k + 3].mean()
        found[k] = float(after / before) if several[i] <= 1.0 and before else None
    return found


def _changes(series: np.ndarray, k: np.ndarray, width: int) -> tuple[np.ndarray, np.ndarray]:
    """(K, M) each: the change at splits k, by every other of `width` frames on either side, those
    nearest to it among them, and by the rest of them."""
    pair = []
    for first in (0, 1):
        offsets = np.arange(first, width, 2)
        after = series[k[:, None] + 1 + offsets].mean(axis=1)
        pair.append(after - series[k[:, None] - offsets].mean(axis=1))
    return pair[0], pair[1]


def _median(white: np.ndarray) -> np.ndarray:
    """(U, M): the median of each frame and the two beside it, of the channel where all are lost; a
    step leaves it as sharp as it is."""
    channel = np.nanmedian(np.where(np.isfinite(white).any(axis=0), white, 0.0), axis=0)
    around = np.stack([white[:-2], white[1:-1], white[2:]])
    around = np.concatenate([around[:, :1], around, around[:, -1:]], axis=1)
    known = np.isfinite(around).any(axis=0)
    return np.nanmedian(np.where(known, around, channel), axis=0)


def _loud(white: np.ndarray) -> np.ndarray:
    """(U,): frames (U, M), in noise units, that are unlike those beside them in most channels."""
    unlike = np.nanmedian(np.abs(white - _median(white)), axis=1)
    return unlike > SPIKE * np.maximum(np.median(unlike), 1.0 / SPIKE)


def _calm(white: np.ndarray) -> np.ndarray:
    """(U, M): frames in noise units, spikes and lost readings replaced by the median of a frame and
    the two beside it."""
    median = _median(white)
    return np.where(np.abs(white - median) <= SPIKE, white, median)


def _splits(
    recording: Recording, rows: np.ndarray, width: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Splits after the k-th of the untouched frames, with `width` on either side in a session:
    k (K,), whether touched frames lie between (K,), and how far apart its frames are (K,), over
    the usual distance where that is less.
    """
    session = sessions(recording.frames)[rows]
    k = np.arange(width - 1, len(rows) - width)
    k = k[session[k - width + 1] == session[k + width]]
    touched = np.cumsum(recording.frames["touch"].to_numpy(dtype=bool))
    across = touched[rows[k + 1]] > touched[rows[k]]
    time = recording.frames["time_s"].to_numpy(float)
    if recording.metadata["clock"] == "index":
        time = np.arange(len(time), dtype=float)
    gap = time[rows[k + 1]] - time[rows[k]]
    for kind in (across, ~across):
        if kind.any():
            gap[kind] = np.maximum(gap[kind] / np.median(gap[kind]), 1.0)
    return k, across, gap


def _alike(near: np.ndarray, far: np.ndarray) -> np.ndarray:
    """(K,): squared length that two measurements (K, M) of a change have in common, at most that
    of the shorter; without the few channels that have most, for two spikes may meet in one.
    """
    product = np.sort(near * far, axis=1)
    counted = product.shape[1] - int(IN_FEW * product.shape[1])
    length = np.linalg.norm(near, axis=1), np.linalg.norm(far, axis=1)
    longer = np.maximum(*length)
    ratio = np.minimum(*length) / np.where(longer > 0, longer, 1.0)
    return ratio * product[:, :counted].sum(axis=1)


def _ordinary(alike: np.ndarray, across: np.ndarray, gap: np.ndarray, least: float) -> np.ndarray:
    """(K,): what `alike` is of an ordinary split of its kind; infinite where too few tell.

    least: what white noise alone makes of it.
    """
    size = np.abs(alike)
    result = np.full(len(alike), np.inf)
    if across.sum() >= LEAST_SPLITS:
        result[across] = gap[across] * NORMAL * np.median(size[across] / gap[across])
    if len(alike) >= LEAST_SPLITS:
        result[~across] = gap[~across] * NORMAL * np.median(size)
    return np.maximum(result, max(least, np.finfo(float).tiny))


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
