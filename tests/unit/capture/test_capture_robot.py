"""The robot's process ends with the host, also where it has not said that it is ready."""

import signal
import subprocess
import threading
from collections.abc import Iterator

import pytest

from eitskin.capture.robot import Robot, RobotError


@pytest.fixture
def worker(monkeypatch) -> Iterator[list[subprocess.Popen]]:
    """The worker that a robot begins: it says nothing and hears no signal but SIGKILL."""
    processes, popen = [], subprocess.Popen

    def mute(command, **options):
        processes.append(popen(["sh", "-c", "trap '' INT TERM; exec sleep 600"], **options))
        return processes[-1]

    monkeypatch.setattr(subprocess, "Popen", mute)
    yield processes
    for process in processes:
        process.kill()
        process.wait()


def test_ctrl_c_before_the_robot_is_ready_leaves_no_worker(worker, monkeypatch):
    def interrupted(*_arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr(threading.Condition, "wait_for", interrupted)
    with pytest.raises(KeyboardInterrupt):
        Robot("127.0.0.1", 10.0)
    assert worker[0].wait(30) == -signal.SIGKILL


def test_a_robot_that_does_not_answer_leaves_no_worker(worker, monkeypatch):
    monkeypatch.setattr("eitskin.capture.robot.READY_S", 0.01)
    with pytest.raises(RobotError, match=r"127\.0\.0\.1: no answer within 0\.01 s"):
        Robot("127.0.0.1", 10.0)
    assert worker[0].wait(30) == -signal.SIGKILL
