"""Several sheets at once are each as Forward has it, on NumPy, on PyTorch and on a GPU, if any."""

import numpy as np
import pytest
import torch

from eitskin.errors import InputError
from eitskin.physics import sheets
from eitskin.physics.accuracy import CONTRASTS
from eitskin.physics.forward import Forward
from eitskin.physics.geometry import Geometry, Patch
from eitskin.physics.protocol import channel_table
from eitskin.physics.sheets import Sheets

CHANNELS = channel_table(16)
BASE = Geometry(80.0, 3.0, 0.5, np.arange(16) * 22.5, 5.0, 1e-3)
SKINS = [
    BASE,
    BASE.with_values(
        shape_cos={2: 0.02}, shape_sin={3: -0.01}, anisotropy_ratio=1.2, anisotropy_deg=30.0
    ),
    BASE.with_values(
        electrode_deg=BASE.electrode_deg + np.linspace(0.0, 3.0, 16),
        contact_impedivity_ohm_m2=np.linspace(1e-4, 5e-3, 16),
        conductivity_S_per_m=0.7,
        stretch_x=1.04,
    ),
]
PLACES = np.array(
    [(0.0, 0.0, 5.0), (30.0, 41.0, 7.5), (-71.0, 0.0, 5.0), (5.0, -60.0, 2.0), (76.0, 5.0, 5.0)]
)
DEVICES = [None, "cpu", *["cuda"] * torch.cuda.is_available()]


def alone(geometry: Geometry, places: np.ndarray, accuracy: str) -> np.ndarray:
    """(P, F, M): as Forward has it."""
    modes = Forward(geometry, accuracy).places([tuple(place) for place in places.tolist()])
    return np.array([one.channel_change(CHANNELS, CONTRASTS) for one in modes])


def here(found) -> np.ndarray:
    """What lies on a device."""
    return found.cpu().numpy() if isinstance(found, torch.Tensor) else found


def assert_close(found, expected: np.ndarray, tolerance: float) -> None:
    """Of each place and contrast, over channels."""
    found = here(found)
    size = np.linalg.norm(expected, axis=-1)
    assert (np.linalg.norm(found - expected, axis=-1) < tolerance * size).all()


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize(("accuracy", "tolerance"), [("train", 2e-4), ("diagnose", 1e-6)])
def test_they_are_each_as_alone(accuracy, tolerance, device):
    """To the accuracy: a place has on all skins the multipoles that it needs on one."""
    several = Sheets(SKINS, accuracy, device)
    found = several.channel_change(PLACES, CHANNELS, CONTRASTS)
    expected = np.array([alone(geometry, PLACES, accuracy) for geometry in SKINS])
    assert_close(found, expected, tolerance)
    untouched = np.array([Forward(g, accuracy).voltages(CHANNELS) for g in SKINS])
    off = np.abs(here(several.voltages(CHANNELS)) - untouched).max(axis=1)
    assert (off < tolerance * np.median(np.abs(untouched), axis=1)).all()


@pytest.mark.parametrize("device", DEVICES)
def test_a_skin_by_itself_is_forward_to_rounding(device):
    found = Sheets(SKINS[1:2], "train", device).channel_change(PLACES, CHANNELS, CONTRASTS)
    assert_close(found[0], alone(SKINS[1], PLACES, "train"), 1e-11)


@pytest.mark.parametrize("device", DEVICES)
def test_every_skin_has_places_of_its_own(device):
    own = np.array([PLACES[:3], PLACES[[1, 4, 0]], PLACES[2:]])
    found = Sheets(SKINS, "train", device).channel_change(own, CHANNELS, CONTRASTS)
    expected = [
        alone(geometry, places, "train") for geometry, places in zip(SKINS, own, strict=True)
    ]
    assert_close(found, np.array(expected), 2e-4)


@pytest.mark.parametrize("device", DEVICES)
def test_on_very_anisotropic_skins_they_are_as_alone(device):
    several = [BASE.with_values(anisotropy_ratio=ratio) for ratio in (1.0, 3.0)]
    places = np.array([(65.0, 0.0, 5.0), (0.0, 65.0, 5.0), (20.0, 20.0, 5.0)])
    found = Sheets(several, "train", device).channel_change(places, CHANNELS, CONTRASTS)
    finest = np.array([alone(geometry, places, "diagnose") for geometry in several])
    assert_close(found, finest, 1e-3)


@pytest.mark.parametrize("device", DEVICES)
def test_a_node_on_the_rim_of_one_skin_does_no_harm(device):
    several = [BASE.with_values(radius_mm=radius_mm) for radius_mm in (72.0, 80.0)]
    places = np.array([(67.0, 0.0, 5.0)])
    found = Sheets(several, "train", device).channel_change(places, CHANNELS, CONTRASTS)
    expected = np.array([alone(geometry, places, "train") for geometry in several])
    assert_close(found, expected, 1e-9)


@pytest.mark.parametrize("places", [(0.0, 0.0, 5.0), np.zeros((2, 4, 3)), [(0.0, 5.0)]])
def test_places_of_another_shape_are_told(places):
    with pytest.raises(InputError, match="shape of the places"):
        Sheets(SKINS).channel_change(places, CHANNELS, CONTRASTS)


def test_few_at_a_time_are_those_of_all(monkeypatch):
    whole = Sheets(SKINS).channel_change(PLACES, CHANNELS, CONTRASTS)
    monkeypatch.setattr(sheets, "CORE_BYTES", 1)
    parts = Sheets(SKINS).channel_change(PLACES, CHANNELS, CONTRASTS)
    assert_close(parts, whole, 1e-13)


def test_results_stay_where_they_were_found():
    found = Sheets(SKINS[:1], device="cpu").channel_change(PLACES[:1], CHANNELS, CONTRASTS)
    assert isinstance(found, torch.Tensor) and found.dtype == torch.float64


@pytest.mark.parametrize(
    ("other", "told"),
    [
        (BASE.with_values(gradient_across=0.1), "gradient_across"),
        (BASE.with_values(patches=(Patch(0.0, 0.0, 9.0, 2.0),)), "patch"),
        (BASE.with_values(deep=True, electrode_height_mm=2.0), "deep"),
        (BASE.with_values(electrode_width_mm=0.0), "electrode_width_mm"),
        (
            BASE.with_values(
                electrode_deg=np.arange(8) * 45.0,
                electrode_width_mm=np.full(8, 5.0),
                contact_impedivity_ohm_m2=np.full(8, 1e-3),
            ),
            "8, 16",
        ),
    ],
)
def test_what_they_cannot_be_is_told(other, told):
    with pytest.raises(InputError, match=told):
        Sheets([BASE, other])


@pytest.mark.parametrize(
    ("place", "told"), [((200.0, 0.0, 5.0), "200"), ((0.0, 0.0, -1.0), "radius_mm")]
)
def test_a_place_that_cannot_be_is_told(place, told):
    with pytest.raises(InputError, match=told):
        Sheets(SKINS).channel_change([(0.0, 0.0, 5.0), place], CHANNELS, CONTRASTS)
