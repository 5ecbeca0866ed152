"""Averages of successive frames: their values, their frames, what they leave out."""

from dataclasses import replace

import numpy as np
import pytest

from eitskin.data.averages import LEAST_FRAMES, averages
from small_skin import small_recording


def recorded(values):
    """A recording of untouched frames with readings (N, M)."""
    frames = small_recording(places=4).frames
    base = small_recording(places=4)
    untouched = np.flatnonzero(~frames["touch"].to_numpy(bool))[0]
    table = frames.iloc[[untouched] * len(values)].reset_index(drop=True)
    table = table.assign(frame=np.arange(len(values)), time_s=0.1 * np.arange(len(values)))
    return replace(base, frames=table, voltage=values, quadrature=None, touches=None)


def drawn(count, seed=1):
    channel_count = len(small_recording(places=4).channels)
    return np.random.default_rng(seed).normal(1.0, 1e-3, (count, channel_count))


def test_averages_are_means_of_blocks_at_their_middle_frames():
    values = drawn(12)
    part = averages(recorded(values), 3)
    assert np.allclose(part.voltage, values.reshape(3, 4, -1).mean(axis=1), rtol=0, atol=1e-12)
    assert part.frames["frame"].tolist() == [2, 6, 10]
    assert part.frames["time_s"].tolist() == pytest.approx([0.2, 0.6, 1.0])


def test_noise_of_averages_is_smaller_by_the_root_of_their_frames():
    part = averages(recorded(drawn(6 * 25)), 6)
    assert part.voltage.std() == pytest.approx(1e-3 / np.sqrt(25), rel=0.1)


def test_readings_that_stand_out_and_lost_ones_are_left_out():
    values = drawn(24)
    values[5, 3], values[9, 2] = 2.0, np.nan
    values[:6, 7] = np.nan
    part = averages(recorded(values), 4)
    rest = np.delete(values[:6, 3], 5)
    assert part.voltage[0, 3] == pytest.approx(rest.mean(), abs=1e-15)
    assert part.voltage[1, 2] == pytest.approx(np.nanmean(values[6:12, 2]), abs=1e-15)
    assert np.isnan(part.voltage[0, 7]) and np.isfinite(part.voltage[1:, 7]).all()


def test_sessions_are_not_averaged_together():
    values = drawn(12)
    two_sessions = recorded(values)
    session = np.where(np.arange(12) < 7, "before", "after")
    two_sessions = replace(two_sessions, frames=two_sessions.frames.assign(session=session))
    part = averages(two_sessions, 3)
    assert part.frames["session"].tolist() == ["before", "before", "after"]
    assert np.allclose(part.voltage[1], values[4:7].mean(axis=0), rtol=0, atol=1e-12)


def test_too_few_frames_are_refused():
    with pytest.raises(ValueError, match="7 frames are too few for 2 averages"):
        averages(recorded(drawn(2 * LEAST_FRAMES - 1)), 2)
