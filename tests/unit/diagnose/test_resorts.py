"""Another instrument than its owner's: tried only where readings are not those of the skin."""

from dataclasses import replace

import numpy as np
import pytest

from eitskin.data import importers
from eitskin.data.subset import of_frames
from eitskin.diagnose import diagnosis
from eitskin.diagnose.fitting.candidates import replaces_instrument
from eitskin.diagnose.fitting.fit import FitLimits, fit
from eitskin.diagnose.search import growth, last_resorts, prediction, refits, staging
from eitskin.diagnose.search.gates import SIZE
from eitskin.diagnose.search.starting_point import StartingPoint
from eitskin.diagnose.verdict import certainty, conclusion
from shared_data import shared_data
from small_skin import candidates_of, problem_of, small_recording

NOISE = 1e-3
SIEMENS, RATIO = 3e-3, -0.6
AGAINST_GROUND = [
    {"name": "ground-return", "parameters": {"siemens": SIEMENS}},
    {"name": "common-mode", "parameters": {"ratio": RATIO}},
]


@pytest.fixture(scope="module")
def groups():
    recorded = small_recording(noise=NOISE)
    problem, scales = problem_of(recorded, NOISE)
    every = candidates_of(recorded, problem, scales)
    last = [c for c in every if c.effect.last_resort]
    ordinary = [c for c in every if not c.effect.last_resort]
    return problem, list(last_resorts.groups(ordinary, last))


def test_each_is_tried_alone_and_with_what_it_calls_for(groups):
    _, tried = groups
    names = [[c.name for c in group] for group in tried]
    assert names[::2] == [["ground-return"]] * (len(names) // 2)
    assert names[1::2] == [["ground-return", "common-mode"]] * (len(names) // 2)
    assert len({tuple(group[0].start.items()) for group in tried}) == len(names) // 2 > 1
    for alone, both in zip(tried[::2], tried[1::2], strict=True):
        assert (
            len(last_resorts.start_coordinates(alone))
            == 1
            < len(last_resorts.start_coordinates(both))
        )
        assert {len(start) for start in last_resorts.start_coordinates(both)} == {2}
        assert replaces_instrument(both) and not replaces_instrument(both[1:])


def test_a_size_that_might_be_anything_is_not_told(groups):
    problem, ((alone, *_), *_) = groups
    nothing = replace(alone, start={"siemens": 1e-9})  # far below the noise, whatever its size
    size = len(problem.model.calibrations)
    unfitted = fit(problem, [nothing], np.zeros(size + 1), limits=FitLimits(0.0))
    assert not SIZE.admits(last_resorts.size_sd(unfitted))
    recorded = small_recording(*AGAINST_GROUND[:1], noise=NOISE)
    seen = replace(problem, readings=recorded.voltage)
    large = replace(alone, start={"siemens": SIEMENS})
    assert SIZE.admits(last_resorts.size_sd(fit(seen, [large], np.zeros(size + 1))))


@pytest.mark.long
def test_a_source_against_ground_is_named_with_its_sizes_and_never_certain():
    found = diagnosis.diagnose(small_recording(*AGAINST_GROUND, noise=NOISE))
    first, second = found.explanation.fit.settings()
    assert [c.name for c in found.explanation.effects] == ["ground-return", "common-mode"]
    assert first.values["siemens"] == pytest.approx(SIEMENS, rel=0.02)
    assert second.values["ratio"] == pytest.approx(RATIO, rel=0.02)
    assert certainty.held_out_p(found) == 0.0
    for index in range(2):
        assert not certainty.is_certain(certainty.certainty(found, index))


def test_what_is_not_borne_out_leaves_nothing_of_its_noise(monkeypatch):
    """Neither in the covariance nor among what is kept of the sets that were met."""
    recorded = small_recording(*AGAINST_GROUND, noise=NOISE)
    _, search, _ = staging.prepared(recorded, 1)
    plain = search.problem
    search, before = refits.calibrated(search)
    rig = search.rig
    monkeypatch.setattr(last_resorts, "size_sd", lambda fitted: np.inf)
    assert prediction.is_unlike(search, before)
    untold, found = last_resorts.another_instrument(search, before)
    assert found is None and untold.problem is plain and untold.rig is rig
    assert not untold.cache.met and untold.unblurred is None
    monkeypatch.undo()
    blurred, found = last_resorts.another_instrument(search, before)
    assert replaces_instrument(found.effects) and blurred.problem is not plain
    # A set of less is one of the same noise.
    less = refits.reduced(blurred, found, 1)
    assert less.fit.problem.whitening is blurred.problem.whitening
    assert blurred.restored().problem is plain and blurred.restored().rig is rig
    monkeypatch.setattr(growth, "_confirmed", lambda search, explanation: before)
    start = StartingPoint.from_explanation(found)
    ended, again, state = growth.run(search, start)
    assert ended.problem is not plain and replaces_instrument(state.effects)
    assert not again.effects


def test_untouched_frames_in_noise_of_their_own_making_begin_nothing():
    recorded = small_recording(*AGAINST_GROUND, noise=NOISE)
    _, search, _ = staging.prepared(recorded, 1)
    assert staging._untouched_first(search, recorded, 1) is None


def test_a_last_resort_is_not_among_what_could_not_be_shown():
    recorded = small_recording(noise=NOISE, places=1)
    found = diagnosis.diagnose(recorded)
    assert "ground-return" not in conclusion.unobservable(found)


@pytest.mark.long
def test_the_real_hydrogel_skin_has_candidates_with_the_intervals_that_its_misfit_allows():
    """Its owner's simulation leaves 0.73 of |v|; of what is found nothing is certain."""
    recorded = importers.load(shared_data("hydrogel-skin/ohmc16.mat"))
    found = diagnosis.diagnose(of_frames(recorded, np.arange(len(recorded.frames)) < 120))
    assert [c.name for c in found.explanation.effects] == ["ground-return", "common-mode"]
    sd = np.sqrt(np.diag(found.explanation.fit.covariance))
    assert 0.1 < sd[found.explanation.fit.coordinate_slice(0)][0] < SIZE.threshold
    before, after = (
        np.sqrt(np.nanmean((recorded.voltage[:120] - f.voltage()) ** 2))
        for f in (found.baseline.fit, found.explanation.fit)
    )
    assert after < 0.7 * before
