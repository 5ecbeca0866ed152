"""Controls: repeatable, and the truth is what is in the recording."""

import numpy as np
import pandas as pd
import pytest

from eitskin.data import recording
from eitskin.errors import InputError
from witness import controls
from witness.alien_errors import FORMS
from witness.controls import KINDS, QUANTITIES, draw
from witness.press import Press

SEED = 3


@pytest.fixture(scope="module")
def drawn():
    return {kind: draw(f"control:{kind}", SEED, "disc") for kind in KINDS}


@pytest.mark.parametrize("kind", KINDS)
def test_a_recording_can_be_read_and_repeats_bit_for_bit(drawn, kind):
    control, repeated = drawn[kind], draw(f"control:{kind}", SEED, "disc")
    recording.validate(control.recorded, kind)
    assert np.array_equal(control.recorded.readings, repeated.recorded.readings)
    pd.testing.assert_frame_equal(control.recorded.frames, repeated.recorded.frames)
    assert (control.common, control.unlabelled) == (repeated.common, repeated.unlabelled)
    assert control.generator == "disc" and control.kind == f"control:{kind}"


@pytest.mark.parametrize("percent", controls.WHITE_PERCENT)
def test_nulls_have_the_noise_that_they_say(drawn, percent):
    control = drawn[f"white-{percent}"]
    frames, voltage = control.recorded.frames, control.recorded.readings
    untouched = voltage[~frames["touch"].to_numpy(bool)]
    noise = untouched.std(axis=0, ddof=1).mean() / np.median(np.abs(untouched))
    assert control.level == 1e-2 * float(percent)
    assert noise == pytest.approx(control.level, rel=0.5)
    assert control.effects == [] and control.rig == ()


def test_a_frame_is_one_or_the_mean_of_many(drawn):
    for kind, fewest, most in (("single-frame", 1, 1), ("averaged-frames", 2, 100)):
        control = drawn[kind]
        assert control.recorded.readings.shape == (1, 208)
        assert not control.recorded.frames["touch"].any()
        assert fewest <= control.averaged <= most


@pytest.mark.parametrize("rig", ["white", "alien"])
def test_a_press_says_nothing_where_it_is_unlabelled(drawn, rig):
    control = drawn[f"unlabelled-{rig}"]
    frames, voltage = control.recorded.frames.set_index("frame"), control.recorded.readings
    assert bool(control.rig) == (rig == "alien") and control.effects == []
    for stretch in control.unlabelled:
        said = frames.loc[stretch.first : stretch.last]
        assert not said["touch"].any() and (said["force_N"] == 0.0).all()
        assert said[["x_mm", "y_mm", "probe_mm", "contact"]].isna().all(axis=None)
        assert len(stretch.snr) == len(said) and max(stretch.snr) > 8.0
        off = np.linalg.norm(voltage - voltage[0], axis=1)
        strongest = stretch.first + int(np.argmax(stretch.snr))
        assert off[strongest] > off[stretch.first - 1]


def test_a_common_part_is_in_proportion_to_the_rig_s_own():
    for kind in ("common-place", "common-force-zero", "common-force-factor"):
        common = draw(f"control:{kind}", 5, "disc").common
        values = np.array(list(common.parameters.values()))
        amount = np.linalg.norm(np.log(values) if kind.endswith("factor") else values)
        assert 0.19 <= amount / common.own <= 10.1


@pytest.mark.parametrize("kind", QUANTITIES)
def test_the_rig_has_an_error_of_the_quantity(drawn, kind):
    assert FORMS[drawn[kind].rig[0].kind].on in QUANTITIES[kind].on


@pytest.mark.parametrize("kind", QUANTITIES)
def test_states_that_are_put_right_are_those_of_the_skin(monkeypatch, kind):
    """Without noise and own errors: readings are those of the states that the truth says."""
    monkeypatch.setattr(controls, "ALIEN_LEVELS", (1e-9, 1e-9))
    monkeypatch.setattr(controls, "_rig", lambda rng, on: [])
    plain = controls.replace(QUANTITIES[kind], error=lambda *states: 0.1)  # a scale without errors
    monkeypatch.setitem(controls.KINDS, kind, lambda *given: controls._common(plain, *given))
    control = draw(f"control:{kind}", SEED, "disc")
    frames, parameters = control.recorded.frames.copy(), control.common.parameters
    touched = frames["touch"].to_numpy(bool)
    for _, press in frames[touched].groupby("contact"):
        rows, time = press.index, press["time_s"].to_numpy()
        if kind == "common-place":
            frames.loc[rows, "x_mm"] += parameters["dx_mm"]
            frames.loc[rows, "y_mm"] += parameters["dy_mm"]
        elif kind == "common-force-zero":
            frames.loc[rows, "force_N"] += parameters["offset_N"]
        elif kind == "common-force-factor":
            frames.loc[rows, "force_N"] *= parameters["ratio"]
        elif kind == "delay-force":
            force = Press.from_reports(time, press["force_N"].to_numpy(), 0.0, 0.0)
            frames.loc[rows, "force_N"] = [force.force(t + parameters["lag_s"]) for t in time]
        else:
            for key in ("x_mm", "y_mm"):
                speed = np.polyfit(time, press[key], 1)[0]
                frames.loc[rows, key] += speed * parameters["delay_s"]
    world = controls.cases.draw(
        f"control:{kind}", SEED, names=[], generator="disc", levels=(1e-9, 1e-9)
    ).world
    voltage = control.recorded.readings
    assert voltage == pytest.approx(world.readings(frames, []), rel=1e-5, abs=1e-12)
    assert np.abs(voltage / world.readings(control.recorded.frames, []) - 1.0).max() > 1e-5


def test_a_pair_is_far_above_the_noise(drawn):
    control = drawn["strong-pair"]
    assert len(control.effects) == 2 == len({effect["name"] for effect in control.effects})
    assert all(400.0 <= snr <= 1500.0 for snr in control.snr)


@pytest.mark.parametrize("kind", ["control:grey", "owner:white-1"])
def test_an_unknown_kind_is_refused(kind):
    with pytest.raises(InputError, match="controls: kind"):
        draw(kind, 1)


def test_a_rig_s_own_error_of_a_delay_is_in_seconds(drawn):
    for kind, keys in (("delay-pose", ["x_mm", "y_mm"]), ("delay-force", ["force_N"])):
        control = drawn[kind]
        frames, common = control.recorded.frames, control.common
        assert 0.05 <= next(iter(common.parameters.values())) <= 0.5
        step = frames.groupby("contact")[["time_s", *keys]].diff().dropna()
        rate = np.median(np.abs(step[keys].to_numpy() / step[["time_s"]].to_numpy()))
        assert 0.0 < common.own < 3.0 * FORMS[control.rig[0].kind].size * 3.0 / rate
