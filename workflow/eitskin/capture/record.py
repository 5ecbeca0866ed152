"""A finished journal becomes a recording, and a manifest that says where every byte came from."""

import hashlib
import json
from collections import Counter
from datetime import datetime
from pathlib import Path

import numpy as np
import pandas as pd

from eitskin.atomic import atomic_path
from eitskin.capture import journal
from eitskin.capture.configuration import believed_skin
from eitskin.capture.press_plan import contacts
from eitskin.capture.wire import BOARDS, Reject, measured, rms_frame
from eitskin.data import recording
from eitskin.data.recording import Recording, frames_table
from eitskin.errors import InputError
from eitskin.physics.protocol import channel_table

REAL, EMULATED = "rig", "emulated rig"
RUN_GAP_S = 1.0  # least time between runs where the host's clock was set back


def write(journal_path: str | Path, out: str | Path, manifest_out: str | Path) -> None:
    """Write the recording and the manifest of a finished capture.

    Raises InputError for a journal that is damaged or in which a contact is missing.
    """
    found = journal.read(journal_path)
    recorded, left_out = to_recording(found.records, journal_path)
    recording.write(recorded, out)
    said = manifest(found.records, recorded, left_out)
    said["recording_sha256"] = _sha256(out)
    said["journal_sha256"] = _sha256(journal_path)
    with atomic_path(manifest_out) as temporary:
        text = json.dumps(said, indent=1, sort_keys=True) + "\n"
        temporary.write_text(text, encoding="utf-8")


def to_recording(records: list[dict], file: str | Path) -> tuple[Recording, int]:
    """The recording of a finished journal, and how many pressed frames it leaves out because the
    load cell, less its zero, did not read more than 0.

    Each contact's last, finished attempt; forces less the untouched cell's reading; places in mm
    from the centre along the robot's base axes, as measured, not as commanded.
    """
    config = records[0]["config"]
    planned = contacts(config["plan"])
    first = journal.Journal(records, 0).first_unfinished(len(planned))
    if first < len(planned):
        found = f"contact {first} of {len(planned)} unfinished"
        raise InputError(file, "contacts", found, "all finished; `eitskin rig resume` goes on")
    rows = journal.finished_frames(records)
    table = _measured(rows, records)
    centre = np.array(config["pose"]["centre"][:2])
    ends = np.array([[row["pose_before"][:2], row["pose_end"][:2]] for row in rows])
    place_mm = 1e3 * (ends.mean(axis=1) - centre)
    kept = ~(table["touch"] & ~(table["force_N"] > 0)).to_numpy()
    voltage = _voltages(rows, config, file)[kept]
    (x_mm, y_mm), table = place_mm[kept].T, table[kept].reset_index(drop=True)
    by_number = {contact.number: contact for contact in planned}
    at = [by_number[number] for number in table["contact"]]
    touch = table["touch"].to_numpy()
    time_s = table["time_s"].to_numpy()
    time_s = time_s - time_s[0]
    frames = frames_table(
        time_s,
        touch,
        x_mm,
        y_mm,
        table["force_N"],
        probe_mm=np.array([contact.probe_mm for contact in at]),
        depth_mm=table["depth_mm"].to_numpy(dtype=float),
    )
    frames["session"] = pd.Series([contact.session for contact in at], dtype=object)
    frames["contact"] = table["contact"].where(touch).astype("Int64")
    if table["room_C"].notna().any():
        frames["temperature_C"] = table["room_C"]
    for name in ("phase", "utc"):
        frames[f"note_{name}"] = table[name].astype("str")
    for name in ("spread_N", "saturated", "robot_s"):
        frames[f"note_{name}"] = table[name]
    metadata = recording.metadata_of(
        channel_table(BOARDS[config["board"]["profile"]].n_electrodes),
        believed_skin(config, file).metadata(),
        source(records),
        "magnitude",
        "robot",
        float(min([*table["frame_s"], *np.diff(time_s)])),
    )
    return Recording(frames, voltage, None, None, metadata), int((~kept).sum())


def _measured(rows: list[dict], records: list[dict]) -> pd.DataFrame:
    """What a journal of these records says of its frames, one row each. What may change from run to
    run (`plan_sha256`) is that of a frame's own run."""
    offsets = _run_offsets(records)
    runs = {record["run"]: record for record in records if record["kind"] == "run"}
    frame_s = [runs[row["run"]]["board"]["frame_s"] for row in rows]
    began_s = [_begin_s(row, s) for row, s in zip(rows, frame_s, strict=True)]
    return pd.DataFrame(
        {
            "time_s": [s + offsets[row["run"]] for s, row in zip(began_s, rows, strict=True)],
            "frame_s": frame_s,
            "room_C": np.array([runs[row["run"]]["session"]["room_C"] for row in rows], float),
            "touch": [row["phase"] != "untouched" for row in rows],
            "force_N": [row["force_N"] - row["zero_N"] for row in rows],
            "depth_mm": [row["depth_mm"] for row in rows],
            "contact": [row["contact"] for row in rows],
            "phase": [row["phase"] for row in rows],
            "spread_N": [row["force_spread_N"] for row in rows],
            "saturated": [row["saturated"] for row in rows],
            "utc": [row["end_utc"] for row in rows],
            "robot_s": [row["robot_end_s"] for row in rows],
        }
    )


def source(records: list[dict]) -> str:
    """`rig`, or `emulated rig` where the configuration or any robot of the journal says so."""
    runs = [record for record in records if record["kind"] == "run"]
    emulated = records[0]["config"]["emulated"] or any(run["robot"]["emulated"] for run in runs)
    return EMULATED if emulated else REAL


def manifest(records: list[dict], recorded: Recording, left_out: int) -> dict:
    """What was captured, with what, by whom, and what was refused on the way."""
    first = records[0]
    kinds: dict[str, list[dict]] = {}
    for record in records:
        kinds.setdefault(record["kind"], []).append(record)
    rejects = Counter(f"{r['port']}: {r['reason']}" for r in kinds.get("reject", []))
    return {
        "format": "eit-capture-manifest",
        "version": 1,
        "source": source(records),
        "config": first["config"],
        "plan_sha256": first["plan_sha256"],
        "runs": [{k: v for k, v in r.items() if k != "number"} for r in kinds["run"]],
        "stops": [{k: v for k, v in r.items() if k != "number"} for r in kinds.get("stop", [])],
        "contacts": len(kinds["end"]),
        "ends": dict(sorted(Counter(end["end"] for end in kinds["end"]).items())),
        "frames": len(recorded.frames),
        "frames_left_out_without_force": left_out,
        "rejected_lines": dict(sorted(rejects.items())),
        "readings": "RMS volts; the skin's current is RMS as well",
    }


def _run_offsets(records: list[dict]) -> dict[int, float]:
    """Seconds to add to the monotonic clock of each run for one clock over all runs: UTC between
    runs, and at least 1 s where that was set back."""
    offsets: dict[int, float] = {}
    last_s = -np.inf
    for record in records:
        if record["kind"] == "run":
            utc_s = datetime.fromisoformat(record["utc"]).timestamp()
            offset = utc_s - record["monotonic_s"]
            ahead = last_s + RUN_GAP_S - (record["monotonic_s"] + offset)
            offsets[record["run"]] = offset + max(0.0, ahead)
        elif record["kind"] == "frame":
            last_s = record["end_s"] + offsets[record["run"]]
    return offsets


def _begin_s(row: dict, frame_s: float) -> float:
    """When a frame began: its time before its end, but not before the last one's end."""
    return max(row["before_s"], row["end_s"] - frame_s)


def _voltages(rows: list[dict], config: dict, file: str | Path) -> np.ndarray:
    """(N, M) V: the raw lines, read again."""
    n = BOARDS[config["board"]["profile"]].n_electrodes
    chosen, found = measured(n), []
    for row in rows:
        frame = rms_frame(row["raw"].encode(), n)
        if isinstance(frame, Reject):
            place = f"record {row['number']}"
            raise InputError(file, place, f"{frame.reason}: {frame.detail}", "a frame's raw line")
        found.append(frame[chosen])
    return np.array(found)


def _sha256(path: str | Path) -> str:
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()
