"""A diagnosis that begins with what an earlier one found: each effect has to be borne out anew."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from eitskin import cli
from eitskin.data import recording, subset
from eitskin.diagnose import corrected, diagnosis
from eitskin.diagnose.search import start
from eitskin.diagnose.search.screen import sparse
from eitskin.diagnose.search.start import Start
from eitskin.effects.effect import Setting
from eitskin.effects.settings import settings, site_counts
from eitskin.errors import InputError
from small_skin import CHANNELS, candidates_of, kinds_of, problem_of, small_recording

RECORDED = small_recording(places=2)
PROBLEM, SCALES = problem_of(RECORDED)
CANDIDATES = candidates_of(RECORDED, PROBLEM, SCALES)
SEVERAL = [sparse(c, (1, 4, 5)) for c in CANDIDATES if c.scope == "dense"]
KINDS = [*kinds_of(CANDIDATES), *SEVERAL]
KNOBS = len(PROBLEM.model.calibrations)
CONTACT = {"name": "contact-impedance", "electrodes": [3], "parameters": {"ratio": 1.7}}
NOISE = 5e-4


@given(st.sampled_from(KINDS), st.integers(0, 10**6))
def test_what_effects_yaml_says_is_a_candidate_again(candidate, seed):
    """The same name, sites and scope; the start that is nearest, of which the values are the
    same."""
    if candidate.effect.tone:
        candidate = replace(candidate, start={"frequency_Hz": 50.0})
    coordinates = np.random.default_rng(seed).uniform(-0.4, 0.4, candidate.size)
    (given_back,) = settings([candidate.item(coordinates)], site_counts(CHANNELS), (0, 0))
    found = Start.at([given_back], CANDIDATES, PROBLEM)
    (again,) = found.effects
    assert (again.name, again.kind, again.sites) == candidate.key[:3]
    assert again.scope == candidate.scope
    assert np.array_equal(found.theta[:KNOBS], np.zeros(KNOBS)) and not found.p_values
    values = again.setting(found.theta[KNOBS:]).values
    for key, value in candidate.setting(coordinates).values.items():
        if value is not None:
            wanted = np.asarray(value, float)
            assert values[key] == pytest.approx(wanted, rel=1e-6, abs=1e-9), key


def test_an_effect_that_is_not_sought_is_refused(tmp_path):
    timeless = candidates_of(RECORDED, PROBLEM, SCALES, timed=False)
    item = {"name": "conductivity-drift", "parameters": {"per_minute": 1e-4}}
    chosen: list[Setting] = settings([item], site_counts(CHANNELS), (0, 0))
    with pytest.raises(InputError, match="conductivity-drift, expected an effect that is sought"):
        Start.at(chosen, timeless, PROBLEM)


@pytest.mark.parametrize(
    ("content", "found"),
    [
        ({"skin": {}}, "twin.effects: found None"),
        ({"twin": {"effects": CONTACT}}, "twin.effects: found"),
        ({"twin": {"effects": [{"name": "contact"}]}}, "name: found 'contact'"),
        ({"twin": {"effects": [CONTACT | {"electrodes": [19]}]}}, "found [19]"),
    ],
)
def test_a_file_without_effects_is_refused_before_anything_is_written(
    content, found, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    recording.write(RECORDED, "skin.parquet")
    (tmp_path / "effects.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    assert cli.main(["diagnose", "skin.parquet", "--earlier", "effects.yaml"]) == cli.REFUSED
    said = capsys.readouterr().err
    assert said.startswith("effects.yaml: ") and found in said
    assert not (tmp_path / "diagnosis-skin").exists()


@pytest.fixture(scope="module")
def grown(tmp_path_factory):
    """A recording, its diagnosis, and the effects.yaml of its first part's."""
    recorded = small_recording(CONTACT, noise=NOISE, places=5)
    part = subset.of_frames(recorded, np.arange(len(recorded.frames)) < 0.8 * len(recorded.frames))
    found = diagnosis.diagnose(part)
    path = tmp_path_factory.mktemp("earlier") / "effects.yaml"
    text = corrected.text(found.after.fit, part, found.noise.sd, "part")
    path.write_text(text, encoding="utf-8")
    return recorded, diagnosis.diagnose(recorded), path


def test_a_recording_that_grew_has_the_diagnosis_that_it_has_from_nothing(grown):
    recorded, plain, path = grown
    earlier = start.read(path, recorded.channels)
    found = diagnosis.diagnose(recorded, earlier=earlier)
    actions = [(row["action"], row["effect"], row["sites"]) for row in found.search.path]
    assert actions == [("calibrate", "", ""), ("start", "contact-impedance", "3")]
    assert found.search.path[1]["p_value"] is None  # chance is asked after, on all frames
    assert [c.key for c in found.after.effects] == [c.key for c in plain.after.effects]
    assert found.after.log_evidence == pytest.approx(plain.after.log_evidence, abs=0.01)
    (effect,) = found.after.effects
    assert found.after.p_value(effect) == pytest.approx(plain.after.p_value(effect), rel=1e-6)
    again = diagnosis.diagnose(recorded, earlier=earlier)
    assert np.array_equal(found.after.fit.theta, again.after.fit.theta)


def test_what_was_found_earlier_and_is_not_there_is_not_found(grown):
    _, _, path = grown
    nothing = small_recording(noise=NOISE, places=4)
    found = diagnosis.diagnose(nothing, earlier=start.read(path, nothing.channels))
    assert found.after.effects == []
    assert [row["action"] for row in found.search.path] == ["calibrate"]


def test_what_came_since_is_found_beside_what_was_found_earlier(grown):
    """And what has gone beside it gives way."""
    _, _, path = grown
    other = {"name": "measurement-gain", "measures": [5], "parameters": {"gain": 1.02}}
    recorded = small_recording(CONTACT, other, noise=NOISE, places=4)
    found = diagnosis.diagnose(recorded, earlier=start.read(path, recorded.channels))
    names = {c.name: c.sites for c in found.after.effects}
    assert names == {"contact-impedance": (3,), "measurement-gain": (5,)}
    changed = small_recording(other, noise=NOISE, places=4)
    found = diagnosis.diagnose(changed, earlier=start.read(path, changed.channels))
    assert [(c.name, c.sites) for c in found.after.effects] == [("measurement-gain", (5,))]
