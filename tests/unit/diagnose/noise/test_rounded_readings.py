"""A converter with steps wider than the noise: an error of the rig, no physics without a name."""

from dataclasses import replace

import numpy as np
import pytest

from eitskin.diagnose import diagnosis
from eitskin.diagnose.verdict import conclusion
from small_skin import small_recording


def rounded(recorded, step):
    """A recording read in steps, of the median |v|, and a step's width."""
    width = step * np.median(np.abs(recorded.voltage))
    return replace(recorded, voltage=width * np.round(recorded.voltage / width)), width


@pytest.mark.parametrize(("noise", "step"), [(1e-4, 6e-4), (5e-5, 3e-4)])
def test_coarse_steps_are_the_converter_s(noise, step):
    """Channels of a symmetric skin that read alike are rounded alike, in every frame."""
    recorded, width = rounded(small_recording(noise=noise, places=4), step)
    found = diagnosis.diagnose(recorded)
    said = conclusion.document(found, "rounded")
    assert said["effects"] == []
    assert found.remainder.p_value > 0.01 and found.remainder.probability < 0.1
    (size,) = (c["sd"] for c in said["noise"]["components"] if c["name"] == "quantisation")
    assert 1 / 1.5 < size / found.noise.rounding_sd < 1.5
    assert found.noise.converter_step == pytest.approx(width)


def test_an_effect_is_named_beside_coarse_steps():
    """Without it the fit is half a step off: the parts of the steps are those of another skin."""
    contact = {"name": "contact-impedance", "electrodes": [3], "parameters": {"ratio": 1.7}}
    recorded, _ = rounded(small_recording(contact, noise=1e-4, places=4), 6e-4)
    said = conclusion.document(diagnosis.diagnose(recorded), "rounded")
    assert [(e["name"], e["electrodes"]) for e in said["effects"]] == [("contact-impedance", [3])]
    (ratio,) = said["effects"][0]["parameters"].values()
    assert ratio["low"] <= 1.7 <= ratio["high"]
    assert said["other"]["probability"] < 0.1
