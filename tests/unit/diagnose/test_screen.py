"""Score tests: their p-values are uniform by chance, alone and over the whole catalogue."""

from copy import copy
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import chdtrc
from scipy.stats import binom, kstest

from eitskin.diagnose.fitting.candidates import is_discrete
from eitskin.diagnose.fitting.fit import fit
from eitskin.diagnose.fitting.tangents import Tangents
from eitskin.diagnose.search import channels, tones
from eitskin.diagnose.search.screen import (
    NullDistribution,
    best_few,
    chance_p_value,
    log_evidence,
    null_distribution,
    score,
    sparse,
    subset,
)
from small_skin import SKIN, calibrated, candidates_of, problem_of, small_recording

PROBLEM, SCALES = problem_of(small_recording(places=2))
CATALOGUE = candidates_of(small_recording(places=2), PROBLEM, SCALES)
DRAWS = 150


@pytest.fixture(scope="module")
def tangents():
    return Tangents(calibrated(PROBLEM))


def test_a_tone_is_not_sought_in_few_frames_or_one_channel_and_without_their_duration(tangents):
    tone = next(c for c in CATALOGUE if c.effect.tone)
    frames = np.arange(len(PROBLEM.readings))

    def scored(count, frame_s=PROBLEM.model.frame_s, channels=PROBLEM.model.channels):
        mask = PROBLEM.whitening.mask & (frames < count)[:, None]
        model = copy(PROBLEM.model)
        model.frame_s, model.channels = frame_s, channels
        few = copy(tangents)
        few.problem = replace(PROBLEM, model=model, whitening=replace(PROBLEM.whitening, mask=mask))
        return tones.score(few, tone.effect, tone.skin, SCALES)

    assert len(frames) > tones.LEAST_FRAMES and scored(len(frames)) is not None
    assert scored(tones.LEAST_FRAMES - 1) is None
    assert scored(len(frames), None) is None
    assert scored(len(frames), channels=PROBLEM.model.channels[:1]) is None


@pytest.fixture(scope="module")
def columns(tangents):
    """Every candidate with tangents, kept for residuals of any noise."""
    usable = [
        c
        for c in CATALOGUE
        if c.kind != "channels" and not is_discrete(c) and c.name != "mains-interference"
    ]
    return {c.key: (c, tangents.columns(c)) for c in usable if len(tangents.columns(c))}


def noisy(tangents, columns, draw):
    """What score tests see of a recording without any effect."""
    residual = tangents.project_out(draw.normal(size=tangents.residual.size))
    return SimpleNamespace(
        marginal=tangents.marginal,
        residual=residual,
        columns=lambda c: np.concatenate([columns[key][1] for key in _parts(c, columns)]),
        problem=tangents.problem,
        voltage=tangents.voltage,
        fitted_directions=tangents.fitted_directions,
        channel_directions=tangents.channel_directions,
        column_count=tangents.column_count,
        single_precision=tangents.single_precision,
    )


def _parts(candidate, columns):
    if candidate.key in columns:
        return [candidate.key]
    return [sparse(candidate, (site,)).key for site in candidate.sites]


def test_a_score_s_p_value_is_uniform_by_chance(tangents, columns):
    draw = np.random.default_rng(1)
    p = [
        [score(seen, c).p_value for c, _ in list(columns.values())[::40]]
        for seen in (noisy(tangents, columns, draw) for _ in range(DRAWS))
    ]
    assert all(kstest(one, "uniform").pvalue > 1e-4 for one in np.transpose(p))


def test_the_least_p_value_of_the_catalogue_is_calibrated(tangents, columns):
    chosen = [c for c, _ in columns.values()]
    nothing = null_distribution(tangents, chosen, 0, 1)
    draw = np.random.default_rng(2)
    found = []
    for _ in range(DRAWS):
        seen = noisy(tangents, columns, draw)
        found.append(nothing.p_value(min(score(seen, c).p_value for c in chosen)))
    assert kstest(found, "uniform").pvalue > 1e-3
    assert nothing.p_value(0.0) == pytest.approx(1 / (1 + len(nothing.least_p_values)))


def test_the_choice_of_the_best_few_sites_counts(tangents, columns):
    """Tested as if they had been given, channels would surprise by chance far too often."""
    drives = next(c for c, _ in columns.values() if (c.name, c.scope) == ("drive-gain", "dense"))
    single = next(c for c in CATALOGUE if c.name == "channel-gain")
    draw = np.random.default_rng(5)
    several = []
    for _ in range(400):
        seen = noisy(tangents, columns, draw)
        of_channels = channels.scores(seen, single)[2:-1]
        several.append([best_few(seen, drives), *(of_channels or [None])])
    few_drives, few_channels = np.transpose(several)
    often = binom.ppf(0.999, len(several), 0.05)
    assert sum(s.p_value < 0.05 for s in few_drives if s) <= often
    assert sum(s.p_value < 0.05 for s in few_channels if s) <= often
    assert sum(chance_p_value(s.gain, s.dof) < 0.05 for s in few_channels if s) > 5 * often


def test_chance_of_the_best_of_several_choices():
    assert chance_p_value(9.0, 1) == chdtrc(1, 9.0)
    assert chance_p_value(9.0, 1, 100) == pytest.approx(1 - (1 - chdtrc(1, 9.0)) ** 100)
    assert chance_p_value(200.0, 1, 100) == pytest.approx(100 * chdtrc(1, 200.0))
    assert chance_p_value(-3.0, 1, 100) == 1.0


def test_a_channel_that_is_fitted_already_has_nothing_to_gain(tangents):
    dense = next(c for c in CATALOGUE if c.name == "channel-gain")
    gain = next(iter(dense.effect.parameters.values()))
    change = np.zeros_like(tangents.voltage)
    change[:, 5] = dense.scales.typical_change(gain) * dense.effect.slope(tangents.voltage)[:, 5]
    own = tangents.project_out(tangents.problem.whitening(change).ravel())
    seen = SimpleNamespace(
        marginal=tangents.marginal,
        residual=tangents.residual - (tangents.residual @ own) * own / (own @ own),
        problem=tangents.problem,
        voltage=tangents.voltage,
        fitted_directions=np.concatenate([tangents.fitted_directions, [own / np.linalg.norm(own)]]),
        channel_directions=tangents.channel_directions,
        column_count=tangents.column_count,
        single_precision=tangents.single_precision,
    )
    every = channels.scores(seen, dense)[-1]
    assert every.dof == 39 and np.isfinite(every.gain)


def test_a_channel_whose_gain_is_all_but_an_offset_is_told_as_in_double_precision(monkeypatch):
    """Of a gain an offset takes all but the share by which touches change the readings."""
    skin = replace(SKIN, radius_mm=90.0)
    gain = {"name": "channel-gain", "channels": [7], "parameters": {"gain": 1.3}}
    recorded = small_recording(gain, noise=1e-4, places=8, skin=skin)
    problem, scales = problem_of(recorded, 1e-4)
    of = {c.name: c for c in candidates_of(recorded, problem, scales) if c.scope == "dense"}
    offset, gains = of["offset"], of["channel-gain"]
    start = np.zeros(len(problem.model.calibrations) + offset.size)
    tangents = Tangents(fit(problem, [offset], start, polish=True))
    assert tangents.single_precision is not problem.whitening
    found = channels.scores(tangents, gains)
    monkeypatch.setitem(vars(tangents), "single_precision", problem.whitening)
    for one, other in zip(found, channels.scores(tangents, gains), strict=True):
        assert one.candidate.sites == other.candidate.sites and one.dof == other.dof
        assert one.gain == pytest.approx(other.gain, rel=1e-6)
    assert found[0].candidate.sites == (7,) and found[0].gain > 1e3 and found[-1].dof == 40


def test_further_looks_count():
    alone, many = (
        NullDistribution(np.linspace(0.0, 1.0, 1001), 0),
        NullDistribution(np.linspace(0.0, 1.0, 1001), 500),
    )
    assert many.p_value(1e-3) > alone.p_value(1e-3) + 0.3


def test_a_planted_signature_has_the_best_score(tangents, columns):
    draw = np.random.default_rng(3)
    alone = [c for c, own in columns.values() if len(own) == 1]
    for candidate in alone[::10]:
        own = columns[candidate.key][1]
        seen = noisy(tangents, columns, draw)
        seen.residual = seen.residual + 30.0 * own[0] / np.linalg.norm(own[0])
        gains = {c.key: score(seen, c).gain for c in alone}
        assert gains[candidate.key] > 0.97 * max(gains.values())


def test_evidence_falls_where_a_coordinate_brings_nothing():
    assert log_evidence(np.zeros(1), np.full((1, 1), 1e4)) < 0.0
    assert log_evidence(np.full(1, 2e3), np.full((1, 1), 1e4)) > 100.0
    assert log_evidence(np.zeros(0), np.zeros((0, 0))) == -np.inf


def test_a_subset_is_found(tangents):
    dense = next(c for c in CATALOGUE if c.name == "contact-impedance" and c.scope == "dense")
    own = tangents.columns(dense)
    residual = 20.0 * (own[2] / np.linalg.norm(own[2]) - own[6] / np.linalg.norm(own[6]))
    seen = SimpleNamespace(
        marginal=tangents.marginal,
        residual=residual,
        columns=tangents.columns,
        column_count=tangents.column_count,
    )
    assert subset(seen, dense).sites == (2, 6)


def test_single_channels_scores_are_those_of_their_columns(tangents):
    dense = next(c for c in CATALOGUE if c.name == "channel-gain")
    best, second, *rest = channels.scores(tangents, dense)
    for found in (best, second):
        alone = score(tangents, sparse(dense, found.candidate.sites))
        assert found.gain == pytest.approx(alone.gain, rel=1e-6)
        assert found.p_value == pytest.approx(alone.p_value, rel=1e-5)
    assert rest[-1].candidate == dense and rest[-1].dof == 40
