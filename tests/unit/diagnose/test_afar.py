"""Fits from afar, where nobody touches: a body whose depth and electrode height nobody knows."""

from dataclasses import replace

import numpy as np
import pytest

from eitskin.data.recording import Recording
from eitskin.diagnose.fitting import readings
from eitskin.diagnose.fitting.held_out import folds
from eitskin.diagnose.noise.noise_model import NoiseModel
from eitskin.diagnose.search import far_starts, growth, proposals, refits
from eitskin.diagnose.search.catalogue import Conditions, catalogue
from eitskin.diagnose.search.gates import AGAIN, DISTINCT, EVIDENCE
from eitskin.diagnose.search.journal import Refusal
from eitskin.diagnose.search.search import Search
from eitskin.diagnose.verdict.gaps import gaps
from eitskin.effects import EFFECTS
from eitskin.effects.settings import site_counts
from small_skin import CHANNELS, SKIN, small_recording

NOISE = 1e-2
TANK = replace(
    SKIN,
    thickness_mm=0.9 * SKIN.radius_mm,
    electrode_height_mm=0.3 * SKIN.radius_mm,
    electrode_z_mm=None,
)


def untouched(*items, skin=SKIN, **unknown) -> Recording:
    """The untouched frames of a recording, of whose skin its owner knows less."""
    every = small_recording(*items, noise=NOISE, places=1, skin=skin)
    rows = np.flatnonzero(~every.frames["touch"].to_numpy(bool))
    frames = every.frames.iloc[rows].reset_index(drop=True)
    known = every.metadata["skin"] | unknown
    known = {k: v for k, v in known.items() if v is not None or not k.startswith("electrode_h")}
    return Recording(frames, every.voltage[rows], None, None, every.metadata | {"skin": known})


def search_of(recorded: Recording) -> Search:
    sd = np.full(len(CHANNELS), NOISE * np.median(np.abs(recorded.voltage)))
    problem, scales = readings.problem_of(recorded, NoiseModel(sd, 1e3, "given"))
    counts = site_counts(CHANNELS)
    believed = problem.model.nominal_skin
    conditions = Conditions(recorded.skin, believed, counts, True, True, touched=False)
    every = catalogue(conditions, recorded.voltage, scales)
    model = problem.model
    fold = folds(model.touched, model.press, CHANNELS, 1)
    return Search(problem, every, fold, seed=1, report=lambda line: None, learns_rig=True)


def test_a_body_is_fitted_from_the_nearest_of_its_starts_and_comes_first():
    """By the gates of evidence and chance, before any other name is tried: others take what the
    depth does."""
    body = {"name": "third-dimension"}
    search = search_of(untouched(body, skin=TANK, thickness_mm=None, electrode_height_mm=None))
    assert search.problem.model.coarse and search.folds.ndim == 2
    search, sheet = refits.calibrated(search)
    first, *_ = [
        s.candidate
        for s in proposals._far(search, sheet, [])
        if s.candidate.name == "third-dimension"
    ]
    found = refits.with_effect(search, sheet, first)
    assert found.log_evidence > sheet.log_evidence + 15
    assert found.fit.chi2 < 1.2 * search.problem.whitening.size
    # No trial beside a coarse body counts as one whose touches were followed.
    assert found.fit.problem.model is search.problem.model
    foremost = growth._as_body(search, sheet)
    assert foremost is not None and foremost.effects == [first]
    assert foremost.p_values.keys() == {first.key}


def test_a_body_has_no_rival_that_imitates_it():
    search = search_of(untouched(thickness_mm=None, electrode_height_mm=None))
    first = {c.name: c for c in reversed(search.candidates)}
    body, disc, gain = (first[n] for n in ("third-dimension", "conductivity-patch", "drive-gain"))
    others = [c for c in search.candidates if c.name == body.name and c.key != body.key]
    assert others and not any(proposals._is_rival(search, c, body) for c in [body, *others, disc])
    assert proposals._is_rival(search, gain, body)
    assert proposals._is_rival(search, disc, gain) and proposals._is_rival(search, body, disc)
    assert not proposals._is_rival(search, disc, disc)


def test_where_a_sheet_is_right_no_body_is_worth_its_name():
    search = search_of(untouched(thickness_mm=None, electrode_height_mm=None))
    search, sheet = refits.calibrated(search)
    tried = [
        refits.with_effect(search, sheet, s.candidate) for s in proposals._far(search, sheet, [])
    ]
    assert tried
    bodies = [trial for trial in tried if not isinstance(trial, Refusal)]
    assert all(body.log_evidence < sheet.log_evidence + 1 for body in bodies)
    assert growth._as_body(search, sheet) is None
    refused = [d for d in search.journal.decisions if not EVIDENCE.admits(d.value)]
    assert EVIDENCE.name in {d.gate for d in refused}


def test_a_body_far_behind_is_not_tried_beside_further_effects():
    search = search_of(untouched())
    search, sheet = refits.calibrated(search)
    names = {s.candidate.name for s in proposals._far(search, sheet, [])}
    assert "third-dimension" in names
    for lack, is_tried in ((AGAIN.threshold - 1.0, True), (AGAIN.threshold + 1.0, False)):
        search.cache.lacks["third-dimension"] = lack
        tried = {s.candidate.name for s in proposals._far(search, sheet, [])}
        assert tried == names - (set() if is_tried else {"third-dimension"})


def test_a_touched_skin_of_unknown_height_has_no_body_among_its_candidates():
    recorded = small_recording(noise=NOISE, places=1)
    problem, scales = readings.problem_of(
        recorded, NoiseModel(np.full(len(CHANNELS), 1e-6), 1e3, "given")
    )
    believed, counts = problem.model.nominal_skin, site_counts(CHANNELS)
    touched = Conditions(recorded.skin, believed, counts, True, True, touched=True)
    every = catalogue(touched, recorded.voltage, scales)
    assert "third-dimension" not in {c.name for c in every}
    every = catalogue(replace(touched, touched=False), recorded.voltage, scales)
    bodies = [c for c in every if c.name == "third-dimension"]
    assert bodies and all(far_starts.is_far(c) for c in bodies)


def test_starts_have_room_for_their_electrodes():
    skin = replace(TANK, thickness_mm=None, electrode_height_mm=None, electrode_z_mm=6.0)
    starts = EFFECTS["third-dimension"].starts(skin, np.zeros((1, 1)))
    assert len(starts) > 8
    for start in starts:
        half = 0.5 * start["electrode_height_mm"]
        assert 6.0 - half >= 0.0 and 6.0 + half <= start["depth_mm"]


def test_a_place_that_nobody_knows_starts_off_the_middle_where_there_is_room():
    skin = replace(TANK, electrode_height_mm=None)
    starts = EFFECTS["third-dimension"].starts(skin, np.zeros((1, 1)))
    depth, placed = skin.thickness_mm, [s for s in starts if "electrode_z_mm" in s]
    assert placed and len(placed) < len(starts)
    for start in placed:
        half, z = 0.5 * start["electrode_height_mm"], start["electrode_z_mm"]
        assert half <= z < 0.45 * depth
    assert all("depth_mm" not in s for s in starts)


def test_starts_of_a_name_differ_in_their_first_coordinate():
    body = {"name": "third-dimension"}
    search = search_of(untouched(body, skin=TANK, thickness_mm=None, electrode_height_mm=None))
    search, sheet = refits.calibrated(search)
    bodies = [[c] for c in search.candidates if c.name == body["name"]]
    starts = refits._starts(refits.rough(search, sheet), sheet.fit, bodies, None)
    depths = [candidate.start["depth_mm"] for _, (candidate,) in starts]
    assert len(depths) == len(set(depths)) > 1


def test_before_a_fit_from_afar_bodies_are_solved_coarsely():
    search = search_of(untouched())
    search, sheet = refits.calibrated(search)
    rough, problem = refits.rough(search, sheet), search.problem
    assert rough.model.coarse and rough.model.solved_skins is problem.model.solved_skins
    assert rough.whitening.size == problem.whitening.size
    residual = [p.residual(np.zeros(len(p.model.calibrations)), []) for p in (rough, problem)]
    assert (residual[0] ** 2).sum() < (residual[1] ** 2).sum()


@pytest.mark.long
def test_rivals_of_a_body_are_fitted_even_when_no_more_may_be_solved(monkeypatch):
    """What a tangent promises so far away is not kept: it would make every name an alternative."""
    body = {"name": "third-dimension"}
    search = search_of(untouched(body, skin=TANK, thickness_mm=None, electrode_height_mm=None))
    search, sheet = refits.calibrated(search)
    first, *_ = [
        s.candidate
        for s in proposals._far(search, sheet, [])
        if s.candidate.name == "third-dimension"
    ]
    found = refits.with_effect(search, sheet, first)
    free = {g.rival: g.gap for g in gaps(search, found, 0)}
    monkeypatch.setattr(Search, "spent", property(lambda self: True))
    spent = {g.rival: g.gap for g in gaps(search, found, 0)}
    assert set(spent) <= set(free) and "electrode-width" in spent
    assert {n for n in spent if spent[n] < DISTINCT.threshold} <= {
        n for n in free if free[n] < DISTINCT.threshold
    }
