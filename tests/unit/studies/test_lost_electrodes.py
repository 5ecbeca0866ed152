"""The limit of the channels that are left, when electrodes are lost."""

from types import SimpleNamespace

import numpy as np
import pytest

from authors_strengths import EFFECTS, FORCES
from eitskin.exported.electrodes import using
from eitskin.limit.observation import Experiment
from eitskin.limit.posterior_mean import Starts
from eitskin.physics.protocol import channel_table
from eitskin.physics.skin import Skin
from studies import lost_electrodes

CHANNELS = channel_table(8)
SKIN = Skin(80.0, 3.0, 0.5, tuple(45.0 * np.arange(8)), 0.0, 0.0, 1e-3, 0.9)


@pytest.fixture(scope="module")
def model():
    experiment = Experiment(SKIN, CHANNELS, "train", EFFECTS, 0.01, 1, 72.0, 16.0, FORCES, 10.0)
    return experiment.unknown()


def test_the_limit_knows_nothing_of_channels_that_are_lost(model):
    change = model.mixing @ model.change(np.array([30.0, -12.0, 5.0]), np.zeros(10))[0]
    harmed = change.copy()
    harmed[np.flatnonzero(using(CHANNELS, (2,)))] = 1e3
    starts = Starts(model)
    found = lost_electrodes.limit(model, starts, np.array([change]), (2,))
    assert np.array_equal(found, lost_electrodes.limit(model, starts, np.array([harmed]), (2,)))
    whole = lost_electrodes.limit(model, starts, np.array([change]), ())
    assert np.abs(found - whole).max() < 8.0 and not np.allclose(found, whole, rtol=1e-6)


def test_a_set_whose_samples_have_no_likelihood_has_no_limit():
    config = {
        "touch_grid": {"outer": 0.9, "probe_mm": 16.0},
        "forces": FORCES,
        "skin": {"radius_mm": 80.0},
        "configurations": {"authors": {"effects": [], "session_frames": 1}},
    }
    for name in ("simulated-authors", "another-skin"):
        data = SimpleNamespace(metadata={"name": name})
        assert lost_electrodes.model_of(data, config) is None
