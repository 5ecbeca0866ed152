"""What a driver that breaks a rule finds: an entry of the log and the emulator's exit code."""

import asyncio
import json
import signal
import socket
import subprocess
import sys

import numpy as np
import pytest
import yaml

from eitskin.errors import InputError
from eitskin.physics.protocol import channel_table
from rigsim import robot
from rigsim.config import read_config, read_fault
from rigsim.log import EventLog
from rigsim.rig import Rig
from rigsim.robot import Controller
from rigsim.ur import SCRIPT_PORT, ScriptServer
from rigsim.world import World
from rigsim_process import (
    CENTRE,
    ROOT,
    SURFACE_Z_M,
    client,
    configuration,
    emulator,
    free_host,
    in_background,
)

STRICT = {
    "box_m": [[-0.7, -0.5], [-0.3, -0.1], [-0.112, 0.0]],
    "max_speed_m_s": 0.1,
    "max_acceleration_m_s2": 1.0,
    "watchdog": True,
    "asynchronous": True,
}
SCRIPT = b"# float register offset\n 0\n# int register offset\n 0\ndef rtde_control():\nend\n"


def broken(log: EventLog) -> list[str]:
    entries = map(json.loads, log.path.read_text(encoding="utf-8").splitlines())
    return [e["rule"] for e in entries if e["event"] == "violation"]


def playing(folder, monkeypatch, script: bytes = SCRIPT) -> Controller:
    """A controller with a program that it takes for a known one."""
    controller = Controller("cb3", CENTRE, 1.0, STRICT, EventLog(folder / "events.jsonl"))
    monkeypatch.setattr(robot, "SCRIPTS", {robot.digest(SCRIPT): "a test's"})
    controller.start(script)
    assert not controller.playing
    for _ in range(10):
        controller.tick(0.02)
    return controller


def command(controller: Controller, number: int, doubles=(), asynchronous: int = 1) -> None:
    """One command, its acknowledgement and the clearing of it."""
    values = {f"input_double_register_{k}": value for k, value in enumerate(doubles)}
    controller.receive(
        values | {"input_int_register_1": asynchronous, "input_int_register_0": number}
    )
    controller.tick(0.008)
    controller.receive({"input_int_register_0": 0})


def test_a_driver_that_keeps_the_rules_breaks_none(tmp_path, monkeypatch):
    controller = playing(tmp_path, monkeypatch)
    command(controller, 35, [10.0])
    command(controller, 3, [*CENTRE, 0.05, 0.5])
    command(controller, 33, [0.5])
    assert broken(controller.log) == []


@pytest.mark.parametrize(
    ("doubles", "asynchronous", "rule"),
    [
        ([*CENTRE, 0.2, 0.5], 1, "max_speed_m_s"),
        ([*CENTRE, 0.05, 1.5], 1, "max_acceleration_m_s2"),
        ([*CENTRE[:2], -0.113, *CENTRE[3:], 0.05, 0.5], 1, "box_m"),
        ([*CENTRE, 0.05, 0.5], 0, "asynchronous moves only"),
    ],
)
def test_a_move_beyond_the_rules_is_a_violation(tmp_path, monkeypatch, doubles, asynchronous, rule):
    controller = playing(tmp_path, monkeypatch)
    command(controller, 35, [10.0])
    command(controller, 3, doubles, asynchronous)
    assert broken(controller.log) == [rule]


def test_a_move_before_the_last_is_over_is_a_violation(tmp_path, monkeypatch):
    controller = playing(tmp_path, monkeypatch)
    command(controller, 35, [10.0])
    command(controller, 3, [*CENTRE[:2], -0.08, *CENTRE[3:], 0.01, 0.5])
    command(controller, 3, [*CENTRE, 0.01, 0.5])
    assert broken(controller.log) == ["moves begin at rest"]


def test_a_move_without_a_watchdog_is_a_violation(tmp_path, monkeypatch):
    controller = playing(tmp_path, monkeypatch)
    command(controller, 3, [*CENTRE, 0.05, 0.5])
    assert broken(controller.log) == ["a watchdog before any motion"]


def test_a_command_while_another_runs_is_lost_and_a_violation(tmp_path, monkeypatch):
    controller = playing(tmp_path, monkeypatch)
    command(controller, 35, [1.0])
    up = [*CENTRE[:2], -0.08, *CENTRE[3:], 0.01, 0.5]
    values = {f"input_double_register_{k}": value for k, value in enumerate(up)}
    controller.receive(values | {"input_int_register_1": 0, "input_int_register_0": 3})
    controller.tick(0.008)
    controller.receive({"input_double_register_0": 0.5, "input_int_register_0": 33})
    controller.tick(0.008)
    assert controller.moving
    assert broken(controller.log)[-1] == "one command at a time"


def test_a_command_that_is_not_emulated_is_a_violation(tmp_path, monkeypatch):
    controller = playing(tmp_path, monkeypatch)
    command(controller, 57)
    assert broken(controller.log) == ["a command that is emulated"]


@pytest.mark.parametrize(
    ("script", "rules"),
    [
        (SCRIPT + b"\n# one byte more\nend\n", ["script known"]),
        (SCRIPT.replace(b"def", b"$5.4 def"), ["script without version marks", "script known"]),
        (SCRIPT[:-5], ["script known"]),
    ],
)
def test_a_script_that_is_not_the_known_one_is_a_violation(tmp_path, monkeypatch, script, rules):
    assert broken(playing(tmp_path, monkeypatch, script).log) == rules


def test_half_a_script_does_not_run_and_is_a_violation(tmp_path, monkeypatch):
    controller = Controller("cb3", CENTRE, 1.0, STRICT, EventLog(tmp_path / "events.jsonl"))
    host = free_host()

    async def listen() -> None:
        await asyncio.start_server(ScriptServer(controller).serve, host, SCRIPT_PORT)

    with in_background() as loop:
        asyncio.run_coroutine_threadsafe(listen(), loop).result()
        with socket.create_connection((host, SCRIPT_PORT), timeout=30.0) as upload:
            upload.sendall(SCRIPT[:-5])
            upload.shutdown(socket.SHUT_WR)
            assert upload.recv(1) == b""
    assert not controller.playing
    assert broken(controller.log) == ["script complete"]


def test_the_watchdog_counts_the_robots_time(tmp_path, monkeypatch):
    controller = playing(tmp_path, monkeypatch)
    command(controller, 35, [10.0])
    command(controller, 3, [*CENTRE[:2], -0.05, *CENTRE[3:], 0.01, 0.5])
    controller.tick(30.0)  # the emulator itself was late: no more than one cycle goes by
    assert controller.playing and controller.moving
    for _ in range(12):
        controller.tick(0.008)
        controller.receive({"input_int_register_0": 0})
    assert controller.playing
    for _ in range(14):
        controller.tick(0.008)
    assert not controller.playing
    for _ in range(5):
        controller.tick(0.008)
    assert not controller.moving


@pytest.mark.parametrize(
    ("poses", "rule"),
    [
        ([[0.0, 0.0, -13.0]], "hard_N"),
        ([[0.0, 0.0, -1.0], [2.0, 0.0, -1.0]], "no dragging"),
        ([[0.0, 90.0, -1.0]], "presses on the skin"),
    ],
)
def test_what_the_world_itself_forbids_is_told_once_a_press(tmp_path, poses, rule):
    rig = Rig(configuration(tmp_path))
    for k, offset in enumerate(poses):
        pose = np.array(CENTRE)
        pose[:3] = [CENTRE[0], CENTRE[1], SURFACE_Z_M] + 1e-3 * np.array(offset)
        rig.robot.motion = rig.robot.motion.rest(pose)
        for step in range(3):
            rig._step(rig.start + 0.01 * (3 * k + step + 1))
    assert broken(rig.log) == [rule]


def test_a_broken_rule_is_the_emulators_exit_code(tmp_path):
    rules = {"max_speed_m_s": 0.01}
    with emulator(tmp_path, rules=rules) as rig:
        with client(
            rig.host,
            "c = rtde_control.RTDEControlInterface(host)\n"
            f"say(moved=c.moveL({[*CENTRE[:2], -0.09, *CENTRE[3:]]}, 0.05, 0.5))\n"
            "heard()\n",
        ) as host:
            assert host.said()["moved"] is True
        assert rig.end() == 3
    assert rig.events("violation")[0]["rule"] == "max_speed_m_s"
    assert rig.events("end")[0]["violations"] == 1


def test_an_emulator_ends_with_its_parents_pipe_or_by_a_signal_and_leaves_no_links(tmp_path):
    with emulator(tmp_path) as rig:
        rig.process.stdin.write("no JSON\n" + json.dumps({"fault": "no_such"}) + "\n")
        rig.process.stdin.flush()
        while len(rig.events("control refused")) < 2:
            pass
        assert rig.end() == 0
    assert not (tmp_path / "board").is_symlink() and not (tmp_path / "load-cell").is_symlink()
    with (
        emulator(tmp_path) as rig,
        socket.create_connection((rig.host, 29999), timeout=30.0) as dashboard,
    ):
        assert dashboard.recv(100)
        rig.process.send_signal(signal.SIGTERM)
        assert rig.process.wait(60) == 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"series": "cb2"}, "series: found 'cb2', expected one of cb3, e"),
        ({"faults": [{"fault": "flood"}]}, "faults.0.fault: found 'flood'"),
        ({"board": {"baud": "fast"}}, "board.baud: found 'fast', expected a whole number"),
    ],
)
def test_a_wrong_configuration_is_one_line(tmp_path, change, message):
    path = tmp_path / "rigsim.yaml"
    path.write_text(yaml.safe_dump(configuration(tmp_path, **change)), encoding="utf-8")
    with pytest.raises(InputError) as refused:
        read_config(path)
    assert message in str(refused.value)


def test_the_paper_like_rig_reads_as_real_boards_do():
    config = read_config(ROOT / "workflow" / "config" / "rigsim.yaml")
    world = World(config["world"], channel_table(16), config["seed"])
    reading = np.abs(world.readings(world.voltages(0.0, 0.3, None)))
    # Frames of real boards go down to 0.0365 V; a sine at full scale has 0.778 V.
    assert reading.min() > 0.0365 and reading.max() < 0.778


def test_a_wrong_configuration_ends_the_program_with_code_1(tmp_path):
    path = tmp_path / "rigsim.yaml"
    path.write_text("{}", encoding="utf-8")
    ended = subprocess.run(
        [sys.executable, "-m", "rigsim", str(path)], capture_output=True, text=True
    )
    assert ended.returncode == 1 and len(ended.stderr.splitlines()) == 1


def test_a_fault_waits_for_all_of_its_conditions(tmp_path):
    rig = Rig(configuration(tmp_path))
    line = {"fault": "protective_stop", "contact": 2, "depth_mm": 1.0, "force_N": 1.0}
    rig.faults.pending.append(read_fault(json.dumps(line)))

    def press(depth_mm: float, t: float) -> None:
        pose = np.array(CENTRE)
        pose[2] = SURFACE_Z_M - 1e-3 * depth_mm
        rig.robot.motion = rig.robot.motion.rest(pose)
        rig._step(rig.start + t)

    for t, depth in enumerate([3.0, -1.0, 0.5, 1.2, 2.0], start=1):
        assert rig.robot.safety_mode == robot.NORMAL
        press(depth, float(t))
    assert rig.robot.safety_mode == robot.PROTECTIVE_STOP
    assert rig.world.contacts == 2


@pytest.mark.parametrize("speedup", [1.0, 5.0])
def test_compressed_time_shortens_frames_and_readings(tmp_path, speedup):
    rig = Rig(configuration(tmp_path, speedup=speedup))
    assert rig.board.frame_s == pytest.approx(0.03 / speedup)
    assert rig.board.period_s == pytest.approx(0.035 / speedup)
    assert rig.cell.period_s == pytest.approx(1.0 / 80.0 / speedup)
