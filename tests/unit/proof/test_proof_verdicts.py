"""Verdicts come from a recording and its query, and from nothing else."""

import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from eitskin.data import recording
from eitskin.data.recording import Recording
from eitskin.errors import InputError
from eitskin.fingerprint import reached
from proof import verdicts
from witness.cases import Blinding, draw

ROOT = Path(__file__).parents[3]
SCHEMA = ROOT / "workflow/eitskin/diagnose/diagnosis.schema.yaml"


@pytest.fixture
def block(tmp_path, make_recording):
    """A block of two recordings, the second one's query of other channels."""
    public = tmp_path / "results/concealed/demo"
    for number, electrodes in ((1, 8), (2, 16)):
        made = make_recording(n_electrodes=8, presses=4, seed=number)
        asked = make_recording(n_electrodes=electrodes, presses=2, seed=3)
        query = Recording(asked.frames, None, None, None, asked.metadata)
        recording.write(made, public / f"recordings/case-00{number}.parquet")
        recording.write(query, public / f"queries/case-00{number}.parquet")
    return public


@pytest.fixture
def quick(monkeypatch):
    """A diagnosis that says the recording's mean and counts what it is asked for."""
    asked = []

    def diagnose(recorded, seed, progress):
        asked.append(float(np.nanmean(recorded.voltage)))
        return asked[-1], seed

    def record(diagnosed, name, query):
        return [name, *diagnosed]

    def write(recorded, folder, schema, query):
        (Path(folder) / "evidence").mkdir()
        (Path(folder) / "evidence" / "search.csv").write_text("a\n")
        (Path(folder) / "diagnosis.json").write_text(json.dumps(recorded) + "\n")

    monkeypatch.setattr(verdicts.diagnosis, "diagnose", diagnose)
    monkeypatch.setattr(verdicts, "record", record)
    monkeypatch.setattr(verdicts.files, "write", write)
    return asked


def run(block, *names, code="a"):
    verdicts.run(list(names), block, SCHEMA, 1, code)


def said(block):
    """Bytes of every verdict's files."""
    found = (block / "verdicts").rglob("*")
    return {f.relative_to(block): f.read_bytes() for f in found if f.is_file()}


def test_a_case_that_fails_leaves_a_failed_verdict(block, quick):
    run(block, "case-001", "case-002")
    failed = json.loads((block / "verdicts/case-002/diagnosis.json").read_text())
    assert failed["recording"] == "case-002" and "electrodes" in failed["failed"]
    assert sorted(f.name for f in (block / "verdicts/case-002").iterdir()) == [
        "diagnosis.json",
        "made.json",
    ]
    assert json.loads((block / "verdicts/case-001/diagnosis.json").read_text())[0] == "case-001"
    assert len(quick) == 1


@pytest.mark.parametrize("fault", [MemoryError, OSError])
def test_a_fault_of_the_machine_is_no_verdict(block, quick, monkeypatch, fault):
    def fails(*_, **__):
        raise fault("no room")

    monkeypatch.setattr(verdicts.diagnosis, "diagnose", fails)
    with pytest.raises(fault):
        run(block, "case-001")
    monkeypatch.undo()
    assert not (block / "verdicts/case-001/diagnosis.json").exists()


def test_made_says_of_what(block, quick):
    run(block, "case-001")
    made = json.loads((block / "verdicts/case-001/made.json").read_text())
    digest = hashlib.sha256((block / "recordings/case-001.parquet").read_bytes()).hexdigest()
    assert made["recording"] == digest and made["code"] == "a"


def test_what_is_diagnosed_stays(block, quick):
    run(block, "case-001")
    before = said(block)
    run(block, "case-001")
    assert len(quick) == 1 and said(block) == before
    run(block, "case-001", code="b")
    assert len(quick) == 2 and said(block) != before


def test_what_a_kill_left_behind_is_made_anew(block, quick):
    run(block, "case-001")
    before = said(block)
    (block / "verdicts/case-001/made.json").unlink()
    (block / "verdicts/case-001/evidence/half.csv").write_text("hal")
    run(block, "case-001")
    assert said(block) == before


def test_another_recording_is_diagnosed_anew(block, quick, make_recording):
    run(block, "case-001")
    recording.write(
        make_recording(n_electrodes=8, presses=4, seed=9), block / "recordings/case-001.parquet"
    )
    run(block, "case-001")
    assert len(quick) == 2 and quick[0] != quick[1]


def test_the_final_block_is_diagnosed_once(block, quick):
    final = block.with_name("final")
    block.rename(final)
    run(final, "case-001")
    run(final, "case-001", code="b")
    assert len(quick) == 1


def test_a_sealed_block_is_never_diagnosed_again(block, quick):
    run(block, "case-001")
    before = said(block)
    (block / "seal.json").write_text("{}")
    for code in "ab":
        with pytest.raises(InputError, match=r"seal\.json: file: found a sealed block"):
            run(block, "case-001", code=code)
    assert len(quick) == 1 and said(block) == before and (block / "seal.json").exists()


def test_the_same_verdict_without_the_truths(tmp_path):
    """The real diagnosis, byte for byte, whether truths lie beside it or not."""
    block = tmp_path / "results/concealed/demo"
    case = draw("null", 3, 40, blinding=Blinding(20))
    for folder, frames, voltage in (
        ("recordings", case.states, case.voltage),
        ("queries", case.query, None),
    ):
        made = Recording(frames, voltage, None, None, case.metadata)
        recording.write(made, block / folder / "case-001.parquet")
    truths = block.parents[1] / "truths" / "demo"
    truths.mkdir(parents=True)
    (truths / "case-001.sealed").write_bytes(bytes(100))
    (block / "opened").mkdir()
    (block / "opened/case-001.json").write_text('{"effects": [{"name": "offset"}]}')
    run(block, "case-001")
    before = said(block)
    assert "failed" not in json.loads(before[Path("verdicts/case-001/diagnosis.json")])
    shutil.rmtree(truths)
    shutil.rmtree(block / "verdicts")
    shutil.rmtree(block / "opened", ignore_errors=True)
    run(block, "case-001")
    assert said(block) == before and len(before) > 8


def test_verdicts_import_nothing_that_draws_or_opens():
    """Neither the witness nor what conceals or opens is part of a diagnosis' code."""
    used = set(reached("verdicts", []))
    assert "eitskin.diagnose.search.search" in used
    tops = {name.split(".")[0] for name in used} - {"scripts/verdicts"}
    assert tops == {"proof", "eitskin"}
    assert {name for name in used if name.startswith("proof.")} == {
        "proof.ledger",
        "proof.verdicts",
    }
