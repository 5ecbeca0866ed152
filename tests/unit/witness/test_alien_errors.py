"""Errors of a rig in other forms: each is of its size, has no mean, and touches nothing else."""

from collections import Counter

import numpy as np
import pytest

from eitskin.data import recording
from eitskin.errors import InputError
from witness import alien_errors, rig_errors
from witness.alien_errors import FORMS, OPEN, SEALED, AlienError
from witness.cases import ALIEN_LEVELS, again, draw
from witness.rig_errors import MAX_SIZE, MIN_SIZE

OF_STATES = [kind for kind, form in FORMS.items() if form.usual.target == "states"]
OF_READINGS = [kind for kind, form in FORMS.items() if form.usual.target == "readings"]
ROUNDED = [kind for kind, form in FORMS.items() if form.course is None]
KEYS = ["x_mm", "y_mm", "force_N", "time_s"]
CHANNELS, SEEDS = 8, 200
# What grows, fades, is rare, or has lost its mean, is less over a whole recording than where it is
# as large as its size says.
LEAST, MOST = 0.1, 1.15


@pytest.fixture(scope="module")
def plain():
    """A case of a rig without errors."""
    return draw("null", 3)


@pytest.fixture(scope="module")
def clean():
    """Noise-free readings (M,) of 0.1 to 1 V."""
    return np.geomspace(0.1, 1.0, CHANNELS) * np.where(np.arange(CHANNELS) % 2, 1.0, -1.0)


def read_error(kind, size, seed, states, clean, noise_V=1e-3):
    """(N, M): what one error changes of readings, in the unit of its size."""
    frames = np.tile(clean, (len(states), 1))
    voltages = [
        alien_errors.read(
            frames, errors, states, np.full(CHANNELS, noise_V), np.random.default_rng(1)
        )
        for errors in ([AlienError(kind, size, seed)], [])
    ]
    unit = {"noise sd": noise_V, "median |v|": np.median(np.abs(clean)), "1": frames}
    return (voltages[0] - voltages[1]) / unit[FORMS[kind].usual.unit]


def state_error(kind, size, seed, states):
    """(N, 4): what one error changes of KEYS where touched, of forces as a share for a load cell;
    no force is close enough to 0 to be clipped."""
    states = states.assign(force_N=10.0 * states["force_N"])
    reported = alien_errors.reported(states, [AlienError(kind, size, seed)])
    change = (reported[KEYS] - states[KEYS])[states["touch"]].to_numpy(float)
    if FORMS[kind].on == "load-cell":
        change /= states.loc[states["touch"], ["force_N"]].to_numpy(float)
    return change


def error_of(kind, seed, plain, clean, factor=1.0):
    size = factor * FORMS[kind].size
    if kind in OF_STATES:
        return state_error(kind, size, seed, plain.states)
    return read_error(kind, size, seed, plain.states, clean)


def test_sizes_are_log_uniform_about_the_usual():
    rng = np.random.default_rng(1)
    for kind, form in FORMS.items():
        sizes = np.array([alien_errors.draw(rng, [kind])[0].size for _ in range(200)])
        low, high = MIN_SIZE * form.size, MAX_SIZE * form.size
        assert sizes.min() > 0.99 * low and sizes.max() < 1.01 * high
        quantiles = np.log(sizes / low) / np.log(high / low)
        assert abs(quantiles.mean() - 0.5) < 4.0 * np.sqrt(1 / 12 / 200)


def test_a_third_of_the_kinds_is_sealed_and_drawn_only_when_asked_for():
    assert len(FORMS) >= 24 and not set(FORMS) & set(rig_errors.USUAL)
    assert len(SEALED) == len(FORMS) // 3 and {*OPEN, *SEALED} == {*FORMS}
    assert not set(OPEN) & set(SEALED)
    rng = np.random.default_rng(1)
    for sealed in (False, True):
        drawn = [[e.kind for e in alien_errors.draw(rng, sealed=sealed)] for _ in range(600)]
        assert {*Counter(map(len, drawn))} == {1, 2, 3}
        assert all(len(set(kinds)) == len(kinds) for kinds in drawn)
        assert {kind for kinds in drawn for kind in kinds} == set(FORMS if sealed else OPEN)
        assert all(bool(set(kinds) & set(SEALED)) == sealed for kinds in drawn)


@pytest.mark.parametrize("kind", FORMS)
def test_it_changes_its_target_alone_and_the_same_at_each_call(plain, kind):
    errors = [AlienError(kind, FORMS[kind].size, 7)]
    states = alien_errors.reported(plain.states, errors)
    assert states.equals(plain.states) == (kind in OF_READINGS)
    args = errors, plain.states, plain.noise_V
    voltage, repeated = (
        alien_errors.read(plain.clean, *args, np.random.default_rng(1)) for _ in range(2)
    )
    np.testing.assert_array_equal(voltage, repeated)
    assert states.equals(alien_errors.reported(plain.states, errors))
    silent = rig_errors.read(plain.clean, [], plain.states, plain.noise_V, np.random.default_rng(1))
    assert np.array_equal(voltage, silent) == (kind in OF_STATES)
    for size in (MIN_SIZE, MAX_SIZE):
        errors = [AlienError(kind, size * FORMS[kind].size, 8)]
        states = alien_errors.reported(plain.states, errors)
        recorded = recording.Recording(states, voltage, None, None, plain.metadata)
        recording.validate(recorded, kind)
        untouched = ~plain.states["touch"]
        for key in KEYS[:3]:
            assert states[key][untouched].equals(plain.states[key][untouched])


@pytest.mark.parametrize("kind", sorted(set(FORMS) - set(ROUNDED)))
def test_it_is_in_proportion_to_its_size(plain, clean, kind):
    one, twice = (error_of(kind, 5, plain, clean, factor) for factor in (1.0, 2.0))
    assert np.abs(one).max() > 0.05 * FORMS[kind].size
    np.testing.assert_allclose(twice, 2.0 * one, rtol=1e-6, atol=1e-9 * FORMS[kind].size)
    if kind in OF_STATES:
        acts = {"place": [0, 1], "force": [2], "load-cell": [2], "clock": [3]}[FORMS[kind].on]
        assert np.abs(np.delete(one, acts, axis=1)).max() == 0.0


@pytest.mark.parametrize("kind", sorted(set(FORMS) - set(ROUNDED)))
def test_it_is_as_large_as_its_size_and_has_no_mean(plain, kind):
    touched = plain.states["touch"].to_numpy()
    acting = touched if kind in OF_STATES else np.ones(len(touched), bool)
    line = alien_errors.timeline(plain.states, acting)
    made = (AlienError(kind, 1.0, seed).course(line, CHANNELS) for seed in range(SEEDS))
    errors = np.array([course[acting] for course in made])
    assert LEAST < np.sqrt((errors**2).mean()) < MOST
    # Of some hundreds of numbers, which depend on each other, few are beyond 4 sd.
    sd = errors.std(axis=0) + 0.02
    assert (np.abs(errors.mean(axis=0)) < 4.5 * sd / np.sqrt(SEEDS)).mean() > 0.99
    if FORMS[kind].course.__name__ == "centred":
        assert np.abs(errors.mean(axis=1)).max() < 1e-9


@pytest.mark.parametrize("kind", ROUNDED)
def test_what_is_coarse_is_rounded(plain, kind):
    step = FORMS[kind].size
    reported = alien_errors.reported(plain.states, [AlienError(kind, step, 1)])
    keys = {"mm": ["x_mm", "y_mm"], "N": ["force_N"], "s": ["time_s"]}[FORMS[kind].usual.unit]
    steps = reported.loc[plain.states["touch"], keys].to_numpy(float) / step
    assert np.abs(steps - np.round(steps)).max() < 1e-6
    assert np.abs(reported[keys] - plain.states[keys]).max().max() <= 0.5 * step + 1e-9
    others = [key for key in KEYS if key not in keys]
    assert reported[others].equals(plain.states[others])


def test_rounding_comes_last(plain):
    errors = [AlienError(kind, FORMS[kind].size, 3) for kind in ("coarse-place", "backlash")]
    steps = alien_errors.reported(plain.states, errors)["x_mm"].dropna() / errors[0].size
    assert np.abs(steps - np.round(steps)).max() < 1e-6


@pytest.mark.parametrize("word", ["alien", "sealed"])
def test_cases_are_recorded_by_such_rigs(plain, word):
    case, repeated = draw(f"null+{word}", 3), draw(f"null+{word}", 3)
    np.testing.assert_array_equal(case.voltage, repeated.voltage)
    assert case.rig == repeated.rig and case.true_states.equals(plain.states)
    np.testing.assert_array_equal(case.clean, plain.clean)
    assert {type(error) for error in case.rig} == {AlienError}
    assert any(error.kind in SEALED for error in case.rig) == (word == "sealed")
    recording.validate(case.recorded, "case")
    (kind,) = {error.kind for error in again(plain, f"{word}:{case_kind(word)}", 1).rig}
    assert kind == case_kind(word)


def case_kind(word):
    return (SEALED if word == "sealed" else OPEN)[0]


def test_nulls_have_less_noise_and_other_cases_their_own(plain):
    levels = [draw(f"null+alien:{OPEN[0]}", seed, frames=40).level for seed in range(1, 13)]
    assert min(levels) >= ALIEN_LEVELS[0] and max(levels) <= ALIEN_LEVELS[1]
    assert min(levels) < 3e-4
    alien, bare = draw("single:offset+alien", 3, frames=40), draw("single:offset", 3, frames=40)
    assert alien.level == bare.level and alien.effects == bare.effects and alien.rig


def test_unknown_and_sealed_kinds_are_refused():
    for kind in ("alien:spikes", "sealed:spikes", f"alien:{SEALED[0]}", f"sealed:{OPEN[0]}"):
        with pytest.raises(InputError, match=rf"\+{kind}"):
            draw(f"null+{kind}", 1)
