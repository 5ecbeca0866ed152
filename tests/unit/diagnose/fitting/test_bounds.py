"""What ended a fit at a bound of what is tried is said, and has no interval."""

import json
from dataclasses import replace
from functools import cache
from html import unescape
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from diagnosed_skin import SCHEMA, diagnosed
from eitskin.diagnose.fitting.estimates import amounts, calibration, estimates, range_share
from eitskin.diagnose.fitting.fit import fit
from eitskin.diagnose.fitting.simulator import MAX_SD, UNKNOWN, Calibration
from eitskin.diagnose.report import page
from eitskin.diagnose.verdict import words
from eitskin.diagnose.verdict.validation import validate
from eitskin.effects import EFFECTS
from eitskin.errors import InputError
from small_skin import SKIN, candidates_of, problem_of, small_recording

IMPEDIVITY = "contact_impedivity_ohm_m2"
START, SD = UNKNOWN[IMPEDIVITY]


def contacts(ratio):
    """A fit to a skin whose contacts, which nobody knows, have `ratio` times the impedivity that
    calibrations start from."""
    skin = replace(SKIN, contact_impedivity_ohm_m2=ratio * START)
    recorded = small_recording(noise=0.0, places=3, skin=skin)
    unknown = {**recorded.metadata["skin"], IMPEDIVITY: None}
    recorded = replace(recorded, metadata=recorded.metadata | {"skin": unknown})
    problem, _ = problem_of(recorded, noise=1e-6)
    return fit(problem, [], np.zeros(len(problem.model.calibrations)), polish=True)


@pytest.mark.parametrize("ratio, bound", [(100.0, "high"), (1e-3, "low")])
def test_a_calibration_beyond_what_is_tried_ends_at_its_bound(ratio, bound):
    found = calibration(contacts(ratio))
    assert found[IMPEDIVITY]["at_bound"] == bound
    limit = START * np.exp(MAX_SD * SD if bound == "high" else -MAX_SD * SD)
    assert np.isclose(found[IMPEDIVITY]["value"], limit, rtol=0.07)
    word = {"high": "largest", "low": "least"}[bound]
    (said,) = words.bound_sentences({IMPEDIVITY: found[IMPEDIVITY]})
    assert said.startswith(f"The contact impedivity of all electrodes ended at the {word} value")
    assert said.endswith("Ω·m²; its interval means nothing.")


@pytest.mark.parametrize("ratio", [0.3, 1.0, 5.0])
def test_a_calibration_within_what_is_tried_is_at_no_bound(ratio):
    found = calibration(contacts(ratio))
    assert np.isclose(found[IMPEDIVITY]["value"], ratio * START, rtol=1e-2)
    assert "at_bound" not in found[IMPEDIVITY] and words.bound_sentences(found) == []


@given(
    st.floats(-30.0, 30.0), st.sampled_from([-2.0, 0.5, 80.0]), st.floats(0.1, 3.0), st.booleans()
)
def test_a_value_is_at_the_bound_that_it_is_near(coordinate, start, sd, log):
    one = Calibration("one", "1", start, sd, log)
    low, high = sorted((one.value(-1e3), one.value(1e3)))
    ended, value = one.at_bound(coordinate), one.value(coordinate)
    if ended is None:
        assert low < value < high
    else:
        near = {"low": low, "high": high}[ended]
        assert abs(value - near) < abs(value - (low + high - near))


def planted(name, key, value):
    """An effect of one parameter in a recording, its sentence and the parameter's estimate."""
    kind = next(iter(EFFECTS[name].sites), None)
    sites = {kind: [5]} if kind else {}
    recorded = small_recording(
        {"name": name, **sites, "parameters": {key: value}}, noise=0.0, places=3
    )
    problem, scales = problem_of(recorded)
    known = candidates_of(recorded, problem, scales)
    effect = next(c for c in known if c.name == name and c.sites == ((5,) if kind else None))
    fitted = fit(problem, [effect], np.zeros(1 + effect.size), polish=True)
    found = estimates(fitted, 0)
    entry = {"name": name, "scope": effect.scope or "common", "parameters": found}
    entry |= {each: sites.get(each, []) for each in words.NOUNS}
    return found[key], words.effect_sentence(entry, effect.effect)


@pytest.mark.parametrize(
    "name, key, value, bound",
    [
        ("measurement-gain", "gain", 0.0, "low"),
        ("measurement-gain", "gain", 0.01, None),
        ("measurement-gain", "gain", 1.02, None),
        ("crosstalk", "epsilon", 0.25, "high"),
        ("crosstalk", "epsilon", 0.24, None),
        ("indenter-grounding", "siemens_per_N", 0.0, "low"),
    ],
)
def test_a_parameter_at_its_bound_is_said_without_an_interval(name, key, value, bound):
    found, said = planted(name, key, value)
    assert found.get("at_bound") == bound
    assert np.isclose(found["value"], value, atol=1e-3 if key != "siemens_per_N" else 1e-6)
    if bound is None:
        assert "90 %" in said and "tried" not in said
    else:
        word = {"high": "largest", "low": "least"}[bound]
        assert f"(the {word} value tried, without an interval)" in said and "90 %" not in said


@pytest.mark.parametrize("known, bound", [(0.03, None), (3.0, "low")])
def test_a_small_value_that_is_known_is_at_no_bound_where_nothing_is_the_least(known, bound):
    """known: the value's sd over it."""
    recorded = small_recording(noise=0.0, places=3)
    problem, scales = problem_of(recorded)
    name, key = "indenter-grounding", "siemens_per_N"
    effect = next(c for c in candidates_of(recorded, problem, scales) if c.name == name)
    small = np.array([1e-5])
    fitted = SimpleNamespace(
        effects=[effect],
        theta=small,
        covariance=np.diag((known * small) ** 2),
        coordinate_slice=lambda _: slice(0, 1),
    )
    found = estimates(fitted, 0)[key]
    assert 0.0 < found["value"] < found["high"] and found.get("at_bound") == bound


def test_in_a_list_each_value_has_its_own_bound():
    numbers = {"value": [0.0, 1.1, 0.9], "low": [0.0, 1.0, 0.8], "high": [0.4, 1.2, 1.0]}
    estimate = {**numbers, "unit": "1", "at_bound": ["low", None, None]}
    first, *others = words.value_texts(estimate)
    assert first == "0 (the least value tried, without an interval)"
    assert others == words.value_texts({**numbers, "unit": "1"})[1:]


def test_a_size_without_a_direction_is_at_no_bound():
    recorded = small_recording(noise=0.0, places=2)
    problem, scales = problem_of(recorded)
    known = candidates_of(recorded, problem, scales)
    stretched = next(c for c in known if c.name == "anisotropy")
    most = EFFECTS["anisotropy"].parameters["ratio"].high
    ended = [stretched.at_bound("ratio", np.array(value)).item() for value in (1.0, 1.1, most)]
    assert ended == [None, None, "high"]
    assert stretched.at_bound("angle_deg", np.array(360.0)).item() is None


@pytest.fixture
def folder(tmp_path):
    """The folder of a diagnosis whose conductivity ended at a bound, and its recording."""
    made, recording = diagnosed(tmp_path / "explained")
    said = json.loads((made / "diagnosis.json").read_text(encoding="utf-8"))
    said["calibration"]["conductivity_S_per_m"]["at_bound"] = "high"
    (made / "diagnosis.json").write_text(json.dumps(said), encoding="utf-8")
    return made, recording, said


@pytest.mark.usefixtures("undrawn")
def test_a_report_says_what_is_pinned_and_prints_no_interval(folder):
    made, recording, said = folder
    page.write(made, recording, SCHEMA, made / "report.html")
    text = unescape((made / "report.html").read_text(encoding="utf-8"))
    (sentence,) = words.bound_sentences(said["calibration"])
    assert sentence in text and "0.499 (90 %" not in text
    assert "0.499\xa0S/m (the largest value tried, without an interval)" in text


@pytest.mark.parametrize("ended", ["middle", ["low"], 3])
def test_a_bound_is_low_or_high_one_a_value(folder, ended):
    said = folder[2]
    said["calibration"]["conductivity_S_per_m"]["at_bound"] = ended
    with pytest.raises(InputError, match=r"calibration\.conductivity_S_per_m\.at_bound"):
        validate(said, SCHEMA, "diagnosis.json")


@pytest.mark.parametrize("name", ["relaxation", "contact-impedance"])
def test_an_interval_of_all_values_holds_the_whole_range(name):
    recorded = small_recording(noise=0.0, places=1)
    problem, scales = problem_of(recorded)
    effect = next(c for c in candidates_of(recorded, problem, scales) if c.name == name)

    def share(sd):
        theta, covariance = np.full(effect.size, 0.1), sd**2 * np.eye(effect.size)
        fitted = SimpleNamespace(
            effects=[effect],
            theta=theta,
            covariance=covariance,
            coordinate_slice=lambda _: slice(0, effect.size),
        )
        return range_share(fitted, 0)

    shares = [share(sd) for sd in (1e-3, 1e-2, 1e-1, 100.0)]
    assert shares == sorted(shares) and shares[0] < 0.01
    assert np.isclose(shares[-1], 1.0)


@cache
def a_patch():
    recorded = small_recording(noise=0.0, places=1)
    problem, scales = problem_of(recorded)
    known = candidates_of(recorded, problem, scales)
    return next(c for c in known if c.name == "conductivity-patch")


def patch(theta, covariance):
    """A fit of a patch at coordinates, and what parameters come to there."""
    fitted = SimpleNamespace(
        effects=[a_patch()],
        theta=theta,
        covariance=covariance,
        coordinate_slice=lambda _: slice(0, 4),
    )
    return fitted, amounts(fitted, 0, estimates(fitted, 0))


def radius(fitted, theta):
    (effect,) = fitted.effects
    return effect.effect.combination.amounts(effect.setting(theta).values)["equivalent_radius_mm"][
        0
    ]


def opposed(theta, sd):
    """(4, 4): a covariance in which radius and contrast may change by sd as long as what they come
    to stays."""
    fitted, _ = patch(theta, np.eye(4))
    slopes = [np.log(radius(fitted, theta + s) / radius(fitted, theta)) for s in 1e-4 * np.eye(4)]
    along = np.array([0.0, 0.0, slopes[3], -slopes[2]]) / np.hypot(*slopes[2:])
    return sd**2 * np.outer(along, along) + 0.003**2 * np.eye(4)


THETA = np.array([0.1, -0.2, 0.3, 0.4])


def test_what_parameters_come_to_is_known_better_than_each():
    """The interval against draws; between radius and contrast a correlation of almost -1."""
    covariance = opposed(THETA, 5.0)
    fitted, told = patch(THETA, covariance)
    found, each = told["equivalent_radius_mm"], estimates(fitted, 0)["radius_mm"]
    assert found["unit"] == "mm" and np.isclose(found["value"], radius(fitted, THETA))
    assert np.log(found["high"] / found["low"]) < 0.3 * np.log(each["high"] / each["low"])
    drawn = np.random.default_rng(1).multivariate_normal(THETA, 1e-8 * covariance, 4000)
    spread = np.std([np.log(radius(fitted, one)) for one in drawn])
    assert np.isclose(np.log(found["high"] / found["value"]), 1.6449e4 * spread, rtol=0.1)


@pytest.mark.parametrize(
    "theta, covariance",
    [
        (THETA, opposed(THETA, 0.003)),  # each is told
        (THETA, np.diag([1.0, 1.0, 25.0, 25.0])),  # neither, nor what they come to
        (np.array([0.1, -0.2, 0.01, 0.3]), np.diag([0.1, 0.1, 1e-4, 0.04])),  # the radius is
        (np.array([0.1, -0.2, 0.3, 0.0]), np.diag([0.1, 0.1, 1.0, 1.0])),  # there may be none
        (np.array([0.1, -0.2, -60.0, 0.4]), np.diag([0.1, 0.1, 25.0, 0.01])),  # a bound
    ],
)
def test_no_amount_stands_where_it_tells_no_more(theta, covariance):
    _, told = patch(theta, covariance)
    assert told == {}
