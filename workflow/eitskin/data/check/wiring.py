"""Whether channels and electrodes are as the file states: the channels' order, the readings' sign,
the electrodes' numbers.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from eitskin.data import alignment, baseline
from eitskin.data.channel_order import (
    Misfit,
    known_orders,
    misfit,
    relative_change,
    reordered,
)
from eitskin.data.check.finding import ERROR, FACT, UNOBSERVABLE, WARNING
from eitskin.data.check.measures import (
    identity_readings,
    reading_variance,
    untouched_readings,
)
from eitskin.data.recording import Recording, presses
from eitskin.errors import InputError
from eitskin.physics.protocol import reciprocal_channels

MAX_MISFIT = (
    0.25  # rms misfit of the identities: 0.01-0.06 on tanks, mostly 0.8-1.1 in a wrong order
)
DOUBTFUL_MISFIT = 0.1  # above the best tanks: another order may then be the true one
MIN_IMPROVEMENT = 3.0  # factor by which another order must fit better: orders differ by 10 or more
TIE_FACTOR = 1.5  # of the best misfit: orders within it cannot be told apart
EXCHANGED_CORRELATION = -0.5  # with a disc's readings: near 1 by a right table, -1 by a wrong one
MAX_RESIDUAL_RADII = 0.25  # median distance of hotspots: beyond, they show no places
MAX_SHIFT_RADII = 0.5  # of the centre: no drawing is off by as much
MIN_TOUCHES = 20  # for medians over touches
MIN_CHANNELS = 8  # fewer show no direction
MAX_FAULTY = 2  # electrodes, or pairs of them, without which the others keep reciprocity
MIN_PRESSES, MAX_PRESSES = 4, 500  # whose places are compared with hotspots
MAX_PLACE_RADII = 0.1  # from a hotspot to its place: a grid step, and a probe beside it
MAX_LOUDNESS = 30.0  # noise, over that of quieter channels: a touch is hardly seen beside it
MIN_KEPT_PAIRS = 5  # reciprocal pairs that are left then


@dataclass(frozen=True)
class Order:
    """Misfit of the table's order, the smallest misfit of other known orders, and their names.

    `worst_electrodes` are the two with most of the misfit of reciprocal pairs; `faults` the
    electrodes, each alone or a driven and measured pair, without which the rest keep reciprocity.
    """

    misfit: Misfit
    best_misfit: float
    best_names: list[str]
    worst_electrodes: tuple[int, int] | None = None
    faults: tuple[tuple[int, ...], ...] = ()

    @property
    def is_wrong(self) -> bool:
        """Whether another known order fits far better."""
        overall = self.misfit.overall or 0.0
        return overall > DOUBTFUL_MISFIT and self.best_misfit < overall / MIN_IMPROVEMENT

    @property
    def severity(self) -> str:
        """An error where reciprocity is broken, which no passive, linear skin does; a warning where
        only the weaker identities are, and where it is at a few electrodes: a wire may be broken
        there, a gain or an offset wrong, which the catalogue of effects has names for."""
        if self.misfit.overall is None:
            return UNOBSERVABLE
        if self.is_wrong:
            return ERROR
        if self.misfit.overall <= MAX_MISFIT:
            return FACT
        return WARNING if self.misfit.reciprocity is None or self.faults else ERROR


def order(recording: Recording) -> Order:
    """Whether the readings are in the table's order or fit another known one far better.

    By the untouched readings, then by the changes of strong touches.
    """
    signed = recording.metadata["voltage"] == "signed"
    values, _ = identity_readings(recording, np.ones(1))
    variance = reading_variance(recording)
    mean_variance = variance
    if recording.metadata["values"] == "absolute":
        mean_variance = variance / int((~recording.frames["touch"].to_numpy(dtype=bool)).sum())
    untouched_order = _order(
        recording, values, signed and recording.quadrature is None, mean_variance
    )
    if untouched_order.misfit.overall is None or untouched_order.is_wrong:
        return untouched_order
    changes = _strong_changes(recording)
    touched_order = None if changes is None else _order(recording, changes, signed, variance)
    return (
        touched_order if touched_order is not None and touched_order.is_wrong else untouched_order
    )


def _order(recording: Recording, values: np.ndarray, signed: bool, variance: np.ndarray) -> Order:
    channels, n = recording.channels, recording.n_electrodes
    table_misfit = misfit(values, channels, n, signed, variance)
    if table_misfit.reciprocity is None and _is_noise(recording, values):
        if recording.metadata["values"] == "difference":
            return Order(Misfit(None, None, None), np.inf, [])
        # A skin reads more than noise untouched: no mean of its frames is noise alone.
        variance = np.zeros_like(variance)
        table_misfit = misfit(values, channels, n, signed)
    misfits = {
        name: misfit(
            reordered(values, permutation),
            channels,
            n,
            signed,
            reordered(variance[None], permutation)[0],
        ).overall
        for name, permutation in known_orders(channels, n).items()
    }
    other_misfits = {name: value for name, value in misfits.items() if value is not None}
    worst_electrodes = (
        None if table_misfit.reciprocity is None else _worst_electrodes(recording, values)
    )
    if table_misfit.overall is None or not other_misfits:
        return Order(table_misfit, np.inf, [], worst_electrodes)
    best_misfit = min(other_misfits.values())
    return Order(
        table_misfit,
        best_misfit,
        [name for name, value in other_misfits.items() if value <= TIE_FACTOR * best_misfit],
        worst_electrodes,
        _faults(recording, values, signed, variance) if table_misfit.reciprocity else (),
    )


def _is_noise(recording: Recording, values: np.ndarray) -> bool:
    """Whether the table has enough reciprocal pairs, and only their noise rules them out."""
    return misfit(values, recording.channels, recording.n_electrodes, True).reciprocity is not None


def _faults(
    recording: Recording, values: np.ndarray, signed: bool, variance: np.ndarray
) -> tuple[tuple[int, ...], ...]:
    """At most MAX_FAULTY electrodes, or pairs that drive and measure, without which the misfit of
    reciprocity is at most DOUBTFUL_MISFIT; of the two the one that takes fewer reciprocal pairs
    with it. None where nothing does."""
    pairs, signs = reciprocal_channels(recording.channels)
    signs = signs if signed else np.ones(len(signs))
    ends = recording.channels[pairs[:, 0]].reshape(-1, 2, 2)
    electrodes = [(electrode,) for electrode in range(recording.n_electrodes)]
    couples = [tuple(couple) for couple in np.unique(np.sort(ends.reshape(-1, 2)), axis=0).tolist()]
    solutions = []
    for sites in (electrodes, couples):
        takes_part = np.array([_takes_part(ends, site) for site in sites])
        is_kept, faults = np.ones(len(pairs), bool), []
        for _ in range(MAX_FAULTY):
            misfits = [
                _pair_misfit(values, pairs[kept], signs[kept], variance)
                for kept in is_kept & ~takes_part
            ]
            site = int(np.argmin(misfits))
            faults.append(sites[site])
            is_kept &= ~takes_part[site]
            if misfits[site] <= DOUBTFUL_MISFIT:
                solutions.append((int(is_kept.sum()), tuple(sorted(faults))))
                break
    return max(solutions, key=lambda solution: solution[0])[1] if solutions else ()


def _takes_part(ends: np.ndarray, site: tuple[int, ...]) -> np.ndarray:
    """(M,) bool: whether an electrode, or a pair as such, drives or measures in channels of `ends`
    (M, 2, 2), pairs of drive and measurement."""
    if len(site) == 1:
        return np.asarray((ends == site[0]).any(axis=(1, 2)))
    return np.asarray((np.sort(ends, axis=2) == np.sort(site)).all(axis=2).any(axis=1))


def showing_places(recording: Recording, sites: Sequence[tuple[int, ...]]) -> Recording:
    """A recording with NaN in the channels that show no places of touches: those in which `sites`,
    electrodes or pairs of them as such, take part, and those of noise above MAX_LOUDNESS."""
    ends = recording.channels.reshape(-1, 2, 2)
    variance = reading_variance(recording)
    usual = np.quantile(variance, 0.25)  # half of eight electrodes' channels use each of them
    is_out = (variance > MAX_LOUDNESS**2 * usual) & (usual > 0.0)
    for site in sites:
        is_out |= _takes_part(ends, site)
    return (
        recording
        if not is_out.any()
        else replace(recording, voltage=np.where(is_out, np.nan, recording.readings))
    )


def _pair_misfit(
    values: np.ndarray, pairs: np.ndarray, signs: np.ndarray, variance: np.ndarray
) -> float:
    """The misfit of reciprocal pairs; infinite where they are few, or unread."""
    if len(pairs) < MIN_KEPT_PAIRS:
        return np.inf
    change = relative_change(values, pairs, signs, variance)
    return np.inf if change is None else change


def _strong_changes(recording: Recording) -> np.ndarray | None:
    """Changes (K, M) by the strongest touches of absolute readings; None where they are few."""
    touched = recording.frames["touch"].any()
    if recording.metadata["values"] == "difference" or not touched:
        return None
    try:
        rows = alignment.strongest_touches(recording)
        changes = baseline.steady_changes(recording, "recording")[rows]
    except InputError:  # a session without an untouched frame
        return None
    return changes if np.isfinite(changes).any() and len(rows) >= MIN_TOUCHES else None


def _worst_electrodes(recording: Recording, values: np.ndarray) -> tuple[int, int]:
    pairs, _ = reciprocal_channels(recording.channels)
    pair_break = np.nansum((values[:, pairs[:, 1]] - values[:, pairs[:, 0]]) ** 2, axis=0)
    electrode_break = np.array(
        [
            pair_break[(recording.channels[pairs[:, 0]] == electrode).any(axis=1)].sum()
            for electrode in range(recording.n_electrodes)
        ]
    )
    worst = np.argsort(-electrode_break, kind="stable")[:2]
    return int(worst[0]), int(worst[1])


def polarity(recording: Recording) -> float | None:
    """Correlation of signed untouched readings with those of a homogeneous disc.

    None where signs, angles or readings are unknown.
    """
    angles = recording.skin.electrode_deg
    metadata = recording.metadata
    if metadata["voltage"] != "signed" or metadata["values"] != "absolute" or angles is None:
        return None
    disc_readings = alignment.homogeneous_readings(recording.channels, np.array(angles))
    reading = untouched_readings(recording.readings, recording)[0]
    is_usable = np.isfinite(disc_readings) & np.isfinite(reading)
    if (
        is_usable.sum() < 3
        or np.ptp(disc_readings[is_usable]) == 0
        or np.ptp(reading[is_usable]) == 0
    ):
        return None
    return float(np.corrcoef(disc_readings[is_usable], reading[is_usable])[0, 1])


@dataclass(frozen=True)
class Numbering:
    """Turn of the hotspots of touches against their stated places.

    `turn_deg` is counter-clockwise, `pitch_deg` the angle between electrodes, `residual_radii` the
    median distance after that turn, in radii; `is_clear` where it is small and much smaller than
    that of the other handedness; `is_lost` where no turn brings them to their places. `centre_mm`:
    where the stated coordinates have the skin's centre, None where that is at their origin.
    """

    touches: int
    turn_deg: float
    pitch_deg: float
    residual_radii: float
    is_mirrored: bool
    is_clear: bool
    is_lost: bool
    centre_mm: tuple[float, float] | None

    @property
    def severity(self) -> str:
        """An error where places are clearly mirrored, turned by an electrode or more or counted
        from elsewhere."""
        if self.centre_mm is not None:
            return ERROR
        if self.is_clear and (self.is_mirrored or abs(self.turn_deg) > 0.75 * self.pitch_deg):
            return ERROR
        return WARNING if abs(self.turn_deg) > 0.25 * self.pitch_deg or not self.is_clear else FACT


def numbering(recording: Recording) -> Numbering | None:
    """Whether hotspots of touches are at their stated places.

    None where places are not in the skin's frame, angles are unknown, touches are few or channels
    are fewer than MIN_CHANNELS.
    """
    skin = recording.skin
    touched = int(recording.frames["touch"].sum())
    in_skin = recording.metadata["position_frame"] == "skin"
    if not in_skin or skin.electrode_deg is None or touched < MIN_TOUCHES:
        return None
    if len(recording.channels) < MIN_CHANNELS:
        return None
    try:
        similarity = alignment.fit(recording)
    except InputError:  # too few strong touches, or all at one place
        return None
    radius = skin.radius_mm or 1.0
    is_clear = (
        similarity.residual < MAX_RESIDUAL_RADII * radius
        and similarity.rival_residual > MIN_IMPROVEMENT * similarity.residual
    )
    centre_mm = None
    if is_clear and np.hypot(*similarity.shift) > MAX_SHIFT_RADII * radius:
        centre_mm = similarity.robot_place(0.0, 0.0)
    return Numbering(
        touches=similarity.touches,
        turn_deg=similarity.rotation_deg,
        pitch_deg=360.0 / recording.n_electrodes,
        residual_radii=similarity.residual / radius,
        is_mirrored=similarity.is_mirrored,
        is_lost=similarity.residual > MAX_RESIDUAL_RADII * radius,
        is_clear=is_clear,
        centre_mm=centre_mm,
    )


@dataclass(frozen=True)
class Misplaced:
    """Presses of which another press' place is where they light up: their numbers, the number of
    all, and the median distances, in radii, from hotspots to the stated places and to those."""

    presses: tuple[int, ...]
    number: int
    stated_radii: float
    assigned_radii: float

    @property
    def severity(self) -> str:
        """An error where it is half of the presses or more: then places tell nothing."""
        return ERROR if 2 * len(self.presses) >= self.number else WARNING


def misplaced(recording: Recording) -> Misplaced | None:
    """Presses that light up at each other's places, by the assignment of places to hotspots of the
    least sum of distances.

    None where places are not in the skin's frame, its radius or angles are unknown, presses are
    few, or one turn brings all to their places.
    """
    skin = recording.skin
    press = presses(recording)
    number = int(press.max(initial=-1)) + 1
    in_skin = recording.metadata["position_frame"] == "skin"
    if not in_skin or skin.radius_mm is None or skin.electrode_deg is None or number < MIN_PRESSES:
        return None
    turn = numbering(recording)
    if turn is not None and turn.severity == ERROR:
        return None
    try:
        change = np.nan_to_num(baseline.steady_changes(recording, "recording"))
    except InputError:  # a session without an untouched frame
        return None
    size = (change**2).sum(axis=1)
    numbers = np.unique(np.linspace(0, number - 1, min(number, MAX_PRESSES)).astype(int))
    rows = np.array([np.argmax(np.where(press == chosen, size, -1.0)) for chosen in numbers])
    hotspots = alignment.hotspots(recording, rows)
    stated = recording.frames[["x_mm", "y_mm"]].to_numpy(float)[rows] @ np.array([1.0, 1.0j])
    distance = np.abs(hotspots[:, None] - stated / skin.radius_mm)
    from scipy.optimize import linear_sum_assignment  # here, as every start would load it

    assigned = linear_sum_assignment(distance)[1]
    stated_radii = np.diag(distance)
    assigned_radii = distance[np.arange(len(rows)), assigned]
    is_moved = (stated_radii > MAX_RESIDUAL_RADII) & (assigned_radii < MAX_PLACE_RADII)
    is_closed = is_moved & np.isin(np.arange(len(rows)), assigned[is_moved])
    if is_closed.sum() < 2 or np.median(assigned_radii) > MAX_PLACE_RADII:
        return None
    return Misplaced(
        tuple(numbers[is_closed].tolist()),
        len(rows),
        float(np.median(stated_radii[is_closed])),
        float(np.median(assigned_radii[is_closed])),
    )
