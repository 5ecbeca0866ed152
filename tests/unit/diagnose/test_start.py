"""A diagnosis that begins with what an earlier one found: each effect has to be borne out anew."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from eitskin import cli
from eitskin.data import recording, subset
from eitskin.diagnose import diagnosis, parts
from eitskin.diagnose.search import starting_point, tones
from eitskin.diagnose.search.screen import sparse
from eitskin.diagnose.search.starting_point import StartingPoint
from eitskin.effects.settings import settings, site_counts
from eitskin.errors import InputError
from small_skin import CHANNELS, candidates_of, kinds_of, problem_of, small_recording

pytestmark = pytest.mark.xdist_group("start")  # share what takes seconds

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
    same. What a recording decides, effects.yaml says as well."""
    if candidate.effect.tone:
        candidate = replace(candidate, start={"frequency_Hz": 50.0})
    coordinates = np.random.default_rng(seed).uniform(-0.4, 0.4, candidate.size)
    item = candidate.item(coordinates)
    for key, value in candidate.effect.recorded_values(PROBLEM.model.force_max_N).items():
        item["parameters"].setdefault(key, value)
    (given_back,) = settings([item], site_counts(CHANNELS), (0, 0))
    found = StartingPoint.from_settings([given_back], CANDIDATES, PROBLEM)
    (again,) = found.effects
    assert (again.name, again.kind, again.sites) == candidate.key[:3]
    assert again.scope == candidate.scope
    assert again.looks == candidate.looks or candidate.effect.tone
    assert again.start.keys() == candidate.start.keys()
    assert np.array_equal(found.theta[:KNOBS], np.zeros(KNOBS)) and not found.p_values
    values = again.setting(found.theta[KNOBS:]).values
    for key, value in candidate.setting(coordinates).values.items():
        if value is None:
            assert values[key] is None
        else:
            wanted = np.asarray(value, float)
            assert values[key] == pytest.approx(wanted, rel=1e-6, abs=1e-9), key


def test_what_the_recording_decides_does_not_count():
    """effects.yaml has half of that recording's largest force, a longer recording another."""
    gain = {"name": "force-dependent-gain", "parameters": {"per_N": 0.002, "F_mid_N": 4.9}}
    found = StartingPoint.from_settings(
        settings([gain], site_counts(CHANNELS), (0, 0)), CANDIDATES, PROBLEM
    )
    assert [c.name for c in found.effects] == ["force-dependent-gain"]


def test_a_tone_is_one_of_as_many_as_were_looked_at():
    tone = next(c for c in CANDIDATES if c.effect.tone)
    model = PROBLEM.model
    time_s = model.states["time_s"].to_numpy()
    _, looks, _ = tones.strongest(np.ones((len(time_s), len(CHANNELS))), time_s, model.frame_s)
    assert tones.at_frequency(tone, 50.0, model).looks == looks > 100


@pytest.mark.parametrize("shared_sd", [0.0, 2.0])
def test_noise_has_a_line_no_more_often_than_is_said(shared_sd):
    time_s, draw = 0.5 * np.arange(60), np.random.default_rng(5)
    p_values = []
    for _ in range(200):
        shared = draw.normal(size=(60, 1)) * np.sin(0.3 * np.arange(40))
        weighted = draw.normal(size=(60, 40)) + shared_sd * shared
        _, looks, prominence = tones.strongest(weighted, time_s, 0.4)
        p_values.append(tones.line_p_value(prominence, looks))
    for level in (1e-3, 0.1):
        assert np.mean(np.array(p_values) < level) <= level + 2.0 * np.sqrt(level / 200)


def test_a_weak_tone_is_a_line():
    time_s, draw = 0.5 * np.arange(100), np.random.default_rng(6)
    moments = time_s[:, None] + 0.4 / 40 * np.arange(40)
    weighted = draw.normal(size=(100, 40)) + 0.2 * np.sin(2 * np.pi * 17.3 * moments)
    frequency, looks, prominence = tones.strongest(weighted, time_s, 0.4)
    assert abs(frequency - 17.3) < 0.02 and tones.line_p_value(prominence, looks) < 1e-3


def test_an_effect_that_is_not_sought_begins_nothing():
    timeless = candidates_of(RECORDED, PROBLEM, SCALES, timed=False)
    drift = {"name": "conductivity-drift", "parameters": {"per_minute": 1e-4}}
    chosen = settings([CONTACT, drift], site_counts(CHANNELS), (0, 0))
    assert StartingPoint.from_settings(chosen, timeless, PROBLEM) is None
    assert len(StartingPoint.from_settings(chosen[:1], timeless, PROBLEM).effects) == 1


AT_DRIVE = {"name": "drive-gain", "drives": [2], "parameters": {"gain": 1.1}}


@pytest.mark.parametrize(
    ("content", "found"),
    [
        ({"skin": {}}, "twin.effects: found None, expected the list of effects"),
        ({"twin": {"effects": CONTACT}}, "twin.effects: found {'"),
        ({"twin": {"effects": [CONTACT, "x"]}}, "twin.effects[1]: found x, expected an effect"),
        ({"twin": {"effects": [{"name": "contact"}]}}, "name: found 'contact', expected one of"),
        ({"twin": {"effects": [CONTACT | {"electrodes": [19]}]}}, "electrodes: found [19]"),
        (
            {"twin": {"effects": [CONTACT | {"electrodes": 3}]}},
            "twin.effects[0].electrodes: found 3, expected a list of whole numbers",
        ),
        ({"twin": {"effects": [CONTACT | {"electrodes": [3.7]}]}}, "found [3.7]"),
        (
            {"twin": {"effects": [CONTACT | {"electrode": [3]}]}},
            "twin.effects[0]: found electrode, expected name, parameters or one of",
        ),
        (
            {"twin": {"effects": [CONTACT | {"parameters": None}]}},
            "twin.effects[0].parameters: found None, expected a mapping",
        ),
        (
            {"twin": {"effects": [CONTACT | {"parameters": {"ratio": {"sd": 0.1}}}]}},
            "twin.effects[0].parameters.ratio: found {'sd': 0.1}, expected a number",
        ),
        (
            {"twin": {"effects": [AT_DRIVE], "protocol": {"drive": "opposite"}}},
            "twin.protocol: found {'drive': 'opposite'}, expected what makes the recording's",
        ),
    ],
)
def test_another_file_is_refused_before_anything_is_written(
    content, found, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    recording.write(RECORDED, "skin.parquet")
    (tmp_path / "effects.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    assert cli.main(["diagnose", "skin.parquet", "--earlier", "effects.yaml"]) == cli.REFUSED
    said = capsys.readouterr().err
    assert said.startswith("effects.yaml: ") and found in said and said.count("\n") == 1
    assert not (tmp_path / "diagnosis-skin").exists()


@pytest.fixture(scope="module")
def grown(tmp_path_factory):
    """A recording, its diagnosis, and the effects.yaml of its first part's."""
    folder = tmp_path_factory.mktemp("earlier")
    recorded = small_recording(CONTACT, noise=NOISE, places=5)
    part = subset.of_frames(recorded, np.arange(len(recorded.frames)) < 0.8 * len(recorded.frames))
    recording.write(part, folder / "part.parquet")
    assert cli.main(["diagnose", str(folder / "part.parquet"), "--out", str(folder)]) == 0
    return recorded, diagnosis.diagnose(recorded), folder / "effects.yaml"


def earlier(path, recorded):
    return diagnosis.diagnose(recorded, earlier=starting_point.read(path, recorded.channels))


def test_a_recording_that_grew_has_the_diagnosis_that_it_has_from_nothing(grown):
    recorded, plain, path = grown
    found = earlier(path, recorded)
    actions = [(row["action"], row["effect"], row["sites"]) for row in found.search.journal.steps]
    assert actions == [("calibrate", "", ""), ("start", "contact-impedance", "3")]
    assert found.search.journal.steps[1]["p_value"] is None  # chance is asked after, on all frames
    assert [c.key for c in found.explanation.effects] == [c.key for c in plain.explanation.effects]
    assert found.explanation.log_evidence == pytest.approx(plain.explanation.log_evidence, abs=0.01)
    (effect,) = found.explanation.effects
    assert found.explanation.p_value(effect) == pytest.approx(
        plain.explanation.p_value(effect), rel=1e-6
    )
    again = earlier(path, recorded)
    assert np.array_equal(found.explanation.fit.theta, again.explanation.fit.theta)


def test_the_command_begins_with_what_it_is_given(grown, tmp_path, capsys):
    recorded, _, path = grown
    file = tmp_path / "whole.parquet"
    recording.write(recorded, file)
    command = ["diagnose", str(file), "--earlier", str(path), "--out", str(tmp_path / "out")]
    assert cli.main(command) == 0
    assert "first what was found earlier: contact-impedance\n" in capsys.readouterr().err
    steps = pd.read_csv(tmp_path / "out" / "evidence" / "search.csv")
    assert steps["action"].tolist() == ["calibrate", "start"]
    assert "Start: found before" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


def test_what_was_found_earlier_and_is_not_there_is_not_found(grown, tmp_path):
    """Nor is a wire that has been mended since, which no value makes little of."""
    _, _, path = grown
    nothing = small_recording(noise=NOISE, places=4)
    found = earlier(path, nothing)
    assert found.explanation.effects == []
    assert [row["action"] for row in found.search.journal.steps] == ["calibrate"]
    swapped = {"name": "electrode-swap", "electrodes": [1, 5]}
    other = tmp_path / "effects.yaml"
    other.write_text(yaml.safe_dump({"twin": {"effects": [CONTACT, swapped]}}), encoding="utf-8")
    mended = earlier(other, small_recording(CONTACT, noise=NOISE, places=4))
    assert [(c.name, c.sites) for c in mended.explanation.effects] == [("contact-impedance", (3,))]


def test_what_came_since_is_found_beside_what_was_found_earlier(grown):
    _, _, path = grown
    other = {"name": "measurement-gain", "measures": [5], "parameters": {"gain": 1.001}}
    found = earlier(path, small_recording(CONTACT, other, noise=NOISE, places=4))
    assert found.search.journal.steps[1]["action"] == "start"
    names = {c.name: c.sites for c in found.explanation.effects}
    assert names == {"contact-impedance": (3,), "measurement-gain": (5,)}


def test_of_a_recording_with_a_step_every_part_begins_with_it(grown, monkeypatch):
    recorded, _, path = grown
    chosen = starting_point.read(path, recorded.channels)
    seen = []

    def diagnosed(part, seed, progress, memory_GiB, earlier):
        seen.append(earlier)
        raise InputError("recording", "frames", "a part", "nothing")

    monkeypatch.setattr(parts.diagnosis, "diagnose", diagnosed)
    for steps in ([], [SimpleNamespace(frame=12)]):
        monkeypatch.setattr(parts, "steps", lambda recorded, found=steps: found)
        with pytest.raises(InputError):
            parts.diagnose(recorded, earlier=chosen)
    assert [one is chosen for one in seen] == [True, True, True]
