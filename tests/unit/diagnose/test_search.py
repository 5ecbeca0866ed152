"""Whole diagnoses of tiny recordings, and the controls: evidence that goes where it must."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import binom

from eitskin import cores
from eitskin.data.recording import Recording, presses
from eitskin.diagnose import diagnosis
from eitskin.diagnose.fitting import query, readings
from eitskin.diagnose.fitting.fit import (
    FitLimits,
    expected_decrease,
    fit,
    gauss_newton_step,
    rewhitened,
)
from eitskin.diagnose.fitting.tangents import Tangents
from eitskin.diagnose.noise.component_sds import SETTLED
from eitskin.diagnose.noise.components import COMPONENTS
from eitskin.diagnose.search import growth, prediction, proposals, refits, search, staging
from eitskin.diagnose.search.explanation import Explanation
from eitskin.diagnose.search.gates import (
    CHANCE,
    COMPETING,
    EVIDENCE,
    FORLORN,
    GROSS_MISFIT,
    PLACE,
    UNLIKE,
)
from eitskin.diagnose.search.journal import Journal, Refusal
from eitskin.diagnose.search.screen import NULL_DRAWS, score
from eitskin.diagnose.search.search import Cache, Search
from eitskin.diagnose.search.starting_point import StartingPoint
from eitskin.diagnose.verdict import conclusion, record
from eitskin.diagnose.verdict.atlas import atlas
from eitskin.diagnose.verdict.corrected import effect_items
from eitskin.effects import EFFECTS
from eitskin.errors import InputError
from proof.refit import true_gaps
from small_skin import (
    CHANNELS,
    SKIN,
    calibrated,
    candidates_of,
    problem_of,
    small_recording,
    voltage,
)
from witness import cases

CONTACT = {"name": "contact-impedance", "electrodes": [3], "parameters": {"ratio": 1.7}}
SWAP = {"name": "electrode-swap", "electrodes": [1, 5], "parameters": {}}
MEMORY = {"name": "multiplexer-memory", "parameters": {"mu": 0.03}}
DRIFT = {"name": "conductivity-drift", "parameters": {"per_minute": 0.00025}}
STIFF = {"name": "touch-contrast", "parameters": {"ratio": 1.05}}
NOISE = 5e-4


@pytest.fixture(scope="module")
def contact():
    """A recording of one poor contact, and its diagnosis."""
    recorded = small_recording(CONTACT, noise=NOISE, places=4)
    return recorded, diagnosis.diagnose(recorded)


def fresh(search):
    """A search that has not computed anything but the null distribution."""
    return replace(search, cache=Cache(null=search.cache.null), journal=Journal())


def test_nothing_missing_is_consistent():
    said = conclusion.document(diagnosis.diagnose(small_recording(noise=NOISE, places=4)), "null")
    assert said["verdict"] == "consistent" and said["effects"] == []
    assert 0.8 < said["fit"]["held_out"]["chi2_per_dof_after"] < 1.25
    conductivity = said["calibration"]["conductivity_S_per_m"]
    assert 0.49 < conductivity["low"] < conductivity["high"] < 0.51


def test_what_else_could_be_there_is_held_against_the_covariance_of_what_is_named(contact):
    """Chi squared rises by twice what the log density falls by: a rival has no discrepancy of its
    own in which its misfit would be hidden."""
    _, found = contact
    table = record._rivals(found)
    assert table["effect"].tolist() == ["", *["contact-impedance"] * len(found.rivals[0])]
    rise = table["chi2_per_dof"] - table["chi2_per_dof"][0]
    assert 0.8 < table["chi2_per_dof"][0] < 1.25 and table["elpd_difference"][0] == 0.0
    fall = -2.0 * table["elpd_difference"] / found.search.problem.whitening.size
    assert rise[1] > 0.4 and rise.to_numpy() == pytest.approx(fall.to_numpy(), rel=0.1, abs=0.05)


def test_loud_frames_are_numbered_as_in_the_recording_that_an_excerpt_is_of(contact):
    recorded, found = contact
    thinned = replace(
        recorded, frames=recorded.frames.assign(frame=3 * recorded.frames["frame"] + 1)
    )
    found = replace(found, recording=thinned, noise=replace(found.noise, loud_frames=(2, 5)))
    assert conclusion.document(found, "contact")["noise"]["loud_frames"] == [7, 16]


def test_one_effect_is_found(contact):
    said = conclusion.document(contact[1], "contact")
    assert said["verdict"] == "explained"
    (effect,) = said["effects"]
    assert (effect["name"], effect["electrodes"], effect["scope"]) == (
        "contact-impedance",
        [3],
        "sparse",
    )
    assert 1.4 < effect["parameters"]["ratio"]["low"] < 1.75
    assert effect["share"] > 0.8 and effect["evidence"]["elpd_gain"] > 30
    fit = said["fit"]["held_out"]
    assert fit["chi2_per_dof_after"] < 1.2 < fit["chi2_per_dof_before"]


@pytest.mark.parametrize(
    ("ratio", "electrodes"),
    [(1.1, [3]), pytest.param(1.25, [3, 6], marks=pytest.mark.long)],
)
def test_a_further_site_must_earn_what_an_effect_must(ratio, electrodes):
    """The second contact is worth one nat at a ratio of 1.1, over ten at 1.25."""
    both = {**CONTACT, "electrodes": [3, 6], "parameters": {"ratio": [1.7, ratio]}}
    found = diagnosis.diagnose(small_recording(both, noise=NOISE, places=4))
    (effect,) = conclusion.document(found, "further")["effects"]
    assert (effect["name"], effect["electrodes"]) == ("contact-impedance", electrodes)


def test_an_effect_gives_way_to_itself_at_further_sites_as_to_no_other(contact):
    _, found = contact
    (effect,) = found.explanation.effects
    more = replace(effect, sites=(3, 6, 7))
    lead = growth._further_sites(effect, more) + PLACE.threshold
    assert lead == 2 * EVIDENCE.threshold
    width = next(c for c in found.search.candidates if c.name == "electrode-width" and c.sites)
    for other in (replace(more, scope="dense"), replace(more, sites=(6, 7)), width):
        assert growth._further_sites(effect, other) == 0.0


@pytest.mark.long
def test_swapped_wires_are_found_beside_another_fault():
    recorded = small_recording(SWAP, MEMORY, noise=NOISE, places=2)
    said = conclusion.document(diagnosis.diagnose(recorded), "swapped")
    found = {effect["name"]: effect for effect in said["effects"]}
    assert set(found) == {"electrode-swap", "multiplexer-memory"}
    assert found["electrode-swap"]["electrodes"] == [1, 5]
    assert found["multiplexer-memory"]["parameters"]["mu"]["value"] == pytest.approx(0.03, abs=2e-3)
    surest = pytest.approx(1 / (1 + NULL_DRAWS))
    assert found["electrode-swap"]["evidence"]["p_value"] == surest


def test_what_few_frames_showed_must_stand_on_all_of_them(contact):
    recorded, found = contact
    _, again, _ = staging.prepared(recorded, 1)
    few = found.explanation
    again, _, after = growth.run(again, StartingPoint.from_explanation(few))
    assert [c.key for c in after.effects] == [c.key for c in few.effects]
    begun = [row for row in again.journal.steps if row["action"] == "start"]
    assert [(row["effect"], row["sites"]) for row in begun] == [("contact-impedance", "3")]
    assert begun[0]["p_value"] == few.p_value(few.effects[0]) < CHANCE.threshold
    assert after.p_value(after.effects[0]) < CHANCE.threshold
    # One value too many, found on frames that said so alone.
    more = next(c for c in again.candidates if c.name == "measurement-gain" and c.scope == "sparse")
    theta = np.r_[few.fit.theta, np.zeros(more.size)]
    both = fit(again.problem, [*few.effects, more], theta, polish=True)
    known = refits.explain(again, both, dict(few.p_values), few.error_sds)
    confirmed = growth._confirmed(again, known)
    assert [c.name for c in confirmed.effects] == ["contact-impedance"]
    nothing = small_recording(noise=NOISE, places=4)
    _, none, _ = staging.prepared(nothing, 1)
    none, _ = refits.calibrated(none)
    only = fit(none.problem, few.effects, few.fit.theta, polish=True)
    assert growth._confirmed(none, refits.explain(none, only)).effects == []


def test_the_best_of_the_rest_is_that_of_the_least_p_value(contact):
    _, found = contact
    least = min(s.p_value for s in proposals.scores(found.search, found.baseline))
    best = proposals.best_p_value(found.search, found.baseline)
    assert best == proposals.global_p(found.search, least) < 0.01


@pytest.mark.long
def test_a_search_on_few_frames_goes_on_with_all(monkeypatch):
    weak = {"name": "multiplexer-memory", "parameters": {"mu": 2e-4}}
    monkeypatch.setattr(staging, "FIRST_FRAMES", 11)
    found = diagnosis.diagnose(small_recording(CONTACT, weak, noise=NOISE))
    assert [effect.name for effect in found.explanation.effects] == [
        "contact-impedance",
        "multiplexer-memory",
    ]
    steps = [(step["action"], step["effect"]) for step in found.search.journal.steps]
    assert steps == [
        ("calibrate", ""),
        ("start", "contact-impedance"),
        ("add", "multiplexer-memory"),
    ]
    monkeypatch.setattr(staging, "FIRST_SHARE", 0.0)
    unbegun = diagnosis.diagnose(small_recording(CONTACT, weak, noise=NOISE)).search.journal.steps
    assert "start" not in [step["action"] for step in unbegun]
    assert unbegun[-1]["action"] == "cut short"


def test_equal_seeds_give_equal_diagnoses_on_any_number_of_cores(contact, monkeypatch):
    recorded, found = contact
    other = 1 if cores.allowed() > 1 else 3
    monkeypatch.setenv("OMP_NUM_THREADS", str(other))
    again = diagnosis.diagnose(recorded)
    assert conclusion.document(again, "x") == conclusion.document(found, "x")


@pytest.mark.long
def test_what_begins_on_a_few_frames_is_the_same_on_any_number_of_cores(contact, monkeypatch):
    monkeypatch.setattr(staging, "FIRST_FRAMES", len(contact[0].frames) // 2)
    found = []
    for count in (1, 2):
        monkeypatch.setenv("OMP_NUM_THREADS", str(count))
        found.append(diagnosis.diagnose(contact[0]))
        assert "start" in [step["action"] for step in found[-1].search.journal.steps]
    one, two = found
    assert conclusion.document(one, "x") == conclusion.document(two, "x")
    assert (
        one.search.problem.model.solved_skins.effort == two.search.problem.model.solved_skins.effort
    )


def test_the_recovered_effect_in_a_clean_simulation_has_the_same_atlas(contact):
    recorded, found = contact
    clean = small_recording(*effect_items(found.explanation.fit), noise=0.0, places=4)
    draw = np.random.default_rng(9)
    sd = found.noise.sd
    again = replace(recorded, voltage=clean.voltage + sd * draw.normal(size=clean.voltage.shape))
    atlases = []
    for one in (recorded, again):
        problem, _ = readings.problem_of(one, found.noise)
        fitted = calibrated(problem)
        jacobian = fitted.jacobian.reshape(1, -1).T
        atlases.append(atlas(one, fitted.residual, fitted.voltage() / sd, jacobian))
    tops = [[*zip(a["statistic"], a["site"], strict=True)][:5] for a in atlases]
    assert tops[0][0] == tops[1][0]
    assert len(set(tops[0]) & set(tops[1])) >= 3
    after = found.atlas
    assert (after["q"] > 0.05).all() and (atlases[0]["q"] < 1e-6).sum() >= 5


def p_values(recorded, residual, *names, sites=None):
    """Score tests' p-values of candidates about the calibrated fit of a recording whose whitened
    misfit is exchanged for `residual` of it."""
    problem, scales = problem_of(recorded, NOISE)
    seen = Tangents(calibrated(problem))
    seen.residual = seen.project_out(residual(seen.fit.residual).ravel())
    every = candidates_of(recorded, problem, scales)
    return [score(seen, c).p_value for c in every if c.name in names and c.sites in (sites, None)]


def chance_p_values(search, draws):
    """(draws,): global p-values of the best candidates where a recording's misfit is white noise,
    seen from one fit."""
    search, state = refits.calibrated(search)
    seen = refits.linearised(search, state)
    draw = np.random.default_rng(7)
    found = []
    for _ in range(draws):
        seen.residual = seen.project_out(draw.normal(size=seen.residual.size))
        search.cache.scores.clear()
        least = min(s.p_value for s in proposals.scores(search, state))
        found.append(proposals.global_p(search, least))
    return np.array(found)


def seldom(p, level=0.05, margin=1.5):
    """Whether p-values lie below a level no more often than `margin` times it, but for luck of one
    in a thousand."""
    return (p < level).sum() <= binom.ppf(0.999, len(p), margin * level)


def test_chance_seldom_gives_a_small_global_p_value():
    names = ("contact-impedance", "ground-leak", "channel-gain", "offset", "electrode-swap")
    recorded = small_recording(noise=NOISE, places=1)
    problem, scales = problem_of(recorded, NOISE)
    few = [c for c in candidates_of(recorded, problem, scales) if c.name in names]
    one = Search(
        problem, few, np.zeros(len(recorded.frames), int), seed=1, report=lambda line: None
    )
    assert seldom(chance_p_values(one, 150))


@pytest.mark.long
def test_chance_seldom_gives_a_small_global_p_value_in_the_whole_catalogue():
    p = []
    for seed in (1, 2, 3):
        case = cases.draw("null", seed)
        recorded = Recording(case.states, case.voltage, None, None, dict(case.metadata))
        p.append(chance_p_values(staging.prepared(recorded, 1)[1], 100))
    assert seldom(np.concatenate(p))


def test_an_effect_has_the_p_value_of_its_own_score():
    faint = {**CONTACT, "parameters": {"ratio": 1.25}}
    _, one, _ = staging.prepared(small_recording(faint, noise=NOISE, places=4), 1)
    one, state = refits.calibrated(one)
    scores = proposals.scores(one, state)
    trials = proposals.trials(one, state, scores)
    p = {t.effects[-1].key: t.p_values[t.effects[-1].key] for t in trials}
    for s, trial in ((s, t) for s in scores for t in trials if t.effects[-1] == s.candidate):
        gain = 2.0 * (trial.log_likelihood - state.log_likelihood)
        dof = max(s.dof, s.candidate.size)
        assert p[s.candidate.key] == proposals.global_p(
            one, replace(s, gain=max(gain, 0), dof=dof).p_value
        )
    assert min(p.values()) < CHANCE.threshold < max(p.values())


def off_in_force(share, *effects):
    """A recording with forces that are off by a share of them from press to press."""
    recorded = small_recording(*effects, noise=NOISE, places=8)
    press, draw = presses(recorded), np.random.default_rng(1)
    off = np.where(press >= 0, share * draw.normal(size=press.max() + 1)[press], 0.0)
    recorded.frames["force_N"] *= 1.0 + off
    return recorded


def test_trials_of_other_processes_are_of_this_search(contact, monkeypatch):
    found = contact[1]
    held, state = fresh(found.search), found.baseline
    trials = proposals.trials(held, state, proposals.scores(held, state))
    assert len(trials) > 2
    for trial in trials:
        problem = trial.fit.problem
        assert (
            trial.folds is held.folds
            and problem.model.solved_skins is held.problem.model.solved_skins
        )
        assert problem.model is held.problem.model and problem.readings is held.problem.readings
        assert trial.score.absorbed or trial.rig is state.rig
        assert all(one.effect is EFFECTS[one.name] for one in trial.effects)
    whitenings = [trial.fit.problem.whitening for trial in trials]
    in_use = held.problem.whitening, state.fit.problem.whitening
    own = [one for one in whitenings if not any(one is other for other in in_use)]
    assert own and not any("factors" in vars(one) for one in own)


def test_what_trials_solve_counts_for_those_that_follow(contact, monkeypatch):
    found = contact[1]
    held, state, near = found.search, found.baseline, found.search.problem.model.solved_skins
    begun, seen = near.effort, []
    monkeypatch.setattr(refits, "PROCESSES", 2)

    def solving(part):
        seen.append(near.effort - begun)
        near.effort += 10.0
        return near.effort - begun - 10.0

    assert refits.in_processes(held, state, solving, range(5)) == [0.0, 0.0, 20.0, 20.0, 40.0]
    assert near.effort == begun + 50.0 and not seen
    near.effort = begun


def test_what_an_effect_leaves_is_fitted_once(contact, monkeypatch):
    found = contact[1]
    held, state = fresh(found.search), found.explanation
    less = refits.reduced(held, state, 0)
    assert refits.reduced(held, state, 0).fit is less.fit
    other = replace(state, fit=replace(state.fit, theta=state.fit.theta + 0.01))
    assert refits.reduced(held, other, 0).fit is not less.fit


def test_names_that_a_rig_error_holds_are_found_as_if_all_were_scored_without_it(monkeypatch):
    _, held, _ = staging.prepared(off_in_force(0.05, STIFF), 1)
    held, state = refits.calibrated(held)
    assert state.error_sds["force-per-press"] > 0.0
    monkeypatch.setitem(vars(COMPETING), "threshold", 100)
    ranked = proposals._without_components(held, state, ("force-per-press",), set())
    found = {s.candidate.key: s for s in ranked}
    without = {**state.error_sds, "force-per-press": 0.0}
    here = refits.linearised(held, state).fit
    problem = replace(here.problem, whitening=state.rig.whitening(without, fitted=True))
    seen = Tangents(rewhitened(here, problem))
    best = {}
    for one in proposals.scores(held, state):
        if one.candidate.scope != "dense" and one.information is not None:
            own = score(seen, one.candidate)
            if own is not None and proposals.global_p(held, own.p_value) < CHANCE.threshold:
                kept = best.setdefault(one.candidate.name, own)
                best[one.candidate.name] = min(kept, own, key=lambda s: s.p_value)
    assert "touch-contrast" in best
    assert {one.candidate.name for one in found.values()} == set(best)


def test_a_trial_whose_own_score_chance_gives_does_not_enter(contact, monkeypatch):
    found, before = contact[1].search, contact[1].baseline
    trials = [
        replace(t, p_values={t.effects[-1].key: CHANCE.threshold})
        for t in proposals.trials(found, before, proposals.scores(found, before))
    ]
    monkeypatch.setattr(growth, "trials", lambda search, explanation, ranked: trials)
    assert growth._add(found, before) is None


def test_shuffled_times_take_the_evidence_of_a_drift():
    recorded = small_recording(DRIFT, noise=NOISE, places=8)
    order = np.random.default_rng(4).permutation(len(recorded.frames))
    (before,) = p_values(recorded, lambda r: r, "conductivity-drift")
    (after,) = p_values(recorded, lambda r: r[order], "conductivity-drift")
    assert before < 1e-10 and after > 1e-3


def test_shuffled_channels_take_the_evidence_of_a_contact(contact):
    recorded, _ = contact
    order = np.random.default_rng(4).permutation(len(CHANNELS))
    (before,) = p_values(recorded, lambda r: r, "contact-impedance", sites=(3,))
    (after,) = p_values(recorded, lambda r: r[:, order], "contact-impedance", sites=(3,))
    assert before < 1e-10 and after > 1e-3


@pytest.mark.parametrize("wins", [False, True])
def test_a_second_growth_that_loses_leaves_no_trace(contact, monkeypatch, wins):
    state = contact[1].baseline
    held = replace(contact[1].search, cache=contact[1].search.cache.branch())
    met = held.cache.met
    refits.linearised(held, state)
    held.cache.trials[state.key] = state.fit, [contact[1].explanation]
    other = replace(state, fit=replace(state.fit))

    def grown(branch, _explanation):
        refits.linearised(branch, other)
        return replace(other, log_evidence=np.inf if wins else -np.inf)

    monkeypatch.setattr(growth, "_grown_and_stood", grown)
    found = growth._rival(held, state, state, held.candidates)
    met = held.cache.met[state.key]
    assert (met is other) == wins == (found.fit is other.fit)
    if not wins:
        assert proposals.cached_trials(held, met) == [contact[1].explanation]


def test_a_broken_wire_is_no_name_where_the_readings_are_of_no_such_skin(monkeypatch):
    recorded = small_recording(SWAP, noise=NOISE, places=2)
    monkeypatch.setitem(vars(UNLIKE), "threshold", 1.1)
    monkeypatch.setitem(vars(GROSS_MISFIT), "threshold", 0.1)
    found = diagnosis.diagnose(recorded)
    assert found.explanation.effects == [] and found.remainder.sentence.startswith(
        "The readings are not"
    )


@pytest.mark.parametrize("wrong", ["order", pytest.param("polarity", marks=pytest.mark.long)])
def test_readings_in_an_order_or_polarity_of_their_own_get_no_name(wrong):
    recorded = small_recording(noise=NOISE, places=2)
    order = np.random.default_rng(1).permutation(len(CHANNELS))
    recorded.voltage = recorded.voltage[:, order] if wrong == "order" else -recorded.voltage
    found = diagnosis.diagnose(recorded)
    said = conclusion.document(found, wrong)
    assert (said["verdict"], said["effects"]) == ("unexplained", [])
    likeness = prediction.likeness(found.search, found.explanation)
    assert abs(likeness) < 0.1 if wrong == "order" else likeness < -0.99
    assert "Order and polarity" in said["other"]["sentence"]
    assert "unlike" in {step["action"] for step in found.search.journal.steps}


def test_turned_electrode_labels_turn_the_answer(contact):
    """What electrode 3 did, told of electrode k + 2 wherever it was told of k, is electrode 5's."""
    recorded, _ = contact
    turned = (CHANNELS + 2) % 8
    at = [int(np.flatnonzero((row == CHANNELS).all(axis=1))[0]) for row in turned]
    still = ~recorded.frames["touch"].to_numpy()
    one = replace(recorded, frames=recorded.frames[still].reset_index(drop=True))
    one.voltage = recorded.voltage[still].copy()
    one.voltage[:, at] = recorded.voltage[still]
    problem, scales = problem_of(one, NOISE)
    seen = Tangents(calibrated(problem))
    own = [c for c in candidates_of(one, problem, scales) if c.name == "contact-impedance"]
    gains = {c.sites[0]: score(seen, c).gain for c in own if c.scope == "sparse"}
    assert max(gains, key=gains.get) == 5


def test_an_effect_is_taken_out_where_no_skin_has_the_rest_alone():
    """Contacts better than can be resolved on the electrodes believed in, on narrower ones."""
    recorded = small_recording(noise=NOISE, places=1)
    skin = {**recorded.metadata["skin"], "contact_impedivity_ohm_m2": 4e-6}
    recorded = replace(recorded, metadata={**recorded.metadata, "skin": skin})
    problem, scales = problem_of(recorded, NOISE)
    every = candidates_of(recorded, problem, scales)
    effects = [
        next(c for c in every if c.name == name and c.scope == "common")
        for name in ("contact-impedance", "electrode-width")
    ]
    ratio = np.log(0.4) / scales.typical_change(effects[0].effect.parameters["ratio"])
    width = np.log(0.5) / scales.typical_change(effects[1].effect.parameters["width_mm"])
    both = fit(problem, effects, np.array([0.0, ratio, width]), limits=FitLimits(-np.inf))
    alone = both.theta[:2]
    with pytest.raises(InputError, match="z sigma / width"):
        problem.residual(alone, effects[:1])
    search = Search(
        problem, every, np.zeros(len(recorded.frames), int), seed=1, report=lambda line: None
    )
    less = refits.without(search, Explanation(both, search.folds, 0.0, 0.0), 1)
    assert (
        less.effects == effects[:1]
        and less.fit.chi2 < (problem.residual(np.zeros(2), effects[:1]) ** 2).sum()
    )
    found = SimpleNamespace(
        explanation=SimpleNamespace(fit=both),
        noise=SimpleNamespace(sd=np.full(len(CHANNELS), NOISE)),
    )
    changes, _ = record._changes(found, problem.whitening.mask)
    assert np.isfinite(changes[0]).all() and np.isnan(changes[1]).all()


def test_a_body_is_found_from_beliefs_where_a_sheet_took_the_calibrations_astray():
    """Its depth is unknown, and the best of sheets has a conductivity far from any belief."""
    deep = replace(SKIN, thickness_mm=20.0, electrode_height_mm=5.0, electrode_z_mm=8.0)
    recorded = small_recording({"name": "third-dimension"}, noise=NOISE, places=1, skin=deep)
    skin = {**recorded.metadata["skin"], "thickness_mm": None}
    recorded = replace(recorded, metadata={**recorded.metadata, "skin": skin})
    problem, scales = problem_of(recorded, NOISE)
    every = candidates_of(recorded, problem, scales)
    search = Search(
        problem, every, np.zeros(len(recorded.frames), int), seed=1, report=lambda line: None
    )
    search, sheet = refits.calibrated(search)
    assert sheet.fit.chi2 > 2.0 * problem.whitening.size and sheet.fit.theta.max() > 5.0
    shallow = next(c for c in every if c.name == "third-dimension")
    assert shallow.start["depth_mm"] < 14.0
    found = refits.with_effect(search, sheet, shallow).fit
    assert found.chi2 < 1.2 * problem.whitening.size
    (body,) = found.settings()
    assert abs(body.values["depth_mm"] - 20.0) < 0.5


def test_a_set_without_effects_is_fitted_without_a_discrepancy_too(contact, monkeypatch):
    """Its evidence is what every name must beat: it may not stay where a climb is stuck."""
    own, before = contact[1].search, contact[1].baseline
    assert not before.effects and before.error_sds["static-discrepancy"] > 0.0
    tried, learned_explanation = [], refits._learned_explanation

    def learned(search, fitted, p_values, error_sds, rig, scoring=None):
        tried.append((fitted, error_sds))
        return learned_explanation(search, fitted, p_values, error_sds, rig, scoring)

    monkeypatch.setattr(refits, "_learned_explanation", learned)
    found = refits.explain(own, before.fit, error_sds=before.error_sds, rig=before.rig)
    (_, first), (fitted, second) = tried
    assert first == before.error_sds
    assert set(second) == {n for n in found.error_sds if not COMPONENTS[n].discrepancy}
    assert not np.allclose(fitted.theta, before.fit.theta)
    assert found.log_evidence >= before.log_evidence - SETTLED


@pytest.mark.parametrize(
    ("nearer", "gross", "count"), [(1e-6, 1e9, 1), (-1e-6, 1e9, 2), (1e-6, 0.0, 2)]
)
def test_a_discrepancy_that_explains_far_more_is_not_taken_out(
    contact, monkeypatch, nearer, gross, count
):
    """Where the fit without it is further behind than FORLORN after a step, and what the next one
    promises, and not far off."""
    own, before = contact[1].search, contact[1].baseline
    trial = next(
        t
        for t in proposals.trials(own, before, proposals.scores(own, before))
        if refits.without_discrepancy(t, t.fit) is not t.fit
    )
    learned_explanation = refits._learned_explanation
    job = trial.fit, None, trial.error_sds, trial.rig
    found = learned_explanation(own, *job, own.cache.scoring)
    moved = gauss_newton_step(refits.without_discrepancy(found, found.fit))
    kept = {k: s for k, s in found.error_sds.items() if not COMPONENTS[k].discrepancy}
    density = -0.5 * (moved.chi2 + moved.problem.whitening.log_determinant)
    behind = (
        found.log_likelihood - density - found.rig.log_prior(kept) - 0.5 * expected_decrease(moved)
    )
    monkeypatch.setitem(vars(FORLORN), "threshold", behind - nearer)
    monkeypatch.setitem(vars(GROSS_MISFIT), "threshold", gross)
    tried = []
    monkeypatch.setattr(
        refits,
        "_learned_explanation",
        lambda *arguments: tried.append(arguments) or learned_explanation(*arguments),
    )
    refits.explain(own, trial.fit, error_sds=trial.error_sds, rig=trial.rig)
    assert len(tried) == count


def test_a_fit_that_went_astray_is_no_trial(monkeypatch):
    recorded = small_recording(
        {"name": "touch-contrast", "parameters": {"ratio": 1.2}}, noise=NOISE, places=3
    )
    problem, scales = problem_of(recorded, NOISE)
    every = candidates_of(recorded, problem, scales)
    one = Search(
        problem, every, np.zeros(len(recorded.frames), int), seed=1, report=lambda line: None
    )
    one, state = refits.calibrated(one)
    contrast = next(c for c in every if c.name == "touch-contrast")
    found = refits.with_effect(one, state, contrast)
    assert found.log_evidence > state.log_evidence + 100.0
    here = refits.fit

    def astray(problem, effects, start, *rest, **more):
        fitted = here(problem, effects, start, *rest, **more)
        theta = fitted.theta + 0.3
        return replace(fitted, theta=theta, residual=problem.residual(theta, effects))

    monkeypatch.setattr(refits, "fit", astray)
    refusal = refits.with_effect(one, state, contrast)
    assert isinstance(refusal, Refusal) and refusal.gate.name == "astray"
    assert not refusal.gate.admits(refusal.value)


@pytest.mark.parametrize("again", [True, False])
def test_a_fit_that_did_not_end_is_begun_again_from_the_beliefs(again, monkeypatch):
    """What it reached so far stands where that is the better of the two."""
    recorded = small_recording(CONTACT, noise=NOISE, places=2)
    problem, scales = problem_of(recorded, NOISE)
    every = candidates_of(recorded, problem, scales)
    lines = []
    one = Search(problem, every, np.zeros(len(recorded.frames), int), seed=1, report=lines.append)
    one, state = refits.calibrated(one)
    loose = next(c for c in every if c.name == "contact-impedance" and c.sites == (3,))
    here, starts = refits.fit, []

    def unending(problem, effects, start, *rest, **more):
        starts.append(np.array(start))
        first = len(starts) == 1
        fitted = here(problem, effects, start, *rest, **more)
        if first != again:
            return replace(fitted, converged=not first)
        theta = 0.5 * fitted.theta
        return replace(
            fitted, theta=theta, residual=problem.residual(theta, effects), converged=not first
        )

    whole = refits.with_effect(one, state, loose)
    monkeypatch.setattr(refits, "fit", unending)
    found = refits.with_effect(one, state, loose)
    knobs = len(problem.model.calibrations)
    assert (starts[1] == 0.0).all() and (starts[0][:knobs] != 0.0).any()
    assert np.allclose(found.fit.theta, whole.fit.theta, atol=0.02)


def test_a_trial_whose_fit_did_not_end_is_told(contact, monkeypatch):
    _, found = contact
    lines = []
    one = replace(fresh(found.search), report=lines.append)
    fitted = refits._fitted

    def unended(*arguments):
        trial = fitted(*arguments)
        if isinstance(trial, Refusal):
            return trial
        return replace(trial, fit=replace(trial.fit, converged=False))

    monkeypatch.setattr(refits, "_fitted", unended)
    proposals.trials(one, found.baseline, proposals.scores(one, found.baseline))
    assert any("contact-impedance: its fit did not come to an end" in line for line in lines)


def free_gains(found):
    """A gain of its own for every channel, in place of what was found."""
    search = found.search
    free = next(c for c in search.candidates if c.name == "channel-gain")
    search, state = refits.calibrated(search)
    return refits.with_effect(search, state, free)


@pytest.mark.long
def test_free_gains_lose_unless_they_are_there(contact):
    _, found = contact
    assert free_gains(found).log_evidence < found.explanation.log_evidence - 10
    gain = 1 + 0.02 * np.random.default_rng(3).normal(size=len(CHANNELS))
    planted = {"name": "channel-gain", "parameters": {"gain": gain.tolist()}}
    recorded = small_recording(planted, noise=NOISE, places=5)
    said = conclusion.document(diagnosis.diagnose(recorded), "gains")
    assert [(e["name"], e["scope"]) for e in said["effects"]] == [("channel-gain", "dense")]
    estimate = said["effects"][0]["parameters"]["gain"]
    apart = np.array(estimate["value"]) / np.mean(estimate["value"]) - gain / gain.mean()
    assert np.abs(apart).max() < 5 * NOISE


def test_what_is_injected_is_what_was_planted(contact):
    recorded, found = contact
    (item,) = effect_items(found.explanation.fit)
    assert item["name"] == "contact-impedance" and item["electrodes"] == [3]
    corrected = voltage(recorded, [item])
    assert np.sqrt(np.mean((corrected - voltage(recorded, [CONTACT])) ** 2)) < 0.5 * np.median(
        found.noise.sd
    )


def test_a_search_that_has_spent_its_skins_ends_with_what_it_has(contact, monkeypatch):
    monkeypatch.setattr(search, "MOST_SOLVED", 0)
    found = diagnosis.diagnose(contact[0])
    assert found.search.journal.steps[-1]["action"] == "cut short"
    assert contact[1].search.journal.steps[-1]["action"] != "cut short"
    said = conclusion.document(found, "contact")
    assert said["verdict"] == "unexplained" and said["effects"] == []
    assert said["other"]["probability"] > 0.5


def test_what_a_search_cut_short_missed_has_its_gaps_all_the_same(contact, monkeypatch):
    monkeypatch.setattr(search, "MOST_SOLVED", 1)
    found = diagnosis.diagnose(contact[0])
    assert found.explanation.effects == []
    (listed,) = true_gaps(found, [CONTACT], ["sparse"])
    assert 0.0 < listed[0][1] == min(gap for _, gap in listed)


def test_a_query_beyond_the_physics_found_is_predicted_as_far_as_it_goes(capsys):
    law = {"name": "force-dependent-impedance", "electrodes": [2], "parameters": {"per_N": -0.09}}
    recorded = small_recording(law, noise=NOISE, places=4)
    found = diagnosis.diagnose(recorded)
    assert [effect.name for effect in found.explanation.effects] == ["force-dependent-impedance"]
    query.predict(found.explanation.fit, found.recording, recorded)
    assert capsys.readouterr().err == ""
    force = (
        2.0 * recorded.frames["force_N"]
    )  # up to 16 N: from 11.1 N on its contact has less than 0
    twice = replace(recorded, frames=recorded.frames.assign(force_N=force))
    predicted = query.predict(found.explanation.fit, found.recording, twice)
    said = capsys.readouterr().err
    most = float(re.search(r"touches above (\S+) N are predicted as at \1 N", said)[1])
    assert 9.5 < most < 12.0
    capped = replace(recorded, frames=recorded.frames.assign(force_N=force.clip(upper=most)))
    assert "contact_impedivity_ohm_m2" in said
    for ours, theirs in zip(
        predicted, query.predict(found.explanation.fit, found.recording, capped), strict=True
    ):
        np.testing.assert_array_equal(ours, theirs)


def test_what_comes_and_goes_again_ends_the_growth(contact, monkeypatch):
    """A further site may earn enough to come and too little to stay."""
    found = contact[1]
    state, less = found.explanation, found.baseline
    rounds = []

    def added(_search, now):
        rounds.append(now)
        assert len(rounds) < 10
        return state

    monkeypatch.setattr(growth, "_add", added)
    monkeypatch.setattr(growth, "_drop", lambda search, better: less)
    assert growth._grow(replace(found.search, rival_evidence=-np.inf), less) is less
    assert len(rounds) == 1


def test_a_harmonic_of_the_rim_is_one_entry_drawn_wrongly_or_pressed():
    recorded = small_recording(noise=NOISE, places=2)
    problem, scales = problem_of(recorded, NOISE)
    every = candidates_of(recorded, problem, scales)
    fold = np.arange(len(recorded.frames)) % 5
    one = Search(problem, every, fold, seed=1, report=print)
    shapes = {
        (c.start["harmonic"], c.start.get("carried", 0)): c
        for c in one.candidates
        if c.name == "domain-shape"
    }
    one, before = refits.calibrated(one)
    state = refits.with_effect(one, before, shapes[2, 0])
    assert refits.with_effect(one, state, shapes[2, 1]).gate.name == "entry"
    assert len(refits.with_effect(one, state, shapes[3, 1]).effects) == 2
