"""What is drawn to be asked: the same each time, and never told to the tool."""

from collections import Counter
from copy import deepcopy

import numpy as np
import pytest

from eitskin.data import recording
from eitskin.errors import InputError
from proof import queries
from proof.blocks import FIRST_SEED, sort_of, trials
from shared_data import shared_data

SIMULATED = [kind for kind in queries.KINDS if kind != "real"]
REAL = {1: "hydrogel-skin/ohmc8.mat", 3: "iirc-tank/iirc_data_2006.mat", 5: "lct-tank/homogeneous"}


def drawn(name, seed):
    return queries.draw(f"query:{name}", seed)


@pytest.fixture
def real(monkeypatch):
    """The data folder, or a skip."""
    monkeypatch.setenv("EITSKIN_DATA", str(shared_data("hydrogel-skin").parent))


@pytest.mark.parametrize("name", SIMULATED)
def test_a_query_is_of_states_that_come_after_the_recording_s(name):
    one = drawn(name, 2)
    recording.validate(one.recorded, name)
    recording.validate(one.query, name)
    assert one.kind == f"query:{name}" and one.seed == 2 and one.description
    assert one.query.voltage is None
    assert one.query.frames["time_s"].min() > one.recorded.frames["time_s"].max()
    assert one.readings.shape == one.unit.shape == (len(one.query.frames), 208)
    assert len(np.unique(one.unit)) == one.query.frames["contact"].nunique()


@pytest.mark.parametrize("name", SIMULATED)
def test_equal_seeds_give_equal_bits(name):
    one, again, other = drawn(name, 4), drawn(name, 4), drawn(name, 5)
    assert np.array_equal(one.recorded.voltage, again.recorded.voltage, equal_nan=True)
    assert np.array_equal(one.readings, again.readings)
    assert one.recorded.frames.equals(again.recorded.frames)
    assert one.recorded.metadata == again.recorded.metadata and one.description == again.description
    assert one.recorded.voltage.shape != other.recorded.voltage.shape or not np.array_equal(
        one.recorded.voltage, other.recorded.voltage, equal_nan=True
    )


def test_foreign_physics_is_recorded_for_queries_alone(monkeypatch):
    def noted(kind, seed, **more):
        made.add((kind, seed))
        raise InterruptedError

    others = {
        trial
        for block in FIRST_SEED
        if sort_of(block) == "diagnoses"
        for trial in trials(block, "full")
    }
    monkeypatch.setattr(queries.cases, "draw", noted)
    of = []
    for block in ("queries-development", "queries-report"):
        made = set()
        seeds = [seed for kind, seed in trials(block, "full") if kind == "query:foreign"]
        for seed in seeds:
            with pytest.raises(InterruptedError):
                drawn("foreign", seed)
        assert len(made) == len(seeds)
        of.append(made)
    assert not of[0] & of[1] and not (of[0] | of[1]) & others


def test_every_belief_may_be_wrong_by_its_factor_at_most():
    metadata, wrong = drawn("belief", 1).recorded.metadata, set()
    for seed in range(100):
        told = deepcopy(metadata)
        assert queries.mistake(np.random.default_rng(seed), told)
        for key, most in queries.WRONG.items():
            off = abs(np.log(told["skin"][key] / metadata["skin"][key]))
            assert off <= np.log(most)
            wrong |= {key} if off else set()
    assert wrong == set(queries.WRONG)


@pytest.mark.parametrize("name", queries.MISTAKES)
def test_a_mistake_keeps_the_format(name):
    one = drawn("belief", 1).recorded
    before = one.channels.copy(), one.metadata["skin"]["electrode_deg"]
    assert queries.MISTAKES[name](np.random.default_rng(1), one.metadata)
    recording.validate(one, name)
    moved = not np.array_equal(before[0], one.channels)
    assert moved == (name in ("exchanged", "opposite"))
    turned = before[1] != one.metadata["skin"]["electrode_deg"]
    assert turned == (name in ("turned", "mirrored"))


def test_shuffled_channels_are_shuffled_in_the_query_alike():
    one = drawn("shuffled", 3)
    assert one.description == "channels"
    near = one.recorded.voltage[:1] - one.readings[:1]  # both untouched
    assert np.abs(near).max() < 0.2 * np.abs(one.readings[0]).max()


@pytest.mark.parametrize("seed", range(len(queries.GARBAGE)))
def test_garbage_has_a_plausible_size(seed):
    one = drawn("garbage", seed)
    assert one.description == list(queries.GARBAGE)[seed]
    assert np.isfinite(one.recorded.voltage).all() and np.isfinite(one.readings).all()
    assert 1e-8 < np.median(np.abs(one.recorded.voltage)) < 10.0


def test_presses_stay_whole_and_what_is_kept_out_is_not_given(real):
    one = drawn("real", 1)
    given, kept = one.recorded.frames, one.query.frames
    assert not set(given["time_s"]) & set(kept["time_s"])
    assert not kept["touch"].any()  # nobody measured a force
    assert np.isfinite(one.readings).all()
    assert len(np.unique(one.unit)) == 32  # channels, without reciprocal ones


@pytest.mark.parametrize("seed", [3, 5])
def test_reciprocal_channels_are_kept_out_together(real, seed):
    one = drawn("real", seed)
    shared_data(REAL[seed])
    asked_of, given = np.isfinite(one.readings), np.isfinite(one.recorded.voltage)
    assert not (asked_of & given).any() and (asked_of | given).all()
    assert not set(one.unit[asked_of].tolist()) & set(one.unit[given].tolist())
    sizes = Counter(one.unit[0].tolist())
    assert set(sizes.values()) == {2}


def test_a_real_recording_that_is_absent_is_said(tmp_path, monkeypatch):
    monkeypatch.setenv("EITSKIN_DATA", str(tmp_path))
    with pytest.raises(FileNotFoundError, match=r"hydrogel-skin-8 .*EITSKIN"):
        drawn("real", 1)


@pytest.mark.parametrize("kind", ["rig", "query:nothing", "query:"])
def test_an_unknown_kind_is_refused(kind):
    with pytest.raises(InputError, match="query: kind"):
        queries.draw(kind, 1)
