"""The drive and measurement pattern of frames of which nobody says it, by the readings themselves.

Each pattern of as many channels lets a homogeneous disc read something else. The one whose sizes
leave least of the readings' unexplained, up to a factor, is taken where they correlate clearly and
no other comes near. (By correlation alone, readings at driven electrodes, which are large, would
choose: a pattern that takes them for others' nearest.)
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
MIN_CORRELATION = 0.8  # tanks and gels: 0.95 and more in the right pattern
RIVAL_FACTOR = 2.0  # of what the best pattern leaves unexplained: a rival within it is as good
LEAST_UNEXPLAINED = 1e-9  # rounding: patterns of which one is another's reciprocal are alike
NOTHING = 0.0, 1.0  # correlation, and the share unexplained, of a pattern that cannot be


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
    protocols = _protocols(frames.shape[1], n_electrodes)
    if not protocols:
        return None
    correlation, unexplained = np.array([_fit(frames, item.layout) for item in protocols]).T
    best, *rivals = np.argsort(unexplained, kind="stable")
    is_alone = (unexplained[rivals] >= RIVAL_FACTOR * unexplained[best]).all()
    return protocols[best] if is_alone and correlation[best] >= MIN_CORRELATION else None


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


def _fit(frames: np.ndarray, layout: Layout) -> tuple[float, float]:
    """Correlation of the sizes of mean readings with those of a homogeneous disc, and the share of
    their square that is left when these, times a factor, are taken out."""
    if layout.subtrahends is not None and not _are_potentials(frames, layout):
        return NOTHING
    values = np.abs(layout.readings(frames))
    is_read = np.isfinite(values)
    counts = np.maximum(is_read.sum(axis=0), 1)
    reading = np.where(is_read, values, 0.0).sum(axis=0) / counts
    disc = np.abs(alignment.homogeneous_readings(layout.channels, even_angles(layout.n_electrodes)))
    is_usable = is_read.any(axis=0) & np.isfinite(disc)
    reading, disc = reading[is_usable], disc[is_usable]
    if is_usable.sum() < 3 or not np.ptp(reading) or not np.ptp(disc):
        return NOTHING
    explained = (reading @ disc) ** 2 / ((reading @ reading) * (disc @ disc))
    return float(np.corrcoef(reading, disc)[0, 1]), max(float(1.0 - explained), LEAST_UNEXPLAINED)


def _are_potentials(frames: np.ndarray, layout: Layout) -> bool:
    """Whether current enters and leaves where the potentials of each drive are extreme."""
    n = layout.n_electrodes
    potential = np.nan_to_num(frames.real).mean(axis=0).reshape(n, n)
    extremes = np.sort([potential.argmax(axis=1), potential.argmin(axis=1)], axis=0)
    drives = dict(zip(layout.channels[:, 0].tolist(), layout.channels[:, :2].tolist(), strict=True))
    driven = np.sort([drives[source] for source in range(n)], axis=1).T
    return bool((extremes == driven).all(axis=0).mean() >= MIN_EXTREME_SHARE)
