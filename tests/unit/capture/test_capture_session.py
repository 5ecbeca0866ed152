"""A capture on a pretended rig: nobody else writes its journal, and however it ends, a person is
told what became of the arm."""

import contextlib
import copy
import errno
import os
import signal
from pathlib import Path

import pytest
import yaml

pytest.importorskip("serial", reason="pyserial is not installed: extra `rig`")

from eitskin.capture import journal, session
from eitskin.capture.interlock import Stop
from eitskin.capture.preflight import Finding
from eitskin.capture.rig import Fault, Interrupted
from eitskin.capture.session import FAULT, Stopped
from eitskin.errors import InputError

PAPER = Path(__file__).parents[3] / "workflow" / "config" / "rig.yaml"
RIG = yaml.safe_load(PAPER.read_text(encoding="utf-8"))["rig"]
RIG["plan"] |= {"radii": 1, "angles": 2, "probes_mm": [7.0]}
LIFTED = ["stopped by stopL", "lifted off"]
NOT_LIFTED = ["stopped by stopL", "NOT lifted off: it stays; use the emergency stop"]


class Pretended:
    """A rig, its robot and its devices in one; `did` is what its arm did."""

    def __init__(self, folder: Path):
        self.config, self.path = copy.deepcopy(RIG), folder / "j.jsonl"
        self.did: list[str] = []
        self.hovers, self.fate = True, LIFTED
        self.load_cell = Finding("load cell", True, "at zero")
        self.signal, self.last_force_N, self.position_m = None, 5.0, (0.0, 0.0, 0.0)
        self.press = lambda keep: keep({"force_N": 8.0})

    def listen(self, load, board):
        pass

    def move(self, *arguments):
        self.did.append("move")

    def take_rejects(self) -> list[dict]:
        return []

    def stop_and_retreat(self) -> list[str]:
        self.did.append("retreat")
        self.hovers = self.fate is LIFTED
        return self.fate

    def close(self):
        pass

    def capture(self, resume: bool = False, mounted_mm: float | None = 7.0):
        session.capture(self.config, "rig.yaml", self.path, resume, mounted_mm, lambda news: None)

    def kinds(self) -> list[str]:
        return [record["kind"] for record in journal.read(self.path).records]


@pytest.fixture
def rig(tmp_path, monkeypatch) -> Pretended:
    """A rig above the skin, at which all is well."""
    pretended = Pretended(tmp_path)
    monkeypatch.setattr(session, "PACKAGES", ("numpy",))
    monkeypatch.setattr(session, "Robot", lambda host, watchdog_Hz: pretended)
    monkeypatch.setattr(session, "Rig", lambda config, robot: pretended)
    monkeypatch.setattr(session, "press", lambda rig, contact, keep, show: pretended.press(keep))
    monkeypatch.setattr(session.preflight, "robot", lambda config: ([], {"emulated": False}))
    for port in ("opened_load_cell", "opened_board"):
        monkeypatch.setattr(session.preflight, port, contextlib.nullcontext)
    monkeypatch.setattr(session.preflight, "load_cell", lambda load, config: pretended.load_cell)
    sound = Finding("board", True, "whole frames")
    monkeypatch.setattr(session.preflight, "board", lambda board, config: sound)
    return pretended


@pytest.fixture
def no_room(monkeypatch):
    """From the call on nothing more can be written to a journal."""

    def full(*_arguments):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    return lambda: monkeypatch.setattr(journal.Writer, "append", full)


def too_large(keep) -> None:
    raise Fault(Stop("force", "the force is too large"))


def capture_until_stop(rig: Pretended, **arguments) -> Stopped:
    """How a capture ended early."""
    with pytest.raises(Stopped) as ended:
        rig.capture(**arguments)
    return ended.value


def test_a_capture_that_was_stopped_goes_on_to_its_end(rig):
    complete_press, rig.press = rig.press, too_large
    assert str(capture_until_stop(rig)) == "the force is too large; stopped by stopL; lifted off"
    rig.press = complete_press
    rig.capture(resume=True)
    contacts = ["begin", "frame", "end"] * 2
    assert rig.kinds() == ["capture", "run", "begin", "stop", "run", *contacts, "done"]
    rig.did.clear()
    rig.capture(resume=True)
    assert rig.did == []


@pytest.mark.parametrize("fate", [LIFTED, NOT_LIFTED])
def test_where_the_disk_is_full_in_a_press_it_is_told_what_became_of_the_arm(rig, no_room, fate):
    def press(keep):
        no_room()
        keep({"force_N": 8.0})

    rig.press, rig.fate = press, fate
    ended = capture_until_stop(rig)
    assert ended.code == FAULT
    assert str(ended).startswith("OSError: [Errno 28] No space left on device; stopped by stopL; ")
    assert fate[-1] in str(ended)


def test_a_stop_that_the_journal_cannot_hold_is_told(rig, no_room):
    def press(keep):
        no_room()
        too_large(keep)

    rig.press, rig.fate = press, NOT_LIFTED
    ended = capture_until_stop(rig)
    assert ended.code == FAULT
    assert str(ended).startswith(f"the force is too large; {'; '.join(NOT_LIFTED)}; the journal")
    assert "No space left on device" in str(ended)


def test_a_command_for_the_probe_that_is_not_there_is_a_fault(rig, tmp_path):
    rig.config["probe_change"] = [str(tmp_path / "chnage")]
    ended = capture_until_stop(rig, mounted_mm=None)
    assert ended.code == FAULT
    assert str(ended).startswith("the probe was not changed: ")
    assert "chnage" in str(ended) and str(ended).endswith("; ".join(LIFTED))


def test_what_nobody_thought_of_is_a_fault_and_in_the_journal(rig):
    def press(keep):
        raise KeyError("depth")

    rig.press, rig.fate = press, NOT_LIFTED
    ended = capture_until_stop(rig)
    assert (str(ended), ended.code) == (f"KeyError: 'depth'; {'; '.join(NOT_LIFTED)}", FAULT)
    stop = journal.read(rig.path).records[-1]
    assert (stop["kind"], stop["reason"], stop["message"]) == ("stop", "error", str(ended))
    assert 'raise KeyError("depth")' in stop["traceback"]


def test_a_journal_that_another_capture_writes_is_refused_before_anything_moves(rig):
    rig.press = too_large
    capture_until_stop(rig)
    rig.did.clear()
    rig.hovers = False
    other_writer = journal.Writer(rig.path, journal.read(rig.path))
    with pytest.raises(InputError, match="another capture's lock"):
        rig.capture(resume=True)
    other_writer.close()
    assert rig.did == []


@pytest.mark.parametrize("resume", [False, True])
def test_the_journal_is_locked_before_the_arm_is_lifted(rig, resume):
    if resume:
        rig.press = too_large
        capture_until_stop(rig)
    rig.hovers = False
    attempts = []

    def lift():
        with pytest.raises(InputError, match="another capture's lock"):
            journal.Writer(rig.path, journal.read(rig.path))
        attempts.append(True)
        return Pretended.stop_and_retreat(rig)

    rig.stop_and_retreat = lift
    rig.press = lambda keep: None
    rig.capture(resume)
    assert attempts == [True]


def test_a_capture_that_is_refused_leaves_no_journal(rig):
    rig.load_cell = Finding("load cell", False, "0 readings in 5 s")
    with pytest.raises(InputError, match="0 readings in 5 s"):
        rig.capture()
    assert list(rig.path.parent.iterdir()) == []
    rig.load_cell = Finding("load cell", True, "at zero")
    rig.capture()
    original_bytes = rig.path.read_bytes()
    with pytest.raises(InputError, match="resume"):
        rig.capture()
    assert rig.path.read_bytes() == original_bytes


@pytest.mark.parametrize("resume", [False, True])
def test_a_journal_that_was_killed_before_a_run_is_in_nobodys_way(rig, resume):
    head = {"kind": "capture", "format": "eit-capture", "version": 1}
    journal.begin(rig.path, {**head, "config": {}, "plan_sha256": "another plan's"})
    rig.capture(resume)
    assert rig.kinds()[:2] == ["capture", "run"] and rig.kinds().count("end") == 2


def test_no_capture_begins_whose_probe_would_reach_over_the_rim(rig):
    rig.config["plan"] |= {"radii": 2, "radius_mm": 88.0, "probes_mm": [15.0]}
    with pytest.raises(InputError, match=r"a probe of 15 mm reaches 83\.2 mm .* at 80 mm"):
        rig.capture(mounted_mm=15.0)
    assert rig.did == [] and not rig.path.exists()
    rig.config["skin"]["radius_mm"] = None
    rig.capture(mounted_mm=15.0)


def test_a_signal_in_a_press_ends_the_capture_with_the_arm_lifted(rig):
    def struck(keep):
        os.kill(os.getpid(), signal.SIGTERM)
        raise Interrupted(rig.signal)

    rig.press = struck
    end = capture_until_stop(rig)
    assert rig.signal == signal.SIGTERM and end.code == session.SIGNAL + signal.SIGTERM
    assert "lifted off" in str(end) and rig.kinds()[-1] == "stop"
