"""The limit of the channels that are left, when electrodes are lost."""

from types import SimpleNamespace

import numpy as np
import pytest

from authors_strengths import EFFECTS, FORCES
from benchmark import lost_electrodes
from eitskin.exported.electrodes import channels_using
from eitskin.limit.observation import Experiment
from eitskin.limit.posterior_mean import Starts
from eitskin.physics.protocol import channel_table
from eitskin.physics.skin import Skin

CHANNELS = channel_table(8)
SKIN = Skin(80.0, 3.0, 0.5, tuple(45.0 * np.arange(8)), 0.0, 0.0, 1e-3, 0.9)


@pytest.fixture(scope="module")
def model():
    experiment = Experiment(SKIN, CHANNELS, "train", EFFECTS, 0.01, 1, 72.0, 16.0, FORCES, 10.0)
    return experiment.prior_session()


def test_the_limit_knows_nothing_of_channels_that_are_lost(model):
    change = model.mixing @ model.change(np.array([30.0, -12.0, 5.0]), np.zeros(10))[0]
    harmed = change.copy()
    harmed[np.flatnonzero(channels_using(CHANNELS, (2,)))] = 1e3
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


def test_every_set_has_touches_of_its_own_and_all_channels_as_many_as_single_electrodes():
    sets = lost_electrodes.sets_of(8)
    assert [len(lost) for lost in sets].count(2) == min(lost_electrodes.PAIRS, 28)
    rows = lost_electrodes.rows_of(np.arange(500, 900), sets, 20)
    assert [len(own) for own in rows] == [160, *[20] * (len(sets) - 1)]
    tested = np.arange(500, 1500)
    rows = lost_electrodes.rows_of(tested, sets, 20)
    together = np.concatenate(rows)
    assert len(set(together)) == len(together) == 160 + 20 * (len(sets) - 1)
    assert all(map(np.array_equal, rows, lost_electrodes.rows_of(tested, sets, 20)))
    again = np.concatenate(lost_electrodes.rows_of(tested[:100], sets, 20))
    times = np.unique(again, return_counts=True)[1]
    assert len(times) == 100 and times.max() - times.min() <= 1


def test_sets_of_one_size_are_told_together(monkeypatch):
    """Estimates twice as far off as the limit, of which the intervals hold half."""
    rng = np.random.default_rng(1)
    truth = rng.normal(size=(60, 3))
    off = {"one": rng.normal(size=(60, 3))}

    def errors(predictor, change, lost):
        at = change[:, 0].astype(int)
        half = np.where(at[:, None] % 2 == 0, np.inf, 0.0) * np.ones(3)
        return truth[at] + 2.0 * off["one"][at], half

    def limit(model, starts, change, lost):
        at = change[:, 0].astype(int)
        return truth[at] + off["one"][at]

    monkeypatch.setattr(lost_electrodes, "errors", errors)
    monkeypatch.setattr(lost_electrodes, "limit", limit)
    monkeypatch.setattr(lost_electrodes, "Starts", lambda model: "starts")
    sets = [(), (0,), (1,), (0, 1)]
    rows = [np.arange(20), np.arange(20, 30), np.arange(30, 40), np.arange(40, 60)]
    touches = lost_electrodes.Touches(np.arange(60.0)[:, None], truth, np.arange(60) // 4)
    found = lost_electrodes.table(None, touches, sets, rows, object())
    found = found.set_index("lost")
    assert list(found.index) == ["none", "0", "1", "0 1", "one", "two"]
    assert list(found["touches"]) == [20, 10, 10, 20, 20, 20]
    for key in ("rmse_F_N", "rmse_place_mm", "median_place_mm"):
        for part in ("", "_low", "_high"):
            assert np.allclose(found[f"times_{key}{part}"], 2.0)
    assert (found["held_x"] == 0.5).all()
    together = np.sqrt(np.mean((2.0 * off["one"][20:40, 2]) ** 2))
    assert found.loc["one", "rmse_F_N"] == pytest.approx(together)
    plain = lost_electrodes.table(None, touches, sets, rows)
    assert not any("times" in name for name in plain.columns)
