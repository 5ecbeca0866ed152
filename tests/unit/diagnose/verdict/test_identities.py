"""Exact equivalents: each proved on the two sides' readings, seen to break where it must, and
declared by a diagnosis that names one side."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as example_settings
from hypothesis import strategies as st

from eitskin.data.recording import Recording, frames_table
from eitskin.diagnose import diagnosis
from eitskin.diagnose.search import refits
from eitskin.diagnose.search.gates import DISTINCT
from eitskin.diagnose.search.search import Search
from eitskin.diagnose.verdict import conclusion
from eitskin.diagnose.verdict.gaps import gaps
from eitskin.diagnose.verdict.identities import other_sides, sentences, substitute_setting
from eitskin.effects import EFFECTS, catalogue_names
from eitskin.effects.anisotropy import carried_outline
from eitskin.effects.effect import START
from eitskin.physics.forward import Forward, channel_values
from eitskin.physics.geometry import Geometry
from eitskin.physics.protocol import channel_table
from eitskin.physics.touch import Touch
from eitskin.quantities import MINUS
from eitskin.simulate.readings import apply_skin
from simulated_metadata import simulated_metadata
from small_skin import (
    CHANNELS,
    SKIN,
    calibrated,
    candidates_of,
    problem_of,
    small_recording,
    voltage,
)
from witness import elements
from witness.curves import Shape

N, TABLE = 16, channel_table(16)
OVAL = {"name": "ellipse", "parameters": {"sx": 1.08, "sy": 0.93}}
DIRECTED = {"name": "anisotropy", "parameters": {"ratio": 1.3, "angle_deg": 30.0}}
CONTACTS = {"name": "contact-impedance", "parameters": {"ratio": 4.0}}
LESS = {"name": "contact-impedance", "parameters": {"ratio": 1.25}}
SMALLER = {
    "name": "domain-shape",
    "parameters": {"harmonic": 0, "amplitude": 0.2, "phase_deg": 180.0},
}
TURN = {"name": "registration", "parameters": {"rotation_deg": 3.0}}
TURN_AND_SHIFT = {"name": "registration", "parameters": {"rotation_deg": 3.0, "dx_mm": 1.0}}
SHAPE = {"name": "domain-shape", "parameters": {"harmonic": 2, "amplitude": 0.1, "phase_deg": 40.0}}
LAW = {"name": "contact-law", "parameters": {"exponent": 0.8}}
CONTRAST = {"name": "touch-contrast", "parameters": {"ratio": 1.5}}
GAIN_OF_FORCE = {"name": "force-dependent-gain", "parameters": {"per_N": 0.01}}
DRIFT = {"name": "conductivity-drift", "parameters": {"per_minute": 0.01}}
DRIVES = {"name": "drive-gain", "drives": [4, 5], "parameters": {"gain": [0.95, 0.9]}}
PAIRS = {"name": "measurement-gain", "measures": [4, 5], "parameters": {"gain": [0.95, 0.9]}}
OTHER_PAIRS = {"name": "measurement-gain", "measures": [4, 5], "parameters": {"gain": [0.95, 1.05]}}
POINTS = replace(SKIN, electrode_width_mm=0.0)
SEATED = [
    {"name": "drive-gain", "drives": [4], "parameters": {"gain": 0.95}},
    {"name": "measurement-gain", "measures": [4], "parameters": {"gain": 0.95}},
]


def still(*items: dict, noise: float = 1e-3, seed: int = 0) -> Recording:
    """A recording of twelve untouched frames; noise: over the median reading."""
    nowhere = np.full(12, np.nan)
    frames = frames_table(
        2.0 * np.arange(12), np.zeros(12, bool), nowhere, nowhere, np.zeros(12), nowhere
    )
    recorded = Recording(frames, None, None, None, simulated_metadata(SKIN, CHANNELS))
    clean = voltage(recorded, list(items))
    draw = np.random.default_rng([seed, 1]).normal(size=clean.shape)
    recorded.voltage = clean + noise * np.median(np.abs(clean)) * draw
    return recorded


def touched(*items: dict, **given) -> Recording:
    """A recording with touches, free of noise."""
    return small_recording(*items, **{"noise": 0.0, **given})


def fitted(recorded: Recording, *items: dict, scopes: tuple = (), noise: float = 1e-3):
    """A search of a recording and a state with candidates of items fitted, that is, at their
    values; noise: what is believed, over the median reading; scopes: of the items, else common
    where no sites are given."""
    problem, scales = problem_of(recorded, noise)
    candidates = candidates_of(recorded, problem, scales)
    fold = np.zeros(len(problem.readings), int)
    search = Search(problem, candidates, fold, seed=1, report=lambda line: None)
    state = refits.explain(search, calibrated(problem))
    for k, item in enumerate(items):
        sites = item.get("drives") or item.get("measures")
        scope = scopes[k] if scopes else ("sparse" if sites else "common")
        for site in sites or [None]:
            state = refits.with_effect(search, state, _candidate(candidates, item, scope, site))
    return search, state


def _candidate(candidates, item: dict, scope: str, site: int | None):
    harmonic = item["parameters"].get("harmonic")
    for c in candidates:
        same = c.name == item["name"] and c.start.get("harmonic") == harmonic
        if same and (c.scope or "common") == scope and site in (None, *(c.sites or ())):
            return c
    raise LookupError(item["name"])


def sides(recorded: Recording, *items: dict, index: int = 0, **given) -> tuple[dict, float]:
    """The other sides of effect `index` with their gaps, by the function that simulates them; and
    the length of its signature."""
    search, state = fitted(recorded, *items, **given)
    snr = gaps(search, state, index)[0].snr
    return {i.other_side.__name__: s.gap for i, s in other_sides(search, state, index)}, snr


# ---- a disc that conducts in one direction is an ellipse that carries its electrodes


def outlines(width_mm: float, ratio: float, angle: float) -> list[Geometry]:
    """A disc, the disc with an anisotropy, and its other side as effects of the catalogue."""
    base = Geometry(80.0, 3.0, 0.5, 22.5 * np.arange(N), np.array(width_mm), np.array(2e-3))
    directed = base.with_values(anisotropy_ratio=ratio, anisotropy_deg=angle)
    substitutes = carried_outline(directed, base, ratio, angle)
    oval = apply_skin(base, [substitute_setting(s) for s in substitutes], START)
    assert oval.anisotropy_ratio == 1.0
    return [base, directed, oval]


def apart(volts: list[np.ndarray]) -> float:
    """Difference of the two sides over what the effect changes."""
    none, one, other = volts
    return float(np.linalg.norm(other - one) / np.linalg.norm(one - none))


@example_settings(max_examples=15, deadline=None)
@given(st.floats(1.02, 2.0), st.floats(0.0, 180.0))
def test_an_anisotropy_is_an_ellipse_that_carries_its_electrodes(ratio, angle):
    """Exact for points. An electrode's even contact is uneven on the ellipse, to second order in
    its width: under 1e-3 of the effect at widths of 5 mm."""
    points = [Forward(g).voltages(TABLE) for g in outlines(0.0, ratio, angle)]
    assert apart(points) < 1e-6
    narrow, wide = (
        [Forward(g).voltages(TABLE) for g in outlines(width, ratio, angle)] for width in (1.25, 5.0)
    )
    assert apart(wide) < 1e-3 and apart(narrow) < 0.2 * apart(wide)


def test_finite_elements_have_the_same_readings_of_a_tensor_and_of_an_ellipse():
    """A solver that shares nothing with the tool's, which unfolds every tensor."""

    def volts(g: Geometry) -> np.ndarray:
        rim = {k: g.shape_cos[k] + 1j * g.shape_sin.get(k, 0.0) for k in g.shape_cos}
        shape = Shape(g.radius_mm, rim, (g.anisotropy_ratio, g.anisotropy_deg))
        body = elements.Body(shape, g.electrode_deg, g.electrode_width_mm)
        length = 1e3 * g.contact_impedivity_ohm_m2 * g.conductivity_S_per_m / g.radius_mm
        admittance = body.place([]).admittance(body.contact(length), [])
        return channel_values(np.linalg.inv(0.5 * (admittance + admittance.T) + 1.0), TABLE)

    assert apart([volts(g) for g in outlines(5.0, 1.91, 30.0)]) < 3e-4


def test_a_touch_belongs_to_the_identity_only_where_it_is_carried_along():
    """Carried, it differs by its edge alone, which is an ellipse's: 5 % of its change at a ratio of
    1.5, over 25 % where it stays put."""
    ratio, angle = 1.5, 20.0
    _, directed, oval = outlines(5.0, ratio, angle)
    place = 50.0 * np.exp(1j * np.radians(70.0))
    there = complex(directed.unfold(np.array([place]))[0])

    def change(geometry: Geometry, at: complex) -> np.ndarray:
        forward = Forward(geometry)
        pressed = forward.voltages(TABLE, [Touch(at.real, at.imag, 5.0, 2.0)])
        return pressed - forward.voltages(TABLE)

    one = change(directed, place)
    with_it, without = (
        np.linalg.norm(change(oval, at) - one) / np.linalg.norm(one) for at in (there, place)
    )
    assert without > 0.25 and with_it < 0.06


@pytest.mark.parametrize("item", [DIRECTED, OVAL])
def test_an_ellipse_is_within_the_noise_of_an_anisotropy_in_untouched_frames_alone(item):
    """Whichever of the two it was."""
    found, snr = sides(still(item, noise=0.0), DIRECTED)
    assert found["elliptic_rim"] < 1e-6 * snr
    found, _ = sides(touched(item), DIRECTED)
    assert found["elliptic_rim"] > 2.0 * DISTINCT.threshold


@example_settings(max_examples=15, deadline=None)
@given(st.floats(0.005, 0.05), st.floats(0.0, 360.0))
def test_a_rim_of_harmonic_2_is_an_anisotropy_to_second_order(amplitude, phase):
    """Of points; even contacts add 2e-3 of the effect at widths of 5 mm."""

    def both(width_mm: float) -> float:
        base, *_ = outlines(width_mm, 1.1, 0.0)
        turn = amplitude * np.exp(1j * np.radians(phase))
        rim = base.with_values(shape_cos={2: turn.real}, shape_sin={2: turn.imag})
        ratio, angle = np.exp(2.0 * amplitude), 0.5 * phase + 90.0
        tensor = base.with_values(anisotropy_ratio=ratio, anisotropy_deg=angle)
        return apart([Forward(g).voltages(TABLE) for g in (base, rim, tensor)])

    assert both(0.0) < 0.15 * amplitude**2 and both(5.0) < 3e-3


PLACES = {"name": "electrode-position", "parameters": {}}
JITTER = {
    "name": "electrode-position",
    "parameters": {"shift_deg": [1.0, -1.0, 0.5, 0.8, -1.2, 1.1, -0.4, -0.8]},
}


@pytest.mark.long
def test_places_that_follow_a_stretch_are_an_anisotropy_in_untouched_frames_alone():
    search, state = fitted(still(DIRECTED, noise=0.0), PLACES, scopes=("dense",), noise=5e-3)
    near = {g.rival: g.gap for g in gaps(search, state, 0)}
    assert max(near["anisotropy"], near["domain-shape"]) < DISTINCT.threshold
    (said,) = sentences(search, state, 0, list(near))
    assert "1.30 times as well along 30° as across" in said
    stretched = {"name": "electrode-position", "parameters": {"shift_deg": _stretch_deg()}}
    for recorded in (still(JITTER, noise=0.0), touched(stretched)):
        search, state = fitted(recorded, PLACES, scopes=("dense",), noise=5e-3)
        near = {g.rival: g.gap for g in gaps(search, state, 0)}
        assert min(near["anisotropy"], near["domain-shape"]) > 2.0 * DISTINCT.threshold


def test_an_anisotropy_beside_places_of_their_own_is_an_ellipse_still():
    """All that may follow has been fitted already."""
    items = DIRECTED, PLACES
    search, state = fitted(still(*items[:1], noise=0.0), *items, scopes=("common", "dense"))
    near = {g.rival: g.gap for g in gaps(search, state, 0)}
    assert near["domain-shape"] < DISTINCT.threshold


def _stretch_deg() -> list[float]:
    """Shifts by which, in untouched frames, electrodes give the readings of DIRECTED."""
    wave = np.sin(2.0 * np.radians(np.array(SKIN.electrode_deg) - 30.0))
    return np.degrees(0.5 * np.log(1.3) * wave).tolist()


# ---- scales, turns, forces, times


@pytest.mark.parametrize(
    ("item", "recorded", "same"),
    [
        (CONTACTS, touched, ["scaled_currents"]),
        (LESS, still, ["scaled_currents", "scaled_rim"]),
        (SMALLER, still, ["scaled_currents", "scaled_contacts"]),
        (TURN_AND_SHIFT, touched, ["turned_electrodes_and_shift"]),
        (LAW, touched, ["bent_load_cell"]),
        (CONTRAST, touched, ["scaled_load_cell"]),
    ],
)
def test_an_identity_is_exact(item, recorded, same):
    found, snr = sides(recorded(item, noise=0.0), item)
    assert snr > 4.0 and all(found[side] < 1e-9 * snr for side in same)


def test_a_turn_of_touches_is_one_of_all_electrodes():
    """To what is left of the shift fitted beside it."""
    found, snr = sides(touched(TURN), TURN)
    assert found["turned_electrodes"] < 3e-3 * snr and "turned_electrodes_and_shift" not in found
    found, snr = sides(touched(TURN_AND_SHIFT), TURN_AND_SHIFT)
    assert found["turned_electrodes"] > 0.3 * snr


def test_a_drift_of_the_conductivity_is_one_of_the_gain_but_for_the_contacts():
    found, snr = sides(touched(DRIFT), DRIFT)
    assert 1e-4 * snr < found["drifting_gain"] < 1e-2 * snr
    found, snr = sides(touched(DRIFT, skin=POINTS), DRIFT)
    assert found["drifting_gain"] < 1e-9 * snr


@pytest.mark.parametrize(
    ("beside", "item", "broken"),
    [
        (None, SMALLER, ["scaled_currents", "scaled_contacts"]),  # touches have their places
        (None, LESS, ["scaled_rim"]),
        (
            SHAPE,
            TURN,
            ["turned_electrodes", "turned_electrodes_and_shift"],
        ),  # a rim that has a direction
        (GAIN_OF_FORCE, LAW, ["bent_load_cell"]),  # another that follows the force
        (GAIN_OF_FORCE, CONTRAST, ["scaled_load_cell"]),
    ],
)
def test_an_identity_breaks(beside, item, broken):
    items = [beside, item] if beside else [item]
    found, _ = sides(touched(*items), *items, index=len(items) - 1)
    assert all(found[side] > 2.0 * DISTINCT.threshold for side in broken)


# ---- drive and measurement


def test_a_shunt_across_two_wires_is_one_gain_in_drive_and_in_measurement():
    """Sherman, Morrison 1950: of contacts r it is 1 / (1 + G (Z + 2 r)) for all channels of the
    pair; what it changes elsewhere fades as contacts grow."""
    impedance = Forward(outlines(5.0, 1.1, 0.0)[0]).transfer_impedance()
    pair, shunt = np.zeros(N), 1e-5
    pair[[4, 5]] = 1.0, -1.0
    driven, measured = TABLE[:, 0] == 4, TABLE[:, 2] == 4
    elsewhere = []
    for contact in (1e2, 1e5):
        wired = impedance + contact * np.eye(N)
        gain = 1.0 / (1.0 + shunt * (pair @ wired @ pair))
        there = wired - gain * shunt * np.outer(wired @ pair, pair @ wired)
        ratio = channel_values(there, TABLE) / channel_values(impedance, TABLE)
        assert ratio[driven | measured] == pytest.approx(gain, rel=1e-9)
        far = ~(np.isin(TABLE, (4, 5)).any(axis=1))
        elsewhere.append(np.abs(ratio[far] - 1.0).max() / (1.0 - gain))
    assert elsewhere[1] < 0.02 * elsewhere[0]


@pytest.mark.parametrize("index", [0, 1])
def test_equal_gains_point_at_the_electrode_and_others_at_the_amplifiers(index):
    search, state = fitted(touched(DRIVES, PAIRS), DRIVES, PAIRS)
    (said,) = sentences(search, state, index, [])
    assert "the contact of electrode 5 before the board" in said
    search, state = fitted(touched(DRIVES, OTHER_PAIRS), DRIVES, OTHER_PAIRS)
    assert sentences(search, state, index, []) == []
    search, state = fitted(touched(DRIVES), DRIVES)
    assert other_sides(search, state, 0) == []


def test_equal_gains_have_the_electrodes_seat_among_their_names_where_noise_allows_it():
    """Place, width and contact of two electrodes leave a sixth of it: no identity, but a class at
    SNR 15 and less."""
    recorded = touched(*SEATED)
    for noise, same in ((1e-3, False), (0.08, True)):
        search, state = fitted(recorded, *SEATED, noise=noise)
        near = {g.rival for g in gaps(search, state, 0) if g.gap < DISTINCT.threshold}
        assert ({"contact-impedance", "electrode-position", "electrode-width"} <= near) == same


# ---- what a diagnosis says


def said(recorded: Recording) -> dict:
    """The only effect of a recording's diagnosis."""
    (effect,) = conclusion.document(diagnosis.diagnose(recorded), "identity")["effects"]
    return effect


@pytest.mark.long
@pytest.mark.parametrize("item", [DIRECTED, OVAL])
def test_a_diagnosis_of_untouched_frames_names_anisotropy_and_the_ellipse(item):
    effect = said(still(item))
    assert effect["name"] == "anisotropy"
    assert effect["alternatives"][:2] == ["domain-shape", "electrode-position"]
    assert effect["gap"] < DISTINCT.threshold
    assert "Measure it with a ruler." in effect["sentence"]
    if item is OVAL:
        assert "1.16 times as long along 0° as across" in effect["sentence"]


@pytest.mark.long
def test_a_diagnosis_with_touches_tells_an_anisotropy_from_an_ellipse():
    effect = said(small_recording(DIRECTED))
    assert effect["name"] == "anisotropy" and effect["alternatives"] == []
    assert "ruler" not in effect["sentence"]


def test_a_diagnosis_names_contacts_and_all_gains():
    effect = said(small_recording(CONTACTS))
    assert effect["name"] == "contact-impedance" and effect["scope"] == "common"
    assert {"drive-gain", "measurement-gain", "channel-gain"} <= {*effect["alternatives"]}
    assert "Measure the current through a known resistor." in effect["sentence"]


@pytest.mark.long
def test_a_diagnosis_names_a_turn_of_touches_and_one_of_electrodes():
    effect = said(small_recording(TURN))
    assert (effect["name"], effect["alternatives"]) == ("registration", ["electrode-position"])
    assert f"all electrodes turned by {MINUS}3.0" in effect["sentence"]


@pytest.mark.long
@pytest.mark.parametrize(
    ("item", "check"),
    [
        (LAW, "Put known weights on it."),
        (DRIFT, "Record a known resistor for as long."),
    ],
)
def test_a_diagnosis_says_a_reading_for_which_there_is_no_name(item, check):
    effect = said(small_recording(item))
    assert effect["name"] == item["name"] and check in effect["sentence"]


@pytest.mark.long
def test_sides_of_an_alternative_are_alternatives_too():
    """Of the size, the contacts and the gains none stands among them without the others."""
    effect = said(still(SMALLER, noise=1e-4))
    names = {effect["name"], *effect["alternatives"]}
    assert {"domain-shape", "contact-impedance", "drive-gain", "measurement-gain"} <= names


@pytest.mark.long
def test_a_diagnosis_of_equal_gains_points_at_the_electrodes():
    found = conclusion.document(diagnosis.diagnose(small_recording(*SEATED)), "gains")["effects"]
    assert {effect["name"] for effect in found} == {"drive-gain", "measurement-gain"}
    for effect in found:
        assert "the contact of electrodes 4 and 5 before the board" in effect["sentence"]


def test_identities_name_what_a_diagnosis_may_name():
    for name, effect in EFFECTS.items():
        names = {other for identity in effect.identities for other in identity.names}
        assert names <= {*catalogue_names()} - {name}
