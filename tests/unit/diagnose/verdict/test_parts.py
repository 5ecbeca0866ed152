"""A recording with a step is diagnosed apart, and what the step changed is said."""

import json
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest

from diagnosed_skin import SCHEMA
from eitskin import cli
from eitskin.data import recording, subset
from eitskin.data.check.steps import Step
from eitskin.data.recording import Recording, presses
from eitskin.diagnose import diagnosis, parts
from eitskin.diagnose.verdict import conclusion
from eitskin.diagnose.verdict.validation import validate
from eitskin.diagnose.verdict.words import part_sentences
from eitskin.errors import InputError
from proof.drawing import draw
from small_skin import small_recording
from witness import owned

STEPS = 33, 57


@dataclass(frozen=True)
class Told:
    """What stands for a diagnosis where only its place matters."""

    recording: Recording
    parts: tuple = ()
    steps: tuple = ()
    unlabelled: tuple = ()


@pytest.fixture
def stepped(make_recording):
    """A recording one channel of which reads otherwise between two steps."""
    made = make_recording(presses=12)
    made.voltage[STEPS[0] : STEPS[1], 40] *= 1.3
    return made


@pytest.fixture
def diagnosed(monkeypatch):
    """Parts given to the diagnosis, in order; of the lengths in `refused` it ends in a refusal;
    and those whose result was made."""
    given, refused, made = [], set(), []

    def diagnose(recorded, *_):
        given.append(recorded)
        if len(recorded.frames) in refused:
            raise InputError("recording", "frames", len(recorded.frames), "others")
        return Told(recorded)

    def said(found, name):
        made.append(found.recording)
        entries = {"verdict": "consistent", "effects": [], "other": {"sentence": None}, "fit": {}}
        return {"recording": name, **entries}

    monkeypatch.setattr(diagnosis, "diagnose", diagnose)
    monkeypatch.setattr(parts, "document", said)
    return given, refused, made


def test_parts_are_the_whole_recording_and_steps_lie_between(stepped, diagnosed):
    found = parts.diagnose(stepped)
    given, *_ = diagnosed
    ends = [part["frames"] for part in found.parts]
    first_after = [step["frame"] for step in found.steps]
    assert [b[0] for b in ends[1:]] == first_after and len(first_after) == 2
    assert all(abs(a - b) <= 1 for a, b in zip(first_after, STEPS, strict=True))
    assert [a[1] + 1 for a in ends[:-1]] == first_after
    assert ends[0][0] == 0 and ends[-1][1] == len(stepped.frames) - 1
    longest = max(given, key=lambda part: len(part.frames))
    assert found.recording is longest
    rows = longest.frames["frame"].to_numpy()
    assert np.array_equal(longest.voltage, stepped.voltage[rows])


def test_a_step_says_what_it_changed_and_back(stepped, diagnosed):
    found = parts.diagnose(stepped)
    for step, word in zip(found.steps, ("more", "less"), strict=True):
        (one,) = step["difference"]["found"]
        assert one["named"] and one["channels"] == [40]
        assert word in step["sentences"][0]
    of_no_file = {"verdict": "consistent", "effects": [], "other": {"sentence": None}}
    written = [part | of_no_file if "told" in part else part for part in found.parts]
    heads = [head for head, _ in part_sentences({"parts": written, "steps": found.steps})]
    assert [head.split()[0] for head in heads] == ["Frames", "The", "Frames", "The", "Frames"]


def test_the_longest_part_that_can_be_diagnosed_is_told(stepped, diagnosed):
    given, refused, _ = diagnosed
    parts.diagnose(stepped)
    lengths = sorted(len(part.frames) for part in given)
    refused.add(lengths[-1])
    found = parts.diagnose(stepped)
    assert len(found.recording.frames) == lengths[-2]
    (entry,) = [part for part in found.parts if "refused" in part]
    assert f"found {lengths[-1]}, expected others" in entry["refused"]
    refused.update(lengths)
    with pytest.raises(InputError, match=f"found {lengths[-1]},"):
        parts.diagnose(stepped)


def test_one_part_says_that_it_is_told_and_its_result_is_made_where_it_is_written(
    stepped, diagnosed
):
    given, refused, made = diagnosed
    found = parts.diagnose(stepped)
    assert [part["frames"] for part in found.parts if "told" in part] == [frames_of(found)]
    assert len(made) == len(given) - 1 and all(part is not found.recording for part in made)
    refused.add(len(found.recording.frames))
    found = parts.diagnose(stepped)
    assert [part["frames"] for part in found.parts if "told" in part] == [frames_of(found)]


def frames_of(found):
    return found.recording.frames["frame"].iloc[[0, -1]].tolist()


def test_what_is_told_stands_at_the_top_and_among_the_parts():
    found = diagnosis.diagnose(small_recording(places=4))
    other = {"frames": [0, 4], "refused": "too short"}
    step = {"frame": 5, "sentences": ["All is other."], "difference": {}}
    told = {"frames": [5, 60], "told": True}
    said = conclusion.document(replace(found, parts=(other, told), steps=(step,)), "skin")
    validate(said, SCHEMA, "diagnosis.json")
    assert said["parts"] == [other, told | {key: said[key] for key in conclusion.PART_KEYS}]
    assert "parts" not in conclusion.document(found, "skin")


def test_a_part_of_few_frames_is_left_out_and_said_to_be(make_recording):
    made = make_recording(presses=12)
    made.voltage[33:38, 40] *= 1.3
    cut = [subset.of_frames(made, mask) for mask in masks(len(made.frames), 33, 38)]
    assert [parts._is_short(part, cut) for part in cut] == [False, True, False]
    into, out = parts._changes(cut)
    assert (into["frame"], out["frame"]) == (33, 38)
    assert into["sentences"] == ["Frames 33 to 37 are too few to tell a change."]
    assert out["difference"]["found"] == []


@pytest.mark.parametrize("short", [True, False])
def test_a_short_part_is_not_diagnosed(stepped, diagnosed, monkeypatch, short):
    given, *_ = diagnosed
    bounds = (5, STEPS[1]) if short else STEPS
    starts = [Step(start, (start - 1, start), 1.0, None, (), ()) for start in bounds]
    monkeypatch.setattr(parts, "steps", lambda recorded: starts)
    found = parts.diagnose(stepped)
    reasons = [part["refused"] for part in found.parts if "refused" in part]
    assert reasons == [parts.TOO_SHORT.format(5, parts.FEWEST_FRAMES)] * short
    assert len(given) == 3 - short and len(found.steps) == 2


def masks(count, *bounds):
    rows = np.arange(count)
    return [(a <= rows) & (rows < b) for a, b in pairwise([0, *bounds, count])]


def test_the_longest_part_is_never_left_out(make_recording):
    made = make_recording(presses=0)
    cut = [subset.of_frames(made, mask) for mask in masks(len(made.frames), 4, 9)]
    shortened = [cut[0], cut[1]]
    assert [parts._is_short(part, shortened) for part in shortened] == [True, False]


def test_a_press_without_a_label_makes_no_parts(diagnosed):
    recorded = draw("null", 0).recorded
    hidden = presses(recorded) == 3
    frames = recorded.frames.copy()
    frames.loc[hidden, ["x_mm", "y_mm", "probe_mm", "depth_mm"]] = np.nan
    frames.loc[hidden, "force_N"] = 0.0
    frames.loc[hidden, "touch"] = False
    found = parts.diagnose(replace(recorded, frames=frames))
    first, last = np.flatnonzero(hidden)[[0, -1]]
    assert found.parts == found.steps == () and found.unlabelled == ((first, last),)
    assert len(found.recording.frames) == len(frames) - hidden.sum()


def test_without_a_step_nothing_is_apart(make_recording, diagnosed):
    made = make_recording(presses=12)
    found = parts.diagnose(made)
    assert found.recording is made and found.parts == found.steps == ()


@pytest.mark.long
def test_a_drives_gain_from_the_middle_on_is_named_with_its_frame(tmp_path, capsys):
    owner = owned.draw("owner:step", 1)
    path, out = tmp_path / "recording.parquet", tmp_path / "out"
    recording.write(owner.recorded, path)
    assert cli.main(["diagnose", str(path), "--out", str(out)]) == 0
    said = json.loads((out / "diagnosis.json").read_text("utf-8"))
    (fault,) = owner.truth.effects
    assert said["noise"]["jumps"] == [owner.truth.step]
    assert [part["verdict"] for part in said["parts"]] == ["consistent", "explained"]
    (after,) = said["parts"][1]["effects"]
    (changed,) = said["steps"][0]["difference"]["found"]
    for one in (after, changed):
        assert (one["name"], one["drives"]) == (fault["name"], fault["drives"])
    assert after["parameters"]["gain"]["value"] == pytest.approx(
        fault["parameters"]["gain"][0], rel=1e-3
    )
    assert said["effects"] == said["parts"][1]["effects"]
    printed = capsys.readouterr().out
    page = (out / "report.html").read_text("utf-8")
    for sentence in (*said["steps"][0]["sentences"], after["sentence"]):
        assert sentence in printed and sentence.split("(")[0] in page
