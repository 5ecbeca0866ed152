"""Exact equivalents: readings that two causes share, and what an owner checks to tell them apart.

Each row of IDENTITIES says of a name that there is another cause of the same readings. That cause
is simulated at the values that follow from those found, and the gap is measured in the recording's
own noise: an identity of untouched frames, say, breaks where touches have known places, and is
not declared there. No row needs more causes than one on its other side: a rim of any shape is also
a pattern of electrode angles on a circle, but each of them would have to be off by itself. Nor has
the catalogue a name for every cause: a load cell or a gain that drifts is said in words alone.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from eitskin.diagnose.fitting.candidates import Candidate
from eitskin.diagnose.fitting.estimates import estimates
from eitskin.diagnose.fitting.fit import fit
from eitskin.diagnose.fitting.simulator import RecordingSimulator
from eitskin.diagnose.fitting.tangents import Tangents
from eitskin.diagnose.search.explanation import Explanation
from eitskin.diagnose.search.gates import DISTINCT
from eitskin.diagnose.search.refits import linearised, reduced
from eitskin.diagnose.search.screen import explained, sparse
from eitskin.diagnose.search.search import Search
from eitskin.effects.anisotropy import Anisotropy
from eitskin.effects.contact_impedance import ContactImpedance
from eitskin.effects.domain_shape import DomainShape
from eitskin.effects.drive_gain import DriveGain
from eitskin.effects.effect import Effect, Moment, Setting, SkinEffect
from eitskin.effects.electrode_position import ElectrodePosition
from eitskin.effects.electrode_width import ElectrodeWidth
from eitskin.effects.registration import Registration
from eitskin.errors import InputError
from eitskin.physics.geometry import Geometry
from eitskin.quantities import listed, number, quantity

OUTLINE = (
    "domain-shape",
    "electrode-position",
    "electrode-width",
    "contact-impedance",
    "anisotropy",
)
HARMONICS = 16  # of a rim, the most that a domain-shape may have
WAVE = 0.5  # of the variance of electrodes' shifts, that a stretch has at least
RIM_PHI = np.linspace(0.0, 2.0 * np.pi, 4096, endpoint=False)
SEAT = ("contact-impedance", "electrode-position", "electrode-width")
GAINS = ("drive-gain", "measurement-gain")
FORCE = ("contact-law", "touch-contrast")


@dataclass(frozen=True)
class Found:
    """One effect of a state, and what its readings are compared with."""

    search: Search
    state: Explanation
    index: int

    @property
    def effect(self) -> Candidate:
        """The effect."""
        return self.state.effects[self.index]

    @property
    def model(self) -> RecordingSimulator:
        """The recording's simulator."""
        return self.state.fit.problem.model

    @property
    def knobs(self) -> np.ndarray:
        """(P,): coordinates of the calibrations."""
        return self.state.fit.theta[: len(self.model.calibrations)]

    @property
    def values(self) -> dict:
        """The effect's parameters."""
        return self.state.fit.settings()[self.index].values

    def others(self, but: tuple[str, ...] = ()) -> list[Setting]:
        """The other effects, less those named."""
        chosen = self.state.fit.settings()
        return [s for i, s in enumerate(chosen) if i != self.index and s.effect.name not in but]

    def simulated(self, chosen: list[Setting]) -> np.ndarray:
        """(N, M) readings with other effects; InputError where there is no such skin."""
        return self.model.voltage(self.knobs, chosen)

    def apart(self, voltage: np.ndarray, places_follow: bool = False) -> float:
        """Length, in noise units, of what readings (N, M) have beyond those found once calibrations
        and other effects have followed, or all that is fitted and the place of every electrode: to
        first order, the gap."""
        own = self.state.fit
        there = self.simulated(own.settings())
        change = own.problem.whitening(voltage - there).ravel()
        if places_follow:
            angles = self.model.nominal_skin.electrode_deg
            assert angles is not None
            places = tuple(range(len(angles)))
            like, shift = self.effect, ElectrodePosition()
            every = Candidate(shift, "electrodes", places, "dense", {}, like.skin, like.scales)
            tangents = Tangents(own, reversed(self.search.cache.tangents.values()))
            change, columns = tangents.project_out(change), tangents.columns(every)
        else:
            place = own.coordinate_slice(self.index)
            columns = np.delete(own.jacobian, np.arange(place.start, place.stop), axis=0)
            columns = columns.reshape(len(columns), -1)
        followed = explained(columns, change)[0] if len(columns) else 0.0
        return float(np.sqrt(max(change @ change - followed, 0.0)))


@dataclass(frozen=True)
class Side:
    """The other side of an identity: its gap to what was found, and the reading in words."""

    gap: float
    reading: str


@dataclass(frozen=True)
class Identity:
    """name: an effect that a diagnosis may name; instead: names of the catalogue that together are
    the same, none where the catalogue has none; side: the other side of an effect found, None where
    the identity does not speak of it."""

    name: str
    instead: tuple[str, ...]
    side: Callable[[Found], Side | None]


def declared(search: Search, state: Explanation, index: int) -> list[tuple[Identity, Side]]:
    """The identities of effect `index` of a state, each with its other side; `instead` without
    names that the recording's catalogue does not have."""
    known = {candidate.name for candidate in search.candidates}
    effect, found = state.effects[index], []
    for identity in IDENTITIES:
        if identity.name == effect.name:
            try:
                side = identity.side(Found(search, state, index))
            except (InputError, np.linalg.LinAlgError):
                continue  # the physics has no such skin
            if side is not None:
                names = tuple(name for name in identity.instead if name in known)
                found.append((replace(identity, instead=names), side))
    return found


def readings(search: Search, state: Explanation, index: int, alternatives: list[str]) -> list[str]:
    """What effect `index` of a state may be as well, in sentences that an owner can check: the
    other sides below DISTINCT, and those that have a name among its alternatives."""
    return [
        side.reading
        for identity, side in declared(search, state, index)
        if side.reading and (not DISTINCT.admits(side.gap) or {*identity.instead} & {*alternatives})
    ]


class _Conductivity(SkinEffect):
    """sigma * ratio: a calibration's, and so no name; another side may need it."""

    name = "conductivity"
    driver = "static"

    def change(self, geometry: Geometry, setting: Setting, moment: Moment) -> Geometry:
        sigma = geometry.conductivity_S_per_m * setting.values["ratio"]
        return geometry.with_values(conductivity_S_per_m=sigma)


# ---- a stretched plane


def carried(geometry: Geometry, base: Geometry, ratio: float, angle_deg: float) -> list[Setting]:
    """Effects on `base`, a disc, that give the outline of `geometry` stretched, at equal area,
    ratio^(-1/4) along the angle and ratio^(1/4) across, its electrodes carried along and each with
    the contact conductance that it had.

    With x' = A x, det A = 1, the conductivity becomes A sigma A^T (Lionheart 1997): the stretch
    takes an anisotropy of ratio and angle away. Exact but for one thing: an even contact impedivity
    is uneven along a stretched electrode, by |A t| of its tangent t; its mean is kept.
    """
    plane = geometry.with_values(anisotropy_ratio=ratio, anisotropy_deg=angle_deg)

    def image(phi: np.ndarray) -> np.ndarray:
        return plane.unfold(geometry.rim(phi))

    def angle(phi: np.ndarray) -> np.ndarray:
        return phi + np.angle(image(phi) * np.exp(-1j * phi))

    at, radius = angle(RIM_PHI), np.abs(image(RIM_PHI)) / base.radius_mm
    closed = np.append(at, at[0] + 2.0 * np.pi), np.append(radius, radius[0])
    even = (RIM_PHI - at[0]) % (2.0 * np.pi) + at[0]
    spectrum = np.fft.fft(CubicSpline(*closed, bc_type="periodic")(even) - 1.0) / len(even)
    chosen = []
    for k in range(HARMONICS + 1):
        size, phase = abs(spectrum[k]) * (2.0 if k else 1.0), -np.degrees(np.angle(spectrum[k]))
        values = {"harmonic": k, "amplitude": size, "phase_deg": phase}
        chosen.append(Setting(DomainShape(), None, values))
    half = geometry.electrode_width_mm / (2.0 * geometry.radius_mm)
    phi = np.radians(geometry.electrode_deg)
    first, last = angle(phi - half), angle(phi + half)
    shift = np.degrees(0.5 * (first + last)) - base.electrode_deg
    per_electrode: list[tuple[Effect, dict]] = [(ElectrodePosition(), {"shift_deg": shift})]
    if not geometry.points:
        node, weight = np.polynomial.legendre.leggauss(16)
        slope = geometry.rim(phi[:, None] + half[:, None] * node, 1)
        stretch = (np.abs(plane.unfold(slope)) @ weight) / (np.abs(slope) @ weight)
        contact = geometry.contact_impedivity_ohm_m2 / base.contact_impedivity_ohm_m2
        per_electrode.append((ElectrodeWidth(), {"width_mm": base.radius_mm * (last - first)}))
        per_electrode.append((ContactImpedance(), {"ratio": contact * stretch}))
    sites = np.arange(len(phi))
    chosen += [Setting(effect, sites, v, "electrodes") for effect, v in per_electrode]
    return chosen


def _outlines(found: Found) -> tuple[Geometry, Geometry]:
    """The skin found, untouched and at the start, and the disc that its owner believes in."""
    there = found.model.geometry(found.knobs, found.state.fit.settings())
    return there, Geometry.from_skin(found.model.skin(found.knobs))


def _degrees(axis: float) -> str:
    """The direction of an axis in words."""
    return f"{number(round(axis % 180.0, 1) % 180.0)}°"


def _pressed_out_of_round(found: Found) -> Side:
    """Of an anisotropy: gel that conducts alike in all directions, its rim pressed out of round
    and the electrodes with it."""
    there, base = _outlines(found)
    ratio, along = there.anisotropy_ratio, there.anisotropy_deg
    chosen = [*found.others(OUTLINE), *carried(there, base, ratio, along)]
    across = 2.0 * there.radius_mm * (1.0 + there.shape_cos.get(0, 0.0))
    long, short = across * ratio**0.25, across * ratio**-0.25
    reading = (
        "As well the gel may conduct alike in all directions and the rim be an ellipse that carries"
        f" its electrodes along, {number(long / short)} times as long along"
        f" {_degrees(along + 90.0)} as across ({number(long)} and {number(short)} mm, if its area"
        " is right). Measure it with a ruler."
    )
    return Side(found.apart(found.simulated(chosen), places_follow=True), reading)


def _directed(found: Found) -> Side | None:
    """Of a rim of harmonic 2, its electrodes' angles kept: a circle of gel that conducts better
    across the rim's long axis, by ln ratio = 2 amplitude, to first order. Conformal maps to the
    circle move the electrodes by amplitude sin(2 phi - phase) in both cases."""
    if found.effect.start.get("harmonic") != 2:
        return None
    ratio = float(np.exp(2.0 * found.values["amplitude"]))
    angle = 0.5 * found.values["phase_deg"] + 90.0
    tensor = Setting(Anisotropy(), None, {"ratio": ratio, "angle_deg": angle})
    reading = (
        f"As well the skin may be round, and its gel conduct {number(ratio)} times as well along"
        f" {_degrees(angle)} as across. Measure the rim with a ruler."
    )
    return Side(found.apart(found.simulated([*found.others(), tensor])), reading)


def _stretched(found: Found) -> Side | None:
    """Of electrodes each with its shift, most of it a wave A sin 2(phi - angle): one anisotropy,
    ln ratio = 2 A to first order, the other effects found following; fitted on the full model."""
    if found.effect.scope != "dense":
        return None
    phi = np.radians(np.array(found.model.skin(found.knobs).electrode_deg))
    shift = np.radians(found.values["shift_deg"])
    wave = 2j * np.mean((shift - shift.mean()) * np.exp(-2j * phi))
    if 0.5 * abs(wave) ** 2 < WAVE * np.var(shift):
        return None
    problem, state = found.state.fit.problem, found.state
    kind, like = Anisotropy(), found.effect
    tensor = Candidate(kind, None, None, "", {}, like.skin, like.scales)
    turn = 2.0 * np.conj(wave) / like.scales.typical_change(kind.parameters["ratio"])
    effects = [c for i, c in enumerate(state.effects) if i != found.index]
    place = state.fit.coordinate_slice(found.index)
    start = np.delete(state.fit.theta, np.arange(place.start, place.stop))
    target = replace(problem, readings=state.fit.voltage())
    fitted = fit(target, [*effects, tensor], np.r_[start, turn.real, turn.imag], polish=True)
    values = fitted.settings()[-1].values
    reading = (
        "As well all electrodes may sit where the drawing has them, and the gel conduct"
        f" {number(values['ratio'])} times as well along {_degrees(values['angle_deg'])} as across,"
        " or the rim be an ellipse that carries them along,"
        f" {number(values['ratio'] ** 0.5)} times as long along"
        f" {_degrees(values['angle_deg'] + 90.0)} as across. Measure the rim with a ruler."
    )
    ellipse = _pressed_out_of_round(Found(found.search, replace(state, fit=fitted), len(effects)))
    return Side(max(float(np.sqrt(fitted.chi2)), ellipse.gap), reading)


# ---- scales


def _factor(found: Found) -> float | None:
    """By how much contacts found, or a size found, raise all readings of a gel that conducts as
    much better: U = f(z sigma / length) / (sigma h) at unit current."""
    if found.effect.scope == "common" and found.effect.name == "contact-impedance":
        return float(found.values["ratio"])
    if found.effect.start.get("harmonic") == 0:
        return 1.0 / (1.0 + _signed_size(found.values))
    return None


def _signed_size(values: dict) -> float:
    return values["amplitude"] * float(np.cos(np.radians(values["phase_deg"])))


def _all_gains(found: Found) -> Side | None:
    """Of contacts all alike, or of a size: all currents, or all amplifiers, and the conductivity
    with them."""
    ratio = _factor(found)
    if ratio is None:
        return None
    better = Setting(_Conductivity(), None, {"ratio": ratio})
    drives = np.unique(found.model.channels[:, 0])
    gain = Setting(DriveGain(), drives, {"gain": ratio}, "drives")
    stated = found.model.skin(found.knobs).conductivity_S_per_m
    assert stated is not None
    sigma = stated * ratio
    reading = (
        f"As well all currents, or all readings, may be {number(ratio)} times what is stated, and"
        f" the gel conduct {quantity(sigma, 'S/m')}. Measure the current through a known resistor."
    )
    return Side(found.apart(found.simulated([*found.others(), better, gain])), reading)


def _size(found: Found) -> Side | None:
    """Of contacts all alike: the size of the skin, its electrodes' angles kept."""
    ratio, shape = _factor(found), DomainShape()
    if ratio is None or found.effect.name == "domain-shape":
        return None
    larger = 1.0 / ratio - 1.0
    if abs(larger) > shape.parameters["amplitude"].high:
        return None
    phase = 0.0 if larger > 0 else 180.0
    size = Setting(shape, None, {"harmonic": 0, "amplitude": abs(larger), "phase_deg": phase})
    radius = found.model.skin(found.knobs).radius_mm
    assert radius is not None
    across = 2.0 * radius / ratio
    reading = f"As well the skin may be {number(across)} mm across. Measure it with a ruler."
    return Side(found.apart(found.simulated([*found.others(), size])), reading)


def _contacts(found: Found) -> Side | None:
    """Of a size: all contacts."""
    ratio = _factor(found)
    if ratio is None or found.effect.name == "contact-impedance":
        return None
    angles = found.model.nominal_skin.electrode_deg
    assert angles is not None
    sites = np.arange(len(angles))
    every = Setting(ContactImpedance(), sites, {"ratio": ratio}, "electrodes")
    reading = (
        f"As well the skin may have its size and every contact {number(ratio)} times the impedance"
        " that is assumed. Measure the skin with a ruler."
    )
    return Side(found.apart(found.simulated([*found.others(), every])), reading)


# ---- drive and measurement


def _shared(found: Found) -> tuple[int, list[int], float] | None:
    """Of a gain found at few sites: the index of the other kind of gain, the electrodes that all
    pairs of both have, or else all of theirs, and the SNR gap to one gain for each pair in drive
    and in measurement. None where the pairs of the two differ."""
    effects, fit = found.state.effects, found.state.fit
    other = [i for i, c in enumerate(effects) if c.name in GAINS and c.name != found.effect.name]
    if len(other) != 1 or any(effects[i].scope != "sparse" for i in (found.index, *other)):
        return None
    pairs, places = [], []
    for index in (found.index, other[0]):
        start = 0 if effects[index].kind == "drives" else 2
        table = found.model.channels[:, start : start + 2]
        own = [
            {tuple(sorted(pair)) for pair in table[table[:, 0] == site].tolist()}
            for site in effects[index].site_indices
        ]
        if any(len(ends) != 1 for ends in own):
            return None
        pairs.append([ends.pop() for ends in own])
        places.append(
            np.arange(fit.coordinate_slice(index).start, fit.coordinate_slice(index).stop)
        )
    if sorted(pairs[0]) != sorted(pairs[1]):
        return None
    second = places[1][[pairs[1].index(pair) for pair in pairs[0]]]
    apart = fit.theta[places[0]] - fit.theta[second]
    turn = np.zeros((len(apart), len(fit.theta)))
    turn[range(len(apart)), places[0]], turn[range(len(apart)), second] = 1.0, -1.0
    spread = turn @ fit.covariance @ turn.T
    gap = float(np.sqrt(apart @ np.linalg.solve(spread, apart)))
    common = set.intersection(*map(set, pairs[0])) or set.union(*map(set, pairs[0]))
    return other[0], sorted(common), gap


def _one_wire(found: Found) -> Side | None:
    """Of a gain: one transfer of the wires, alike in drive and in measurement, as every passive
    network between skin and board has it (reciprocity: A Z A^T is symmetric as Z is)."""
    shared = _shared(found)
    if shared is None:
        return None
    _, electrodes, gap = shared
    where = f"electrode{'s' if len(electrodes) > 1 else ''} {listed(electrodes)}"
    reading = (
        "Drive and measurement have the same gain there, which no two amplifiers need have: look at"
        f" the wire and the contact of {where} before the board."
    )
    return Side(gap, reading)


def _seat(found: Found) -> Side | None:
    """Of a gain, alike in drive and in measurement: place, width and contact of the electrodes
    that it is at, in place of both gains; linear."""
    shared = _shared(found)
    if shared is None or DISTINCT.admits(shared[2]):
        return None
    other, electrodes, _ = shared
    search, state = found.search, found.state
    less = reduced(search, state, max(found.index, other))
    less = reduced(search, less, min(found.index, other))
    tangents = linearised(search, less)
    whitening = less.fit.problem.whitening
    change = whitening(found.simulated(state.fit.settings()) - tangents.voltage).ravel()
    signature = tangents.project_out(change)
    dense = [c for c in search.candidates if c.name in SEAT and c.scope == "dense"]
    columns = np.concatenate([tangents.columns(sparse(c, tuple(electrodes))) for c in dense])
    gain, _ = explained(columns, signature)
    return Side(float(np.sqrt(max(signature @ signature - gain, 0.0))), "")


# ---- places, forces and times


def _turned(found: Found, shifted: bool) -> Side | None:
    """Of a registration: all electrodes turned the other way, about touches where they are
    reported, or `shifted` still. Nothing else on the skin may have a direction."""
    turn = float(found.values["rotation_deg"])
    turned = estimates(found.state.fit, found.index)["rotation_deg"]
    if turned["low"] <= 0.0 <= turned["high"]:
        return None
    angles = found.model.nominal_skin.electrode_deg
    assert angles is not None
    sites = np.arange(len(angles))
    ring = Setting(ElectrodePosition(), sites, {"shift_deg": -turn}, "electrodes")
    chosen, what = [*found.others(), ring], "The touches may as well be where they are reported"
    if shifted:
        shift = complex(found.values["dx_mm"], found.values["dy_mm"])
        shift *= np.exp(-1j * np.radians(turn))
        values = {"dx_mm": shift.real, "dy_mm": shift.imag, "rotation_deg": 0.0}
        chosen.append(Setting(Registration(), None, values))
        what = "The touches may as well be shifted alone"
    reading = (
        f"{what} and all electrodes turned by {number(-turn)}°. Hold electrode 0 against a mark on"
        " the robot's axis."
    )
    return Side(found.apart(found.simulated(chosen)), reading)


def _pure_turn(found: Found) -> Side | None:
    return _turned(found, shifted=False)


def _shifted_turn(found: Found) -> Side | None:
    pure = _turned(found, shifted=False)
    return None if pure is None or not DISTINCT.admits(pure.gap) else _turned(found, shifted=True)


def _load_cell(found: Found) -> Side:
    """Of a law of the force: a load cell that reads another force than there is."""
    model = found.model
    force = model.states["force_N"].to_numpy(float)
    if found.effect.name == "contact-law":
        exponent = float(found.values["exponent"])
        true, how = force**exponent, f"its reading, in newton, to the power of {number(exponent)}"
    else:
        ratio = float(found.values["ratio"])
        true, how = ratio * force, f"{number(ratio)} times its reading"
    voltage = model.with_displacements({"force_N": true - force}).voltage(
        found.knobs, found.others()
    )
    reading = (
        f"As well the load cell may be at fault, the true force being {how}. Put known weights on"
        " it."
    )
    return Side(found.apart(voltage), reading)


def _gain_drift(found: Found) -> Side:
    """Of a conductivity that drifts: a current, or amplifiers, that do, the other way."""
    rate = float(found.values["per_minute"])
    minutes = found.model.states["time_s"].to_numpy(float) / 60.0
    minutes = minutes - minutes[0]
    voltage = found.simulated(found.others()) / (1.0 + rate * minutes)[:, None]
    reading = (
        f"As well the current, or all amplifiers, may drift by {number(-100.0 * rate)} % per"
        " minute. Record a known resistor for as long."
    )
    return Side(found.apart(voltage), reading)


ELLIPSE = ("domain-shape", "electrode-position")
IDENTITIES = (
    Identity("anisotropy", ELLIPSE, _pressed_out_of_round),
    Identity("domain-shape", ("anisotropy",), _directed),
    Identity("electrode-position", ("anisotropy", "domain-shape"), _stretched),
    *(
        Identity(name, (*GAINS, "channel-gain"), _all_gains)
        for name in ("contact-impedance", "domain-shape")
    ),
    Identity("contact-impedance", ("domain-shape",), _size),
    Identity("domain-shape", ("contact-impedance",), _contacts),
    *(Identity(name, (), _one_wire) for name in GAINS),
    *(Identity(name, SEAT, _seat) for name in GAINS),
    Identity("registration", ("electrode-position",), _pure_turn),
    Identity("registration", (), _shifted_turn),
    *(Identity(name, (), _load_cell) for name in FORCE),
    Identity("conductivity-drift", (), _gain_drift),
)
# Names that, even as another's alternative, do not stand without their other side. Gains need one
# another to have one.
TWO_SIDED = {i.name for i in IDENTITIES if i.instead and i.name not in GAINS}
