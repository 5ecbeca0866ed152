"""The drive and measurement pattern of frames of which nobody says it, by the readings themselves.

Each pattern of as many channels lets a homogeneous disc read something else. The one whose sizes
correlate with the readings' is taken where it does so clearly and no other comes near.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from math import isqrt

import numpy as np

from eitskin.data import alignment
from eitskin.data.importers import bare_vectors
from eitskin.data.importers.bare_vectors import GROUND, Layout
from eitskin.errors import InputError
from eitskin.physics.geometry import even_angles

RINGS = (8, 16, 32)  # of common boards
TURNING = "drive-plus-ascending-own"  # EIDORS `rotate_meas`, pyEIT `fmmu`, and many boards
MIN_EXTREME_SHARE = 0.75  # of drives whose own electrodes have the extreme potentials
MIN_CORRELATION = 0.9  # tanks and gels: 0.95 and more in the right pattern
RIVAL_FACTOR = 2.0  # of what the best pattern leaves unexplained: a rival within it is as good


@dataclass(frozen=True)
class Protocol:
    """Electrodes, drive, measurement and order of frames, and the layout of their numbers."""

    drive: str
    measurement: str
    order: str | None
    layout: Layout

    @property
    def description(self) -> dict[str, int | str]:
        """The keys that describe a matrix so."""
        n = self.layout.n_electrodes
        keys: dict[str, int | str] = {"electrodes": n, "drive": self.drive}
        keys |= {"measurement": self.measurement}
        return keys if self.order is None else keys | {"order": self.order}


def protocol_of(frames: np.ndarray, n_electrodes: int | None = None) -> Protocol | None:
    """The protocol by which frames (F, width) read as a skin does; None where none clearly does."""
    scores = [
        (_correlation(frames, protocol.layout), protocol)
        for protocol in _protocols(frames.shape[1], n_electrodes)
    ]
    if not scores:
        return None
    best, protocol = max(scores, key=lambda score: score[0])
    rivals = [score for score, other in scores if other is not protocol]
    unexplained = 1.0 - best
    if best < MIN_CORRELATION or any(1.0 - rival < RIVAL_FACTOR * unexplained for rival in rivals):
        return None
    return protocol


def common_protocol(width: int, n_electrodes: int | None = None) -> Protocol | None:
    """The most common protocol of frames of `width` numbers; None where none has as many."""
    return next(iter(_protocols(width, n_electrodes)), None)


@cache
def _protocols(width: int, n_electrodes: int | None) -> tuple[Protocol, ...]:
    return tuple(_searched_protocols(width, n_electrodes))


def _searched_protocols(width: int, n_electrodes: int | None) -> Iterator[Protocol]:
    """Protocols of frames of `width` numbers, the most common first."""
    least = isqrt(max(width - 1, 0)) + 1  # a frame has n n numbers at most
    rings = [n for n in RINGS if least <= n <= 2 * least]
    rings = rings if n_electrodes is None else [n_electrodes]
    candidates = [(n_electrodes, drive, "adjacent") for drive in ("adjacent", "opposite")]
    candidates += [(n, drive, measurement) for n in rings for drive, measurement in _patterns(n)]
    known = set()
    for order in (None, TURNING):
        for n, drive, measurement in candidates:
            try:
                layout = bare_vectors.pattern_layout("", width, drive, measurement, order, n)
            except InputError:
                continue
            key = str([layout.n_electrodes, layout.channels.tolist(), layout.subtrahends is None])
            if key not in known:
                known.add(key)
                yield Protocol(drive, measurement, order, layout)


def _patterns(n_electrodes: int) -> list[tuple[str, str]]:
    """Pairs of drive and measurement, the most common first."""
    skips = [f"skip-{k}" for k in range(1, n_electrodes // 2 - 1)]
    steps = ["adjacent", *(["opposite"] if n_electrodes % 2 == 0 else []), *skips]
    equal_steps = [(step, step) for step in steps]
    other_steps = [(drive, step) for step in steps for drive in steps if drive != step]
    return [*equal_steps, *other_steps, *((drive, GROUND) for drive in steps)]


def _correlation(frames: np.ndarray, layout: Layout) -> float:
    """Correlation of the sizes of mean readings with those of a homogeneous disc."""
    if layout.subtrahends is not None and not _are_potentials(frames, layout):
        return 0.0
    values = np.abs(layout.readings(frames))
    is_read = np.isfinite(values)
    counts = np.maximum(is_read.sum(axis=0), 1)
    reading = np.where(is_read, values, 0.0).sum(axis=0) / counts
    disc = np.abs(alignment.homogeneous_readings(layout.channels, even_angles(layout.n_electrodes)))
    is_usable = is_read.any(axis=0) & np.isfinite(disc)
    if is_usable.sum() < 3 or not np.ptp(reading[is_usable]) or not np.ptp(disc[is_usable]):
        return 0.0
    return float(np.corrcoef(reading[is_usable], disc[is_usable])[0, 1])


def _are_potentials(frames: np.ndarray, layout: Layout) -> bool:
    """Whether current enters and leaves where the potentials of each drive are extreme."""
    n = layout.n_electrodes
    potential = np.nan_to_num(frames.real).mean(axis=0).reshape(n, n)
    extremes = np.sort([potential.argmax(axis=1), potential.argmin(axis=1)], axis=0)
    drives = dict(zip(layout.channels[:, 0].tolist(), layout.channels[:, :2].tolist(), strict=True))
    driven = np.sort([drives[source] for source in range(n)], axis=1).T
    return bool((extremes == driven).all(axis=0).mean() >= MIN_EXTREME_SHARE)
