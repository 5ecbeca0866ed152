"""Hand-made rows of queries, scored by hand."""

import json

import numpy as np
import pytest

from proof import prediction_score, score
from proof.blocks import trials
from proof.trial import file_of


def row(kind, seed, after=1.0, before=2.0, apart=-3.0, names=(), **more):
    return {
        "kind": f"query:{kind}",
        "seed": seed,
        "code": "a",
        "drawn": "something",
        "seconds": 10.0,
        "said": {"verdict": "consistent", "effects": [{"name": name} for name in names]},
        "hidden": {"rmse_V": after, "rmse_before_V": before, "standard_errors": apart, "units": 5},
        **more,
    }


def broken(kind, seed, outcome):
    return {"kind": f"query:{kind}", "seed": seed, "code": "a", outcome: "why"}


ROWS = [
    row("rig", 1, names=["offset"]),
    row("rig", 2, after=2.1, apart=2.5),
    row("rig", 3, after=2.0, apart=0.0),
    row("garbage", 1, after=0.0, before=0.0, apart=0.0),
    broken("garbage", 2, "failed"),
    broken("belief", 1, "refused"),
    broken("real", 1, "absent"),
]


def summary(rows):
    return prediction_score.scored("queries", rows)[0]["summary"]


def line(lines, of, what):
    (one,) = lines[(lines["of"] == of) & lines["what"].str.startswith(what)].to_dict("records")
    return one


def test_of_each_recording_what_came_of_it():
    table = prediction_score.queries(ROWS)
    assert table["outcome"].tolist() == ["predicted"] * 4 + ["failed", "refused", "absent"]
    assert table["ratio"].tolist()[:4] == [0.5, 1.05, 1.0, 1.0]
    assert table["names"].tolist()[:2] == ["offset", ""]
    assert table["kind"].tolist()[0] == "rig" and table["why"].tolist()[-1] == "why"


def test_counts_and_bounds():
    lines = summary(ROWS)
    worse = line(lines, "all queries", "after worse")
    assert (worse["hits"], worse["n"], worse["met"]) == (1, 4, False)
    assert worse["low"] < 0.25 < worse["high"]
    assert line(lines, "all queries", "after better")["hits"] == 1
    largest = line(lines, "all queries", "rms error")
    assert largest["value"] == 1.05 and largest["met"]
    traced = line(lines, "all queries", "tracebacks")
    assert (traced["hits"], traced["n"], traced["met"]) == (1, 6, False)
    assert line(lines, "all queries", "refused")["hits"] == 1
    assert line(lines, "rig", "after worse")["n"] == 3
    assert np.isnan(line(lines, "foreign", "rms error")["value"])
    assert line(lines, "real", "tracebacks")["n"] == 0


def test_no_verdict_is_not_worse_and_is_told():
    rows = [*ROWS, row("real", 2, after=3.0, apart=float("nan"))]
    lines = summary(rows)
    for what, hits in (("after worse", 1), ("after better", 1), ("no verdict", 1)):
        counted = line(lines, "all queries", what)
        assert (counted["hits"], counted["n"]) == (hits, 5)
    assert line(lines, "rig", "no verdict")["hits"] == 0


def test_what_was_perfect_and_is_not_any_more_is_worse_without_bound():
    assert prediction_score.rmse_ratio({"rmse_V": 1.0, "rmse_before_V": 0.0}) == np.inf


@pytest.mark.parametrize("there", [0, 3])
def test_a_block_is_scored_in_whatever_part_is_there(tmp_path, there):
    folder = tmp_path / "trials"
    folder.mkdir()
    for kind, seed in trials("queries-report", "quick")[:there]:
        made = row(kind.partition(":")[2], seed)
        file_of(folder, kind, seed).write_text(json.dumps(made))
    score.write(tmp_path, "queries-report", "quick")
    said = (tmp_path / "summary.md").read_text()
    assert f"{there} of 20 recordings" in said and "absent, of these: 0" in said
    assert len((tmp_path / "queries.csv").read_text().splitlines()) == 1 + there
