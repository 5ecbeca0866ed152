"""The recording of a finished journal, and the manifest that states its origin."""

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
from eitskin.data import board, recording
from eitskin.data.board import Board
from eitskin.data.recording import Recording, frames_table
from eitskin.errors import InputError

REAL, EMULATED = "rig", "emulated rig"
RUN_GAP_S = 1.0  # least time between runs where the host's clock was set back


def write(journal_path: str | Path, recording_path: str | Path, manifest_path: str | Path) -> None:
    """Write the recording and the manifest of a finished capture.

    Raises InputError for a journal that is damaged or lacks a contact.
    """
    capture_journal = journal.read(journal_path)
    recorded, n_without_force = to_recording(capture_journal.records, journal_path)
    recording.write(recorded, recording_path)
    manifest_fields = manifest(capture_journal.records, recorded, n_without_force)
    manifest_fields["recording_sha256"] = _sha256(recording_path)
    manifest_fields["journal_sha256"] = _sha256(journal_path)
    with atomic_path(manifest_path) as temporary:
        text = json.dumps(manifest_fields, indent=1, sort_keys=True) + "\n"
        temporary.write_text(text, encoding="utf-8")


def to_recording(records: list[dict], file: str | Path) -> tuple[Recording, int]:
    """The recording of a finished journal, and the number of pressed frames left out because their
    force was not above 0.

    Frames are those of each contact's last attempt, forces are less the untouched cell's reading,
    places in mm from the centre along the robot's base axes, as measured. `file` names the journal
    in an InputError.
    """
    config = records[0]["config"]
    planned = contacts(config["plan"])
    unfinished_contact = journal.Journal(records, 0).first_unfinished(len(planned))
    if unfinished_contact < len(planned):
        violation = f"contact {unfinished_contact} of {len(planned)} unfinished"
        raise InputError(file, "contacts", violation, "all finished; `eitskin rig resume` goes on")
    frame_records = journal.finished_frames(records)
    table = _frame_table(frame_records, records)
    centre = np.array(config["pose"]["centre"][:2])
    pose_pairs_m = np.array(
        [[row["pose_before"][:2], row["pose_end"][:2]] for row in frame_records]
    )
    place_mm = 1e3 * (pose_pairs_m.mean(axis=1) - centre)
    valid_frames = ~(table["touch"] & ~(table["force_N"] > 0)).to_numpy()
    eit_board = _board(records[0], file)
    voltage = _voltages(frame_records, eit_board, file)[valid_frames]
    (x_mm, y_mm), table = place_mm[valid_frames].T, table[valid_frames].reset_index(drop=True)
    contact_of_number = {contact.number: contact for contact in planned}
    frame_contacts = [contact_of_number[number] for number in table["contact"]]
    touch = table["touch"].to_numpy()
    time_s = table["time_s"].to_numpy()
    time_s = time_s - time_s[0]
    frames = frames_table(
        time_s,
        touch,
        x_mm,
        y_mm,
        table["force_N"],
        probe_mm=np.array([contact.probe_mm for contact in frame_contacts]),
        depth_mm=table["depth_mm"].to_numpy(dtype=float),
    )
    frames["session"] = pd.Series([contact.session for contact in frame_contacts], dtype=object)
    frames["contact"] = table["contact"].where(touch).astype("Int64")
    if table["room_C"].notna().any():
        frames["temperature_C"] = table["room_C"]
    for name in ("phase", "utc"):
        frames[f"note_{name}"] = table[name].astype("str")
    for name in ("spread_N", "saturated", "robot_s"):
        frames[f"note_{name}"] = table[name]
    metadata = recording.metadata_of(
        eit_board.channels,
        believed_skin(config, file).metadata(),
        source(records),
        eit_board.voltage,
        position_frame="robot",
        unit=eit_board.unit,
        frame_s=float(min([*table["frame_s"], *np.diff(time_s)])),
    )
    return Recording(frames, voltage, None, None, metadata), int((~valid_frames).sum())


def _frame_table(frame_records: list[dict], records: list[dict]) -> pd.DataFrame:
    """A row for each of `frame_records`, with the settings of the frame's run."""
    offsets = _run_offsets(records)
    runs = {record["run"]: record for record in records if record["kind"] == "run"}
    frame_s = [runs[record["run"]]["board"]["frame_s"] for record in frame_records]
    begin_s = [_begin_s(record, s) for record, s in zip(frame_records, frame_s, strict=True)]
    return pd.DataFrame(
        {
            "time_s": [
                s + offsets[record["run"]] for s, record in zip(begin_s, frame_records, strict=True)
            ],
            "frame_s": frame_s,
            "room_C": np.array(
                [runs[record["run"]]["session"]["room_C"] for record in frame_records], float
            ),
            "touch": [record["phase"] != "untouched" for record in frame_records],
            "force_N": [record["force_N"] - record["zero_N"] for record in frame_records],
            "depth_mm": [record["depth_mm"] for record in frame_records],
            "contact": [record["contact"] for record in frame_records],
            "phase": [record["phase"] for record in frame_records],
            "spread_N": [record["force_spread_N"] for record in frame_records],
            "saturated": [record["saturated"] for record in frame_records],
            "utc": [record["end_utc"] for record in frame_records],
            "robot_s": [record["robot_end_s"] for record in frame_records],
        }
    )


def source(records: list[dict]) -> str:
    """`rig`, or `emulated rig` where the configuration or any run's robot is emulated."""
    runs = [record for record in records if record["kind"] == "run"]
    emulated = records[0]["config"]["emulated"] or any(run["robot"]["emulated"] for run in runs)
    return EMULATED if emulated else REAL


def manifest(records: list[dict], recorded: Recording, n_without_force: int) -> dict:
    """The manifest: configuration, runs, stops, counts of contacts, frames and rejected lines."""
    header, eit_board = records[0], _board(records[0])
    kind = "RMS" if eit_board.is_rms else "amplitudes"
    records_of_kind: dict[str, list[dict]] = {}
    for record in records:
        records_of_kind.setdefault(record["kind"], []).append(record)
    rejects = Counter(
        f"{record['port']}: {record['reason']}" for record in records_of_kind.get("reject", [])
    )
    return {
        "format": "eit-capture-manifest",
        "version": 1,
        "source": source(records),
        "config": header["config"],
        "plan_sha256": header["plan_sha256"],
        "runs": [
            {k: v for k, v in record.items() if k != "number"} for record in records_of_kind["run"]
        ],
        "stops": [
            {k: v for k, v in record.items() if k != "number"}
            for record in records_of_kind.get("stop", [])
        ],
        "contacts": len(records_of_kind["end"]),
        "ends": dict(sorted(Counter(end["end"] for end in records_of_kind["end"]).items())),
        "frames": len(recorded.frames),
        "frames_left_out_without_force": n_without_force,
        "rejected_lines": dict(sorted(rejects.items())),
        "board": eit_board.description,
        "readings": f"{kind} in {eit_board.unit}; so is the skin's current, in A",
    }


def _run_offsets(records: list[dict]) -> dict[int, float]:
    """Seconds to add to each run's monotonic clock for one clock over all runs.

    Runs are as far apart as in UTC, and at least RUN_GAP_S where the host's clock was set back.
    """
    offsets: dict[int, float] = {}
    last_end_s = -np.inf
    for record in records:
        if record["kind"] == "run":
            utc_s = datetime.fromisoformat(record["utc"]).timestamp()
            offset = utc_s - record["monotonic_s"]
            shortfall_s = last_end_s + RUN_GAP_S - (record["monotonic_s"] + offset)
            offsets[record["run"]] = offset + max(0.0, shortfall_s)
        elif record["kind"] == "frame":
            last_end_s = record["end_s"] + offsets[record["run"]]
    return offsets


def _begin_s(record: dict, frame_s: float) -> float:
    """When a frame began: `frame_s` before its end, but not before the previous frame's end."""
    return max(record["before_s"], record["end_s"] - frame_s)


def _board(header: dict, file: str | Path = "journal") -> Board:
    """The board that a journal's header describes; journals of before it did name one."""
    profile = header["config"]["board"]["profile"]
    if "board" not in header:
        return board.read(profile, file)
    return board.described(profile, header["board"], f"{file}: board")


def _voltages(frame_records: list[dict], eit_board: Board, file: str | Path) -> np.ndarray:
    """(N, M): readings parsed from the raw lines, in the board's unit."""
    readings = []
    for record in frame_records:
        reading = eit_board.parse(record["raw"].encode())
        if not isinstance(reading, np.ndarray):
            violation = f"{reading.reason}: {reading.detail}" if reading else "a remark"
            expected = "a frame's raw line"
            raise InputError(file, f"record {record['number']}", violation, expected)
        readings.append(reading)
    return np.array(readings)


def _sha256(path: str | Path) -> str:
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()
