import json
from dataclasses import replace

import numpy as np
import pytest

from eitskin.data import dataset
from eitskin.data.recording import Recording
from eitskin.diagnose.noise.estimate import estimate_noise
from eitskin.errors import InputError
from eitskin.estimators.sets import source_set
from eitskin.simulate.imitation import PressPrior, imitated_presses
from eitskin.simulators import Simulator
from loop import sources
from loop_skin import FORCES, JITTER, LAW
from small_skin import METADATA, SKIN, small_recording


@pytest.fixture(scope="module")
def recorded():
    touched_recording = small_recording(LAW)
    contact = np.where(
        touched_recording.frames["touch"], np.arange(len(touched_recording.frames)) // 5, -1
    )
    touched_recording.frames["contact"] = contact
    touched_recording.frames["contact"] = (
        touched_recording.frames["contact"].astype("Int64").where(touched_recording.frames["touch"])
    )
    return touched_recording


def made_by(simulator, recorded, seed=1, samples=150):
    prior = PressPrior(FORCES, 8.0)
    split = source_set(simulator, recorded, samples, seed, prior, "a set")
    return split.dataset, split.part


def test_sets_of_one_seed_differ_in_physics_alone(recorded):
    plain, part = made_by(Simulator(SKIN, []), recorded)
    repeated, _ = made_by(Simulator(SKIN, []), recorded)
    law, of_law = made_by(Simulator(SKIN, [LAW]), recorded)
    assert plain.table.equals(law.table) and (part == of_law).all()
    assert np.array_equal(plain.delta_V, repeated.delta_V)
    sd = estimate_noise(recorded).sd
    assert np.abs(plain.delta_V - law.delta_V).max() > 20.0 * sd.max()
    seed_2, _ = made_by(Simulator(SKIN, []), recorded, seed=2)
    assert not seed_2.table.equals(plain.table)
    assert {*part} == {"train", "validation"} and (part == "train").sum() >= 150
    sessions = plain.table["session"]
    assert not {*sessions[part == "train"]} & {*sessions[part == "validation"]}


def test_noise_is_the_recording_s_on_touched_and_untouched_frame(recorded):
    clean = Simulator(SKIN, [])
    noisy_set, _ = made_by(clean, recorded, 1, 600)
    sessions = noisy_set.table["session"].nunique()
    frames = imitated_presses(
        recorded, sessions, np.random.default_rng([1, 4]), PressPrior(FORCES, 8.0)
    )
    exact = Recording(frames, clean.readings(frames, recorded, 1), None, None, METADATA)
    truth = dataset.from_recording(exact, "exact").delta_V
    spread = (noisy_set.delta_V - truth).std(axis=0) / estimate_noise(recorded).sd
    # The first press of a session has five untouched frames to its baseline, the others one.
    assert spread.mean() == pytest.approx(np.sqrt(2.0), rel=0.08)


def test_the_belief_is_calibrated_and_has_no_effect(recorded):
    doubted = {**METADATA, "skin": SKIN.metadata() | {"conductivity_S_per_m": 0.6}}
    believed = Simulator.calibrated(replace(recorded, metadata=doubted))
    assert believed.effects == () and not believed.drawn
    assert believed.skin.conductivity_S_per_m == pytest.approx(0.5, rel=0.05)


def test_the_diagnosed_simulator_is_what_effects_yaml_says(tmp_path):
    twin = {"skin": SKIN.metadata(), "protocol": {}, "effects": [LAW], "noise": 1e-3}
    path = tmp_path / "effects.yaml"
    path.write_text(json.dumps({"twin": twin}))  # which is YAML
    simulator = Simulator.read(path)
    assert (simulator.skin, simulator.effects, simulator.factor, simulator.drawn) == (
        SKIN,
        [LAW],
        1.0,
        False,
    )
    document = {"calibration": {"factor": {"value": 3.0}}}
    (tmp_path / "diagnosis.json").write_text(json.dumps(document))
    assert Simulator.read(tmp_path).factor == 3.0


def test_drawn_effects_change_from_session_to_session(recorded):
    frames = imitated_presses(recorded, 2, np.random.default_rng(1), PressPrior(FORCES, 8.0))
    drawn = Simulator(SKIN, [JITTER], drawn=True).readings(frames, recorded, 1)
    free = np.flatnonzero(~frames["touch"])
    session_0, session_1 = drawn[free[0]], drawn[free[-1]]
    assert np.abs(session_0 - session_1).max() > 1e-3 * np.abs(session_0).max()
    constant = Simulator(SKIN, []).readings(frames, recorded, 1)
    np.testing.assert_allclose(constant[free[0]], constant[free[-1]])


def test_the_truth_is_the_same_physics_by_another_solver(recorded):
    truth_json = {"true": SKIN.metadata(), "effects": [LAW]}
    frames = imitated_presses(recorded, 1, np.random.default_rng(2), PressPrior(FORCES, 8.0))
    readings = sources.truth(truth_json, recorded).readings(frames, recorded, 1)
    ours = Simulator(SKIN, [LAW], factor=2.0).readings(frames, recorded, 1)
    np.testing.assert_allclose(2.0 * readings, ours, atol=2e-3 * np.median(np.abs(readings)))


def test_differences_are_refused(recorded):
    metadata = {**METADATA, "values": "difference"}
    with pytest.raises(InputError, match="difference"):
        made_by(Simulator(SKIN, []), replace(recorded, metadata=metadata))
