"""The record of a stream: a journal while it runs, a recording at its end.

The journal has the form of `capture.journal`, so that a kill or a loss of power costs the frames
since the last flush, FLUSH_INTERVAL_S at most. A journal can be streamed itself, which writes the
recording that the kill prevented.
"""

import json
from dataclasses import fields
from pathlib import Path

import numpy as np
import pandas as pd

from eitskin.capture import journal
from eitskin.data import recording
from eitskin.data.dataset import TARGETS
from eitskin.data.recording import Recording, frames_table
from eitskin.errors import InputError
from eitskin.physics.skin import OPTIONAL, Skin
from eitskin.stream.frames import Frame
from eitskin.stream.judge import CANNOT_TELL, TOUCH, Verdict

KIND = "stream"
SUFFIX, JOURNAL = ".parquet", ".jsonl"
FLUSH_INTERVAL_S = 0.5  # frames that a kill may cost; a sync to disk takes some 10 ms
UNKNOWN_SKIN = {field.name: None for field in fields(Skin) if field.name not in OPTIONAL}


def is_same_file(path: str | Path, other_path: str | Path) -> bool:
    """Whether two paths are of one file."""
    return Path(path).resolve() == Path(other_path).resolve()


def recovery_command(path: str | Path, recording_path: str | Path) -> str:
    """The command that turns a journal into the recording `recording_path`."""
    return f"eitskin stream {path} --model MODEL --fast --out {recording_path}"


def journal_path(recording_path: str | Path) -> Path:
    """Where the journal of the recording `recording_path` lies."""
    return Path(recording_path).with_suffix(JOURNAL)


def is_journal(path: str | Path) -> bool:
    """Whether a path is that of a stream's journal."""
    return Path(path).suffix == JOURNAL


class Recorder:
    """Appends frames and verdicts to the journal of `out`; `close` writes the recording."""

    def __init__(
        self,
        recording_path: str | Path,
        header: dict,
        is_difference: bool,
        description: str,
        source: str | Path,
    ):
        """Begin the journal.

        `header` is the predictor's, `description` goes into the recording's metadata, and `source`
        is the path that is streamed and never overwritten. Raises InputError where `recording_path`
        is no recording's name or the source itself, and where a journal with frames exists.
        """
        self.out, self.path = Path(recording_path), journal_path(recording_path)
        if self.out.suffix != SUFFIX:
            raise InputError(
                recording_path, "--out", f"the ending {self.out.suffix!r}", f"{SUFFIX!r}"
            )
        if is_same_file(self.out, source):
            raise InputError(recording_path, "--out", "the source itself", "another file")
        if is_same_file(self.path, source):
            self.path = self.out.with_suffix(f".again{JOURNAL}")
        trained_on, skin = header["dataset"], header["skin"]
        metadata = recording.metadata_of(
            np.array(trained_on["channels"]),
            UNKNOWN_SKIN if skin is None else Skin.from_metadata(skin, "model").metadata(),
            f"{description}; states estimated by {header['model']} of {trained_on['name']}",
            trained_on.get("voltage", "signed"),
            position_frame=trained_on.get("position_frame", "skin"),
            unit=trained_on["unit"],
            values="difference" if is_difference else "absolute",
        )
        if self.path.exists() and not journal.remove_if_empty(self.path, KIND):
            expected = f"none; `{recovery_command(self.path, recording_path)}` makes its recording"
            raise InputError(self.path, "file", "an earlier stream's journal", expected)
        columns = [TARGETS[target] for target in trained_on["targets"]]
        journal.begin(self.path, {"kind": KIND, "metadata": metadata, "columns": columns})
        self._writer = journal.Writer(self.path, journal.read(self.path, KIND))
        self._pending_records: list[dict] = []
        self._n_decided = 0
        self._last_flush_s = 0.0

    def __call__(self, frame: Frame, verdict: Verdict) -> None:
        """Append a frame; pending records are flushed every FLUSH_INTERVAL_S."""
        estimate = verdict.estimate
        self._n_decided += verdict.kind != CANNOT_TELL
        self._pending_records.append(
            {
                "kind": "frame",
                "time_s": frame.time_s,
                "reading": [x if np.isfinite(x) else None for x in frame.reading.tolist()],
                "verdict": verdict.kind,
                "state": None if estimate is None else estimate.state.tolist(),
                "half": None if estimate is None else estimate.half.tolist(),
                "lost": list(verdict.lost_electrodes),
            }
        )
        if frame.ready_s - self._last_flush_s > FLUSH_INTERVAL_S:
            self.flush()
            self._last_flush_s = frame.ready_s

    def flush(self) -> None:
        """Write the pending records to disk."""
        records, self._pending_records = self._pending_records, []
        self._writer.append(*records)

    def discard(self) -> None:
        """Delete the journal of a stream that was refused."""
        self._writer.close()
        self.path.unlink()

    def close(self) -> None:
        """Write the recording if any frame was decided, then delete the journal."""
        self.flush()
        self._writer.close()
        if self._n_decided:
            recording.write(as_recording(self.path), self.out)
        self.path.unlink()


def as_recording(path: str | Path, with_undecided: bool = False) -> Recording:
    """The recording of a stream's journal, with the estimated states as its labels.

    Frames whose verdict is CANNOT_TELL are left out; `with_undecided` keeps them, as touched, to be
    streamed again. Columns beside those of the format: `note_verdict`, `note_lost`,
    `note_half_...`, half the width of each interval, and `note_estimate_force_N`, the estimate of
    the force before it was clipped to 0 or more. Raises InputError for another file and for a
    journal without frames.
    """
    records = journal.read(path, KIND).records
    first_record, frame_records = (
        records[0],
        [record for record in records if record["kind"] == "frame"],
    )
    chosen_records = [
        record for record in frame_records if with_undecided or record["verdict"] != CANNOT_TELL
    ]
    if not chosen_records:
        raise InputError(path, "frames", "none", "one or more")
    no_state = [np.nan] * len(first_record["columns"])
    state = np.array([record["state"] or no_state for record in chosen_records], dtype=float)
    half_width = np.array([record["half"] or no_state for record in chosen_records], dtype=float)
    touch = np.array([record["verdict"] in (TOUCH, CANNOT_TELL) for record in chosen_records])
    state_columns = dict(zip(first_record["columns"], state.T, strict=True))
    estimated_force_N = state_columns.get("force_N")
    if estimated_force_N is not None:
        state_columns["force_N"] = state_columns["force_N"].clip(min=0.0)
    time_s = np.array([record["time_s"] for record in chosen_records])
    frames = frames_table(time_s - time_s[0], touch, **state_columns)
    frames["note_verdict"] = pd.Series(
        [record["verdict"] for record in chosen_records], dtype="str"
    )
    frames["note_lost"] = pd.Series(
        [json.dumps(record["lost"]) for record in chosen_records], dtype="str"
    )
    for column, values in zip(first_record["columns"], half_width.T, strict=True):
        frames[f"note_half_{column}"] = values
    if estimated_force_N is not None:
        frames["note_estimate_force_N"] = estimated_force_N
    voltage = np.array([record["reading"] for record in chosen_records], dtype=float)
    return Recording(frames, voltage, None, None, first_record["metadata"])
