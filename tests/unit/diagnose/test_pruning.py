"""Effects that folds left out do not bear out are taken out, and nothing else decides that."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from eitskin.diagnose import diagnosis
from eitskin.diagnose.fitting.fit import fit, rewhitened
from eitskin.diagnose.fitting.harm import harm
from eitskin.diagnose.fitting.held_out import CrossValidation, draw_reserve_mask, error_units
from eitskin.diagnose.fitting.readings import problem_of
from eitskin.diagnose.noise.noise_model import NoiseModel
from eitskin.diagnose.search import prediction, pruning, refits
from eitskin.diagnose.search.gates import FOLDS, HARM_RATIO, PREDICTION, PRESSES, STANDARD_ERRORS
from eitskin.diagnose.search.journal import Journal
from eitskin.diagnose.search.search import Search
from small_skin import CHANNELS, candidates_of, small_recording

CONTRAST = {"name": "touch-contrast", "parameters": {"ratio": 1.2}}
NOISE = 1e-3


def searched(recorded, item):
    """A search of what is seen of a recording, and an explanation with one effect."""
    sd = np.full(len(CHANNELS), NOISE * np.median(np.abs(recorded.voltage)))
    kept = draw_reserve_mask(recorded, 1)
    seen = replace(recorded, voltage=np.where(kept, np.nan, recorded.voltage))
    problem, scales = problem_of(seen, NoiseModel(sd, 1e6, "given"))
    candidates = candidates_of(seen, problem, scales)
    effect = next(c for c in candidates if c.name == item["name"])
    fold = np.arange(len(recorded.frames)) % 5
    search = Search(problem, [effect], fold, seed=1, report=print)
    return search, refits.explain(search, fit(problem, [effect], np.zeros(2), polish=True))


def earning(search, explanation, recorded):
    return pruning._earning(search, explanation, error_units(recorded), 1e6)


def pressing():
    recorded = small_recording(CONTRAST, noise=NOISE, places=6)
    return recorded, *searched(recorded, CONTRAST)


@pytest.mark.parametrize("everywhere", [True, False])
def test_an_effect_that_no_fold_bears_out_is_not_earned(everywhere):
    recorded = small_recording(*[CONTRAST] * everywhere, noise=NOISE, places=6)
    search, explanation = searched(recorded, CONTRAST)
    left = earning(search, explanation, recorded)
    assert [c.name for c in left.effects] == (["touch-contrast"] if everywhere else [])
    assert [row["action"] for row in search.journal.steps] == ([] if everywhere else ["not earned"])
    assert {d.gate for d in search.journal.decisions} >= {FOLDS.name, PRESSES.name}


def test_what_is_put_aside_does_not_prune():
    recorded, search, explanation = pressing()
    kept = draw_reserve_mask(recorded, 1)
    plain = small_recording(noise=NOISE, places=6)
    other = replace(recorded, voltage=np.where(kept, plain.voltage, recorded.voltage))
    again, same = searched(other, CONTRAST)
    assert np.array_equal(same.fit.theta, explanation.fit.theta)
    assert earning(again, same, other).effects
    earning(search, explanation, recorded)
    assert again.journal.decisions == search.journal.decisions


@pytest.mark.parametrize(("errors", "stays"), [(1.5, False), (2.5, True)])
def test_a_place_is_earned_by_two_standard_errors(monkeypatch, errors, stays):
    recorded, search, explanation = pressing()
    monkeypatch.setattr(CrossValidation, "gain", lambda self, rival: (4.0 * errors, 4.0))
    assert bool(earning(search, explanation, recorded).effects) == stays
    less = refits.reduced(search, explanation, 0)
    sure = prediction.sure_gain(search, explanation, less)
    assert sure == 4.0 * (errors - STANDARD_ERRORS) and PREDICTION.admits(sure) == stays


@pytest.mark.parametrize(("gain_over_presses", "stays"), [(0.1, True), (-0.1, False)])
def test_a_gain_that_presses_do_not_have_in_common_is_not_earned(
    monkeypatch, gain_over_presses, stays
):
    recorded, search, explanation = pressing()
    asked = []
    monkeypatch.setattr(
        pruning, "gain_over_presses", lambda *of: asked.append(of) or gain_over_presses
    )
    assert bool(earning(search, explanation, recorded).effects) == stays
    after, before, press, pressed = asked[0]
    less = prediction.predicted(search, refits.reduced(search, explanation, 0), explanation)
    assert after is explanation.held_out
    assert np.array_equal(before.log_density, less.log_density)
    assert np.array_equal(press, error_units(recorded)[:, 0])
    seen = ~draw_reserve_mask(recorded, 1).any(axis=1)
    assert np.array_equal(pressed, recorded.frames["touch"].to_numpy(bool) & seen)


def test_harm_is_asked_of_predictions_as_each_fit_would_make_them(monkeypatch):
    """In another's covariance a fit would be another one: worse, maybe, than what does harm."""
    recorded, search, explanation = pressing()
    # What is met is kept in the covariance it was met in.
    refits.linearised(search, refits.calibrated(search)[1])
    white = explanation.fit.problem.whitening
    other = replace(white, sd=white.sd * np.linspace(1.0, 30.0, len(white.sd)))
    problem = replace(explanation.fit.problem, whitening=other)
    explanation = replace(explanation, fit=rewhitened(explanation.fit, problem))
    asked, harmless = [], {"rmse_V": 1.0, "rmse_before_V": 1.0, "standard_errors": 0.0}
    monkeypatch.setattr(pruning, "harm", lambda *of: asked.append(of) or harmless)
    earning(search, explanation, recorded)
    less, (after, before, readings, units) = refits.reduced(search, explanation, 0), asked[0]
    assert np.array_equal(after, explanation.held_out.residual)
    assert np.array_equal(before, less.held_out.residual)
    assert not np.allclose(before, prediction.predicted(search, less, explanation).residual)
    assert np.array_equal(np.isfinite(readings), white.mask)
    assert np.array_equal(units, error_units(recorded))


@pytest.mark.parametrize(("share", "stays"), [(0.85, True), (0.95, False)])
def test_an_effect_whose_size_may_be_any_is_not_earned(monkeypatch, share, stays):
    recorded, search, explanation = pressing()
    monkeypatch.setattr(pruning, "range_share", lambda fitted, index: share)
    assert bool(earning(search, explanation, recorded).effects) == stays


# ---- harm

UNITS = np.repeat(np.arange(8), 10)[:, None] * np.ones((1, 6), int)
ERROR = np.random.default_rng(3).normal(size=UNITS.shape)


def harms(after, before, accepted, units=UNITS):
    """Whether readings are predicted plainly worse."""
    effect, less = SimpleNamespace(name="x", kind=None, sites=None), SimpleNamespace(effects=[])
    comparison = harm(after, before, np.zeros(UNITS.shape), units)
    return not pruning._is_harmless(Journal(), effect, less, comparison, accepted)


@pytest.mark.parametrize("common", [0.0, 30.0])
def test_what_predicts_plainly_worse_does_harm(common):
    """Were the rig's errors ever so large: a covariance that excuses them is no excuse."""
    noise = ERROR + common * np.random.default_rng(4).normal(size=(len(ERROR), 1))
    worse = noise + 40.0 * np.sign(noise)
    for accepted in (False, True):
        assert harms(worse, noise, accepted)
        assert not harms(noise, worse, accepted)
        assert not harms(noise, noise, accepted)


def test_a_little_harm_is_allowed_where_the_covariance_accepts_what_is_left():
    assert harms(1.02 * ERROR, ERROR, False)
    assert not harms(1.02 * ERROR, ERROR, True)
    assert harms(1.2 * ERROR, ERROR, True)


def test_harm_to_one_press_alone_is_allowed_where_the_covariance_accepts_what_is_left():
    left = np.where(UNITS == 7, 2.0, 1.0) * ERROR
    assert harms(left, ERROR, False)
    assert not harms(left, ERROR, True)
    assert np.sqrt((left**2).mean() / (ERROR**2).mean()) > HARM_RATIO.threshold


def test_one_unit_a_little_worse_is_no_harm():
    for accepted in (False, True):
        assert not harms(1.001 * ERROR, ERROR, accepted, np.zeros_like(UNITS))


def test_touches_of_unknown_force_are_no_presses_to_have_in_common():
    """Folds are of channels then."""
    gain = {"name": "drive-gain", "drives": [3], "parameters": {"gain": 1.05}}
    recorded = small_recording(gain, noise=NOISE, places=6)
    touched = recorded.frames["touch"].to_numpy(bool)
    recorded.frames.loc[touched, "force_N"] = np.nan
    found = diagnosis.diagnose(recorded)
    assert [effect.name for effect in found.explanation.effects] == ["drive-gain"]
