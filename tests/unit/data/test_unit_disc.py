"""A skin as the disc onto which it maps: its readings are those of the forward model."""

import numpy as np
import pytest

from eitskin.data import alignment, unit_disc
from eitskin.errors import InputError
from eitskin.physics.forward import Forward
from eitskin.physics.geometry import Geometry
from eitskin.physics.protocol import channel_table
from eitskin.physics.skin import Skin

OUTLINE = {"shape": "rectangle", "width_mm": 120.0, "height_mm": 70.0}
SHARES = tuple(((np.arange(12) + 0.4) / 12).tolist())
CHANNELS = channel_table(12)


def skin(**values):
    stated = dict.fromkeys(("radius_mm", "electrode_deg", "electrode_width_mm"))
    stated |= {"thickness_mm": 3.0, "conductivity_S_per_m": 0.5, "contact_impedivity_ohm_m2": None}
    return Skin.from_metadata({**stated, "current_A": 1.0, "contrast_per_N": None, **values})


def test_readings_and_sensitivities_are_those_of_the_outline():
    rectangle = skin(outline=OUTLINE, electrode_s=SHARES, electrode_width_mm=0.0)
    disc = unit_disc.unit_disc(rectangle)
    forward = Forward(Geometry.from_skin(rectangle), "diagnose")
    resistance = forward.geometry.sheet_resistance_ohm
    expected = forward.voltages(CHANNELS)
    readings = resistance * alignment.homogeneous_readings(CHANNELS, disc.electrode_deg)
    np.testing.assert_allclose(readings, expected, rtol=1e-6, atol=1e-8 * np.abs(expected).max())
    place, radius = 24.0 + 11.0j, 0.2
    image, slope = disc.mapped(np.array([place]))
    change = forward.place(place.real, place.imag, radius).channel_change(
        CHANNELS, np.array([1e-3])
    )
    sensitivity = alignment.sensitivity(CHANNELS, disc.electrode_deg, image)[0] * slope**2
    slopes = resistance * sensitivity * np.pi * radius**2 * 1e-3
    np.testing.assert_allclose(slopes, change.ravel(), rtol=5e-3, atol=5e-3 * np.abs(change).max())


def test_a_disc_is_itself():
    angles = [90.0 * k for k in range(4)]
    disc = unit_disc.unit_disc(skin(radius_mm=80.0, electrode_deg=angles))
    image, slope = disc.mapped(np.array([40.0j]))
    assert (
        disc.electrode_deg.tolist() == angles == unit_disc.electrode_deg(skin(electrode_deg=angles))
    )
    assert image[0] == 0.5j and slope[0] == 1.0 / 80.0


def test_electrodes_without_places_have_no_angles():
    assert unit_disc.electrode_deg(skin(radius_mm=80.0)) is None
    with pytest.raises(
        InputError, match="electrode_deg: found null, expected the electrodes' angles"
    ):
        unit_disc.unit_disc(skin(radius_mm=80.0))
