"""Excerpts of long recordings: whole presses, from all of it."""

import numpy as np
import pytest

from eitskin.data.recording import presses
from eitskin.diagnose.fitting.excerpt import excerpt, excerpt_mask
from eitskin.diagnose.search import staging
from small_skin import problem_of, small_recording


def test_a_short_recording_is_itself(make_recording):
    recorded = make_recording(presses=5)
    assert excerpt(recorded, 40) is recorded


@pytest.mark.parametrize("most", [20, 60, 110])
def test_presses_are_whole_and_from_everywhere(make_recording, most):
    recorded = make_recording(presses=30)
    recorded.frames.loc[recorded.frames.index[33], "force_N"] = 11.0
    few = excerpt(recorded, most)
    assert 0.5 * most < len(few.frames) < 1.4 * most
    at = few.frames["frame"].to_numpy()
    assert (np.diff(at) > 0).all()
    assert np.array_equal(few.voltage, recorded.voltage[at])
    assert np.array_equal(few.frames["time_s"], recorded.frames["time_s"][at])
    press, own = presses(recorded)[at], presses(few)
    assert ((press < 0) == (own < 0)).all()
    for label in set(press[press >= 0]):
        assert (presses(recorded) == label).sum() == (press == label).sum()
        assert len(set(own[press == label])) == 1
    assert len(set(own[own >= 0])) == len(set(press[press >= 0]))
    assert few.frames["force_N"].max() == 11.0
    if most > 20:
        assert press.min() == -1 and {0, 29} <= set(press)
        assert at[0] == 0 and at[-1] == len(recorded.frames) - 1


def test_untouched_recordings_are_thinned(make_recording):
    recorded = make_recording(presses=0)
    few = excerpt(recorded, 6)
    assert len(few.frames) == 6 and few.frames["frame"].iloc[[0, -1]].tolist() == [0, 14]


def test_optional_columns_follow(full_recording):
    few = excerpt(full_recording, 15)
    at = few.frames["frame"].to_numpy()
    assert np.array_equal(few.quadrature, full_recording.quadrature[at])
    assert few.touches == [full_recording.touches[row] for row in at]
    assert few.frames["session"].tolist() == full_recording.frames["session"][at].tolist()


def test_an_excerpt_can_be_cut_again():
    once = excerpt(small_recording(places=6), 20)
    assert len(excerpt(once, 12).frames) < len(once.frames) < 34


def test_noise_lasts_by_the_numbers_of_the_frames():
    """Of an excerpt, and where it is thinned again."""
    once = excerpt(small_recording(places=6), 20)
    problem, _ = problem_of(once)
    assert np.array_equal(problem.whitening.frame_number, once.frames["frame"])
    assert (np.diff(problem.whitening.frame_number) > 1).any()
    _, search, _ = staging.prepared(once, 1)
    few = staging._on_frames(search, once, excerpt_mask(once, 12), 1, 1.0).problem.whitening
    assert np.array_equal(few.frame_number, excerpt(once, 12).frames["frame"])
    assert few.mask.shape[0] == len(few.frame_number) < len(problem.whitening.frame_number)
