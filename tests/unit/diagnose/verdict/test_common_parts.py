"""What all presses share of their errors, against presses that were moved."""

import numpy as np
import pytest

from eitskin.data.recording import presses
from eitskin.diagnose.fitting.linearisation import linearised_rig_errors
from eitskin.diagnose.search.refits import calibrated
from eitskin.diagnose.search.staging import prepared
from eitskin.diagnose.verdict.common_parts import common_parts
from small_skin import small_recording

SHIFT_MM, SCATTER_MM = np.array([0.4, -0.2]), 0.3


@pytest.fixture(scope="module")
def parts():
    """Of recordings whose presses are off by chance and all by SHIFT_MM."""
    found = []
    for seed in range(4):
        recording = small_recording(places=8, seed=seed)
        rng = np.random.default_rng([seed, 1])
        press = presses(recording)
        off = SHIFT_MM + SCATTER_MM * rng.standard_normal((press.max() + 1, 2))
        touched = press >= 0
        for axis, key in enumerate(("x_mm", "y_mm")):
            recording.frames.loc[touched, key] -= off[press[touched], axis]
        _, search, _ = prepared(recording, 1)
        search, calibration = calibrated(search)
        rig = linearised_rig_errors(calibration.fit, search.problem.whitening, 0.0)
        found.append(common_parts(calibration.fit, rig)["place-per-press"])
    return found


def test_the_interval_has_the_chance_mean_of_presses_in_it(parts):
    """Some 0.1 mm of eight presses that are off by 0.3 mm: far more than noise would have."""
    for part in parts:
        low, value, high = (np.array(part[key]) for key in ("low", "value", "high"))
        assert ((low < value) & (value < high)).all()
        half = 0.5 * (high - low)
        assert (half > 0.05).all() and (half < 0.5).all()
        assert (np.abs(value - SHIFT_MM) < 3.0 * half).all()
