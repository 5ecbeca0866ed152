"""Effects of the instrument, each against its definition written out."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eitskin.effects import EFFECTS
from eitskin.effects.effect import Frames
from eitskin.effects.settings import settings, site_counts
from eitskin.errors import InputError
from eitskin.physics.forward import Forward
from eitskin.physics.geometry import Geometry
from eitskin.physics.protocol import channel_table, reciprocal_channels
from eitskin.simulate.readings import apply_instrument

CHANNELS = channel_table(16)
SOURCE, SINK, PLUS, MINUS = CHANNELS.T
IMPEDANCE = Forward(
    Geometry(80.0, 3.0, 0.5, np.arange(16) * 22.5, 5.0, 1e-3, shape_cos={1: 0.02, 3: 0.01}), "train"
).transfer_impedance()
POTENTIAL = (IMPEDANCE[:, SOURCE] - IMPEDANCE[:, SINK]).T
AT = np.arange(208)
CLEAN = 1e-3 * (POTENTIAL[AT, PLUS] - POTENTIAL[AT, MINUS])
ABOVE_SINK = 1e-3 * (0.5 * (POTENTIAL[AT, PLUS] + POTENTIAL[AT, MINUS]) - POTENTIAL[AT, SINK])
VOLTAGE = CLEAN * np.array([1.0, 0.7, 1.2])[:, None]
TIME = np.array([0.0, 0.41, 0.9])
FRAMES = Frames(
    TIME,
    np.array([0.0, 2.0, 10.0]),
    CHANNELS,
    frame_s=0.35,
    force_max_N=10.0,
    above_sink_V=np.tile(ABOVE_SINK, (3, 1)),
)
PAIRS, SIGN = reciprocal_channels(CHANNELS)


def read(*items, voltage=VOLTAGE, frames=FRAMES):
    return apply_instrument(voltage, settings(list(items), site_counts(CHANNELS), (0, 0)), frames)


def item(name, **rest):
    sites = {key: rest.pop(key) for key in ("drives", "measures", "channels") if key in rest}
    return {"name": name, "parameters": rest, **sites}


def test_gains_of_drives_and_measures():
    found = read(item("drive-gain", drives=[3, 15], gain=[1.1, 0.9]))
    assert np.allclose(found, VOLTAGE * np.select([SOURCE == 3, SOURCE == 15], [1.1, 0.9], 1.0))
    found = read(item("measurement-gain", measures=[6], gain=1.2))
    assert np.allclose(found, VOLTAGE * np.where(PLUS == 6, 1.2, 1.0))
    found = read(item("channel-gain", channels=[17], gain=1.3))
    assert np.allclose(found, VOLTAGE * np.where(AT == 17, 1.3, 1.0))


def test_offset_of_measures_or_channels():
    found = read(item("offset", measures=[6, 9], volt=[1e-3, 2e-3]))
    added = np.select([PLUS == 6, PLUS == 9], [1e-3, 2e-3], 0.0)
    assert np.allclose(found, VOLTAGE + added, rtol=1e-12, atol=0)
    found = read(item("offset", channels=[100], volt=1e-3))
    assert np.allclose(found, VOLTAGE + np.where(AT == 100, 1e-3, 0.0), rtol=1e-12, atol=0)
    assert np.allclose(read(item("offset", volt=1e-3)), VOLTAGE + 1e-3, rtol=1e-12, atol=0)


@pytest.mark.parametrize("name", [n for n, e in EFFECTS.items() if "channels" in e.sites])
def test_a_slope_is_what_the_value_of_a_channel_changes_there(name):
    effect, step = EFFECTS[name], 1e-6
    ((key, parameter),) = effect.parameters.items()
    for k in AT:
        up, down = (
            read(item(name, channels=[k], **{key: parameter.neutral + side}))
            for side in (step, -step)
        )
        change = (up - down)[:, k] / (2.0 * step)
        assert effect.slope(VOLTAGE)[:, k] == pytest.approx(change, rel=1e-6), k


@given(st.floats(-0.9, 0.9))
def test_memory_is_the_recursion_that_closes(mu):
    found = read(item("multiplexer-memory", mu=mu))
    for v, y in zip(VOLTAGE, found, strict=True):
        last = y[-1]
        for k in range(208):
            last = (1 - mu) * v[k] + mu * last
            assert y[k] == pytest.approx(last, abs=1e-14)


def test_converter():
    assert read(item("adc-nonlinearity", cubic=40.0)) == pytest.approx(VOLTAGE + 40.0 * VOLTAGE**3)
    limit = np.quantile(np.abs(VOLTAGE), 0.8)
    found = read(item("adc-nonlinearity", limit_V=limit))
    inside = np.abs(VOLTAGE) <= limit
    assert np.array_equal(found[inside], VOLTAGE[inside]) and 0.7 < inside.mean() < 0.9
    assert np.array_equal(found[~inside], (limit * np.sign(VOLTAGE))[~inside])


def test_mains_at_the_moment_of_each_channel():
    found = read(item("mains-interference", frequency_Hz=50.0, volt=1e-3, phase_deg=30.0))
    for n, k in ((0, 0), (1, 77), (2, 207)):
        moment = TIME[n] + k * 0.35 / 208
        tone = 1e-3 * np.sin(2 * np.pi * 50.0 * moment + np.pi / 6)
        assert found[n, k] - VOLTAGE[n, k] == pytest.approx(tone, abs=1e-12)
    with pytest.raises(InputError, match="frame_s: found null"):
        unknown = Frames(TIME, FRAMES.force_N, CHANNELS)
        read(item("mains-interference", frequency_Hz=50.0, volt=1e-3), frames=unknown)


def test_common_mode():
    found = read(item("common-mode", ratio=0.01))
    assert found == pytest.approx(VOLTAGE + 0.01 * ABOVE_SINK)


def test_the_order_is_the_instrument_s():
    items = [
        item("adc-nonlinearity", cubic=30.0),
        item("mains-interference", frequency_Hz=50.0, volt=1e-3),
        item("offset", measures=[3], volt=1e-3),
        item("multiplexer-memory", mu=0.05),
        item("crosstalk", epsilon=0.03),
        item("force-dependent-gain", per_N=0.01),
        item("channel-gain", channels=[5], gain=1.1),
        item("measurement-gain", measures=[5], gain=1.1),
        item("drive-gain", drives=[5], gain=1.1),
        item("common-mode", ratio=0.01),
    ]
    expected = VOLTAGE
    for one in reversed(items):
        expected = read(one, voltage=expected)
    assert read(*items) == pytest.approx(expected, rel=1e-12)
    assert read(*items[::-1]) == pytest.approx(expected, rel=1e-12)


def odd_share(change):
    """Of the energy in reciprocal pairs, the part that changes sign."""
    first, second = change[PAIRS[:, 0]], SIGN * change[PAIRS[:, 1]]
    return np.sum((first - second) ** 2) / (2 * np.sum(first**2 + second**2))


@pytest.mark.parametrize(
    ("one", "low", "high"),
    [
        (item("drive-gain", drives=[3], gain=1.1), 0.499, 0.501),
        (item("measurement-gain", measures=[3], gain=1.1), 0.499, 0.501),
        (item("channel-gain", channels=[3], gain=1.1), 0.499, 0.501),
        (item("offset", channels=[3], volt=1e-3), 0.499, 0.501),
        (item("offset", volt=1e-3), 0.0, 1e-12),
        (item("drive-gain", gain=1.1), 0.0, 1e-12),
        (item("force-dependent-gain", per_N=0.01), 0.0, 1e-12),
        (item("adc-nonlinearity", cubic=30.0), 0.0, 1e-12),
        (item("adc-nonlinearity", limit_V=0.02), 0.0, 1e-12),
        (item("multiplexer-memory", mu=0.05), 0.4, 0.9),
        (item("crosstalk", epsilon=0.03), 0.01, 0.3),
        (item("common-mode", ratio=0.01), 0.001, 0.1),
    ],
)
def test_reciprocity(one, low, high):
    """A clean skin is even; what the instrument adds is as odd as its definition makes it."""
    assert CLEAN[PAIRS[:, 0]] == pytest.approx(SIGN * CLEAN[PAIRS[:, 1]])
    change = read(one)[1] - VOLTAGE[1]
    assert low <= odd_share(change) <= high


def test_every_effect_of_the_instrument_is_here():
    names = {name for name, effect in EFFECTS.items() if effect.stage == "instrument"}
    assert names == {
        "drive-gain",
        "measurement-gain",
        "channel-gain",
        "force-dependent-gain",
        "offset",
        "crosstalk",
        "common-mode",
        "multiplexer-memory",
        "adc-nonlinearity",
        "mains-interference",
    }
