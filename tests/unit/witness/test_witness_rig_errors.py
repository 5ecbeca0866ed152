"""Errors of a rig: each is what it says, of the size it says, and touches nothing else."""

import numpy as np
import pytest

from eitskin.data import recording
from eitskin.errors import InputError
from witness import rig_errors
from witness.cases import draw
from witness.rig_errors import MAX_SIZE, MIN_SIZE, USUAL, RigError

OF_STATES = [kind for kind, usual in USUAL.items() if usual.target == "states"]
OF_READINGS = [kind for kind, usual in USUAL.items() if usual.target == "readings"]
FRAMES, CHANNELS = 4000, 40
NOISE_V = np.full(CHANNELS, 1e-5)


@pytest.fixture(scope="module")
def plain():
    """A case of a rig without errors."""
    return draw("null", 3)


@pytest.fixture(scope="module")
def long(plain):
    """States of many frames, made of the case's, and noise-free readings of 0.1 to 1 V."""
    times = -(-FRAMES // len(plain.states))
    states = plain.states.loc[np.tile(np.arange(len(plain.states)), times)[:FRAMES]]
    states = states.reset_index(drop=True).assign(time_s=np.arange(FRAMES, dtype=float))
    size = np.geomspace(0.1, 1.0, CHANNELS) * np.where(np.arange(CHANNELS) % 2, 1.0, -1.0)
    return states, np.tile(size, (FRAMES, 1))


def read(long, *kinds, size=None, noise_V=NOISE_V):
    states, clean = long
    errors = [RigError(kind, size or USUAL[kind].size, 7) for kind in kinds]
    voltage = rig_errors.read(clean, errors, states, noise_V, np.random.default_rng(1))
    return voltage, voltage - clean


def test_sizes_are_log_uniform_about_the_usual():
    rng = np.random.default_rng(1)
    for kind, usual in USUAL.items():
        sizes = np.array([rig_errors.draw(rng, [kind])[0].size for _ in range(400)])
        low, high = MIN_SIZE * usual.size, MAX_SIZE * usual.size
        if kind == "correlated-noise":
            low, high = rig_errors.CORRELATIONS
        assert sizes.min() > 0.99 * low and sizes.max() < 1.01 * high
        quantiles = np.log(sizes / low) / np.log(high / low)
        assert abs(quantiles.mean() - 0.5) < 4.0 * np.sqrt(1 / 12 / 400)


def test_one_to_three_kinds_are_drawn():
    rng = np.random.default_rng(1)
    drawn = [[error.kind for error in rig_errors.draw(rng)] for _ in range(300)]
    assert {len(kinds) for kinds in drawn} == {1, 2, 3}
    assert all(len(set(kinds)) == len(kinds) for kinds in drawn)
    assert {kind for kinds in drawn for kind in kinds} == set(USUAL)


@pytest.mark.parametrize("kind", USUAL)
def test_the_same_case_is_recorded_by_another_rig(plain, kind):
    case = draw(f"null+rig:{kind}", 3)
    assert case.believed == plain.believed and case.query.equals(plain.query)
    np.testing.assert_array_equal(np.abs(case.clean), np.abs(plain.clean))
    assert case.states.equals(plain.states) == (kind in OF_READINGS)
    is_same = np.array_equal(case.voltage, plain.voltage, equal_nan=True)
    assert is_same == (kind in OF_STATES)
    recorded = recording.Recording(case.states, case.voltage, None, None, case.metadata)
    recording.validate(recorded, "case")
    repeated = draw(f"null+rig:{kind}", 3)
    np.testing.assert_array_equal(repeated.voltage, case.voltage)


def test_a_rig_without_errors_has_white_noise(long):
    _, noise = read(long)
    assert noise.std() == pytest.approx(1e-5, rel=0.02)
    assert abs((noise[1:] * noise[:-1]).mean()) < 4.0 * 1e-10 / np.sqrt(noise.size)


def test_correlated_noise_keeps_its_sd_and_remembers(long):
    _, noise = read(long, "correlated-noise", size=0.9)
    assert noise.std() == pytest.approx(1e-5, rel=0.05)
    lag = (noise[1:] * noise[:-1]).mean() / noise.var()
    assert lag == pytest.approx(0.9, abs=0.01)
    between = np.corrcoef(noise[:, ::5].T)
    assert np.abs(between[np.triu_indices(8, 1)]).max() < 0.35


@pytest.mark.parametrize(
    ("kind", "size"), [("amplitude-per-frame", 5e-4), ("common-noise", 5e-4 * 0.32)]
)
def test_a_frame_s_error_is_one_for_all_channels(long, kind, size):
    voltage, change = read(long, kind, noise_V=np.zeros(CHANNELS))
    relative = voltage / long[1] - 1.0 if kind == "amplitude-per-frame" else change
    assert np.ptp(relative, axis=1).max() < 1e-9
    assert relative.std() == pytest.approx(size, rel=0.1)


@pytest.mark.parametrize(("kind", "channels"), [("gain-walk", 1), ("channel-drift", CHANNELS)])
def test_walks_begin_at_nought_and_grow(long, kind, channels):
    ends = []
    for seed in range(60):
        error = RigError(kind, 1e-3, seed)
        no_noise = np.zeros(CHANNELS), np.random.default_rng(1)
        walk = rig_errors.read(long[1], [error], long[0], *no_noise) / long[1] - 1.0
        assert np.abs(walk[0]).max() < 1e-12
        ends.append(walk[-1, 0] * (1.0 if channels == 1 else np.abs(long[1][0, 0]) / 0.3187))
    assert np.std(ends) == pytest.approx(1e-3, rel=0.3)


def test_what_is_rare_is_as_rare_as_it_says(long):
    _, loud = read(long, "loud-frames", size=0.01)
    assert (np.abs(loud).max(axis=1) > 1e-4).sum() == pytest.approx(40, abs=4)
    _, spikes = read(long, "spikes", size=1e-3)
    assert (np.abs(spikes) > 1e-3).mean() == pytest.approx(1e-3, rel=0.3)
    voltage, _ = read(long, "lost-readings", size=0.01)
    assert np.isnan(voltage).mean() == pytest.approx(0.01, rel=0.1)


def test_steps_and_magnitudes(long):
    voltage, _ = read(long, "quantisation", size=1e-3)
    median = np.median(np.abs(long[1][0]))
    assert np.allclose(voltage / (1e-3 * median), np.round(voltage / (1e-3 * median)), atol=1e-6)
    voltage, _ = read(long, "quadrature", size=2e-2, noise_V=np.zeros(CHANNELS))
    ratio = voltage[0] / np.abs(long[1][0])
    across = np.sqrt(ratio**2 - 1.0)
    assert (voltage > 0).all() and np.sqrt((across**2).mean()) == pytest.approx(0.02, rel=0.4)


@pytest.mark.parametrize("kind", OF_STATES)
def test_states_are_told_off_by_their_size_where_touched(long, kind):
    states, _ = long
    reported = rig_errors.reported(states, [RigError(kind, USUAL[kind].size, 7)])
    touched = states["touch"].to_numpy()
    for key in ("x_mm", "y_mm", "force_N"):
        errors = (reported[key] - states[key])[touched]
        assert reported[key][~touched].equals(states[key][~touched])
        is_moved = key.endswith("mm") == kind.startswith("place")
        assert bool(errors.abs().max() > 0) == is_moved
        if is_moved and kind.endswith("frame"):
            assert errors.std() == pytest.approx(USUAL[kind].size, rel=0.1)
        if is_moved and kind.endswith("press"):
            by_press = errors.groupby(states["contact"][touched])
            scale = states["force_N"][touched] if key == "force_N" else 1.0
            spread = (errors / scale).groupby(states["contact"][touched]).std()
            assert spread.max() < 1e-9 and by_press.ngroups > 5


def test_unknown_kinds_are_refused():
    with pytest.raises(InputError, match=r"\+rig:tides"):
        draw("null+rig:tides", 1)
    with pytest.raises(InputError, match=r"\+rigs"):
        draw("null+rigs", 1)
