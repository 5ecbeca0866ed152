"""An emulated rig for tests: its configuration, its process, and clients of the real libraries."""

import asyncio
import contextlib
import json
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import yaml

from rigsim.ur import RTDE_PORT

ROOT = Path(__file__).parents[1]
PATIENCE_S = 240.0  # with a machine that is busy with other things
CENTRE = [-0.593, -0.201, -0.092, 0.0, 3.142, 0.0]  # 5 mm above the gel
SURFACE_Z_M = -0.097
CLIENT = """
import json, os, socket, sys, threading, time
import rtde_control, rtde_receive
host = sys.argv[1]
def say(**values):
    print("SAID " + json.dumps(values), flush=True)
def heard():
    return json.loads(sys.stdin.readline())
"""


def free_host() -> str:
    """An IP of the loopback whose RTDE port nobody has."""
    first = os.getpid() % 200
    for k in range(200):
        host = f"127.0.1.{(first + k) % 200 + 10}"
        with socket.socket() as probe, contextlib.suppress(OSError):
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((host, RTDE_PORT))
            return host
    raise RuntimeError("no free loopback address")


def configuration(folder: Path, **changed) -> dict:
    """A whole configuration; `changed` blocks are merged into it."""
    config = {
        "seed": 1,
        "host": "127.0.0.1",
        "series": "cb3",
        "speedup": 1.0,
        "log": str(folder / "events.jsonl"),
        "robot": {"pose": CENTRE},
        "world": {
            "skin": {
                "radius_mm": 88.0,
                "thickness_mm": 3.0,
                "conductivity_S_per_m": 0.5,
                "electrode_deg": [22.5 * k for k in range(16)],
                "electrode_width_mm": 5.0,
                "contact_impedivity_ohm_m2": 0.002,
                "current_A": 0.01,
                "contrast_per_N": 0.9,
            },
            "place": {"x_m": -0.593, "y_m": -0.201, "surface_z_m": SURFACE_Z_M, "angle_deg": 0.0},
            "stiffness": {"N_per_mm": 0.55, "exponent": 1.5, "scatter": 0.0},
            "probe_mm": 10.0,
            "probe_file": None,
            "effects": [],
            "noise": 0.0,
            "accuracy": "train",
            "force_max_N": 10.0,
        },
        "board": {
            "link": str(folder / "board"),
            "baud": 115200,
            "frame_s": 0.03,
            "period_s": 0.035,
        },
        "load_cell": {
            "link": str(folder / "load-cell"),
            "baud": 115200,
            "profile": "hx711",
            "rate_Hz": 80,
            "noise_N": 0.004,
        },
        "rules": {
            "hard_N": 20.0,
            "box_m": [[-0.7, -0.5], [-0.3, -0.1], [-0.112, 0.0]],
            "max_speed_m_s": 0.1,
            "max_acceleration_m_s2": 1.0,
            "watchdog": False,
            "asynchronous": False,
        },
        "faults": [],
    }
    for name, value in changed.items():
        config[name] = {**config[name], **value} if isinstance(value, dict) else value
    return config


class Emulator:
    """A running `python -m rigsim`."""

    def __init__(self, config: dict, folder: Path):
        path = folder / "rigsim.yaml"
        path.write_text(yaml.safe_dump(config), encoding="utf-8")
        self.log = Path(config["log"])
        environment = {**os.environ, "PYTHONPATH": str(ROOT / "workflow")}
        self.process = subprocess.Popen(
            [sys.executable, "-m", "rigsim", str(path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=environment,
        )
        line = self.process.stdout.readline()
        assert line, "the emulator ended before it listened"
        self.endpoints = json.loads(line)
        self.host = self.endpoints["robot_host"]

    def events(self, event: str | None = None, since: float = 0.0) -> list[dict]:
        """The log's entries, all or of one kind, from t on."""
        lines = self.log.read_text(encoding="utf-8").splitlines(keepends=True)
        entries = [json.loads(line) for line in lines if line.endswith("\n")]
        return [e for e in entries if event in (None, e["event"]) and e["t"] >= since]

    def wait(self, event: str, since: float = 0.0) -> dict:
        """The first entry of a kind, once it is there."""
        give_up = time.monotonic() + PATIENCE_S
        while time.monotonic() < give_up:
            if found := self.events(event, since):
                return found[0]
            assert self.process.poll() is None, f"the emulator ended before {event}"
            time.sleep(0.01)
        raise AssertionError(f"no {event} in {PATIENCE_S} s")

    def fault(self, name: str, **values) -> None:
        """Let a fault happen."""
        self.process.stdin.write(json.dumps({"fault": name, **values}) + "\n")
        self.process.stdin.flush()

    def end(self) -> int:
        """Close its standard input; the exit code."""
        with contextlib.suppress(BrokenPipeError):
            self.process.stdin.close()
        return self.process.wait(PATIENCE_S)


@contextlib.contextmanager
def emulator(folder: Path, **changed) -> Iterator[Emulator]:
    """An emulated rig on an address of its own."""
    running = Emulator(configuration(folder, host=free_host(), **changed), folder)
    try:
        yield running
    finally:
        running.end()


class Client:
    """A process with the real ur_rtde, which crashes now and then; `code` goes on after CLIENT."""

    def __init__(self, host: str, code: str):
        self.process = subprocess.Popen(
            [sys.executable, "-c", CLIENT + code, host],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def said(self) -> dict:
        """What it says next; AssertionError where it ends instead."""
        for line in self.process.stdout:
            if line.startswith("SAID "):
                return json.loads(line[5:])
        raise AssertionError(f"the client ended with code {self.process.wait(PATIENCE_S)}")

    def tell(self, value: object = None) -> None:
        """Let its `heard()` return."""
        self.process.stdin.write(json.dumps(value) + "\n")
        self.process.stdin.flush()

    def kill(self) -> None:
        """SIGKILL."""
        self.process.kill()
        self.process.wait(PATIENCE_S)


@contextlib.contextmanager
def client(host: str, code: str) -> Iterator[Client]:
    """A client's process, killed in the end."""
    running = Client(host, code)
    try:
        yield running
    finally:
        running.kill()


@contextlib.contextmanager
def in_background(*parts) -> Iterator[asyncio.AbstractEventLoop]:
    """An event loop in a thread, running coroutines until the end."""
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever)
    thread.start()
    for part in parts:
        asyncio.run_coroutine_threadsafe(part, loop)
    try:
        yield loop
    finally:
        asyncio.run_coroutine_threadsafe(_cancel_all(), loop).result()
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()


async def _cancel_all() -> None:
    tasks = asyncio.all_tasks() - {asyncio.current_task()}
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
