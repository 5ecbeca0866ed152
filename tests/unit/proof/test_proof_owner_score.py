"""Hand-made rows of owners' recordings, scored by hand."""

import json

import numpy as np
import pytest

from proof import prediction_score, score
from proof.blocks import trials
from proof.trial import file_of


def effect(name, *alternatives):
    return {"name": name, "alternatives": list(alternatives)}


def row(kind, seed, said=(), true=(), apart=-3.0, steps=(), ceilings=(), wanted=None, **truth):
    names = [{"name": name} for name in true]
    whole = {"step": None, "ceiling_V": None, "wrong": None, **truth}
    wanted = list(true) if wanted is None else wanted
    return {
        "kind": f"owner:{kind}",
        "seed": seed,
        "code": "a",
        "drawn": "something",
        "seconds": 10.0,
        "truth": {"effects": names, "wanted": wanted, **whole},
        "check": {"steps": list(steps), "ceilings": list(ceilings), "warnings": []},
        "said": {"verdict": "consistent", "effects": list(said)},
        "hidden": {"rmse_V": 1.0, "rmse_before_V": 2.0, "standard_errors": apart, "units": 5},
    }


def ended(kind, seed, outcome, value, **truth):
    made = row(kind, seed, **truth)
    return {key: made[key] for key in made if key not in ("said", "hidden")} | {outcome: value}


def broken(kind, seed):
    return {"kind": f"owner:{kind}", "seed": seed, "code": "a", "failed": "ValueError()"}


def summary(rows):
    return prediction_score.scored("owners", rows)[0]["summary"]


def line(lines, of, what):
    (one,) = lines[(lines["of"] == of) & lines["what"].str.startswith(what)].to_dict("records")
    return one


DEEP = {"true": ["third-dimension"]}
ROUND = {"true": ["domain-shape", "electrode-position"], "wanted": ["domain-shape"]}
CLIPPED = {"true": ["adc-nonlinearity"], "wanted": [], "ceiling_V": 1.0}
STEP = {"true": ["drive-gain"], "wanted": [], "step": 31}


@pytest.mark.parametrize(
    ("made", "right", "false"),
    [
        (row("static-body", 1, [effect("third-dimension")], **DEEP), True, 0),
        (row("static-body", 1, [effect("electrode-width", "third-dimension")], **DEEP), True, 0),
        (row("static-body", 1, [effect("electrode-width")], **DEEP), False, 1),
        (row("static-body", 1, [], **DEEP), False, 0),
        (row("static-body", 1, [effect("third-dimension"), effect("offset")], **DEEP), False, 1),
        (row("static-body", 1, []), True, 0),
        (row("static-body", 1, [effect("offset")]), False, 1),
        (row("out-of-round", 1, [effect("anisotropy")], **ROUND), False, 1),
        (row("out-of-round", 1, [effect("anisotropy", "domain-shape")], **ROUND), True, 0),
        (row("out-of-round", 1, [effect("electrode-position")], **ROUND), False, 0),
        (row("clipped", 1, [], ceilings=[0.99], **CLIPPED), True, 0),
        (row("clipped", 1, [], ceilings=[0.9], **CLIPPED), False, 0),
        (row("clipped", 1, [effect("adc-nonlinearity")], **CLIPPED), False, 0),
        (row("clipped", 1, [effect("offset")], ceilings=[1.0], **CLIPPED), False, 1),
        (row("step", 1, [effect("offset")], steps=[31], **STEP), True, 1),
        (row("step", 1, [], steps=[32], **STEP), False, 0),
        (row("step", 1, [], steps=[31, 50], **STEP), False, 0),
        (ended("step", 1, "refused", "why", steps=[31], **STEP), False, 0),
        (ended("order", 1, "unusable", [("order", "wrong.")], wrong="order"), True, 0),
        (ended("polarity", 1, "unusable", [("order", "wrong.")], wrong="polarity"), False, 0),
        (ended("static-body", 1, "unusable", [("order", "wrong.")], **DEEP), False, 0),
        (row("order", 1, [], wrong="order"), False, 0),
        (broken("beliefs", 1), False, 0),
    ],
)
def test_what_is_right_and_what_is_false(made, right, false):
    (one,) = prediction_score.owners([made]).to_dict("records")
    assert (one["right"], one["false"]) == (right, false)


ROWS = [
    row("static-body", 1, [effect("third-dimension")], **DEEP),
    row("static-body", 2, [effect("offset")], apart=2.5, steps=[7], **DEEP),
    row("step", 1, steps=[31], apart=float("nan"), **STEP),
    row("step", 2, steps=[30], ceilings=[1.0], apart=0.0, **STEP),
    row("clipped", 1, ceilings=[1.0], **CLIPPED),
    ended("order", 1, "unusable", [("order", "wrong.")], wrong="order"),
    ended("beliefs", 1, "refused", "no radius"),
    broken("beliefs", 2),
]


def test_counts_and_bounds():
    lines = summary(ROWS)
    right = line(lines, "all recordings", "right name")
    assert (right["hits"], right["n"], right["met"]) == (4, 8, False)
    worse = line(lines, "all recordings", "after worse")
    assert (worse["hits"], worse["n"], worse["met"]) == (1, 5, False)
    assert line(lines, "all recordings", "after better")["hits"] == 2
    assert line(lines, "all recordings", "an effect named that")["hits"] == 1
    exact = line(lines, "step", "its frame")
    assert (exact["hits"], exact["n"], exact["met"]) == (1, 2, False)
    assert (line(lines, "all but step", "a step said")["hits"]) == 1
    assert (line(lines, "all but clipped", "a ceiling said")["hits"]) == 1
    traced = line(lines, "all recordings", "tracebacks")
    assert (traced["hits"], traced["met"]) == (1, False)
    assert line(lines, "beliefs", "refused")["hits"] == 1
    assert line(lines, "order", "right name")["value"] == 1.0
    assert np.isnan(line(lines, "polarity", "right name")["value"])


def test_all_right_meets_the_bounds():
    whole = [ROWS[0], ROWS[2], ROWS[4], ROWS[5]]
    lines = summary(whole)
    assert lines[lines["wanted"] != ""]["met"].all()


@pytest.mark.parametrize("there", [0, 3])
def test_a_block_is_scored_in_whatever_part_is_there(tmp_path, there):
    folder = tmp_path / "trials"
    folder.mkdir()
    for kind, seed in trials("owners-report", "quick")[:there]:
        file_of(folder, kind, seed).write_text(json.dumps(row(kind.partition(":")[2], seed)))
    score.write(tmp_path, "owners-report", "quick")
    assert f"{there} of 8 recordings" in (tmp_path / "summary.md").read_text()
    assert len((tmp_path / "owners.csv").read_text().splitlines()) == 1 + there


SITED = {"name": "drive-gain", "electrodes": [], "drives": [5], "measures": [], "channels": []}


@pytest.mark.parametrize(
    ("changed", "after", "by_step", "told"),
    [
        ([SITED], [SITED], True, True),
        ([SITED | {"named": False}], [], False, False),
        ([SITED | {"drives": [6]}], [SITED, SITED], False, False),
        ([SITED | {"name": "offset", "alternatives": ["drive-gain"]}], [SITED], True, True),
        ([SITED, SITED], [SITED | {"name": "offset"}], False, False),
    ],
)
def test_the_fault_that_a_step_begins_is_counted(changed, after, by_step, told):
    made = row("step", 1, steps=[31], **STEP)
    made["truth"]["effects"] = [{"name": "drive-gain", "drives": [5], "parameters": {}}]
    whole = [{"named": True, "alternatives": []} | one for one in changed]
    parts = [{"effects": []}, {"effects": [{"alternatives": []} | one for one in after]}]
    made["said"] |= {"steps": [{"difference": {"found": whole}}], "parts": parts}
    rows = [made, row("static-body", 1, [], **DEEP)]
    table = prediction_score.owners(rows)
    assert table.loc[0, ["fault_by_step", "fault_after"]].tolist() == [by_step, told]
    lines = summary(rows)
    assert line(lines, "step", "its fault named")["hits"] == int(by_step)
    assert line(lines, "step", "its fault alone")["hits"] == int(told)
    made["said"] = {key: made["said"][key] for key in ("verdict", "effects")}
    unsplit = prediction_score.owners([made])
    assert not unsplit.loc[0, "fault_by_step"] and not unsplit.loc[0, "fault_after"]
