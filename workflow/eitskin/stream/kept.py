"""What a stream leaves: a journal while it goes on, a recording at its end.

The journal is `capture.journal`'s: whole lines on the disk, so that a kill or a loss of power costs
what was streamed since the last of them, EVERY_S at most. It can be streamed itself, which makes
the recording that the kill prevented.
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
EVERY_S = 0.5
UNKNOWN = {field.name: None for field in fields(Skin) if field.name not in OPTIONAL}


def same(one: str | Path, other: str | Path) -> bool:
    """Whether two paths are of one file."""
    return Path(one).resolve() == Path(other).resolve()


def recovery(path: str | Path, out: str | Path) -> str:
    """The command that makes of a journal the recording that a kill prevented."""
    return f"eitskin stream {path} --model MODEL --fast --out {out}"


def journal_of(out: str | Path) -> Path:
    """The journal of what is to be the recording `out`."""
    return Path(out).with_suffix(JOURNAL)


def is_kept(path: str | Path) -> bool:
    """Whether a path is that of a stream's journal."""
    return Path(path).suffix == JOURNAL


class Keeper:
    """Takes frames and verdicts into the journal of `out`; `close` makes the recording of it."""

    def __init__(
        self, out: str | Path, header: dict, difference: bool, about: str, source: str | Path
    ):
        """`header`: the predictor's; `source`: what is streamed, which is left as it is, the
        journal of `out` too. Raises InputError where `out` is no recording's name or the source
        itself, and where a journal with frames is there already."""
        self.out, self.path = Path(out), journal_of(out)
        if self.out.suffix != SUFFIX:
            raise InputError(out, "--out", f"the ending {self.out.suffix!r}", f"{SUFFIX!r}")
        if same(self.out, source):
            raise InputError(out, "--out", "the source itself", "another file")
        if same(self.path, source):
            self.path = self.out.with_suffix(f".again{JOURNAL}")
        trained_on, skin = header["dataset"], header["skin"]
        metadata = recording.metadata_of(
            np.array(trained_on["channels"]),
            UNKNOWN if skin is None else Skin.from_metadata(skin, "model").metadata(),
            f"{about}; states estimated by {header['model']} of {trained_on['name']}",
            trained_on.get("voltage", "signed"),
            trained_on.get("position_frame", "skin"),
            unit=trained_on["unit"],
            values="difference" if difference else "absolute",
        )
        if self.path.exists() and not journal.taken_away(self.path, KIND):
            expected = f"none; `{recovery(self.path, out)}` makes its recording"
            raise InputError(self.path, "file", "an earlier stream's journal", expected)
        columns = [TARGETS[target] for target in trained_on["targets"]]
        journal.begin(self.path, {"kind": KIND, "metadata": metadata, "columns": columns})
        self._writer = journal.Writer(self.path, journal.read(self.path, KIND))
        self._waiting: list[dict] = []
        self._told = 0
        self._written_s = 0.0

    def __call__(self, frame: Frame, verdict: Verdict) -> None:
        """Take one in; what has waited for EVERY_S goes to the disk."""
        estimate = verdict.estimate
        self._told += verdict.kind != CANNOT_TELL
        self._waiting.append(
            {
                "kind": "frame",
                "time_s": frame.time_s,
                "reading": [x if np.isfinite(x) else None for x in frame.reading.tolist()],
                "verdict": verdict.kind,
                "state": None if estimate is None else estimate.state.tolist(),
                "half": None if estimate is None else estimate.half.tolist(),
                "lost": list(verdict.lost),
            }
        )
        if frame.ready_s - self._written_s > EVERY_S:
            self.flush()
            self._written_s = frame.ready_s

    def flush(self) -> None:
        """What waits goes to the disk."""
        waiting, self._waiting = self._waiting, []
        self._writer.append(*waiting)

    def discard(self) -> None:
        """Leave nothing of a stream that was refused."""
        self._writer.close()
        self.path.unlink()

    def close(self) -> None:
        """Write the recording whole, where of any frame it could be told, then take the journal
        away."""
        self.flush()
        self._writer.close()
        if self._told:
            recording.write(as_recording(self.path), self.out)
        self.path.unlink()


def as_recording(path: str | Path, whole: bool = False) -> Recording:
    """The recording of a stream's journal: `touch` and places are what was estimated.

    Frames of which it could not be told are left out, as they are neither touched nor untouched;
    `whole`, to be streamed again: they stay, as touched ones. Notes: `note_verdict`, `note_lost`,
    half the width of each interval, `note_half_`, and of a force, which no recording has below 0,
    the estimate as it was, `note_estimate_`. Raises InputError for what is no such journal or holds
    no frame.
    """
    records = journal.read(path, KIND).records
    head, rows = records[0], [one for one in records if one["kind"] == "frame"]
    told = [one for one in rows if whole or one["verdict"] != CANNOT_TELL]
    if not told:
        raise InputError(path, "frames", "none", "one or more")
    nothing = [np.nan] * len(head["columns"])
    state = np.array([one["state"] or nothing for one in told], dtype=float)
    half = np.array([one["half"] or nothing for one in told], dtype=float)
    touch = np.array([one["verdict"] in (TOUCH, CANNOT_TELL) for one in told])
    known = dict(zip(head["columns"], state.T, strict=True))
    estimated = known.get("force_N")
    if estimated is not None:
        known["force_N"] = known["force_N"].clip(min=0.0)
    time_s = np.array([one["time_s"] for one in told])
    frames = frames_table(time_s - time_s[0], touch, **known)
    frames["note_verdict"] = pd.Series([one["verdict"] for one in told], dtype="str")
    frames["note_lost"] = pd.Series([json.dumps(one["lost"]) for one in told], dtype="str")
    for column, values in zip(head["columns"], half.T, strict=True):
        frames[f"note_half_{column}"] = values
    if estimated is not None:
        frames["note_estimate_force_N"] = estimated
    voltage = np.array([one["reading"] for one in told], dtype=float)
    return Recording(frames, voltage, None, None, head["metadata"])
