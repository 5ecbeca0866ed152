"""The two named accuracies keep their promise, on electrodes and on hard places and probes."""

import numpy as np
import pytest

from eitskin.physics import accuracy
from eitskin.physics.forward import Forward
from eitskin.physics.geometry import Geometry
from eitskin.physics.protocol import channel_table

CHANNELS = channel_table(16)
ANGLES = np.arange(16) * 22.5
SKINS = {
    "points": Geometry(80.0, 3.0, 0.5, ANGLES, 0.0, 0.0),
    "complete": Geometry(80.0, 3.0, 0.5, ANGLES, 5.0, 2e-3),
    "wide, good contact": Geometry(80.0, 3.0, 0.5, ANGLES, 14.0, 1e-4),
}


@pytest.mark.parametrize("skin", SKINS)
@pytest.mark.parametrize(("name", "bound"), [("train", 2e-4), ("diagnose", 2e-5)])
def test_untouched(skin, name, bound):
    limit, _ = accuracy.electrode_limit(SKINS[skin], CHANNELS)
    error = accuracy.untouched_error(SKINS[skin], CHANNELS, name)
    assert error.shape == (208,)
    assert np.sqrt((error**2).mean()) < bound * np.median(np.abs(limit))


@pytest.mark.parametrize("skin", SKINS)
@pytest.mark.parametrize(("name", "bound"), [("train", 5e-3), ("diagnose", 2e-4)])
@pytest.mark.parametrize("radius", [3.5, 7.5])
def test_touch_nearest_the_rim(skin, name, bound, radius):
    found, finest, usual = (
        Forward(SKINS[skin], fineness)
        .place(72.0, 0.0, radius)
        .channel_change(CHANNELS, accuracy.CONTRASTS)
        for fineness in (name, accuracy.FINEST, "diagnose")
    )
    size = np.linalg.norm(usual, axis=1)
    assert (np.linalg.norm(found - finest, axis=1) < bound * size).all()


def test_the_error_falls_at_the_order_told():
    _, order = accuracy.electrode_limit(SKINS["wide, good contact"], CHANNELS)
    assert 4 < order < 7
    assert np.isnan(accuracy.electrode_limit(SKINS["complete"], CHANNELS)[1])


def test_an_untouched_error_that_is_known_is_not_solved_again(monkeypatch):
    skin = SKINS["points"]
    first = accuracy.untouched_error(skin, CHANNELS, "train")
    kept = first.copy()
    first += 1.0
    monkeypatch.setattr(accuracy, "Forward", None)
    assert np.array_equal(accuracy.untouched_error(skin, CHANNELS, "train"), kept)
