import numpy as np
import pytest

from eitskin.data.alignment import homogeneous_readings
from eitskin.physics.geometry import even_angles
from eitskin.physics.protocol import channel_table
from eitskin.physics.skin import Skin
from eitskin.simulate import untouched_frames

SKIN = Skin(80.0, 3.0, 0.5, tuple(even_angles(16)), 0.0, 0.0, 1e-3, 0.9)
CHANNELS = channel_table(16)
FORCE_N = np.array([2.0, 5.0, 8.0])
GAIN = {"name": "channel-gain", "parameters": {"gain": {"sd": 0.04, "tie": "mirror"}}}
FORCE_GAIN = {"name": "force-dependent-gain", "parameters": {"per_N": 0.01, "F_mid_N": 5.0}}
ELLIPSE = {"name": "ellipse", "parameters": {"sx": {"sd": 0.03}, "sy": {"sd": 0.03}}}


def frames(effects, kept, noise=0.0, sessions=3, session_frames=4, seed=1):
    plan = untouched_frames.Plan(sessions, session_frames, FORCE_N, "train", seed)
    return untouched_frames.frames(SKIN, CHANNELS, effects, kept, noise, plan)


def test_the_plain_skin_reads_as_the_closed_form():
    expected = homogeneous_readings(CHANNELS, even_angles(16)) * 1e-3 / (0.5 * 3e-3)
    found = frames([ELLIPSE, GAIN], [])
    assert found.shape == (12, 208)
    np.testing.assert_allclose(found, np.tile(expected, (12, 1)), rtol=1e-6)


def test_an_effect_has_the_same_draws_alone_as_among_others():
    effects = [ELLIPSE, GAIN, FORCE_GAIN]
    plain, on_skin = frames(effects, []), frames(effects, [ELLIPSE])
    gain = frames(effects, [GAIN]) / plain
    force = frames(effects, [FORCE_GAIN]) / plain
    np.testing.assert_allclose(frames(effects, effects), on_skin * gain * force, rtol=1e-12)
    np.testing.assert_allclose(gain, gain[:, ::-1], rtol=1e-12)


def test_each_session_has_draws_of_its_own_that_its_frames_share():
    found = frames([ELLIPSE, GAIN], [ELLIPSE, GAIN]).reshape(3, 4, 208)
    np.testing.assert_array_equal(found, np.repeat(found[:, :1], 4, axis=1))
    assert np.abs(found[0, 0] / found[1, 0] - 1.0).max() > 0.01


def test_each_frame_carries_the_gain_of_a_force():
    found = frames([FORCE_GAIN], [FORCE_GAIN], session_frames=30) / frames(
        [FORCE_GAIN], [], session_frames=30
    )
    np.testing.assert_allclose(np.unique(found.round(9)), [0.97, 1.0, 1.03])


def test_noise_is_relative_to_the_frame_s_median_and_the_seed_s():
    still, found = frames([], []), frames([], [], noise=0.02, sessions=30)
    size = np.std(found - still[0]) / np.median(np.abs(still[0]))
    assert size == pytest.approx(0.02, rel=0.03)
    np.testing.assert_array_equal(found, frames([], [], noise=0.02, sessions=30))
    assert not np.array_equal(found, frames([], [], noise=0.02, sessions=30, seed=2))
