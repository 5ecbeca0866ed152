"""The witness's bodies against sheets, themselves and the tool's depth modes."""

import numpy as np
import pytest
from scipy.special import iv, ivp, kv, kvp

from eitskin.physics.forward import channel_values
from eitskin.physics.geometry import Geometry
from eitskin.physics.protocol import channel_table
from eitskin.physics.solver import forward_model
from witness.boundary import Body, Disc
from witness.curves import Shape
from witness.deep import DeepBody, Depth, Waves

N, R_MM, WIDTH_MM = 16, 60.0, 6.0
DEG = 22.5 * np.arange(N)
CHANNELS = channel_table(N)
LENGTH = np.full(N, 1.0 / R_MM)


def volts(admittance: np.ndarray) -> np.ndarray:
    impedance = np.linalg.inv(0.5 * (admittance + admittance.T) + 1.0)
    return channel_values(impedance, CHANNELS)


def test_bessel_functions():
    k, r = 6.0, np.array([[0.3], [0.9]])
    waves = Waves(k, 30)
    m = waves.m
    assert waves.product == pytest.approx(iv(m, k) * kv(m, k), rel=1e-12)
    assert waves.flux == pytest.approx(iv(m, k) / (k * ivp(m, k)), rel=1e-12)
    assert waves.image == pytest.approx(-kvp(m, k) / ivp(m, k) * iv(m, k) ** 2, rel=1e-12)
    value, slope = waves.inside(r.ravel())
    assert value == pytest.approx(iv(m, k * r) / iv(m, k), rel=1e-11)
    assert slope == pytest.approx(k * ivp(m, k * r) / iv(m, k), rel=1e-11)


def test_electrodes_of_full_height_make_a_sheet():
    disc = Disc(30.0, 20.0, 7.5)
    deep = DeepBody(Shape(R_MM), DEG, np.full(N, WIDTH_MM), Depth(12.0, 12.0, 6.0), 10.0)
    flat = Body(Shape(R_MM), DEG, np.full(N, WIDTH_MM), 10.0)
    admittances = [b.place([disc]).admittance(b.contact(LENGTH), [2.0]) for b in (deep, flat)]
    assert np.abs(admittances[0] - admittances[1]).max() < 1e-6 * np.abs(admittances[1]).max()


@pytest.mark.long
def test_partial_height_agrees_with_the_tool():
    """1e-6 of the median untouched; a touch in the middle, that the electrodes' spread in depth
    does not reach, to 1e-4 of its change."""
    touch = Disc(10.0, 5.0, 7.5)
    deep = DeepBody(Shape(R_MM), DEG, np.full(N, WIDTH_MM), Depth(10.0, 5.0, 4.0), 20.0)
    contact, place = deep.contact(LENGTH), deep.place([touch])
    mine = [volts(5e-3 * place.admittance(contact, [c])) for c in (0.0, 2.0)]
    geometry = Geometry(
        R_MM,
        10.0,
        0.5,
        DEG,
        WIDTH_MM,
        2e-3,
        electrode_height_mm=5.0,
        electrode_z_mm=4.0,
        deep=True,
    )
    tool = forward_model(geometry, "diagnose", None)
    modes = tool.place(touch.x_mm, touch.y_mm, touch.radius_mm)
    theirs = channel_values(tool.transfer_impedance(), CHANNELS)
    change = modes.channel_change(CHANNELS, np.array([2.0]))[0]
    assert np.abs(mine[0] - theirs).max() < 2e-6 * np.median(np.abs(theirs))
    assert np.abs(mine[1] - mine[0] - change).max() < 1e-4 * np.abs(change).max()


def test_near_a_touch_depth_is_felt_and_stays_reciprocal():
    deep = DeepBody(Shape(R_MM), DEG, np.full(N, WIDTH_MM), Depth(20.0, 10.0, 5.0, 16, 8.0), 4.0)
    contact = deep.contact(LENGTH)
    place = deep.place([Disc(48.0, 0.0, 7.5)])
    admittance = place.admittance(contact, [3.0])
    assert np.abs(admittance - admittance.T).max() < 1e-5 * np.abs(admittance).max()
    flat = place.parts[0]
    place.parts[1:] = [
        (among, 0.0 * from_moments, 0.0 * to_electrodes)
        for among, from_moments, to_electrodes in place.parts[1:]
    ]
    place._cached = None
    alone = place.admittance(contact, [3.0])
    assert flat is place.parts[0]
    assert np.abs(admittance - alone).max() > 1e-4 * np.abs(admittance).max()


def test_refuses_what_is_no_disc():
    shape = Shape(R_MM, {2: 0.1})
    with pytest.raises(ValueError, match="round rim"):
        DeepBody(shape, DEG, np.full(N, WIDTH_MM), Depth(12.0, 12.0, 6.0))
