"""Faults of load cell, board and arm in presses of the emulated rig, and presses without a fault.

`python -m benchmark.rig_faults` writes benchmarks/rig_faults.csv, a row a capture, and the table
of it, benchmarks/rig_faults.md. What happened is read from the emulator's log, not from the driver.
"""

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
import yaml

from benchmark import rows
from eitskin.atomic import atomic_path
from eitskin.capture import journal
from eitskin.progress import patient

CSV, PAGE = (rows.ROOT / "benchmarks" / f"rig_faults.{ending}" for ending in ("csv", "md"))
CONFIG = rows.ROOT / "workflow" / "config"
CAPTURE_S, ENDING_S = 1800.0, 60.0  # far longer than any capture and any lift take
MAX_REFUSALS = 20  # of a capture, whose board a busy machine emulates too slowly to begin
SEED, LEAST_N, LARGEST_N = 1, 0.2, 7.0  # true force at which a fault begins: from touch to target
PROBES_MM = (7.0, 10.0, 15.0)
FAULTS: dict[str, dict] = {  # what each is, as the emulator has it
    "load cell sticks": {"fault": "load_cell_stuck"},
    "load cell, bridge unplugged": {"fault": "load_cell_stuck", "size": 0.05},
    "load cell saturates at 3 N": {"fault": "load_cell_saturated", "size": 3.0},
    "load cell drifts by -5 N/s": {"fault": "load_cell_drift", "size": -5.0},
    "load cell loses 60 % of its gain": {"fault": "load_cell_gain", "size": 0.4},
    "load cell silent": {"fault": "load_cell_silent"},
    "load cell's port gone": {"fault": "load_cell_unplugged"},
    "board frozen": {"fault": "board_frozen"},
    "board silent": {"fault": "board_silent"},
    "arm, protective stop": {"fault": "protective_stop"},
    "arm, program killed": {"fault": "program_killed"},
    "arm, clock stands still": {"fault": "rtde_stalled"},
}
HEAD = """\
# Faults in a press

`python -m benchmark.rig_faults --starts {starts} --presses {presses}`, commit `{commit}`: captures
of the emulated rig (`rigsim.yaml`, `demo_capture.yaml`, twenty times as fast as a real one). Each
fault begins in the first or second press at a true force drawn from {least_N} to {largest_N} N,
with a probe of 7, 10 or 15 mm. The largest true force on the gel is to stay below {hard_N} N. A
row of `rig_faults.csv` is a capture.

| fault | captures | stopped | spoilt finished | largest true force, N | rules broken | reasons |
|---|---|---|---|---|---|---|
"""


def configurations(folder: Path, seed: int, plan: dict, faults: list[dict]) -> tuple[dict, dict]:
    """The emulator's and the driver's configuration, with the emulator's files in `folder`.

    `seed` draws the gel's stiffness, the noise and the order of places; `plan` replaces keys of the
    demo's plan.
    """
    emulator = yaml.safe_load((CONFIG / "rigsim.yaml").read_text(encoding="utf-8"))
    driver = yaml.safe_load((CONFIG / "demo_capture.yaml").read_text(encoding="utf-8"))["rig"]
    host = f"127.0.2.{os.getpid() % 200 + 10}"  # other emulators may live beside
    emulator |= {"seed": seed, "host": host, "log": str(folder / "events.jsonl"), "faults": faults}
    driver["robot"]["host"] = host
    for key in ("board", "load_cell"):
        emulator[key]["link"] = driver[key]["port"] = str(folder / key)
    emulator["world"]["probe_file"] = str(folder / "probe-mm")
    driver["probe_change"] = ["sh", "-c", f"printf %s \"$1\" > '{folder / 'probe-mm'}'", "sh"]
    driver["plan"] |= {"seed": seed, **plan}
    return emulator, driver


@contextmanager
def _emulated(folder: Path, config: dict) -> Iterator[None]:
    """The emulated rig, listening, until the block ends."""
    path = folder / "rigsim.yaml"
    path.write_text(yaml.safe_dump(config), encoding="utf-8")
    command = [sys.executable, "-m", "rigsim", str(path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdin is not None and process.stdout is not None
        try:
            if not process.stdout.readline():
                raise RuntimeError("the emulated rig did not start")
            yield
        finally:
            process.stdin.close()
            process.wait(ENDING_S)


def capture(seed: int, plan: dict, faults: list[dict]) -> dict:
    """One capture that began: what the emulator and the journal say of it.

    Keys: refusals, how often the driver refused to begin before; begins_N, the true force at the
    fault's beginning, NaN without one; largest_N, the
    largest true force; stopped, whether the capture ended early; reason, why; presses begun;
    finished presses; spoilt_finished, whether the press of the fault counts as finished; broken,
    rules of the emulator that the driver broke.

    Raises RuntimeError after MAX_REFUSALS.
    """
    for refusals in range(MAX_REFUSALS):
        events, records, refusal = _capture(seed, plan, faults)
        if records:
            return {"refusals": refusals, **_outcome(events, records)}
    raise RuntimeError(f"no capture began: {refusal}")


def _capture(seed: int, plan: dict, faults: list[dict]) -> tuple[list[dict], list[dict], str]:
    """The emulator's events, the journal's records, none where no capture began, and the end of
    what the driver says."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        emulator, driver = configurations(folder, seed, plan, faults)
        (folder / "rig.yaml").write_text(yaml.safe_dump({"rig": driver}), encoding="utf-8")
        files = ["--journal", str(folder / "journal.jsonl"), "--out", str(folder / "it.parquet")]
        run = [sys.executable, "-m", "eitskin.cli", "rig", "run", str(folder / "rig.yaml"), *files]
        with _emulated(folder, emulator):
            process = subprocess.run(run, capture_output=True, text=True, timeout=CAPTURE_S)
        began = (folder / "journal.jsonl").exists()
        records = journal.read(folder / "journal.jsonl").records if began else []
        log = (folder / "events.jsonl").read_text(encoding="utf-8")
    events = [json.loads(line) for line in log.splitlines()]
    return events, records, process.stderr[-2000:]


def _outcome(events: list[dict], records: list[dict]) -> dict:
    """The keys of `capture`, from the emulator's events and the journal's records."""
    fault = next((event for event in events if event["event"] == "fault"), None)
    stop = next((record for record in records if record["kind"] == "stop"), None)
    finished = {record["contact"] for record in records if record["kind"] == "end"}
    return {
        "begins_N": np.nan if fault is None else fault["now"]["force_N"],
        "largest_N": max(event.get("largest_N", 0.0) for event in events),
        "stopped": stop is not None,
        "reason": "" if stop is None else stop["reason"],
        "presses": sum(event["event"] == "touched" for event in events),
        "finished": len(finished),
        "spoilt_finished": fault is not None and fault["now"]["contact"] - 1 in finished,
        "broken": sum(event["event"] == "violation" for event in events),
    }


def faulty(starts: int) -> Iterator[dict]:
    """`starts` captures of each of FAULTS, with the keys of `capture`, the fault's name, and the
    start's number and probe."""
    jobs = [(name, start) for start in range(starts) for name in FAULTS]
    for name, start in patient(jobs, "faults of the emulated rig"):
        number = list(FAULTS).index(name)
        draw = np.random.default_rng([SEED, number, start])
        fault = FAULTS[name] | {
            "contact": int(draw.integers(1, 3)),
            "force_N": float(draw.uniform(LEAST_N, LARGEST_N)),
        }
        probe_mm = float(draw.choice(PROBES_MM))
        plan = {"probes_mm": [probe_mm], "sessions_per_probe": 1}
        seed = int(draw.integers(2**16))
        yield {"fault": name, "start": start, "probe_mm": probe_mm, **capture(seed, plan, [fault])}


def undisturbed(presses: int) -> dict:
    """One capture of `presses` presses, a multiple of 15, with all probes."""
    plan = {"radii": 5, "angles": presses // (5 * len(PROBES_MM)), "probes_mm": list(PROBES_MM)}
    return {"fault": "none", "start": 0, **capture(SEED, plan, [])}


def page(table: pd.DataFrame, command: dict) -> str:
    """The page of the captures in `table`: a line a fault."""
    lines = []
    for name, group in table.groupby("fault", sort=False):
        stops = group.loc[group["stopped"], "reason"].value_counts()
        reasons = ", ".join(f"{count} {reason}" for reason, count in stops.items())
        cells = (
            f"{name}, {int(group['presses'].sum())} presses" if name == "none" else name,
            len(group),
            int(group["stopped"].sum()),
            int(group["spoilt_finished"].sum()),
            f"{group['largest_N'].max():.2f}",
            int(group["broken"].sum()),
            reasons,
        )
        lines.append(f"| {' | '.join(map(str, cells))} |")
    return HEAD.format(**command, least_N=LEAST_N, largest_N=LARGEST_N) + "\n".join(lines) + "\n"


def main() -> None:
    """Measure and write both files."""
    parser = argparse.ArgumentParser(prog="benchmark.rig_faults", description=__doc__)
    parser.add_argument("--starts", type=int, default=10, help="captures of each fault")
    parser.add_argument("--presses", type=int, default=300, help="presses without a fault")
    arguments = parser.parse_args()
    command = {**vars(arguments), "commit": rows.commit()}
    emulator = yaml.safe_load((CONFIG / "rigsim.yaml").read_text(encoding="utf-8"))
    command["hard_N"] = emulator["rules"]["hard_N"]
    table = pd.DataFrame([undisturbed(arguments.presses), *faulty(arguments.starts)])
    with atomic_path(CSV) as path:
        table.to_csv(path, index=False, float_format="%.4f")
    with atomic_path(PAGE) as path:
        path.write_text(page(table, command), encoding="utf-8")


if __name__ == "__main__":
    main()
