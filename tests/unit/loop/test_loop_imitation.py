import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eitskin.data.recording import Recording, presses
from eitskin.errors import InputError
from eitskin.simulate.imitation import PressPrior, imitated_presses
from loop_skin import FORCES
from small_skin import FORCES_N, METADATA, states


def pressed(seed: int, sessions: int = 2, frames: pd.DataFrame | None = None) -> pd.DataFrame:
    recorded = Recording(states() if frames is None else frames, None, None, None, METADATA)
    return imitated_presses(
        recorded, sessions, np.random.default_rng(seed), PressPrior(FORCES, 9.0)
    )


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_presses_keep_their_shape_at_other_places_and_of_other_strength(seed):
    imitated = pressed(seed)
    recorded_states = states()
    touched = recorded_states["touch"].to_numpy()
    reach = np.hypot(recorded_states["x_mm"], recorded_states["y_mm"])[touched].max() + 4.0
    places = set()
    for _, press in imitated[imitated["touch"]].groupby(["session", "contact"]):
        np.testing.assert_allclose(
            press["force_N"] / press["force_N"].max(), np.array(FORCES_N) / max(FORCES_N)
        )
        np.testing.assert_allclose(np.diff(press["time_s"]), 2.0)
        assert press["probe_mm"].unique().tolist() == [8.0]
        assert press[["x_mm", "y_mm"]].drop_duplicates().shape[0] == 1
        x, y = press[["x_mm", "y_mm"]].iloc[0]
        assert np.hypot(x, y) + 4.0 <= reach + 1e-9
        untouched_row = press.index[0] - 1
        assert not imitated["touch"][untouched_row] and imitated["force_N"][untouched_row] == 0.0
        places.add((x, y))
    assert len(places) == 12
    for _, session in imitated.groupby("session"):
        assert session["time_s"].iloc[0] == 0.0 and (np.diff(session["time_s"]) > 0).all()
    labels = presses(Recording(imitated, None, None, None, METADATA))
    assert labels.max() == 11 and ((labels >= 0) == imitated["touch"]).all()


def test_the_largest_forces_lie_between_the_recording_s_and_repeat_for_a_seed():
    frames = states()
    press = presses(Recording(frames, None, None, None, METADATA))
    frames["force_N"] *= np.where(press >= 0, 0.5 + 0.1 * press, 0.0)
    imitated = pressed(3, 8, frames)
    peak = imitated[imitated["touch"]].groupby(["session", "contact"])["force_N"].max()
    assert 4.0 <= peak.min() < 4.7 and 7.3 < peak.max() <= 8.0
    assert peak.nunique() == len(peak)
    pd.testing.assert_frame_equal(imitated, pressed(3, 8, frames))
    assert not imitated.equals(pressed(4, 8, frames))


def test_what_nobody_measured_is_drawn_or_given():
    frames = states()
    frames.loc[frames["touch"], ["force_N", "probe_mm"]] = np.nan
    imitated = pressed(1, 20, frames)
    touched = imitated[imitated["touch"]]
    assert touched["probe_mm"].unique().tolist() == [9.0]
    force = touched.groupby(["session", "contact"])["force_N"]
    assert (force.nunique() == 1).all()
    assert 4.0 < force.first().mean() < 6.0 and force.first().max() <= 10.0


def test_a_touch_without_a_place_is_refused():
    frames = states()
    frames.loc[frames["touch"], "x_mm"] = np.nan
    with pytest.raises(InputError, match="unknown place"):
        pressed(1, 2, frames)
