"""The next experiment: names that a recording confuses, frames that split them, and that they do
once they are simulated with noise."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from eitskin.data import recording
from eitskin.data.recording import Recording, frames_table
from eitskin.diagnose.fitting.candidates import Candidate
from eitskin.diagnose.fitting.fit import Problem, fit
from eitskin.diagnose.fitting.readings import problem_of
from eitskin.diagnose.noise.noise_model import NoiseModel
from eitskin.diagnose.noise.spectrum import Spectrum
from eitskin.diagnose.search import refits
from eitskin.diagnose.search.catalogue import Conditions, catalogue
from eitskin.diagnose.search.gates import DISTINCT
from eitskin.diagnose.search.search import Search
from eitskin.diagnose.verdict import experiment
from eitskin.diagnose.verdict.experiment import NOTHING, REPEAT, Budget, propose
from eitskin.diagnose.verdict.gaps import Gap, gaps
from eitskin.effects import EFFECTS
from eitskin.effects.settings import settings, site_counts
from eitskin.errors import InputError
from eitskin.physics.protocol import channel_table
from eitskin.physics.skin import Skin
from eitskin.simulate.readings import simulate
from simulated_metadata import simulated_metadata

CHANNELS = channel_table(8)
SKIN = Skin(80.0, 3.0, 0.5, tuple(45.0 * np.arange(8)), 5.0, 2e-3, 1e-3, 0.9)
PLACES = np.array([30.0 + 20.0j, -45.0 + 5.0j, 10.0 - 50.0j, 5.0 + 2.0j, 55.0 - 20.0j])


def recorded(
    item: dict, forces: list[float], noise: float, **metadata
) -> tuple[Recording, NoiseModel]:
    """Presses at PLACES, an untouched frame before each, one effect present."""
    force = np.r_[np.zeros(4), np.tile([0.0, *forces], len(PLACES))]
    place = np.r_[np.zeros(4), np.repeat(PLACES, 1 + len(forces))]
    time_s = 0.5 * np.arange(len(force))
    frames = frames_table(time_s, force > 0, place.real, place.imag, force, 10.0)
    known = simulated_metadata(SKIN, CHANNELS)
    query = Recording(frames, None, None, None, known | metadata)
    chosen = settings([item], site_counts(CHANNELS), (0, 0))
    voltage = simulate(frames, recording.presses(query), SKIN, CHANNELS, chosen, frame_s=0.2)
    if query.metadata["values"] == "difference":
        voltage = voltage - voltage[:1]
    sd = np.full(len(CHANNELS), noise)
    draw = np.random.default_rng(5).normal(size=voltage.shape)
    return replace(query, voltage=voltage + sd * draw), NoiseModel(sd, 100.0, "given")


def diagnosed(item: dict, rivals: list[str], forces: list[float], noise: float, **metadata):
    """What `propose` needs of a diagnosis that has found an effect and knows some rivals."""
    taken, sd = recorded(item, forces, noise, **metadata)
    problem, scales = problem_of(taken, sd)
    model = problem.model
    counts = site_counts(CHANNELS)
    conditions = Conditions(taken.skin, model.nominal_skin, counts, floating=True, timed=True)
    candidates = catalogue(conditions, problem.readings, scales)
    sites = item.get("electrodes") or item.get("drives")
    effect = next(
        c
        for c in candidates
        if c.name == item["name"] and (sites is None or c.sites == tuple(sites))
    )
    candidates = [c for c in candidates if c.name in (effect.name, *rivals)]
    search = Search(
        problem, candidates, np.arange(len(model.press)) % 5, seed=1, report=lambda line: None
    )
    start = np.zeros(len(model.calibrations) + effect.size)
    after = refits.explain(search, fit(problem, [effect], start, polish=True))
    return SimpleNamespace(
        recording=taken, search=search, explanation=after, gaps=[gaps(search, after, 0)]
    )


RADIUS = {"name": "probe-radius", "parameters": {"ratio": 1.05}}
GROWTH = {"name": "contact-area-growth", "parameters": {"exponent": 0.02}}


@pytest.mark.parametrize(
    ("item", "rival", "forces", "noise", "words"),
    [
        (RADIUS, "touch-contrast", [5.0], 3e-5, "times the force"),
        (GROWTH, "contact-law", [3.0, 4.0], 3e-5, "a probe twice as wide"),
        (GROWTH, "probe-radius", [5.0], 1e-5, "times the force"),
    ],
)
def test_the_gap_proposed_is_reached_with_noise(item, rival, forces, noise, words):
    found = diagnosed(item, [rival], forces, noise)
    (pair,) = propose(found)["pairs"]
    assert (pair["a"], pair["b"]) == (item["name"], rival)
    assert pair["gap_now"] < DISTINCT.threshold < pair["gap_then"]
    assert words in pair["recipe"] and pair["recipe"] != REPEAT
    rows = np.arange(len(found.recording.frames))
    design = experiment._designs(found, rows)[pair["recipe"]]
    effects, theta = found.explanation.effects, found.explanation.fit.theta
    model = design.simulator()
    problem = Problem(model, np.zeros(1), design.whitening)
    clean = model.voltage(*problem.split(theta, effects))
    gained = []
    for seed in range(6):
        draw = np.random.default_rng(seed).normal(size=clean.shape)
        noisy = replace(problem, readings=clean + design.whitening.sd * draw)
        search = Search(noisy, found.search.candidates, rows, seed=1, report=lambda line: None)
        true = refits.explain(search, fit(noisy, effects, theta, polish=True))
        less = refits.reduced(search, true, 0)
        others = [c for c in found.search.candidates if c.name == rival]
        wrong = min(refits.with_effect(search, less, c).fit.chi2 for c in others)
        gained.append(wrong - true.fit.chi2)
    # Each is gap^2 +- 2 gap.
    error = 2.0 * pair["gap_then"] / np.sqrt(len(gained))
    assert abs(np.mean(gained) - pair["gap_then"] ** 2) < 3.0 * error


def test_more_of_the_same_grows_with_the_root_of_the_frames():
    found = diagnosed(RADIUS, ["touch-contrast"], [5.0], 1e-5)
    designs = experiment._designs(found, np.arange(len(found.recording.frames)))
    now = designs[experiment.AS_IS].gap(found, Budget(np.inf), 0, "touch-contrast")
    assert now == pytest.approx(found.gaps[0][0].gap, rel=0.05)
    assert designs[REPEAT].gap(found, Budget(np.inf), 0, "touch-contrast") == pytest.approx(
        2.0 * now, rel=0.02
    )


def test_what_the_budget_has_no_room_for_is_not_tried(monkeypatch):
    found = diagnosed(RADIUS, ["touch-contrast"], [5.0], 1e-5)
    designs = experiment._designs(found, np.arange(len(found.recording.frames)))
    budget = Budget(1e-9)
    assert designs[REPEAT].gap(found, budget, 0, "touch-contrast") is None
    assert budget.sheets < 0.0
    monkeypatch.setattr(experiment, "BUDGET_SHARE", -1.0)
    for pair in propose(found)["pairs"]:
        assert pair["recipe"] == REPEAT and pair["gap_then"] == pair["gap_now"]


def test_a_turned_connector_takes_faults_of_the_skin_along_and_no_others():
    """Turning twice as many frames as there are electrodes apart would be the same skin: a fault of
    electrode 3 is at terminal 2 after one turn; a drive's stays."""
    contact = {"name": "contact-impedance", "electrodes": [3], "parameters": {"ratio": 3.0}}
    found = diagnosed(contact, [], [5.0], 1e-5)
    rows = np.arange(len(found.recording.frames))
    turned = experiment._designs(found, rows)[experiment.TURN].simulator()
    count = len(found.recording.frames)
    index = {tuple(row): k for k, row in enumerate(CHANNELS.tolist())}
    shifted = [index[tuple(row)] for row in ((CHANNELS + 1) % 8).tolist()]
    knobs = np.zeros(len(turned.calibrations))

    def of(item):
        chosen = settings([item], site_counts(CHANNELS), (0, 0))
        voltage = turned.voltage(knobs, chosen)
        return voltage[:count], voltage[count:]

    before, after = of(contact)
    np.testing.assert_allclose(after, before[:, shifted], rtol=1e-9)
    before, after = of({"name": "drive-gain", "drives": [3], "parameters": {"gain": 1.1}})
    plain = of({"name": "drive-gain", "drives": [3], "parameters": {"gain": 1.0}})[1]
    gained = ~np.isclose(after[0], plain[0], rtol=1e-9)
    np.testing.assert_array_equal(gained, CHANNELS[:, 0] == 3)


def test_a_body_too_low_for_a_finer_solution_is_tried_as_coarsely_as_it_was_fitted(monkeypatch):
    taken, sd = recorded(RADIUS, [], 1e-4)
    problem, scales = problem_of(taken, sd)
    problem.model.coarse = True
    low = {"depth_mm": 3.0 * SKIN.radius_mm, "electrode_height_mm": 0.01 * SKIN.radius_mm}
    body = Candidate(EFFECTS["third-dimension"], None, None, "common", low, SKIN, scales)
    theta = np.zeros(len(problem.model.calibrations) + body.size)
    with pytest.raises(InputError, match="apart"):
        problem.model.voltage(*problem.split(theta, [body]), accuracy="diagnose")
    rows = np.arange(len(taken.frames))
    found = SimpleNamespace(
        recording=taken,
        search=Search(problem, [], rows % 5, seed=1, report=lambda line: None),
        explanation=SimpleNamespace(effects=[body], fit=SimpleNamespace(theta=theta)),
    )
    monkeypatch.setattr(experiment, "gaps", lambda *_: [Gap("electrode-width", 5.0, 9.0)])
    designs = experiment._designs(found, rows)
    for text in (REPEAT, experiment.TURN):
        assert designs[text].gap(found, Budget(np.inf), 0, "electrode-width") == 5.0, text


def test_driven_electrodes_split_contacts_from_leaks():
    contact = {"name": "contact-impedance", "electrodes": [3], "parameters": {"ratio": 3.0}}
    found = diagnosed(contact, ["ground-leak"], [5.0], 3e-5)
    designs = experiment._designs(found, np.arange(len(found.recording.frames)))
    driven, same = (
        designs[k].gap(found, Budget(np.inf), 0, "ground-leak") for k in (experiment.DRIVE, REPEAT)
    )
    assert driven > 3.0 * same
    points = replace(SKIN, electrode_width_mm=0.0).metadata()
    gain = {"name": "drive-gain", "drives": [3], "parameters": {"gain": 1.1}}
    found = diagnosed(gain, [], [5.0], 1e-4, skin=points)
    designs = experiment._designs(found, np.arange(len(found.recording.frames)))
    assert experiment.DRIVE not in designs


def test_presses_go_on_in_the_rhythm_of_the_recording():
    found = diagnosed(RADIUS, [], [2.0, 6.0, 4.0], 1e-5)
    frames = found.recording.frames
    sequel = experiment._Sequel(found.recording, found.search.problem.model, np.arange(len(frames)))
    plans = sequel.presses()
    for plan in plans.values():
        time_s = np.r_[frames["time_s"], plan["time_s"]]
        assert np.all(np.diff(time_s) > 0)
        assert plan["contact"].min() == len(PLACES)
    back = next(p for text, p in plans.items() if "way back" in text)
    forces = back.loc[back["contact"] == len(PLACES), "force_N"]
    assert forces.tolist() == [2.0, 6.0, 2.0, 4.0]
    held = next(p for text, p in plans.items() if "hold" in text)
    one = held[held["contact"] == len(PLACES)]
    assert one["force_N"].tolist() == [2.0, 6.0, 6.0, 6.0, 6.0, 4.0]
    np.testing.assert_allclose(np.diff(one["time_s"]), [0.5, 10.0, 10.0, 10.0, 0.5])


def test_noise_lasts_over_new_frames_by_their_numbers():
    taken, sd = recorded(RADIUS, [2.0], 1e-6)
    problem, _ = problem_of(taken, replace(sd, spectrum=Spectrum((0.5,), (1.0,))))
    rows, last = np.array([0, 3, 4, 9]), len(taken.frames) - 1
    sequel = experiment._Sequel(taken, problem.model, rows)
    covariance = sequel.design(None, problem.whitening, 2).whitening
    assert covariance.frame_number.tolist() == [*rows, last + 1, last + 2]
    ones = np.ones(covariance.mask.shape)
    assert covariance(ones).shape == ones.shape


def test_presses_left_out_of_the_comparison_are_in_the_proof(monkeypatch):
    found = diagnosed(RADIUS, ["touch-contrast"], [5.0], 3e-5)
    whole = propose(found)
    monkeypatch.setattr(experiment, "MOST_PRESSES", 2)
    assert propose(found)["pairs"] == whole["pairs"]


def test_differences_can_be_told_apart_too():
    found = diagnosed(RADIUS, ["touch-contrast"], [5.0], 3e-5, values="difference")
    (pair,) = propose(found)["pairs"]
    assert pair["gap_now"] < DISTINCT.threshold < pair["gap_then"]


def test_what_nothing_splits_is_said():
    found = diagnosed(RADIUS, ["touch-contrast"], [5.0], 1e-2)
    said = propose(found)
    assert said["sentence"].startswith("Nothing tried would tell probe-radius from touch-contrast")
    assert said["pairs"][0]["gap_then"] < DISTINCT.threshold


def test_pairs_are_alternatives_or_a_near_rival():
    found = diagnosed(RADIUS, ["touch-contrast"], [5.0], 3e-5)
    for distances, rivals in (([2.0, 2.9, 4.0], "ab"), ([3.5, 4.0], "a"), ([6.0], ""), ([], "")):
        named = [Gap(name, gap, 9.0) for name, gap in zip("abc", distances, strict=False)]
        found.gaps = [named]
        assert "".join(pair.rival for pair in experiment._pairs(found)) == rivals
    assert propose(found) == {"sentence": NOTHING, "pairs": []}
