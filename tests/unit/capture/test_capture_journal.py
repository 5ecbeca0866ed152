"""The journal: what is in it is on the disk, what was cut short is left out, nothing else is."""

import errno
import json
import os

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eitskin.capture import journal
from eitskin.capture.journal import Journal, Writer, finished_frames
from eitskin.errors import InputError

HEAD = {"kind": "capture"}


def contact(number: int, attempt: int = 0, frames: int = 2) -> list[dict]:
    attempt_key = {"contact": number, "attempt": attempt}
    frame_records = [{"kind": "frame", **attempt_key, "step": step} for step in range(frames)]
    return [{"kind": "begin", **attempt_key}, *frame_records, {"kind": "end", **attempt_key}]


def write_journal(path, *records: dict) -> None:
    journal.begin(path, HEAD)
    writer = Writer(path, journal.read(path))
    writer.append(*records)
    writer.close()


def test_what_is_written_is_read(tmp_path):
    path = tmp_path / "deep" / "j.jsonl"
    write_journal(path, *contact(0))
    read_journal = journal.read(path)
    assert [r["kind"] for r in read_journal.records] == [
        "capture",
        "begin",
        "frame",
        "frame",
        "end",
    ]
    assert [r["number"] for r in read_journal.records] == [0, 1, 2, 3, 4]
    assert read_journal.length == path.stat().st_size


def test_going_on_appends(tmp_path):
    path = tmp_path / "j.jsonl"
    write_journal(path, *contact(0))
    writer = Writer(path, journal.read(path))
    writer.append({"kind": "begin", "contact": 1, "attempt": 0})
    writer.close()
    assert [r["number"] for r in journal.read(path).records] == [0, 1, 2, 3, 4, 5]


@pytest.mark.parametrize("tail", [b'{"number": 5, "ki', b"\x00" * 4096, b"{}", b'{"number": 5}\n'])
def test_what_a_loss_of_power_cut_short_is_left_out_and_then_taken_off(tmp_path, tail):
    path = tmp_path / "j.jsonl"
    write_journal(path, *contact(0))
    complete_bytes = path.read_bytes()
    path.write_bytes(complete_bytes + tail)
    cut_journal = journal.read(path)
    assert (len(cut_journal.records), cut_journal.length) == (5, len(complete_bytes))
    writer = Writer(path, cut_journal)
    writer.append({"kind": "done"})
    writer.close()
    assert path.read_bytes().startswith(complete_bytes)
    assert [r["kind"] for r in journal.read(path).records][-2:] == ["end", "done"]


@given(st.data())
def test_cut_anywhere_it_holds_every_whole_line_and_goes_on_with_the_first_unfinished(data):
    records = [HEAD, *contact(0), *contact(1), *contact(2)]
    lines = [json.dumps({"number": k, **r}).encode() + b"\n" for k, r in enumerate(records)]
    text = b"".join(lines)
    cut = data.draw(st.integers(len(lines[0]), len(text)))
    cut_journal = _parsed(text[:cut])
    n_complete = text[:cut].count(b"\n")
    assert [r["number"] for r in cut_journal.records] == list(range(n_complete))
    n_ended = sum(r["kind"] == "end" for r in records[:n_complete])
    assert cut_journal.first_unfinished(3) == n_ended
    # Redone from its start, nothing of a contact is lost or doubled.
    repeated_records = [r for k in range(n_ended, 3) for r in contact(k, cut_journal.attempts(k))]
    frames = finished_frames([*cut_journal.records, *repeated_records])
    assert [(f["contact"], f["step"]) for f in frames] == [(k, s) for k in range(3) for s in (0, 1)]


def _parsed(data: bytes) -> Journal:
    import tempfile
    from pathlib import Path

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "j.jsonl"
        path.write_bytes(data)
        return journal.read(path)


def test_a_contact_that_was_redone_counts_once(tmp_path):
    broken = contact(0)[:-1]
    records = [HEAD, *broken, *contact(0, attempt=1, frames=3)]
    assert [f["attempt"] for f in finished_frames(records)] == [1, 1, 1]


def test_a_broken_line_with_others_behind_it_is_refused(tmp_path):
    path = tmp_path / "j.jsonl"
    write_journal(path, *contact(0))
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join([*lines[:2], lines[2][:10] + b"\n", *lines[3:]]))
    with pytest.raises(InputError, match="line 3: found b'"):
        journal.read(path)


def test_a_missing_record_is_refused(tmp_path):
    path = tmp_path / "j.jsonl"
    write_journal(path, *contact(0))
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join([*lines[:2], *lines[3:]]))
    with pytest.raises(InputError, match="line 3: found record 3, expected record 2"):
        journal.read(path)


@pytest.mark.parametrize(
    "content", [b"", b"\n", b"hello\nworld\n", b'{"number": 0, "kind": "x"}\n']
)
def test_what_is_no_journal_is_refused(tmp_path, content):
    path = tmp_path / "j.jsonl"
    path.write_bytes(content)
    with pytest.raises(InputError):
        journal.read(path)


def test_a_journal_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(InputError, match="No such file"):
        journal.read(tmp_path / "none")


def test_a_new_journal_does_not_overwrite(tmp_path):
    path = tmp_path / "j.jsonl"
    write_journal(path)
    with pytest.raises(InputError, match="resume"):
        journal.begin(path, HEAD)
    assert [file.name for file in tmp_path.iterdir()] == ["j.jsonl"]


def test_one_capture_at_a_time(tmp_path):
    path = tmp_path / "j.jsonl"
    write_journal(path)
    writer = Writer(path, journal.read(path))
    with pytest.raises(InputError, match="another capture's lock"):
        Writer(path, journal.read(path))
    writer.close()


def test_what_another_has_written_since_a_journal_was_read_is_not_taken_off(tmp_path):
    path = tmp_path / "j.jsonl"
    write_journal(path, *contact(0))
    read_journal = journal.read(path)
    other_writer = Writer(path, read_journal)
    other_writer.append(*contact(1))
    other_writer.close()
    complete_bytes = path.read_bytes()
    with pytest.raises(InputError, match="what another capture has just written"):
        Writer(path, read_journal)
    assert path.read_bytes() == complete_bytes
    Writer(path, journal.read(path)).close()


def test_of_records_for_which_there_is_no_room_nothing_stays(tmp_path, monkeypatch):
    path = tmp_path / "j.jsonl"
    write_journal(path, *contact(0))
    complete_bytes, write = path.read_bytes(), os.write
    writer = Writer(path, journal.read(path))

    def full(file: int, text: bytes) -> int:
        if path.stat().st_size > len(complete_bytes):
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(file, text[: len(text) // 2])

    with monkeypatch.context() as patched:
        patched.setattr(os, "write", full)
        with pytest.raises(OSError, match="No space left"):
            writer.append(*contact(1))
    assert path.read_bytes() == complete_bytes
    writer.append({"kind": "stop"})
    writer.close()
    assert [r["number"] for r in journal.read(path).records] == [0, 1, 2, 3, 4, 5]


def test_what_a_failed_append_could_not_take_off_is_taken_off_by_the_next(tmp_path):
    path = tmp_path / "j.jsonl"
    write_journal(path, *contact(0))
    writer = Writer(path, journal.read(path))
    with path.open("ab") as other_writer:
        other_writer.write(b'{"number": 4, "ki')
    writer.append({"kind": "stop"})
    writer.close()
    assert [r["kind"] for r in journal.read(path).records][-1] == "stop"
