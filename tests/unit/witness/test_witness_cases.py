"""Cases: repeatable, as promised, and made without the tool's solver."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from eitskin.data import recording
from eitskin.effects import EFFECTS
from eitskin.errors import InputError
from witness.cases import OFF_RIM_MM, again, draw, names_of, signature, write
from witness.outside import OUTSIDE, Scene
from witness.strengths import DRAWN
from witness.world import World


@pytest.fixture(scope="module")
def null():
    return draw("null", 3)


def test_draws_every_name_that_a_diagnosis_seeks_in_a_skin_that_is_known():
    diagnosed_names = {n for n, e in EFFECTS.items() if not (e.composite or e.last_resort)}
    assert set(DRAWN) == diagnosed_names


@pytest.mark.parametrize("kind", ["null", "single:crosstalk", "outside:texture"])
def test_repeats_bit_for_bit(kind):
    case, repeated = draw(kind, 5), draw(kind, 5)
    assert np.array_equal(case.voltage, repeated.voltage)
    assert np.array_equal(case.query_clean, repeated.query_clean)
    assert case.effects == repeated.effects and case.outside == repeated.outside
    assert not np.array_equal(case.voltage[:5], draw(kind, 6).voltage[:5])


def test_recorded_again_it_is_the_same_skin(null):
    case_0, repeated, case_1 = (again(null, "rig:gain-walk", number) for number in (0, 0, 1))
    assert np.array_equal(case_0.voltage, repeated.voltage) and case_0.rig == repeated.rig
    assert case_0.rig[0].size != case_1.rig[0].size
    assert np.array_equal(case_0.clean, null.clean) and case_0.kind == "null+rig:gain-walk"
    pd.testing.assert_frame_equal(case_0.states, null.states)
    plain = again(null, "", 0)
    assert plain.rig == () and not np.array_equal(plain.voltage, null.voltage)
    moved_case = again(null, "rig:place-per-press,quadrature", 0)
    assert not moved_case.states["x_mm"].equals(null.states["x_mm"])
    assert moved_case.true_states is null.true_states
    assert moved_case.metadata["voltage"] == "magnitude" and (moved_case.clean >= 0).all()
    assert null.metadata["voltage"] == "signed"
    with pytest.raises(InputError, match="case: kind"):
        again(moved_case, "", 0)


def test_recording_as_promised(null):
    frames = null.states
    assert 100 <= len(frames) <= 150 and 24 <= len(null.query) <= 40
    assert not frames["touch"][:2].any()
    assert 10 <= frames["contact"].dropna().nunique() <= 14
    reach = np.hypot(frames["x_mm"], frames["y_mm"]) + 0.5 * frames["probe_mm"]
    assert reach.max() <= 0.93 * null.true.radius_mm + 1e-9
    conductivity_ratio = null.true.conductivity_S_per_m / null.believed.conductivity_S_per_m
    assert 0.85 <= conductivity_ratio <= 1.15 and conductivity_ratio != 1.0
    noise = (null.voltage - null.clean) / null.noise_V
    assert noise.std() == pytest.approx(1.0, abs=0.02)
    assert null.query["force_N"].max() > frames["force_N"].max()
    assert null.query["time_s"].min() > frames["time_s"].max()


@pytest.mark.parametrize("kind", ["single:contact-impedance", "pair", "outside:source-sag"])
def test_written_and_read(kind, tmp_path):
    case = draw(kind, 4)
    write(case, tmp_path)
    recorded = recording.read(tmp_path / "recording.parquet")
    assert np.array_equal(recorded.voltage, case.voltage)
    assert recorded.skin == case.believed
    asked = recording.read(tmp_path / "query.parquet")
    assert asked.voltage is None and len(asked.frames) == len(case.query_clean)
    truth = json.loads((tmp_path / "truth.json").read_text())
    assert truth["effects"] == case.effects
    assert np.array_equal(truth["query_voltage_V"], case.query_clean)


def test_shows_as_much_as_it_says():
    case = draw("single:drive-gain", 8)
    world = World(case.true, np.array(case.metadata["channels"]), case.metadata["frame_s"])
    plain = world.readings(case.states, [])
    assert signature(case.clean, plain, case.noise_V) == pytest.approx(case.snr[0], rel=1e-9)
    assert 9.5 <= case.snr[0] <= 63.0
    assert signature(1.3 * plain, plain, case.noise_V) == pytest.approx(0.0, abs=1e-6)


def test_an_effect_of_no_strength_changes_nothing(null):
    world = World(null.true, np.array(null.metadata["channels"]), null.metadata["frame_s"])
    for name in ("contact-impedance", "anisotropy", "relaxation", "crosstalk", "frame-skew"):
        scene = type("S", (), {"n": 16, "channels": world.channels})
        nothing = DRAWN[name](np.random.default_rng(1), scene).law_at(0.0)
        changed = world.readings(null.states, [nothing])
        assert np.abs(changed - null.clean).max() < 1e-9 * np.abs(null.clean).max(), name


def test_every_outside_law_starts_from_nothing(null):
    world = World(null.true, np.array(null.metadata["channels"]), null.metadata["frame_s"])
    states = null.states.iloc[:30]
    presses = states["contact"].dropna().unique().astype(int)
    scene = Scene(16, presses, states["time_s"].max(), 60.0, (0.0, 0.0, 0.1), null.clean[0])
    plain = world.readings(states, [])
    median = np.median(np.abs(plain[0]))
    for name, law in OUTSIDE.items():
        if name in ("palm", "slit"):  # these need a free place
            continue
        drawn = law.draw(np.random.default_rng(2), scene)
        small = [
            world.readings(states, [], replace(drawn, amount=a * law.max_amount)) for a in (0, 0.1)
        ]
        limit = 1e-2 if name == "smooth-dent" else 1e-9
        assert np.abs(small[0] - plain).max() < limit * median, name
        assert np.abs(small[1] - plain).max() > 1e-7 * median, name


@pytest.mark.parametrize("kind", ["nil", "single:nothing", "outside:nothing", "pair:x"])
def test_refuses_unknown_kinds(kind):
    with pytest.raises(InputError, match="kind"):
        names_of(kind, np.random.default_rng(0))


def test_a_case_on_an_outline_is_one_on_it_touches_and_all():
    case = draw("single:electrode-position+outline+rig:gain-walk", 2, 20, "elements")
    skin = case.recorded.skin
    assert skin.rim is not None and skin.radius_mm is None and skin.electrode_deg is None
    recording.validate(case.recorded, "case")
    places = np.concatenate([table["x_mm"] + 1j * table["y_mm"] for table in (case.true_states,)])
    radius = 0.5 * case.true_states["probe_mm"].to_numpy()
    touched = case.true_states["touch"].to_numpy(bool)
    assert (skin.rim.depth(places[touched]) > radius[touched] + OFF_RIM_MM - 0.1).all()
    (effect,) = case.effects
    assert set(effect["parameters"]) == {"shift_mm"} and case.rig[0].kind == "gain-walk"
    assert 9.0 < case.snr[0] < 65.0
    shift_deg = np.degrees(np.array(effect["parameters"]["shift_mm"]) / case.true.radius_mm)
    angles = {"parameters": {"shift_deg": shift_deg.tolist()}}
    by_angle = case.world.readings(case.true_states[:1], [{**effect, **angles}])
    np.testing.assert_allclose(by_angle, case.clean[:1], rtol=1e-9)


@pytest.mark.parametrize("kind", ["single:third-dimension", "single:conductivity-gradient"])
def test_no_case_on_an_outline_has_what_discs_alone_have(kind):
    with pytest.raises(InputError, match="outline"):
        draw(f"{kind}+outline", 1)


def test_sets_have_their_size():
    rng = np.random.default_rng(0)
    assert all(len(set(names_of("triple", rng)[0])) == 3 for _ in range(20))


def test_longer_recordings_have_more_presses(null):
    long = draw("null", 3, frames=500)
    assert len(long.states) == len(long.voltage) == 500
    ratio = long.states["contact"].nunique() / null.states["contact"].nunique()
    assert 3.5 < ratio < 4.5
    assert long.true.radius_mm == null.true.radius_mm


def test_a_share_of_the_largest_strength_is_drawn_in_place_of_an_snr():
    case, case_by_snr = draw("single:force-offset", 2, share=0.4), draw("single:force-offset", 2)
    (effect,) = case.effects
    assert abs(effect["parameters"]["offset_N"]) == pytest.approx(0.8)
    assert (
        case.true == case_by_snr.true
        and case.states.equals(case_by_snr.states)
        and case.level >= case_by_snr.level
    )
    assert case.snr[0] > case_by_snr.snr[0]
