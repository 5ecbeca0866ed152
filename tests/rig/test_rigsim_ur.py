"""The emulated robot through the real, unmodified ur_rtde; judged by the emulator's log."""

import contextlib
import socket
import time
from collections.abc import Iterator

import pytest

from rigsim.log import EventLog
from rigsim.robot import NORMAL, Controller
from rigsim_process import CENTRE, client, emulator

pytest.importorskip("rtde_control", reason="ur-rtde, of the extra rig, is not installed")

pytestmark = pytest.mark.rehearsal

DOWN = [*CENTRE[:2], CENTRE[2] - 0.010, *CENTRE[3:]]
CONNECT = """
r = rtde_receive.RTDEReceiveInterface(host)
c = rtde_control.RTDEControlInterface(host)
pose = r.getActualTCPPose()
down = pose[:2] + [pose[2] - 0.010] + pose[3:]
say(pose=pose, mode=r.getRobotMode(), safety=r.getSafetyMode(), runs=c.isProgramRunning())

def streamed(shown):  # it is some cycles old
    for _ in range(25):
        if shown():
            break
        time.sleep(0.004)
"""
LEAVE = """
heard()
os._exit(0)
"""


@pytest.fixture(params=["cb3", "e"])
def rig(request, tmp_path):
    with emulator(tmp_path, series=request.param) as rig:
        yield rig
        assert rig.end() == 0
        assert not rig.events("violation")


@pytest.fixture
def cb3(tmp_path):
    with emulator(tmp_path) as rig:
        yield rig


@pytest.fixture(scope="module")
def resting(tmp_path_factory):
    """A cb3 for tests that move nothing and leave it as it was."""
    with emulator(tmp_path_factory.mktemp("resting")) as rig:
        yield rig


@contextlib.contextmanager
def lasting(rig, name: str) -> Iterator[float]:
    """Until the end a fault lasts; when it began."""
    asked = time.monotonic()
    rig.fault(name)
    began = rig.wait("fault", since=asked)["t"]
    try:
        yield began
    finally:
        rig.fault(name, end=True)
        rig.wait("fault over", since=began)


def test_receive_and_control_connect_and_the_script_is_known(rig):
    with client(rig.host, CONNECT + LEAVE) as host:
        messages = host.said()
    assert messages == {"pose": CENTRE, "mode": 7, "safety": 1, "runs": True}
    script = rig.events("program")[0]
    series = rig.events("start")[0]["config"]["series"]
    assert (
        script["known"] == {"cb3": "ur_rtde 1.6.5 for 3.15", "e": "ur_rtde 1.6.5 for 5.12"}[series]
    )
    assert script["bytes"] == {"cb3": 38544, "e": 42163}[series]


def test_an_asynchronous_move_is_stopped_where_it_is_and_a_whole_one_arrives(rig):
    code = """
begun = c.moveL(down, 0.002, 0.05, True)
say(begun=begun, progress=c.getAsyncOperationProgress())
heard()
c.stopL(0.5)
say(z=r.getActualTCPPose()[2], progress=c.getAsyncOperationProgress())
arrived = c.moveL(down, 0.05, 0.5)
streamed(lambda: abs(r.getActualTCPPose()[2] - down[2]) < 1e-9)
say(arrived=arrived, pose=r.getActualTCPPose(), force=r.getActualTCPForce()[2])
"""
    with client(rig.host, CONNECT + code + LEAVE) as host:
        host.said()
        start_messages = host.said()
        assert start_messages["begun"] and start_messages["progress"] >= 0
        rig.wait("moving")
        host.tell()
        stopped = host.said()
        assert stopped["progress"] < 0
        arrived = host.said()
    still_event, arrival_event = rig.events("still")
    assert CENTRE[2] - 0.010 < still_event["pose"][2] < CENTRE[2]
    assert still_event["velocity"] == [0.0] * 6
    assert arrived["arrived"] is True
    assert arrival_event["pose"] == pytest.approx(DOWN, abs=1e-7)
    # What is streamed is at most some cycles old.
    assert stopped["z"] == pytest.approx(still_event["pose"][2], abs=1e-4)
    assert arrived["pose"] == pytest.approx(DOWN, abs=1e-9)
    assert arrived["force"] == pytest.approx(0.55 * 5.0**1.5, rel=1e-6)
    assert [e["asynchronous"] for e in rig.events("moveL")] == [True, False]


def test_speed_l_goes_on_until_it_is_stopped(cb3):
    code = """
c.speedL([0, 0, 0.01, 0, 0, 0], 0.2)
heard()
stopped = c.speedStop(0.2)
say(stopped=stopped, z=r.getActualTCPPose()[2])
"""
    with client(cb3.host, CONNECT + code + LEAVE) as host:
        host.said()
        cb3.wait("moving")
        host.tell()
        assert host.said()["stopped"] is True
    assert cb3.wait("still")["pose"][2] > CENTRE[2]


def test_without_a_watchdog_a_killed_host_leaves_the_robot_moving_to_its_target(cb3):
    code = "c.moveL(down, 0.02, 0.5, True)\nheard()\n"
    with client(cb3.host, CONNECT + code) as host:
        host.said()
        cb3.wait("moving")
        host.kill()
        still_event = cb3.wait("still")
    assert still_event["pose"] == pytest.approx(DOWN, abs=1e-7)


def test_with_a_watchdog_a_killed_host_stops_the_robot(cb3):
    code = """
assert c.setWatchdog(2)
c.moveL(pose[:2] + [pose[2] + 0.05] + pose[3:], 0.01, 0.5, True)
say(moving=True)
while True:
    c.kickWatchdog()
    time.sleep(0.01)
"""
    with client(cb3.host, CONNECT + code) as host:
        host.said()
        host.said()
        host.kill()
        killed = time.monotonic()
        watchdog = cb3.wait("watchdog")
        still_event = cb3.wait("still", since=watchdog["t"])
    assert watchdog["t"] >= killed - 0.01
    lift_m = still_event["pose"][2] - CENTRE[2]
    assert 0.0 < lift_m < 0.049
    # 10 mm/s for the half second without a host, and the way to stand still.
    assert still_event["pose"][2] - watchdog["pose"][2] < 1e-4
    assert cb3.events("program stopped")[-1]["reason"] == "watchdog"


def test_a_protective_stop_is_unlocked_no_sooner_than_after_five_seconds(tmp_path):
    robot = Controller("cb3", CENTRE, 1.0, {}, EventLog(tmp_path / "events.jsonl"))
    robot.protective_stop()
    for _ in range(240):
        robot.tick(0.02)
        assert not robot.unlock()
    for _ in range(20):
        robot.tick(0.02)
    assert robot.unlock() and robot.safety_mode == NORMAL


def test_a_protective_stop_ends_moves_until_it_is_unlocked(cb3):
    code = """
say(arrived=c.moveL(down, 0.001, 0.05))
while not r.isProtectiveStopped():
    time.sleep(0.01)
say(arrived=c.moveL(pose, 0.05, 0.5))
heard()
while r.isProtectiveStopped():
    time.sleep(0.01)
c.reuploadScript()
while not c.isProgramRunning():
    time.sleep(0.01)
say(arrived=c.moveL(pose, 0.05, 0.5))
"""
    with client(cb3.host, CONNECT + code + LEAVE) as host:
        host.said()
        cb3.wait("moving")
        cb3.fault("protective_stop")
        assert host.said()["arrived"] is False
        assert host.said()["arrived"] is False
        assert dashboard(cb3, "safetymode") == "Safetymode: PROTECTIVE_STOP"
        while "until 5s" in dashboard(cb3, "unlock protective stop"):
            time.sleep(0.1)
        assert dashboard(cb3, "safetymode") == "Safetymode: NORMAL"
        host.tell()
        assert host.said()["arrived"] is True
    stop, still_event = cb3.events("protective stop")[0], cb3.events("still")[0]
    assert abs(still_event["pose"][2] - stop["pose"][2]) < 1e-5


def test_an_emergency_stop_takes_the_power_until_it_is_given_back(cb3):
    code = """
say(arrived=c.moveL(down, 0.001, 0.05))
heard()
streamed(lambda: r.getRobotMode() != 7)
say(emergency=r.isEmergencyStopped(), mode=r.getRobotMode(), safety=r.getSafetyMode())
"""
    with client(cb3.host, CONNECT + code + LEAVE) as host:
        host.said()
        cb3.wait("moving")
        cb3.fault("emergency_stop", for_s=0.5)
        assert host.said()["arrived"] is False
        host.tell()
        messages = host.said()
    assert messages in (
        {"emergency": True, "mode": 3, "safety": 7},
        {"emergency": False, "mode": 3, "safety": 1},
    )
    cb3.wait("emergency stop released")
    assert dashboard(cb3, "power on") == "Powering on"
    assert dashboard(cb3, "robotmode") == "Robotmode: IDLE"
    assert dashboard(cb3, "brake release") == "Brake releasing"
    assert dashboard(cb3, "robotmode") == "Robotmode: RUNNING"


def test_the_dashboards_stop_is_a_second_way_to_stop(rig):
    code = "say(arrived=c.moveL(down, 0.001, 0.05))\n"
    with client(rig.host, CONNECT + code + LEAVE) as host:
        host.said()
        rig.wait("moving")
        assert dashboard(rig, "stop") == "Stopped"
        assert host.said()["arrived"] is False
    assert rig.wait("still")["pose"][2] > DOWN[2]
    assert dashboard(rig, "programState").startswith("STOPPED")
    assert "(EMULATED)" in dashboard(rig, "PolyscopeVersion")
    assert dashboard(rig, "no such command") == "could not understand: 'no such command'"


def test_a_stalled_stream_leaves_the_last_pose_and_comes_back(resting):
    code = """
heard()
while r.isConnected():
    time.sleep(0.01)
say(pose=r.getActualTCPPose())
heard()
say(back=r.reconnect(), pose=r.getActualTCPPose())
"""
    with client(resting.host, CONNECT + code + LEAVE) as host:
        host.said()
        with lasting(resting, "rtde_stalled"):
            host.tell()
            assert host.said()["pose"] == CENTRE
        host.tell()
        assert host.said() == {"back": True, "pose": CENTRE}


def test_a_reset_connection_is_seen_and_taken_up_again(resting):
    code = """
r = rtde_receive.RTDEReceiveInterface(host)
say(pose=r.getActualTCPPose())
heard()
while r.isConnected():
    time.sleep(0.01)
say(back=r.reconnect(), pose=r.getActualTCPPose())
"""
    with client(resting.host, code + LEAVE) as host:
        host.said()
        resting.fault("rtde_reset")
        host.tell()
        assert host.said() == {"back": True, "pose": CENTRE}


def test_registers_that_somebody_else_has_are_in_use(resting):
    code = """
try:
    rtde_control.RTDEControlInterface(host)
except RuntimeError as error:
    say(error=str(error))
"""
    with lasting(resting, "rtde_in_use") as began, client(resting.host, code + LEAVE) as host:
        assert "already in use" in host.said()["error"]
        assert resting.events("rtde in use", since=began)


def test_a_closed_port_refuses_and_opens_again(resting):
    code = """
for _ in range(2):
    heard()
    try:
        say(connected=rtde_receive.RTDEReceiveInterface(host).isConnected())
    except RuntimeError as error:
        say(error=str(error))
"""
    with client(resting.host, code + LEAVE) as host:
        with lasting(resting, "rtde_refused"):
            host.tell()
            assert "verify the IP" in host.said()["error"]
        host.tell()
        assert host.said() == {"connected": True}


def test_a_mute_server_accepts_and_says_nothing(resting):
    with (
        lasting(resting, "rtde_mute"),
        socket.create_connection((resting.host, 30004), timeout=0.5) as mute,
    ):
        mute.sendall(b"\x00\x05V\x00\x02")
        with pytest.raises(TimeoutError):
            mute.recv(1)


def test_a_killed_program_ends_the_move(cb3):
    code = "say(arrived=c.moveL(down, 0.001, 0.05), runs=c.isProgramRunning())\n"
    with client(cb3.host, CONNECT + code + LEAVE) as host:
        host.said()
        cb3.wait("moving")
        cb3.fault("program_killed")
        assert host.said()["arrived"] is False
    assert cb3.wait("still")["pose"][2] > DOWN[2]


def test_a_stop_from_a_second_thread_stops_no_synchronous_move(cb3):
    code = """
def stop():
    heard()
    c.stopL(0.5)
thread = threading.Thread(target=stop)
thread.start()
arrived = c.moveL(down, 0.005, 0.5)
thread.join()
say(arrived=arrived, z=r.getActualTCPPose()[2])
"""
    with client(cb3.host, CONNECT + code + LEAVE) as host:
        host.said()
        cb3.wait("moving")
        host.tell()
        messages = host.said()
    assert messages["arrived"] is True and messages["z"] == pytest.approx(DOWN[2], abs=1e-6)
    # It comes too late or never.
    assert all(stop["t"] > cb3.events("still")[0]["t"] for stop in cb3.events("stopL"))


def dashboard(rig, command: str) -> str:
    """A dashboard's answer."""
    with socket.create_connection((rig.host, 29999), timeout=30.0) as stream:
        lines = stream.makefile("rw", newline="\n")
        assert lines.readline() == "Connected: Universal Robots Dashboard Server\n"
        lines.write(f"{command}\n")
        lines.flush()
        return lines.readline().strip()
