"""The catalogue: what every effect says of itself, that it does nothing at its neutral value; those
on the skin by their equations; how settings are read and drawn."""

import numpy as np
import pandas as pd
import pytest

from eitskin.diagnose.fitting.candidates import Candidate, Scales
from eitskin.effects import EFFECTS, on_readings
from eitskin.effects.effect import START, Frames, Moment
from eitskin.effects.settings import settings, site_counts
from eitskin.errors import InputError
from eitskin.physics.forward import Forward
from eitskin.physics.geometry import Geometry, Patch
from eitskin.physics.protocol import channel_table
from eitskin.physics.skin import Skin
from eitskin.physics.solver import forward_model
from eitskin.simulate.readings import apply_instrument, apply_skin, simulate

CHANNELS = channel_table(16)
COUNTS = site_counts(CHANNELS)
FORCES = np.array([0.0, 2.0, 10.0])
FRAMES = Frames(np.arange(3.0), FORCES, CHANNELS, frame_s=0.35, force_max_N=10.0)
GEOMETRY = Geometry(80.0, 3.0, 0.5, np.arange(16) * 22.5, 5.0, 1e-3)
SKIN = Skin(80.0, 3.0, 0.5, tuple(np.arange(16) * 22.5), 5.0, 1e-3, 1e-3, 0.9)
STATES = pd.DataFrame(
    {
        "time_s": 4.0 * np.arange(6),
        "touch": [False, True, True, True, False, True],
        "x_mm": [np.nan, 30.0, 30.0, 30.0, np.nan, -20.0],
        "y_mm": [np.nan, 10.0, 10.0, 10.0, np.nan, 40.0],
        "force_N": [0.0, 1.0, 4.0, 2.0, 0.0, 3.0],
        "probe_mm": [np.nan, 10.0, 10.0, 10.0, np.nan, 10.0],
    }
)
PRESS = np.array([-1, 0, 0, 0, -1, 1])
VOLTAGE = np.random.default_rng(2).normal(1.0, 0.3, (3, 208))
PATCH = {"x_mm": 25.0, "y_mm": 5.0, "radius_mm": 9.0, "contrast": 1.3}


def one(name, draw=(0, 0), **item):
    return settings([{"name": name, **item}], COUNTS, draw)


def readings(chosen):
    return simulate(STATES, PRESS, SKIN, CHANNELS, chosen, "train", 0.35, sink_grounded=True)


CLEAN = readings([])


def candidates(name):
    """The effect as fits of a diagnosis start it, at all the sites of its first kind: one
    candidate of each set of parameters that starts give."""
    effect = EFFECTS[name]
    kind = effect.sites[0] if effect.sites else None
    sites = tuple(range(effect.site_number or COUNTS[kind])) if kind else None
    scales = Scales(float(np.median(np.abs(CLEAN))), SKIN.current_A)
    starts = {tuple(start): start for start in effect.starts(SKIN, CLEAN)}
    tone = {"frequency_Hz": 50.0} if effect.tone else {}
    scope = "common" if kind else ""
    return [
        Candidate(effect, kind, sites, scope, start | tone, SKIN, scales)
        for start in starts.values()
    ]


def at(candidate, coordinate):
    """What it changes at that, what a start gives staying where it is."""
    return readings([candidate.setting(coordinate * candidate.linear)]) - CLEAN


@pytest.mark.parametrize("name", EFFECTS)
def test_at_its_neutral_value_it_does_nothing(name):
    for candidate in candidates(name):
        if candidate.linear.any():
            assert np.abs(at(candidate, 0.0)).max() < 1e-12 * np.abs(CLEAN).max()


@pytest.mark.parametrize("name", EFFECTS)
def test_at_a_typical_change_it_does_something(name):
    """And nothing to frames that are not touched, where it is one on the touch."""
    for candidate in candidates(name):
        change = at(candidate, 1.0)
        assert np.isfinite(change).all()
        assert np.abs(change).max() > 1e-6 * np.abs(CLEAN).max()
        if candidate.effect.stage in ("touch", "clock"):
            assert np.abs(change[[0, 4]]).max() < 1e-12 * np.abs(CLEAN).max()


@pytest.mark.parametrize("name", EFFECTS)
def test_it_says_what_it_is(name):
    effect = EFFECTS[name]
    assert effect.source and effect.mend and type(effect).__doc__
    for other in effect.confusable:
        assert name in EFFECTS[other].confusable and other != name


@pytest.mark.parametrize("name", [n for n, e in EFFECTS.items() if e.stage == "skin"])
def test_a_body_is_made_where_it_says_so(name):
    moment = Moment(1.0, 2.0, 30.0, 10.0)
    for candidate in candidates(name):
        chosen = [candidate.setting(candidate.linear)]
        made = apply_skin(Geometry.from_skin(SKIN), chosen, moment)
        sheet = Geometry.from_skin(SKIN)
        assert made.deep == (candidate.effect.largest_body(sheet) is not None)


def test_what_acts_on_readings_alone():
    assert on_readings("channel-gain") and on_readings("multiplexer-memory")
    for name in ("common-mode", "contact-impedance", "frame-skew", "ground-leak", "relaxation"):
        assert not on_readings(name)
    with pytest.raises(KeyError):
        on_readings("cross-talk")


def test_equation_9_to_the_letter():
    """C (g(F) * v) with the paper's matrices, written out."""
    gain = 1.0 + 0.08 * np.random.default_rng(0).standard_normal(208)
    gain[104:] = gain[:104][::-1]
    alpha, epsilon = 0.1, 0.03
    chosen = settings(
        [
            {"name": "channel-gain", "parameters": {"gain": gain.tolist()}},
            {"name": "force-dependent-gain", "parameters": {"per_N": alpha / 10, "F_mid_N": 5}},
            {"name": "crosstalk", "parameters": {"epsilon": epsilon}},
        ],
        COUNTS,
        (0, 0),
    )
    shift = np.roll(np.eye(208), 1, axis=0)
    mixing = (1 - 2 * epsilon) * np.eye(208) + epsilon * (shift + shift.T)
    force = FORCES[:, None] / 10.0
    expected = (gain * (1 + alpha * (force - 0.5)) * VOLTAGE) @ mixing.T
    found = apply_instrument(VOLTAGE, chosen, FRAMES)
    assert np.allclose(found, expected, rtol=1e-13)


def test_the_middle_force_is_half_the_largest_unless_given():
    found = apply_instrument(
        VOLTAGE, one("force-dependent-gain", parameters={"per_N": 0.01}), FRAMES
    )
    assert np.allclose(found / VOLTAGE, (1 + 0.01 * (FORCES - 5.0))[:, None])


@pytest.mark.parametrize("harmonic", [2, 3, 5])
def test_a_pressed_rim_keeps_what_lies_along_it(harmonic):
    pressed = {"harmonic": harmonic, "amplitude": 0.08, "phase_deg": 40.0, "carried": 1}
    uneven = np.array(GEOMETRY.electrode_deg) + 2.0 * np.sin(np.arange(16))
    before = GEOMETRY.with_values(electrode_deg=uneven)
    after = apply_skin(before, one("domain-shape", parameters=pressed), START)
    lengths = []
    for geometry in (before, after):
        half = np.degrees(0.5 * geometry.electrode_width_mm / geometry.radius_mm)
        angles = geometry.electrode_deg
        edges = np.radians(np.sort(np.r_[angles - half, angles + half]))
        pairs = zip(edges, np.append(edges[1:], edges[0] + 2.0 * np.pi), strict=True)
        rims = [geometry.rim(np.linspace(*pair, 4001)) for pair in pairs]
        along = [np.abs(np.diff(rim)).sum() for rim in rims]
        lengths.append(np.array(along) / np.sum(along))
    assert lengths[1] == pytest.approx(lengths[0], rel=1e-6)
    kept = apply_skin(before, one("domain-shape", parameters=pressed | {"carried": 0}), START)
    assert np.array_equal(kept.electrode_deg, uneven) and kept.shape_cos == after.shape_cos
    turned = np.radians(after.electrode_deg - before.electrode_deg)
    wave = np.sin(harmonic * np.radians(uneven) - np.radians(40.0))
    assert turned == pytest.approx(-0.08 / harmonic * wave, abs=0.08**2)


def test_an_ellipse_is_shape_and_shifts_to_first_order():
    """Of point electrodes; an arc would be stretched too."""

    def difference(size):
        sx, sy = 1 + size, 1 - 0.5 * size
        phi = np.radians(GEOMETRY.electrode_deg)
        shift = np.degrees(-0.5 * (sx - sy) * np.sin(2 * phi))
        exact = one("ellipse", parameters={"sx": sx, "sy": sy})
        first = settings(
            [
                {
                    "name": "domain-shape",
                    "parameters": {"harmonic": 0, "amplitude": (sx + sy) / 2 - 1},
                },
                {
                    "name": "domain-shape",
                    "parameters": {"harmonic": 2, "amplitude": (sx - sy) / 2},
                },
                {"name": "electrode-position", "parameters": {"shift_deg": shift.tolist()}},
            ],
            COUNTS,
            (0, 0),
        )
        points = GEOMETRY.with_values(electrode_width_mm=np.zeros(16))
        ellipse, sum_of_three, plain = (
            Forward(apply_skin(points, chosen, START), "train").voltages(CHANNELS)
            for chosen in (exact, first, [])
        )
        return np.abs(ellipse - sum_of_three).max(), np.abs(ellipse - plain).max()

    (large, _), (small, effect) = difference(0.04), difference(0.02)
    assert small < 0.2 * effect
    assert 3.0 < large / small < 5.0


def test_sites():
    chosen = one("contact-impedance", electrodes=[7], parameters={"ratio": 2.1})
    impedivity = apply_skin(GEOMETRY, chosen, START).contact_impedivity_ohm_m2
    assert impedivity[7] == pytest.approx(2.1e-3)
    assert np.count_nonzero(impedivity != 1e-3) == 1


def test_drifts_follow_the_clock():
    chosen = one("conductivity-drift", parameters={"per_minute": 0.01})
    assert apply_skin(
        GEOMETRY, chosen, Moment(3.0, 0.0, np.nan, np.nan)
    ).conductivity_S_per_m == pytest.approx(0.515)
    chosen = one("contact-drift", electrodes=[2], parameters={"per_minute": 0.01})
    moved = apply_skin(GEOMETRY, chosen, Moment(3.0, 0.0, np.nan, np.nan))
    assert moved.contact_impedivity_ohm_m2[2] == pytest.approx(1.03e-3)


def test_contacts_that_follow_the_force():
    touched = Moment(0.0, 4.0, 70.0, 10.0)
    chosen = one("force-dependent-impedance", electrodes=[0, 8], parameters={"per_N": [0.1, 0.2]})
    found = apply_skin(GEOMETRY, chosen, touched).contact_impedivity_ohm_m2
    assert found[[0, 8]] == pytest.approx([1.4e-3, 1.8e-3])
    assert (np.delete(found, [0, 8]) == 1e-3).all()
    assert apply_skin(GEOMETRY, chosen, START) is GEOMETRY
    parameters = {"per_N": 0.1, "range_mm": 25.0}
    found = apply_skin(GEOMETRY, one("force-dependent-impedance", parameters=parameters), touched)
    apart = np.abs(80.0 * np.exp(1j * np.radians(GEOMETRY.electrode_deg)) - (70 + 10j))
    expected = 1e-3 * (1 + 0.4 * np.exp(-((apart / 25.0) ** 2)))
    assert np.allclose(found.contact_impedivity_ohm_m2, expected)


def test_anisotropy_repeats_after_half_a_turn():
    first, again, across = (
        Forward(
            apply_skin(
                GEOMETRY, one("anisotropy", parameters={"ratio": 1.3, "angle_deg": a}), START
            )
        ).voltages(CHANNELS)
        for a in (20.0, 200.0, 110.0)
    )
    assert np.allclose(first, again, rtol=1e-9)
    assert np.abs(across - first).max() > 0.05 * np.abs(first).max()


def test_draws():
    parameters = {"gain": {"sd": 0.04, "tie": "mirror"}}
    gain = one("channel-gain", (1, 2), parameters=parameters)[0].values["gain"]
    assert np.array_equal(gain, gain[::-1]) and gain.shape == (208,)
    again = one("channel-gain", (1, 2), parameters=parameters)[0].values["gain"]
    assert np.array_equal(gain, again)
    other = one("channel-gain", (1, 3), parameters=parameters)[0].values["gain"]
    assert not np.array_equal(gain, other)
    stronger = {"gain": {"sd": 0.08, "tie": "mirror"}}
    double = one("channel-gain", (1, 2), parameters=stronger)[0].values["gain"]
    assert np.allclose(double - 1, 2 * (gain - 1))
    many = [
        one("channel-gain", (1, s), parameters=parameters)[0].values["gain"][:104]
        for s in range(50)
    ]
    assert np.std(many) == pytest.approx(0.04, rel=0.05)
    assert np.mean(many) == pytest.approx(1.0, abs=0.003)


@pytest.mark.parametrize(
    ("item", "message"),
    [
        ({"name": "cross-talk"}, "'cross-talk', expected one of"),
        ({"name": "crosstalk", "electrodes": [3]}, "electrodes: found"),
        ({"name": "drive-gain", "channels": [3]}, r"channels: found \[3\], expected drives"),
        ({"name": "offset", "channels": [3], "measures": [3]}, "expected measures or channels"),
        ({"name": "electrode-swap"}, "electrodes: found 16 of them, expected 2"),
        ({"name": "relaxation", "parameters": {"fraction": 0.1}}, "tau_s: found nothing"),
        ({"name": "crosstalk", "parameters": {"eps": 0.1}}, "'eps'"),
        ({"name": "crosstalk", "parameters": {"epsilon": 0.7}}, "epsilon: found 0.7"),
        ({"name": "contact-impedance", "electrodes": [16]}, "indices 0 to 15"),
        ({"name": "domain-shape", "parameters": {"amplitude": 0.1}}, "harmonic: found nothing"),
        ({"name": "contact-impedance", "parameters": {"ratio": [1.0, 2.0]}}, "2 values"),
    ],
)
def test_refusals(item, message):
    with pytest.raises(InputError, match=message):
        settings([item], COUNTS, (0, 0))


def test_gradients_add_as_vectors():
    def gradient(across, angle):
        return {
            "name": "conductivity-gradient",
            "parameters": {"relative_across": across, "angle_deg": angle},
        }

    chosen = settings([gradient(0.03, 90.0), gradient(0.04, 0.0)], COUNTS, (0, 0))
    found = apply_skin(GEOMETRY, chosen, START)
    assert found.gradient_across == pytest.approx(0.05)
    assert found.gradient_deg == pytest.approx(np.degrees(np.arctan2(3, 4)))
    against = settings([gradient(0.03, 90.0), gradient(0.03, 270.0)], COUNTS, (0, 0))
    assert apply_skin(GEOMETRY, against, START).gradient_across == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize("contrast", [0.5, 3.0])
def test_small_patches_of_one_equivalent_radius_look_alike(contrast):
    """r^2 (c - 1) / (c + 1) is all that a small disc changes."""
    patch, base = EFFECTS["conductivity-patch"], forward_model(GEOMETRY, "train")
    protocol = channel_table(len(GEOMETRY.electrode_deg))

    def change(radius_mm, contrast):
        there = GEOMETRY.with_values(patches=(Patch(12.0, 5.0, radius_mm, contrast),))
        return forward_model(there, "train").voltages(protocol) - base.voltages(protocol)

    ((radius_mm, unit),) = patch.combination.amounts(
        {"radius_mm": 3.0, "contrast": contrast}
    ).values()
    assert unit == "mm"
    most = 1e-2 if contrast < 1.0 else 1e2
    alike = change(radius_mm / np.sqrt(abs(most - 1.0) / (most + 1.0)), most)
    found = change(3.0, contrast)
    assert np.linalg.norm(found - alike) < 0.02 * np.linalg.norm(found)


def test_patches_stand_beside_each_other():
    second = {**PATCH, "x_mm": -25.0}
    patches = [{"name": "conductivity-patch", "parameters": p} for p in (PATCH, second)]
    chosen = settings(patches, COUNTS, (0, 0))
    expected = Patch(25.0, 5.0, 9.0, 1.3), Patch(-25.0, 5.0, 9.0, 1.3)
    assert apply_skin(GEOMETRY, chosen, START).patches == expected


@pytest.mark.parametrize(
    "name", ["contact-impedance", "contact-drift", "force-dependent-impedance"]
)
def test_points_have_no_contacts(name):
    points = GEOMETRY.with_values(electrode_width_mm=np.zeros(16))
    with pytest.raises(InputError, match="electrodes with a width"):
        apply_skin(points, one(name), START)
