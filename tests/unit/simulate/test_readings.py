"""Whole recordings: every stage in its place, each frame on the skin that it finds."""

import numpy as np
import pandas as pd
import pytest

from eitskin.effects import EFFECTS
from eitskin.effects.settings import settings, site_counts
from eitskin.errors import InputError
from eitskin.physics.forward import Forward, channel_values
from eitskin.physics.geometry import Geometry, Patch
from eitskin.physics.protocol import channel_table, reciprocal_channels
from eitskin.physics.skin import Skin
from eitskin.physics.solver import SolvedSkins, forward_model
from eitskin.physics.touch import Touch
from eitskin.simulate import readings
from eitskin.simulate.readings import simulate

CHANNELS = channel_table(16)
SKIN = Skin(80.0, 3.0, 0.5, tuple(22.5 * np.arange(16)), 5.0, 1e-3, 1e-3, 0.9)
BASE = Geometry.from_skin(SKIN)
PRESS = np.array([-1, 0, 0, 0, -1, 1])


def states(force=(0.0, 1.0, 4.0, 2.0, 0.0, 3.0)):
    touch = PRESS >= 0
    return pd.DataFrame(
        {
            "time_s": 60.0 * np.arange(6),
            "touch": touch,
            "x_mm": np.where(touch, [0, 30, 30, 30, 0, -20], np.nan),
            "y_mm": np.where(touch, [0, 10, 10, 10, 0, 40], np.nan),
            "force_N": force,
            "probe_mm": np.where(touch, 10.0, np.nan),
        }
    )


def run(*items, at=None, accuracy="train", skin=SKIN, **rest):
    chosen = settings(list(items), site_counts(CHANNELS), (0, 0))
    return simulate(states() if at is None else at, PRESS, skin, CHANNELS, chosen, accuracy, **rest)


def touches(row, contrast=None, radius=5.0):
    state = states().iloc[row]
    if not state["touch"]:
        return []
    contrast = 0.9 * state["force_N"] if contrast is None else contrast
    return [Touch(state["x_mm"], state["y_mm"], radius, contrast)]


def effect(name, **rest):
    sites = {key: rest.pop(key) for key in ("electrodes", "channels") if key in rest}
    return {"name": name, "parameters": rest, **sites}


def test_clean_frames_are_the_forward_model():
    expected = [1e-3 * Forward(BASE, "train").voltages(CHANNELS, touches(k)) for k in range(6)]
    assert np.allclose(run(), expected, rtol=1e-9)


def test_with_and_without_potentials_it_is_one_model():
    """Wiring that does nothing takes the way through whole transfer impedances."""
    swap = effect("electrode-swap", electrodes=[3, 9])
    assert np.allclose(run(swap, swap), run(), rtol=1e-9)


def test_each_frame_is_solved_at_its_own_time_and_force():
    drift = effect("conductivity-drift", per_minute=0.05)
    contacts = effect("force-dependent-impedance", per_N=0.3)
    found = run(drift, contacts)
    for k in range(6):
        geometry = BASE.with_values(
            conductivity_S_per_m=0.5 * (1 + 0.05 * k),
            contact_impedivity_ohm_m2=1e-3 * (1 + 0.3 * states()["force_N"][k]),
        )
        expected = 1e-3 * Forward(geometry, "train").voltages(CHANNELS, touches(k))
        assert np.allclose(found[k], expected, rtol=1e-9)


def test_the_true_force_is_what_everything_sees():
    items = [effect("force-dependent-impedance", per_N=0.3), effect("contact-law", exponent=0.5)]
    items.append(effect("force-dependent-gain", per_N=0.01, F_mid_N=2.0))
    raised = states(force=(0.0, 1.5, 4.5, 2.5, 0.0, 3.5))
    offset = effect("force-offset", offset_N=0.5)
    assert np.allclose(run(offset, *items), run(*items, at=raised), rtol=1e-12)


def test_the_middle_force_is_of_what_was_reported():
    offset, gain = effect("force-offset", offset_N=0.5), effect("force-dependent-gain", per_N=0.01)
    factor = run(offset, gain)[0] / run(offset)[0]
    assert factor == pytest.approx(1 - 0.01 * 2.0)
    assert run(gain, force_max_N=6.0)[0] / run()[0] == pytest.approx(1 - 0.01 * 3.0)


@pytest.mark.parametrize(
    "others",
    [
        [],
        [effect("contact-area-growth", exponent=0.25)],
        [effect("force-dependent-impedance", per_N=0.2, range_mm=40.0)],
        [effect("electrode-swap", electrodes=[3, 9])],
    ],
)
def test_skewed_channels_see_the_force_of_their_moment(others):
    found = run(effect("frame-skew", fraction=0.5), *others)
    step = np.array([0.0, 3.0, 0.5, -2.0, 0.0, 0.0])
    assert np.allclose(found[[0, 4, 5]], run(*others)[[0, 4, 5]], rtol=1e-12)
    for k in (0, 50, 133, 207):
        force = states()["force_N"] + 0.5 * step * (k / 207 - 0.5)
        expected = run(*others, at=states(force=force))
        touch = np.abs(expected[:, k] - expected[0, k]).max()
        assert np.abs(found[:, k] - expected[:, k]).max() < 1e-3 * touch


@pytest.mark.parametrize("fraction", [-1.0, 0.9])
def test_channels_before_a_press_see_no_force(fraction):
    """The press begins, or ends, within the frame: channels before see the skin untouched."""
    force = np.array([0.0, 1.0, 4.0, 0.3, 0.0, 3.0])
    found = run(effect("frame-skew", fraction=fraction), at=states(force=force))
    step = np.array([0.0, 3.0, -0.35, -3.7, 0.0, 0.0])
    begun = force[:, None] + fraction * step[:, None] * (np.arange(208) / 207 - 0.5)
    outside = (begun <= 0.0) & (force > 0.0)[:, None]
    assert outside.any(axis=1).tolist() == [False, True, False, True, False, False]
    touch = np.abs(found - found[0]).max(axis=1)
    for row, k in np.argwhere(outside):
        assert abs(found[row, k] - found[0, k]) < 1e-9 * touch[row]
    for k in range(0, 208, 9):
        expected = run(at=states(force=np.maximum(begun[:, k], 0.0)))
        assert np.all(np.abs(found[:, k] - expected[:, k]) <= 1e-3 * touch + 1e-12)


def test_the_gain_follows_the_force_of_the_moment():
    skew, gain = effect("frame-skew", fraction=0.5), effect("force-dependent-gain", per_N=0.01)
    factor = run(skew, gain, force_max_N=4.0)[1] / run(skew)[1]
    force = states()["force_N"][1] + 1.5 * (np.arange(208) / 207 - 0.5)
    assert factor == pytest.approx(1 + 0.01 * (force - 2.0))


def test_touches_multiply_the_patch():
    patch = {"x_mm": 28.0, "y_mm": 6.0, "radius_mm": 9.0, "contrast": 0.5}
    found = run(effect("conductivity-patch", **patch), accuracy="diagnose")
    forward = forward_model(BASE.with_values(patches=(Patch(**patch),)))
    for k in range(6):
        expected = 1e-3 * forward.voltages(CHANNELS, touches(k))
        assert np.allclose(found[k], expected, rtol=1e-9)


def test_the_common_mode_is_above_the_sink():
    found = run(effect("common-mode", ratio=0.01)) - run()
    source, sink, plus, minus = CHANNELS.T
    for k in (0, 2):
        impedance = Forward(BASE, "train").transfer_impedance(touches(k))
        pairs = [np.column_stack([source, sink, end, sink]) for end in (plus, minus)]
        mean = 0.5 * sum(channel_values(impedance, pair) for pair in pairs)
        assert found[k] == pytest.approx(1e-5 * mean, abs=1e-12)


def test_much_of_a_touch_s_common_mode_is_odd():
    added = run(effect("common-mode", ratio=0.01)) - run()
    change = added[2] - added[0]
    pairs, sign = reciprocal_channels(CHANNELS)
    first, second = change[pairs[:, 0]], sign * change[pairs[:, 1]]
    odd = np.sum((first - second) ** 2) / (2 * np.sum(first**2 + second**2))
    assert odd > 0.4


def test_a_point_electrode_s_potential_has_no_bound():
    points = Skin(80.0, 3.0, 0.5, SKIN.electrode_deg, 0.0, 0.0, 1e-3, 0.9)
    with pytest.raises(InputError, match="a width above 0"):
        run(effect("common-mode", ratio=0.01), skin=points)
    assert np.isfinite(run(effect("electrode-open", electrodes=[3]), skin=points)).all()


def test_a_touch_moved_off_the_skin_is_none():
    found = run(effect("registration", dx_mm=50.0, dy_mm=50.0, rotation_deg=45.0))
    assert np.array_equal(found[1], found[0])


def test_the_conductivity_stays_above_0():
    skin = Skin(80.0, 3.0, 0.5, SKIN.electrode_deg, 5.0, 1e-3, 1e-3, -0.4)
    expected = 1e-3 * Forward(BASE, "train").voltages(CHANNELS, touches(2, contrast=-0.999))
    assert np.allclose(run(skin=skin)[2], expected, rtol=1e-9)


def test_sharing_a_solved_skin_changes_nothing():
    near = Forward(BASE, "train")
    assert np.array_equal(run(solved_skin=near), run())


@pytest.mark.parametrize(
    ("name", "method"),
    [
        ("force-offset", "change"),
        ("probe-radius", "change"),
        ("conductivity-drift", "change"),
        ("electrode-open", "change"),
        ("ground-leak", "admittance"),
        ("offset", "change"),
        ("frame-skew", "force_shift"),
    ],
)
@pytest.mark.parametrize("made", [None, np.zeros(2)])
def test_an_effect_that_returns_something_else_is_refused(monkeypatch, name, method, made):
    monkeypatch.setattr(type(EFFECTS[name]), method, lambda *_: made)
    found = "NoneType" if made is None else r"ndarray\(2,\)"
    with pytest.raises(InputError, match=f"effect {name}: what it returns: found {found}, expec"):
        run(effect(name))


@pytest.mark.parametrize("key", ["force_N", "probe_mm", "x_mm"])
def test_a_touch_without_a_value_is_refused(key):
    at = states()
    at.loc[2, key] = np.nan
    with pytest.raises(InputError, match=f"column {key}, row 2: found null"):
        run(at=at)


DRIVEN = {
    "conductivity drifts": [effect("conductivity-drift", per_minute=0.004)],
    "contacts drift": [effect("contact-drift", per_minute=0.03)],
    "a contact drifts": [effect("contact-drift", electrodes=[3], per_minute=-0.005)],
    "contacts follow the force": [effect("force-dependent-impedance", per_N=0.03)],
    "contacts near a touch": [effect("force-dependent-impedance", per_N=0.02, range_mm=30.0)],
    "both": [
        effect("conductivity-drift", per_minute=1e-4),
        effect("force-dependent-impedance", per_N=0.003),
    ],
    "beside others": [
        effect("domain-shape", harmonic=3, amplitude=0.01),
        effect("conductivity-drift", per_minute=0.004),
        effect("frame-skew", fraction=0.2),
    ],
    "through the touch": [
        effect("conductivity-drift", per_minute=0.004),
        effect("indenter-grounding", siemens_per_N=1e-4),
    ],
}


def many_states(presses=3, frames=12):
    """Presses of many forces, a minute apart."""
    press = np.repeat(np.arange(presses), frames)
    force = np.tile(np.r_[0.0, np.linspace(0.5, 8.0, frames - 1)], presses)
    table = pd.DataFrame(
        {
            "time_s": 60.0 * np.arange(len(press)),
            "touch": force > 0,
            "x_mm": np.array([30.0, -20.0, 66.0])[press],
            "y_mm": np.array([10.0, 40.0, -5.0])[press],
            "force_N": force,
            "probe_mm": 10.0,
        }
    )
    return table, np.where(force > 0, press, -1)


@pytest.mark.parametrize("items", DRIVEN.values(), ids=DRIVEN)
def test_a_skin_that_changes_is_interpolated(items, monkeypatch):
    table, press = many_states()
    chosen = settings(items, site_counts(CHANNELS), (0, 0))
    solved = []
    monkeypatch.setattr(
        SolvedSkins,
        "solve",
        lambda self, *skin, solve=SolvedSkins.solve: solved.append(skin) or solve(self, *skin),
    )

    def values():
        solved.clear()
        found = simulate(table, press, SKIN, CHANNELS, chosen, "diagnose", frame_s=0.3)
        return found, len(solved)

    between, few = values()
    monkeypatch.setattr(readings, "FEW_SKINS", 10_000)
    exact, every = values()
    assert few < every
    assert np.abs(between - exact).max() < 1e-7 * np.median(np.abs(exact))


def test_contacts_that_change_too_much_are_solved_one_by_one(monkeypatch):
    table, press = many_states()
    chosen = settings(
        [effect("force-dependent-impedance", per_N=10.0, range_mm=30.0)],
        site_counts(CHANNELS),
        (0, 0),
    )
    found = simulate(table, press, SKIN, CHANNELS, chosen)
    monkeypatch.setattr(readings, "FEW_SKINS", 10_000)
    exact = simulate(table, press, SKIN, CHANNELS, chosen)
    assert np.allclose(found, exact, rtol=1e-12)
