"""An effect that all presses share is no error of the rig's, however large it is."""

import numpy as np
import pytest

from eitskin.data.recording import presses
from eitskin.diagnose import diagnosis
from small_skin import small_recording

MOVED = {"dx_mm": -6.0, "dy_mm": 2.0, "rotation_deg": 0.0}


def test_touches_that_are_all_moved_are_registered_anew():
    """By twenty times what places are good to in one recording: all presses seem to be off, which
    errors of places, learned first, would explain."""
    recording = small_recording({"name": "registration", "parameters": MOVED}, noise=2e-4, places=8)
    found = diagnosis.diagnose(recording)
    (effect,) = found.explanation.effects
    assert effect.name == "registration"
    assert found.explanation.error_sds["place-per-press"] < 0.05
    (setting,) = found.explanation.fit.settings()
    values = {key: setting.values[key] for key in ("dx_mm", "dy_mm")}
    assert values == pytest.approx({"dx_mm": -6.0, "dy_mm": 2.0}, abs=0.1)


def test_touches_that_are_off_by_chance_are_the_robot_s():
    recording = small_recording(noise=2e-4, places=8)
    press = presses(recording)
    off = np.random.default_rng(2).normal(size=(press.max() + 1, 2))
    for axis, key in enumerate(("x_mm", "y_mm")):
        recording.frames.loc[press >= 0, key] += 0.5 * off[press[press >= 0], axis]
    found = diagnosis.diagnose(recording)
    assert not found.explanation.effects
    assert 0.3 < found.explanation.error_sds["place-per-press"] < 0.8
