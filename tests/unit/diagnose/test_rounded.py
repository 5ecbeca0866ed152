"""A converter with steps wider than the noise: an error of the rig, no physics without a name."""

from dataclasses import replace

import numpy as np
import pytest

from eitskin.diagnose import diagnosis, result
from small_skin import small_recording


@pytest.mark.parametrize(("noise", "step"), [(1e-4, 6e-4), (5e-5, 3e-4)])
def test_coarse_steps_are_the_converter_s(noise, step):
    """Channels of a symmetric skin that read alike are rounded alike, in every frame."""
    exact = small_recording(noise=noise, places=4)
    median = np.median(np.abs(exact.voltage))
    width = step * median
    recorded = replace(exact, voltage=width * np.round(exact.voltage / width))
    found = diagnosis.diagnose(recorded)
    said = result.result(found, "rounded")
    assert said["effects"] == []
    assert found.other.p_value > 0.01 and found.other.probability < 0.1
    (size,) = (c["sd"] for c in said["noise"]["components"] if c["name"] == "quantisation")
    assert 1 / 1.5 < size / found.noise.rounding < 1.5
    assert found.noise.step == pytest.approx(width)
