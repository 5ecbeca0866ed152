"""A row of what the diagnosis says of a recording."""

import numpy as np
import pytest

from eitskin.data.recording import Recording
from proof.diagnosed import row


def test_names_candidates_and_misfits_over_the_readings():
    common = {"scope": "common", "parameters": {}}
    found = [
        common | {"name": "third-dimension", "alternatives": ["electrode-width"], "certain": False},
        common | {"name": "offset", "alternatives": []},
    ]
    held = {"rms_before_V": 0.4, "rms_after_V": 0.02}
    said = {
        "recording": "tank",
        "verdict": "partly-explained",
        "effects": found,
        "fit": {"held_out": held},
    }
    voltage = np.array([[2.0, -2.0, np.nan]])
    made = row(said, Recording(None, voltage, None, None, {}))
    assert made["said"] == "third-dimension?; offset"
    assert made["alternatives"] == "electrode-width; none"
    assert (made["before"], made["after"]) == (pytest.approx(0.2), pytest.approx(0.01))
