"""Why a name is not among the effects: the gate at which it stopped, and that this is the gate."""

import json

import pandas as pd
import pytest

from diagnosed_skin import SCHEMA
from eitskin import cli
from eitskin.diagnose import diagnosis, files
from eitskin.diagnose.search.gates import (
    CHANCE,
    DISTINCT,
    EVIDENCE,
    NAMES,
    PLACE,
    REMAINDER,
    STANDS_OUT,
    STATED,
    STATED_SIZE,
)
from eitskin.diagnose.search.journal import Decision
from eitskin.diagnose.verdict import refusals
from eitskin.diagnose.verdict.record import record
from eitskin.effects import catalogue_names
from eitskin.errors import InputError
from eitskin.quantities import MINUS
from small_skin import small_recording


def decisions(*rows: dict) -> pd.DataFrame:
    """Decisions made by hand: a refusal of `offset` in round 1 beside nothing, but for what a row
    says."""
    usual = {"round": 1, "name": "offset", "kind": "", "sites": "", "value": 0.0}
    usual |= {"admitted": False, "beside": "", "place": "", "detail": ""}
    return pd.DataFrame([vars(Decision(**(usual | row))) for row in rows])


def stopped(effects: list[str], *rows: dict) -> refusals.Stop | None:
    """Where `offset` stopped beside the effects of a diagnosis."""
    return refusals.stop(decisions(*rows), effects, "offset")


@pytest.mark.parametrize(
    ("row", "sentence"),
    [
        (
            {"gate": STATED.name},
            "offset stopped at stated: the skin's metadata do not state what it needs where"
            " somebody touches.",
        ),
        (
            {"gate": NAMES.name, "value": 14.0, "kind": "measures", "sites": "5"},
            "offset at pair 5 stopped at names: its score has rank 14 of all names; ranks up to 12"
            " are fitted.",
        ),
        (
            {"gate": EVIDENCE.name, "value": -1.25, "kind": "channels", "sites": "3 4"},
            f"offset at channels 3 and 4 stopped at evidence: it raises the log evidence by"
            f" {MINUS}1.25 nats; an effect must raise it by 3.",
        ),
        (
            {
                "gate": CHANCE.name,
                "value": 0.5,
                "kind": "channels",
                "sites": " ".join("0123456789"),
            },
            "offset at 10 channels stopped at chance: chance alone gives so good a score, over the"
            " whole catalogue, in 0.500 of recordings; an effect enters below 0.001.",
        ),
        (
            {"gate": PLACE.name, "value": 0.5, "beside": "drive-gain", "place": "drive-gain"},
            "offset stopped at place: beside drive-gain, in the place of drive-gain it has 0.500"
            " nats more; another name takes a place above 1.",
        ),
        (
            {"gate": NAMES.name, "value": 14.0, "detail": "its score is 2 nats"},
            "offset stopped at names: its score has rank 14 of all names; ranks up to 12"
            " are fitted; its score is 2 nats.",
        ),
    ],
)
def test_a_stop_is_a_sentence_with_sites_value_and_threshold(row, sentence):
    stop = stopped([], row)
    assert stop is not None and stop.sentence == sentence


def test_what_counts_is_the_final_set_and_there_the_candidate_that_came_furthest():
    early = {"gate": EVIDENCE.name, "value": 1.0}
    beside_set = {"round": 2, "beside": "drive-gain"}
    near = beside_set | {"sites": "3", "kind": "channels"}
    far = beside_set | {"sites": "7", "kind": "channels"}
    stop = stopped(
        ["drive-gain"],
        early,
        near | {"gate": NAMES.name, "value": 20.0},
        far | {"gate": NAMES.name, "value": 2.0, "admitted": True},
        far | {"gate": EVIDENCE.name, "value": 2.5},
        far | {"gate": CHANCE.name, "value": 0.9},
        beside_set | {"gate": PLACE.name, "place": "drive-gain", "round": 3},
    )
    assert (stop.gate, stop.sites, stop.value) == (EVIDENCE, "7", 2.5)
    assert stop.beside == ("drive-gain",) and stop.place == ""


def test_a_name_that_was_not_judged_beside_the_final_set_stopped_where_it_was_judged_last():
    rows = {"gate": NAMES.name, "value": 20.0}, {"gate": EVIDENCE.name, "value": 1.0, "round": 4}
    stop = stopped(["drive-gain"], *rows)
    assert (stop.gate, stop.beside) == (EVIDENCE, ())
    assert stopped([], {"gate": NAMES.name, "admitted": True}) is None
    assert stopped([], {"gate": NAMES.name, "name": "crosstalk"}) is None


def test_a_candidate_among_the_effects_is_said_to_be_one_with_its_reasons():
    table = decisions(
        {"gate": STANDS_OUT.name, "value": 2.0},
        {"gate": REMAINDER.name, "value": -1.5},
        {"gate": EVIDENCE.name, "value": 1.0},
        {"gate": DISTINCT.name, "value": 9.0, "admitted": True},
    )
    offset = {"name": "offset", "scope": "common", "parameters": {}}
    effects = [offset | {"certain": False}]
    (sentence,) = refusals.sentences(table, {"effects": effects}, "offset")
    assert sentence == (
        "offset is named as a candidate: beyond what the calibrations can do its signature is 2"
        " noise units long; it is certain from 3 on; what has no name exceeds the gap to"
        f" the nearest other name by as much: {MINUS}1.50."
    )
    (sentence,) = refusals.sentences(table, {"effects": [offset]}, "offset")
    assert sentence == "offset is named, and certain."
    nothing = {"volt": {"value": 1.0, "low": -1.0, "high": 3.0, "unit": "V"}}
    effects = [offset | {"certain": True, "parameters": nothing}]  # of an earlier version
    (sentence,) = refusals.sentences(table.iloc[3:], {"effects": effects}, "offset")
    assert sentence == f"offset is named as a candidate: {STATED_SIZE.refusal}."


def test_every_name_of_the_catalogue_has_a_sentence_and_no_other():
    texts = refusals.sentences(decisions({"gate": NAMES.name, "value": 20.0}), {"effects": []})
    assert [text.split()[0] for text in texts] == sorted(catalogue_names())
    assert "anisotropy met no gate." in texts
    with pytest.raises(InputError, match="sticky-electrode"):
        refusals.sentences(decisions({"gate": NAMES.name}), {"effects": []}, "sticky-electrode")


# ---- a search


RECORDING = small_recording(places=4)


@pytest.fixture(scope="module")
def plain():
    """The diagnosis of a recording in which nothing is missing."""
    return diagnosis.diagnose(RECORDING)


@pytest.mark.parametrize(("name", "gate"), [("channel-gain", NAMES), ("contact-law", EVIDENCE)])
def test_the_gate_opened_carries_the_name_to_another_or_in(plain, name, gate):
    """And lets no other name pass."""
    (stop,) = _stops(plain, name)
    assert stop.gate is gate and not gate.admits(stop.value)
    opened = diagnosis.diagnose(RECORDING, opened=frozenset({(gate.name, name)}))
    named = {effect.name for effect in opened.explanation.effects}
    assert named <= {name}
    assert name in named or all(later.gate is not gate for later in _stops(opened, name))
    gates_of = [
        {(stop.name, stop.gate.name) for stop in _stops(found) if stop.name != name}
        for found in (plain, opened)
    ]
    assert named or gates_of[0] == gates_of[1]


def _stops(found: diagnosis.Diagnosis, name: str | None = None) -> list[refusals.Stop]:
    """Where all names stopped, or one."""
    effects = [effect.name for effect in found.explanation.effects]
    stops = refusals.stops(found.search.journal.table(), effects)
    return [stop for stop in stops if name in (None, stop.name)]


# ---- the command line


@pytest.fixture(scope="module")
def folder(plain, tmp_path_factory):
    """The files of the diagnosis."""
    path = tmp_path_factory.mktemp("diagnosis")
    files.write(record(plain, "skin"), path, SCHEMA)
    return path


def test_explain_prints_what_the_search_decided(plain, folder, capsys):
    assert cli.main(["explain", str(folder)]) == 0
    lines = capsys.readouterr().out.splitlines()
    sentences = {stop.name: stop.sentence for stop in _stops(plain)}
    assert len(lines) == len(catalogue_names())
    assert {sentences[name] for name in ("offset", "registration", "third-dimension")} <= {*lines}
    assert cli.main(["explain", str(folder), "offset"]) == 0
    assert capsys.readouterr().out == f"{sentences['offset']}\n"


def test_explain_answers_in_json(plain, folder, capsys):
    assert cli.main(["explain", str(folder), "offset", "--json"]) == 0
    (stop,) = _stops(plain, "offset")
    answer = json.loads(capsys.readouterr().out)
    assert answer["folder"] == str(folder) and answer["sentences"] == [stop.sentence]


def test_explain_refuses_a_name_that_nobody_knows_and_a_folder_without_decisions(
    folder, tmp_path, capsys
):
    assert cli.main(["explain", str(folder), "sticky-electrode"]) == 1
    assert "sticky-electrode" in capsys.readouterr().err
    assert cli.main(["explain", str(tmp_path)]) == 1
    assert "diagnosis.json" in capsys.readouterr().err
    (tmp_path / "diagnosis.json").write_text((folder / "diagnosis.json").read_text("utf-8"))
    assert cli.main(["explain", str(tmp_path)]) == 1
    assert "evidence/decisions.csv" in capsys.readouterr().err
