"""Tangents against differences of the simulator itself."""

from dataclasses import replace

import numpy as np
import pytest

from eitskin.data.subset import of_frames
from eitskin.diagnose.fitting.candidates import is_discrete
from eitskin.diagnose.fitting.fit import FitLimits, fit
from eitskin.diagnose.fitting.tangents import MIN_SPREAD, Tangents
from eitskin.effects.effect import LeakEffect
from eitskin.physics.skin import Skin
from small_skin import calibrated, candidates_of, kinds_of, problem_of, small_recording

RECORDED = small_recording(places=2)
PROBLEM, SCALES = problem_of(RECORDED)
STEP = 1e-3
# A patch's tangent is that of a faint one in untouched frames: enough to find its place.
ROUGH = ("conductivity-patch", "mains-interference")


def single(problem, scales):
    """Candidates whose coordinates have a tangent each."""
    return [
        c
        for c in kinds_of(candidates_of(RECORDED, problem, scales))
        if c.name not in ROUGH
        and c.kind != "channels"
        and not is_discrete(c)
        and c.scope != "dense"
    ]


# Under a floating source no leak acts alone.
KINDS = [c for c in single(PROBLEM, SCALES) if not isinstance(c.effect, LeakEffect)]
GROUNDED, _ = problem_of(
    replace(RECORDED, metadata={**RECORDED.metadata, "source_reference": "sink-grounded"})
)
LEAKS = [c for c in single(GROUNDED, SCALES) if isinstance(c.effect, LeakEffect)]


def of_candidate(candidate):
    return f"{candidate.name} {candidate.kind} {candidate.scope} {candidate.start}"


@pytest.fixture(scope="module")
def tangents():
    return Tangents(calibrated(PROBLEM))


@pytest.fixture(scope="module")
def grounded():
    return Tangents(calibrated(GROUNDED))


def ends(candidate, key):
    """Between how many steps of a parameter a difference is taken: none that its bounds cut."""
    if candidate.name == "force-lag":
        return 1, 0  # a press's beginning is a bend
    neutral = candidate.start.get(key, candidate.effect.neutral(key, candidate.skin))
    bound = candidate.at_bound(key, np.array(neutral)).item()
    return {"low": (1, 0), "high": (0, -1)}.get(bound, (1, -1))


def brute_force(tangents, candidate):
    """Differences of the readings, whitened, what is fitted projected out."""
    columns = []
    for i in np.flatnonzero(candidate.linear):
        unit = STEP * np.eye(candidate.size)[i]
        sides = ends(candidate, candidate.names[i][0])
        up, down = (
            tangents.problem.model.voltage(tangents.calibration, [candidate.setting(side * unit)])
            for side in sides
        )
        change = (up - down) / (STEP * (sides[0] - sides[1]))
        columns.append(tangents.project_out(tangents.problem.whitening(change).ravel()))
    return np.array(columns)


@pytest.mark.parametrize("candidate", KINDS, ids=of_candidate)
def test_tangents_are_differences(tangents, candidate):
    assert_differences(tangents, candidate)


@pytest.mark.parametrize("candidate", LEAKS, ids=of_candidate)
def test_tangents_of_leaks_are_differences_where_the_sink_is_grounded(grounded, candidate):
    assert_differences(grounded, candidate)


def assert_differences(tangents, candidate):
    expected = brute_force(tangents, candidate)
    expected = expected[(expected**2).sum(axis=1) > 1e-9]
    found = tangents.columns(candidate)
    assert found.shape == expected.shape
    for column, other in zip(found, expected, strict=True):
        assert np.linalg.norm(column - other) < 0.02 * np.linalg.norm(other)


def test_tangents_about_a_body_are_differences_of_accurate_ones():
    skin = {**RECORDED.metadata["skin"], "thickness_mm": 14.0, "electrode_height_mm": 6.0}
    skin["electrode_z_mm"] = 7.0
    recorded = replace(RECORDED, metadata={**RECORDED.metadata, "skin": skin})
    problem, scales = problem_of(recorded)
    every = candidates_of(recorded, problem, scales)
    body = next(c for c in every if c.name == "third-dimension")
    about = Tangents(fit(problem, [body], np.zeros(1), limits=FitLimits(-np.inf)))
    assert about.accuracy == "train"
    apart = []
    for name in ("contact-impedance", "electrode-position", "electrode-width", "touch-contrast"):
        candidate = next(c for c in every if c.name == name)
        sides = [
            problem.model.voltage(
                about.calibration, [*about.settings, candidate.setting(np.array([step]))]
            )
            for step in (STEP, -STEP)
        ]
        exact = problem.whitening((sides[0] - sides[1]) / (2 * STEP)).ravel()
        found = about.problem.whitening(about._change(candidate, 0)).ravel()
        apart.append(np.linalg.norm(found - exact) / np.linalg.norm(exact))
    assert max(apart) < 6e-3


@pytest.mark.parametrize("times, accuracy", [(1.01, "train"), (0.99, "diagnose")])
def test_tangents_are_those_of_an_accurate_skin(times, accuracy, monkeypatch):
    """On a small skin with wide electrodes, whose currents crowd most."""
    skin = Skin(30.0, 3.0, 0.5, tuple(45.0 * np.arange(8)), 8.7, 0.0, 1e-3, 0.5)
    skin = replace(skin, contact_impedivity_ohm_m2=times * MIN_SPREAD * 8.7e-3 / 0.5)
    recorded = small_recording(places=2, skin=skin)
    problem, scales = problem_of(recorded)
    found = Tangents(fit(problem, [], np.zeros(len(problem.model.calibrations))))
    assert found.accuracy == accuracy
    monkeypatch.setattr(Tangents, "_accuracy", lambda self: "diagnose")
    exact = Tangents(found.fit)
    for candidate in single(problem, scales):
        if not isinstance(candidate.effect, LeakEffect):
            for index in np.flatnonzero(candidate.linear):
                a, b = (one._raw_column(candidate, int(index)) for one in (found, exact))
                assert (a is None) == (b is None)
                assert a is None or np.linalg.norm(a - b) < 1e-3 * np.linalg.norm(b)


def test_nothing_fitted_is_left_in_them(tangents):
    knob = tangents.fit.jacobian.reshape(1, -1)
    for candidate in KINDS:
        columns = tangents.columns(candidate)
        lengths = np.linalg.norm(columns, axis=1) * np.linalg.norm(knob)
        assert (np.abs(columns @ knob.T).ravel() < 1e-6 * lengths).all()


def test_a_dense_candidate_has_the_columns_of_its_sites(tangents):
    every = candidates_of(RECORDED, PROBLEM, SCALES)
    own = [c for c in every if c.name == "contact-impedance"]
    dense, common = (next(c for c in own if c.scope == s) for s in ("dense", "common"))
    singles = [tangents.columns(c)[0] for c in own if c.scope == "sparse"]
    assert np.allclose(tangents.columns(dense), singles)
    assert np.allclose(tangents.columns(common)[0], np.sum(singles, axis=0))
    assert tangents.jacobian(dense).shape == (8, *RECORDED.voltage.shape)


@pytest.mark.parametrize("beside", [[], ["crosstalk"]])
@pytest.mark.parametrize("kind", ["drives", "measures"])
def test_gains_of_all_sites_are_differentiated_together(kind, beside):
    every = candidates_of(RECORDED, PROBLEM, SCALES)
    effects = [next(c for c in every if c.name == name) for name in beside]
    start = np.full(1 + sum(c.size for c in effects), 0.2)
    about = fit(PROBLEM, effects, start, polish=True)
    gains = [c for c in every if c.kind == kind and c.name.endswith("gain")]
    together = Tangents(about).columns(next(c for c in gains if c.scope == "dense"))
    singles = [Tangents(about).columns(c)[0] for c in gains if c.scope == "sparse"]
    assert np.allclose(together, singles, atol=1e-6 * np.abs(singles).max())


def test_a_patch_beside_several_has_the_derivative_of_another_patch():
    recorded = of_frames(RECORDED, ~RECORDED.frames["touch"].to_numpy(bool))
    problem, scales = problem_of(recorded)
    patches = [c for c in candidates_of(recorded, problem, scales) if c.effect.disc]
    first, second, third = (patches[i] for i in (20, 26, 32))
    contrast = next(i for i, (name, _) in enumerate(first.names) if name == "contrast")
    fitted = calibrated(problem)
    strong = np.eye(first.size)[contrast]
    theta = np.r_[fitted.theta, 2.0 * strong, -2.0 * strong]
    limits = FitLimits(renewals=0)
    tangents = Tangents(fit(problem, [first, second], theta, limits=limits))
    settings = tangents.settings
    up, down = (
        problem.model.voltage(
            tangents.calibration, [*settings, third.setting(side * STEP * strong)]
        )
        for side in (1.0, -1.0)
    )
    (column,) = [c for c in tangents.raw_columns(third) if c is not None]
    difference = ((up - down) / (2.0 * STEP)).ravel()
    np.testing.assert_allclose(column, difference, atol=2e-3 * np.abs(difference).max())
    assert tangents.raw_columns(first) == [None]  # no skin has a patch on another
