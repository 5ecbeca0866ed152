"""Whether channels and electrodes are what the file says: the channels' order, the sign of what
they read, the electrodes' numbers.
"""

from dataclasses import dataclass

import numpy as np

from eitskin.data import alignment, baseline
from eitskin.data.channel_order import Misfit, known_orders, misfit, reordered
from eitskin.data.check.finding import ERROR, FACT, UNOBSERVABLE, WARNING
from eitskin.data.check.measures import identity_readings, untouched_readings
from eitskin.data.recording import Recording
from eitskin.errors import InputError
from eitskin.physics.protocol import reciprocal_channels

BROKEN = 0.25  # rms misfit of the identities: 0.01-0.06 on tanks, mostly 0.8-1.1 in a wrong order
DOUBTFUL = 0.1  # from here on an order that fits FAR_BETTER is taken for the true one
FAR_BETTER = 3.0
ALIKE = 1.5
EXCHANGED = -0.5  # correlation with a homogeneous disc's readings
NUMBERED_WITHIN_RADII = 0.25
LEAST_TOUCHES = 20


@dataclass(frozen=True)
class Order:
    """Misfit of the table's own order, the least misfit of other known orders, and which have it.

    `worst`: the two electrodes that the broken reciprocal pairs have most in common.
    """

    own: Misfit
    best: float
    names: list[str]
    worst: tuple[int, int] | None = None

    @property
    def is_wrong(self) -> bool:
        """Whether another known order fits far better."""
        overall = self.own.overall or 0.0
        return overall > DOUBTFUL and self.best < overall / FAR_BETTER

    @property
    def severity(self) -> str:
        """A passive, linear skin cannot break reciprocity; the weaker identities it can."""
        if self.own.overall is None:
            return UNOBSERVABLE
        if self.is_wrong:
            return ERROR
        if self.own.overall <= BROKEN:
            return FACT
        return WARNING if self.own.reciprocity is None else ERROR


def order(recording: Recording) -> Order:
    """Whether the readings stand in the table's order, or far better in another known one; by the
    untouched readings and by what strong touches change.
    """
    signed = recording.metadata["voltage"] == "signed"
    values, _ = identity_readings(recording, np.ones(1))
    untouched = _order(recording, values, signed and recording.quadrature is None)
    if untouched.own.overall is None or untouched.is_wrong:
        return untouched
    changes = _strong_changes(recording)
    touched = None if changes is None else _order(recording, changes, signed)
    return touched if touched is not None and touched.is_wrong else untouched


def _order(recording: Recording, values: np.ndarray, signed: bool) -> Order:
    channels, n = recording.channels, recording.n_electrodes
    own = misfit(values, channels, n, signed)
    misfits = {
        name: misfit(reordered(values, permutation), channels, n, signed).overall
        for name, permutation in known_orders(channels, n).items()
    }
    others = {name: value for name, value in misfits.items() if value is not None}
    worst = None if own.reciprocity is None else _worst_electrodes(recording, values)
    if own.overall is None or not others:
        return Order(own, np.inf, [], worst)
    best = min(others.values())
    return Order(
        own, best, [name for name, value in others.items() if value <= ALIKE * best], worst
    )


def _strong_changes(recording: Recording) -> np.ndarray | None:
    """(K, M): what the strongest touches of absolute readings change; None where there are few."""
    touched = recording.frames["touch"].any()
    if recording.metadata["values"] == "difference" or not touched:
        return None
    try:
        rows = alignment.strongest_touches(recording)
        changes = baseline.changes(recording, "recording")[rows]
    except InputError:  # a session without an untouched frame
        return None
    return changes if np.isfinite(changes).any() and len(rows) >= LEAST_TOUCHES else None


def _worst_electrodes(recording: Recording, values: np.ndarray) -> tuple[int, int]:
    pairs, _ = reciprocal_channels(recording.channels)
    break_ = np.nansum((values[:, pairs[:, 1]] - values[:, pairs[:, 0]]) ** 2, axis=0)
    share = np.array(
        [
            break_[(recording.channels[pairs[:, 0]] == electrode).any(axis=1)].sum()
            for electrode in range(recording.n_electrodes)
        ]
    )
    worst = np.argsort(-share, kind="stable")[:2]
    return int(worst[0]), int(worst[1])


def polarity(recording: Recording) -> float | None:
    """Correlation of signed readings with a homogeneous disc's, by the sign that the table gives
    them; None where it cannot be told.
    """
    angles = recording.skin.electrode_deg
    metadata = recording.metadata
    if metadata["voltage"] != "signed" or metadata["values"] != "absolute" or angles is None:
        return None
    model = alignment.homogeneous_readings(recording.channels, np.array(angles))
    reading = untouched_readings(recording.readings, recording)[0]
    kept = np.isfinite(model) & np.isfinite(reading)
    if kept.sum() < 3 or np.ptp(model[kept]) == 0 or np.ptp(reading[kept]) == 0:
        return None
    return float(np.corrcoef(model[kept], reading[kept])[0, 1])


@dataclass(frozen=True)
class Numbering:
    """How far round touches light up from where the file puts them, degrees counter-clockwise, and
    how far off, in radii, they are after that turn; `clear`: they fit so, and not the other way
    round.
    """

    touches: int
    turn: float
    pitch: float
    residual_radii: float
    mirrored: bool
    clear: bool

    @property
    def severity(self) -> str:
        """A clear mirror or turn by an electrode or more is wrong numbering."""
        if self.clear and (self.mirrored or abs(self.turn) > 0.75 * self.pitch):
            return ERROR
        return WARNING if abs(self.turn) > 0.25 * self.pitch or not self.clear else FACT


def numbering(recording: Recording) -> Numbering | None:
    """Whether touches light up where the file says that they are; only for places in the skin's
    frame.
    """
    skin = recording.skin
    touched = int(recording.frames["touch"].sum())
    in_skin = recording.metadata["position_frame"] == "skin"
    if not in_skin or skin.electrode_deg is None or touched < LEAST_TOUCHES:
        return None
    try:
        similarity = alignment.fit(recording)
    except InputError:  # too few strong touches, or all at one place
        return None
    radius = skin.radius_mm or 1.0
    return Numbering(
        touches=similarity.touches,
        turn=similarity.rotation_deg,
        pitch=360.0 / recording.n_electrodes,
        residual_radii=similarity.residual / radius,
        mirrored=similarity.mirrored,
        clear=similarity.residual < NUMBERED_WITHIN_RADII * radius
        and similarity.rival_residual > FAR_BETTER * similarity.residual,
    )
