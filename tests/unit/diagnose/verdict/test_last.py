"""The last set decides nothing: it is read when all is decided, and what is said of it is so."""

from dataclasses import replace

import numpy as np
import pytest

from eitskin.diagnose import diagnosis
from eitskin.diagnose.fitting.fit import rewhitened
from eitskin.diagnose.fitting.held_out import held_out
from eitskin.diagnose.fitting.readings import reserve_problem
from eitskin.diagnose.fitting.reserve import Reserve
from eitskin.diagnose.verdict import conclusion, words
from small_skin import small_recording

CONTACT = {"name": "contact-impedance", "electrodes": [3], "parameters": {"ratio": 1.7}}


@pytest.fixture(scope="module")
def found():
    return diagnosis.diagnose(small_recording(CONTACT, noise=5e-4, places=6))


def test_nothing_that_is_decided_depends_on_it(found):
    recorded = small_recording(CONTACT, noise=5e-4, places=6)
    kept = found.reserve_mask
    assert kept.any()
    draw = np.random.default_rng(3)
    permuted = (1.0 + 1e-9) * draw.permutation(recorded.voltage)  # copies would be left out
    recorded.voltage = np.where(kept, permuted, recorded.voltage)
    said, other = (
        conclusion.document(each, "skin") for each in (found, diagnosis.diagnose(recorded))
    )
    last, other_last = said["fit"].pop("last"), other["fit"].pop("last")
    assert said == other
    assert other_last["chi2_per_dof_after"] > 10.0 * last["chi2_per_dof_after"]


def test_before_is_another_fit_than_after(found):
    """On folds and on the last set, each by hand."""
    fit = conclusion.document(found, "skin")["fit"]
    for scores in fit.values():
        assert scores["chi2_per_dof_before"] > 1.2 > scores["chi2_per_dof_after"]
        assert scores["rms_before_V"] > scores["rms_after_V"]
        assert scores["white_chi2_per_dof_before"] > 1.2 > scores["white_chi2_per_dof_after"]
    problem = found.named_fit.problem
    before = held_out(rewhitened(found.baseline.fit, problem), found.search.folds)
    assert fit["held_out"]["chi2_per_dof_before"] == before.chi2_per_dof
    assert fit["held_out"]["frames"] == problem.whitening.mask.any(axis=1).sum()
    last = reserve_problem(found.noise_problem, found.recording, found.noise, found.reserve_mask)
    assert np.array_equal(last.whitening.mask, found.reserve_mask)
    assert fit["last"]["frames"] == found.reserve_mask.any(axis=1).sum()
    for key, sds in (
        ("chi2_per_dof_before", found.explanation.error_sds),
        ("chi2_per_dof_before_own_sizes", found.baseline.error_sds),
    ):
        by_hand = Reserve(last, sds, found.search.converter_step).prediction(found.baseline.fit)
        assert fit["last"][key] == pytest.approx(by_hand.chi2_per_dof)


def test_own_sizes_are_those_learned_without_an_effect(found):
    sds = dict.fromkeys(found.baseline.error_sds, 0.0) | {"amplitude-per-frame": 0.1}
    loose = replace(found, baseline=replace(found.baseline, error_sds=sds))
    last = conclusion.document(loose, "skin")["fit"]["last"]
    assert last["chi2_per_dof_before_own_sizes"] < 0.99 * last["chi2_per_dof_before"]


def test_what_is_said_is_of_the_last_set_where_there_is_one(found):
    said = conclusion.document(found, "skin")
    assert words.last_scores(said) is said["fit"]["last"]
    none = replace(found, reserve_mask=np.zeros_like(found.reserve_mask))
    said = conclusion.document(none, "skin")
    assert "last" not in said["fit"] and words.last_scores(said) is said["fit"]["held_out"]


def test_loud_frames_are_counted_among_the_readings_that_decide(found):
    noise = replace(found.noise, spike_count=10)
    spikes = conclusion.document(replace(found, noise=noise), "skin")["noise"]["spikes"]
    assert spikes["share"] == 10 / (~found.reserve_mask).sum()
