"""What becomes of a capture: a recording with its manifest, or the reason why it ended early."""

from pathlib import Path

import pytest
import yaml

pytest.importorskip("serial", reason="pyserial is not installed: extra `rig`")

from eitskin.capture import cli, record, session
from eitskin.capture.run import capture_recording
from eitskin.errors import InputError

PAPER = Path(__file__).parents[3] / "workflow" / "config" / "rig.yaml"
RIG = yaml.safe_load(PAPER.read_text(encoding="utf-8"))["rig"]
CHANGED = {**RIG, "probe_change": ["change"]}


@pytest.fixture
def captured(tmp_path):
    """Capture the paper's rig, or another, into a folder; no device is there."""

    def capture(rig=RIG, mounted_mm=7.0):
        output_paths = tmp_path / "it.parquet", tmp_path / "it.json"
        return capture_recording(
            rig, "rig.yaml", tmp_path / "j.jsonl", False, mounted_mm, output_paths
        )

    return capture


def test_a_journal_becomes_recording_and_manifest(captured, tmp_path, monkeypatch):
    done = []
    monkeypatch.setattr(session, "capture", lambda *arguments: done.append(arguments[2]))
    monkeypatch.setattr(record, "write", lambda *arguments: done.append(arguments))
    assert captured() is None
    journal = tmp_path / "j.jsonl"
    assert done == [journal, (journal, tmp_path / "it.parquet", tmp_path / "it.json")]


def test_of_a_capture_that_ended_early_nothing_is_written(captured, tmp_path, monkeypatch, capsys):
    def stop(*_arguments):
        raise session.Stopped("the force jumped; stopped by stopL", session.FAULT)

    monkeypatch.setattr(session, "capture", stop)
    stopped = captured()
    assert (str(stopped), stopped.code) == ("the force jumped; stopped by stopL", session.FAULT)
    assert list(tmp_path.iterdir()) == []
    parser = cli.argparse.ArgumentParser()
    cli.add(parser.add_subparsers())
    arguments = parser.parse_args(["rig", "run", str(PAPER), "--out", str(tmp_path / "it.parquet")])
    assert arguments.run(arguments) == session.FAULT
    assert capsys.readouterr() == ("", "the force jumped; stopped by stopL\n")


@pytest.mark.parametrize(
    ("rig", "mounted_mm", "message"),
    [
        (CHANGED, 7.0, "found 7 mm, expected none: rig.probe_change is a command"),
        (RIG, None, "found none, expected the probe of 7 mm"),
        (RIG, 10.0, "found 10 mm, expected the probe of 7 mm"),
    ],
)
def test_a_probe_that_is_not_the_one_or_said_in_vain_is_refused(
    captured, tmp_path, rig, mounted_mm, message
):
    with pytest.raises(InputError) as refused:
        captured(rig, mounted_mm)
    assert str(refused.value).startswith(f"rig.yaml: mounted probe: {message}")
    assert list(tmp_path.iterdir()) == []
