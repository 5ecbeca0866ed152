"""Every effect: does nothing at its neutral value, and what its equation says elsewhere."""

import numpy as np
import pandas as pd
import pytest

from eitskin.effects import EFFECTS, stage_of
from eitskin.effects.effect import STAGES
from eitskin.effects.settings import settings
from eitskin.errors import InputError
from eitskin.forward import Forward
from eitskin.geometry import Geometry
from eitskin.protocol import channel_table
from eitskin.simulate import apply_instrument, apply_skin, apply_touch, site_counts

CHANNELS = channel_table(16)
COUNTS = site_counts(CHANNELS)
FORCES = np.array([0.0, 2.0, 10.0])
GEOMETRY = Geometry(80.0, 3.0, 0.5, np.arange(16) * 22.5, 5.0, 1e-3)
VOLTAGE = np.random.default_rng(2).normal(1.0, 0.3, (3, 208))
GIVEN = {"domain-shape": {"harmonic": 2}, "electrode-width": {"width_mm": 5.0}}


def one(name, draw=(0, 0), **item):
    return settings([{"name": name, **item}], COUNTS, draw)


def transfer(chosen, minutes=0.0):
    return Forward(apply_skin(GEOMETRY, chosen, minutes), "train").transfer()


@pytest.mark.parametrize("name", EFFECTS)
def test_at_its_neutral_value_it_does_nothing(name):
    chosen = one(name, parameters=GIVEN.get(name, {}))
    touches = pd.DataFrame({"contrast": FORCES, "force_N": FORCES})
    pd.testing.assert_frame_equal(apply_touch(touches, chosen), touches)
    assert np.allclose(transfer(chosen, 30.0), transfer([]), rtol=0, atol=1e-9)
    assert np.allclose(apply_instrument(VOLTAGE, chosen, CHANNELS, FORCES), VOLTAGE, rtol=1e-14)


@pytest.mark.parametrize("name", EFFECTS)
def test_it_says_what_it_is(name):
    effect = EFFECTS[name]
    assert effect.name == name and stage_of(name) in STAGES and effect.source
    assert effect.sites in (None, "electrodes", "drives", "measures", "channels")
    assert type(effect).__doc__
    for parameter in effect.parameters.values():
        assert parameter.low < parameter.high
        assert parameter.neutral is None or parameter.low <= parameter.neutral <= parameter.high


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
    found = apply_instrument(VOLTAGE, chosen, CHANNELS, FORCES)
    assert np.allclose(found, expected, rtol=1e-13)


def test_the_middle_force_is_half_the_largest_unless_given():
    found = apply_instrument(
        VOLTAGE, one("force-dependent-gain", parameters={"per_N": 0.01}), CHANNELS, FORCES
    )
    assert np.allclose(found / VOLTAGE, (1 + 0.01 * (FORCES - 5.0))[:, None])


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
            Forward(apply_skin(points, chosen), "train").voltages(CHANNELS)
            for chosen in (exact, first, [])
        )
        return np.abs(ellipse - sum_of_three).max(), np.abs(ellipse - plain).max()

    (large, _), (small, effect) = difference(0.04), difference(0.02)
    assert small < 0.2 * effect
    assert 3.0 < large / small < 5.0


def test_sites():
    chosen = one("contact-impedance", electrodes=[7], parameters={"ratio": 2.1})
    impedivity = apply_skin(GEOMETRY, chosen).contact_impedivity_ohm_m2
    assert impedivity[7] == pytest.approx(2.1e-3)
    assert np.count_nonzero(impedivity != 1e-3) == 1


def test_drifts_follow_the_clock():
    chosen = one("conductivity-drift", parameters={"per_minute": 0.01})
    assert apply_skin(GEOMETRY, chosen, 3.0).conductivity_S_per_m == pytest.approx(0.515)
    chosen = one("contact-drift", electrodes=[2], parameters={"per_minute": 0.01})
    moved = apply_skin(GEOMETRY, chosen, 3.0)
    assert moved.contact_impedivity_ohm_m2[2] == pytest.approx(1.03e-3)


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
