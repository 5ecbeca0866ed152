"""An emulated rig in a process of its own, and the configuration with which the driver meets it."""

import contextlib
import copy
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import yaml

from rigsim_process import free_host

CENTRE = [-0.593, -0.201, -0.092, 0.0, 3.1416, 0.0]
CLEARANCE_M = 0.003
BOX = [[-0.70, -0.48], [-0.31, -0.09], [-0.125, 0.1]]
HARD_N = 20.0
SKIN = {
    "radius_mm": 80.0,
    "thickness_mm": 3.0,
    "conductivity_S_per_m": 0.5,
    "electrode_deg": [22.5 * k for k in range(16)],
    "electrode_width_mm": 5.0,
    "contact_impedivity_ohm_m2": 0.002,
    "current_A": 0.01,  # RMS, as the readings
    "contrast_per_N": 0.9,
}
BOARD = {"baud": 115200, "frame_s": 0.3, "period_s": 0.35}
CELL = {"baud": 115200, "profile": "hx711"}


class Emulated:
    """A running emulator: its process, endpoints, and the driver's configuration for it."""

    def __init__(self, folder: Path, process: subprocess.Popen, endpoints: dict, config: dict):
        self.folder, self.process = folder, process
        self.endpoints, self.config = endpoints, config
        self._events: list[dict] = []
        self._read = 0  # bytes of the log

    @property
    def path(self) -> Path:
        """The driver's configuration as it stands now, written to a file."""
        path = self.folder / "rig.yaml"
        path.write_text(yaml.safe_dump({"rig": self.config}), encoding="utf-8")
        return path

    @property
    def events(self) -> list[dict]:
        """What the emulator has logged so far."""
        with Path(self.endpoints["log"]).open("rb") as log:
            log.seek(self._read)
            new = log.read()
        complete_lines = new[: new.rfind(b"\n") + 1]
        self._read += len(complete_lines)
        self._events += map(json.loads, complete_lines.splitlines())
        return self._events

    def named(self, event: str) -> list[dict]:
        """The logged events of one name."""
        return [logged for logged in self.events if logged["event"] == event]

    def begin(self, **fault: object) -> None:
        """Let a fault happen, when its conditions hold."""
        self.process.stdin.write(json.dumps(fault) + "\n")
        self.process.stdin.flush()


@contextlib.contextmanager
def emulated_rig(
    folder: Path, series: str = "cb3", speedup: float = 1.0, **cell: object
) -> Iterator[Emulated]:
    """Start an emulator on an address of its own; it ends with the context."""
    host = free_host()
    probe_file = folder / "probe_mm"
    cell = CELL | cell
    config = {
        "seed": 1,
        "host": host,
        "series": series,
        "speedup": speedup,
        "log": str(folder / "events.jsonl"),
        "robot": {"pose": CENTRE},
        "world": {
            "skin": SKIN,
            "place": {
                "x_m": CENTRE[0],
                "y_m": CENTRE[1],
                "surface_z_m": CENTRE[2] - CLEARANCE_M,
                "angle_deg": 0.0,
            },
            "stiffness": {"N_per_mm": 1.1, "exponent": 1.2, "scatter": 0.05},
            "probe_mm": 10.0,
            "probe_file": str(probe_file),
            "effects": [],
            "noise": 0.001,
            "accuracy": "train",
            "force_max_N": 10.0,
        },
        "board": {"link": str(folder / "board"), **BOARD},
        "load_cell": {"link": str(folder / "load_cell"), "rate_Hz": 20, "noise_N": 0.005, **cell},
        "rules": {
            "hard_N": HARD_N,
            "box_m": BOX,
            "max_speed_m_s": 0.1,
            "max_acceleration_m_s2": 1.5,
            "watchdog": True,
            "asynchronous": True,
        },
        "faults": [],
    }
    path = folder / "rigsim.yaml"
    path.write_text(yaml.safe_dump(config), encoding="utf-8")
    process = subprocess.Popen(
        [sys.executable, "-m", "rigsim", str(path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        endpoints = json.loads(process.stdout.readline())
        driven = driver_config(endpoints, series, speedup, cell, folder)
        yield Emulated(folder, process, endpoints, driven)
    finally:
        process.stdin.close()
        process.wait(timeout=20)
        process.stdout.close()


def driver_config(endpoints: dict, series: str, speedup: float, cell: dict, folder: Path) -> dict:
    """The driver's configuration: three places and one probe, times as the emulator shortens
    them."""
    return copy.deepcopy(
        {
            "name": "emulated",
            "emulated": True,
            "robot": {"host": endpoints["robot_host"], "series": series},
            "board": {
                "port": endpoints["board"],
                "profile": "circular-16",
                "baud": BOARD["baud"],
                # Gaps of 0.3 to 1.1 s are frames: on a busy machine the emulator is late.
                "period_s": 0.6 / speedup,
                "frame_s": BOARD["frame_s"] / speedup,
            },
            "load_cell": {
                "port": endpoints["load_cell"],
                "profile": cell["profile"],
                "baud": cell["baud"],
            },
            "skin": {"id": "emulated-1", **SKIN},
            "session": {"operator": "a test", "room_C": 21.0},
            "pose": {"centre": CENTRE, "box_m": BOX},
            "motion": {
                "travel_m_s": 0.05,
                "travel_m_s2": 0.5,
                "press_m_s": 0.009,
                "press_m_s2": 0.1,
                "search_m_s": 0.002,
                "stop_m_s2": 1.0,
            },
            "plan": {
                "seed": 1,
                "radius_mm": 88.0,
                "radii": 1,
                "angles": 3,
                "inner": 0.3,
                "outer": 0.3,
                "probes_mm": [10.0],
                "sessions_per_probe": 1,
                "untouched_frames": 2,
                "search_mm": 8.0,
                "touch_N": 0.15,
                "step_mm": 1.0,
                "depth_cap_mm": 8.0,
                "target_N": [2.0, 3.0],
                "settle_s": 0.1,
                "hold_frames": 0,
                "unload": False,
            },
            "probe_change": [
                "sh",
                "-c",
                f"printf %s \"$1\" > '{folder / 'probe_mm'}'",
                "sh",
            ],
            "limits": {
                "soft_N": 12.0,
                "hard_N": HARD_N,
                "zero_N": 0.3,
                "jump_N": 4.0,
                "stale_s": 1.0,
                "watchdog_Hz": 10.0,
                "clock_s": 1.0,  # a busy machine's emulator pauses
                "rejects": 5,
                "frozen_readings": 8,
                "latency_s": 0.4,
                "stiffness_N_per_mm": 2.0,
                "least_stiffness_N_per_mm": 0.2,
                "rise_mm": 1.0,
            },
        }
    )
