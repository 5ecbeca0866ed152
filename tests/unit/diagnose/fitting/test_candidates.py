"""Candidates' coordinates: 0 does nothing, values as the definitions have them, and back."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eitskin.diagnose.fitting.candidates import is_discrete, log_subset_count, without_site
from eitskin.effects.settings import settings, site_counts
from small_skin import CHANNELS, candidates_of, kinds_of, problem_of, small_recording

RECORDED = small_recording(places=2)
PROBLEM, SCALES = problem_of(RECORDED)
CANDIDATES = candidates_of(RECORDED, PROBLEM, SCALES)
# `tones` finds the frequency of mains, without which it is nothing yet.
KINDS = [c for c in kinds_of(CANDIDATES) if c.size and c.name != "mains-interference"]


def label(candidate):
    return f"{candidate.name} {candidate.kind} {candidate.scope} {candidate.start}"


@pytest.fixture(scope="module")
def untouched_by_effects():
    return PROBLEM.model.voltage(np.zeros(1), [])


def test_every_name_that_this_skin_can_have_is_there():
    names = {c.name for c in CANDIDATES}
    assert {"electrode-swap", "conductivity-drift", "offset", "anisotropy"} <= names
    assert not names & {"ellipse", "third-dimension"}
    assert len({c.key for c in CANDIDATES}) == len(CANDIDATES)


def test_effects_of_time_need_a_clock():
    timeless = candidates_of(RECORDED, PROBLEM, SCALES, timed=False)
    gone = {c.name for c in CANDIDATES} - {c.name for c in timeless}
    assert {"conductivity-drift", "contact-drift", "relaxation", "force-lag"} <= gone
    assert all(c.effect.driver != "time" for c in timeless)


@pytest.mark.parametrize(
    "candidate", [c for c in KINDS if not is_discrete(c) and c.linear.any()], ids=label
)
def test_zero_does_nothing_and_one_does_something(candidate, untouched_by_effects):
    still = PROBLEM.model.voltage(np.zeros(1), [candidate.setting(np.zeros(candidate.size))])
    scale = np.median(np.abs(untouched_by_effects))
    assert np.abs(still - untouched_by_effects).max() < 1e-9 * scale
    moved = candidate.setting(0.1 * candidate.linear)
    change = np.abs(PROBLEM.model.voltage(np.zeros(1), [moved]) - still).max()
    if candidate.name == "indenter-grounding":  # the only leak of a floating source
        assert change < 1e-9 * scale
    else:
        assert change > 1e-8 * scale


@given(st.sampled_from(KINDS), st.integers(0, 10**6))
def test_the_configuration_has_the_same_values(candidate, seed):
    coordinates = np.random.default_rng(seed).uniform(-1, 1, candidate.size)
    setting, item = candidate.setting(coordinates), candidate.item(coordinates)
    (again,) = settings([item], site_counts(CHANNELS), (0, 0))
    assert again.effect is setting.effect
    for key, value in setting.values.items():
        if value is not None:
            given_back = np.broadcast_to(again.values[key], np.shape(value))
            assert np.array_equal(given_back, np.asarray(value)), key
    if setting.sites is not None:
        assert again.sites.tolist() == setting.sites.tolist() and again.kind == setting.kind


@given(st.sampled_from([c for c in KINDS if c.effect.polar is None]), st.integers(0, 10**6))
def test_values_are_additive_or_logarithmic(candidate, seed):
    coordinates = np.random.default_rng(seed).uniform(-0.2, 0.2, candidate.size)
    values = candidate.setting(coordinates).values
    for i, (key, place) in enumerate(candidate.names):
        parameter = candidate.effect.parameters[key]
        neutral = candidate.start.get(key, candidate.effect.neutral(key, candidate.skin))
        value = values[key] if place is None else values[key][place]
        change = np.log(value / neutral) if parameter.low > 0 else value - neutral
        assert parameter.low <= value <= parameter.high
        if parameter.low < value < parameter.high:
            expected = SCALES.typical_change(parameter) * coordinates[i]
            assert np.isclose(change, expected, rtol=1e-9, atol=1e-12)


@given(st.sampled_from([c for c in KINDS if c.effect.polar]), st.integers(0, 10**6))
def test_a_size_and_an_angle_are_one_vector(candidate, seed):
    coordinates = np.random.default_rng(seed).uniform(-0.3, 0.3, candidate.size)
    size_key, angle_key, multiple = candidate.effect.polar
    values = candidate.setting(coordinates).values
    parameter = candidate.effect.parameters[size_key]
    at = [i for i, (key, _) in enumerate(candidate.names) if key == size_key]
    neutral = candidate.effect.neutral(size_key, candidate.skin)
    size = np.log(values[size_key] / neutral) if parameter.low > 0 else values[size_key] - neutral
    turn = np.exp(1j * np.radians(multiple * values[angle_key]))
    expected = SCALES.typical_change(parameter) * (coordinates[at[0]] + 1j * coordinates[at[1]])
    assert np.isclose(size * turn, expected)


def test_a_site_less():
    dense = next(c for c in CANDIDATES if c.name == "contact-impedance" and c.scope == "dense")
    assert without_site(dense, 2).sites == (0, 1, 3, 4, 5, 6, 7)


@pytest.mark.parametrize(("count", "size", "ways"), [(8, 1, 8), (8, 2, 28), (208, 3, 1478256)])
def test_ways_to_choose_sites(count, size, ways):
    assert np.isclose(np.exp(log_subset_count(count, size)), ways)
