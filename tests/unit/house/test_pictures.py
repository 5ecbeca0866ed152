"""The pictures of the catalogue: of every effect one, in a frame in which it shows."""

import numpy as np
import pytest

from eitskin.effects import EFFECTS
from manual import pictures


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_shows_where_it_is_drawn(name):
    effect = EFFECTS[name]
    shown = pictures.picture(effect)
    assert np.isfinite(shown.change).all() and np.abs(shown.change).max() > 1e-6
    touched = "a probe of" in shown.caption
    assert touched or (effect.stage not in ("touch", "clock") and effect.driver != "force")
    assert shown.of_touch == (np.abs(shown.comparison).min() < 1e-3)
    for key, parameter in effect.parameters.items():
        assert f"`{key}` = " in shown.caption or parameter.optional


def test_what_comes_with_time_is_drawn_where_it_has_come():
    said = {name: pictures.picture(EFFECTS[name]).caption for name in EFFECTS}
    assert "an hour after the first frame" in said["conductivity-drift"]
    assert "has held 8 N for 30 s" in said["relaxation"]
    assert "back at 4 N after 8 N" in said["hysteresis"]
    assert "the force rising" in said["force-lag"]
    assert "untouched." in said["offset"] and "sink is at ground" in said["ground-leak"]


def test_a_picture_is_the_same_each_time_and_has_two_scales(monkeypatch, tmp_path):
    monkeypatch.setattr(pictures, "EFFECTS", {"offset": EFFECTS["offset"]})
    for folder in ("first", "second"):
        pictures.write(tmp_path / folder)
    (first,), (second,) = ((tmp_path / one).iterdir() for one in ("first", "second"))
    assert first.name == "offset.png" and first.read_bytes() == second.read_bytes()
    left, right, *scales = pictures.draw(pictures.picture(EFFECTS["offset"])).axes
    assert [bar.get_xlabel() for bar in scales] == ["mV", "µV"]
    low, high = right.collections[0].get_clim()
    assert low == -high and left.collections[0].get_clim()[0] > 0
