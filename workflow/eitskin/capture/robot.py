"""The host's side of the robot: its latest state, requests and answers, two ways to stop."""

import contextlib
import json
import math
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from eitskin.capture.dashboard import Dashboard
from eitskin.capture.interlock import STILL_M_S

READY_S = 15.0  # the library uploads its script and waits up to 5 s for it
STOP_S = 0.3  # braking from the speed of a press takes some 10 ms
DASHBOARD_STOP_S = 2.0  # the dashboard answers slowly
MAX_STATES = 8192  # a minute at 125 Hz; the poses of a frame are looked up within a second
ALIVE_S = 0.05  # a tenth of the silence after which the worker stops the arm

Vector6D = tuple[float, float, float, float, float, float]  # as RTDE has poses and speeds


@dataclass(frozen=True)
class ReportedState:
    """A robot's state, received at `host_s` (monotonic s). Pose in m and rad, speed in m/s."""

    host_s: float
    timestamp_s: float
    pose: Vector6D
    speed: Vector6D
    robot_mode: int
    safety_mode: int
    safety_bits: int
    runtime_state: int
    running: bool

    @property
    def is_still(self) -> bool:
        """Whether nothing moves and nothing is about to."""
        return not self.running and math.hypot(*self.speed[:3]) < STILL_M_S


class RobotError(Exception):
    """A robot that is not available or refuses a command; its text is for a person."""


class Robot:
    """The worker process and the dashboard.

    The controller stops the arm where it hears less often than `watchdog_Hz` from the worker.
    Raises RobotError where the controller is not ready within READY_S. Where the worker ends later
    `failure` holds the reason.
    """

    def __init__(self, host: str, watchdog_Hz: float, clock: Callable[[], float] = time.monotonic):
        self._clock = clock
        self._changed = threading.Condition()
        self._states: deque[ReportedState] = deque(maxlen=MAX_STATES)
        self._answers: dict[int, tuple[bool, str]] = {}
        self._remount_command: deque[str] = deque(maxlen=20)
        self._ready_rig = False
        self._failure: str | None = None
        self._advanced_s = -math.inf
        self._requests = 0
        self._alive_s = -math.inf
        self.dashboard = Dashboard(host)
        self._process = subprocess.Popen(
            [sys.executable, "-m", "eitskin.capture.robot_worker", host, str(watchdog_Hz)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            bufsize=1,
            start_new_session=True,  # Ctrl-C at the terminal is the host's to handle
        )
        self._threads = [
            threading.Thread(target=target, daemon=True)
            for target in (self._read, self._read_stderr)
        ]
        try:
            for thread in self._threads:
                thread.start()
            with self._changed:
                self._changed.wait_for(
                    lambda: self._ready_rig or self._failure is not None, READY_S
                )
            if not self._ready_rig:
                reason = self._failure or f"no answer within {READY_S:g} s"
                raise RobotError(f"{host}: {reason}")
        except BaseException:  # Ctrl-C too, which the worker does not hear
            self._process.kill()
            raise

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            now_s, message = self._clock(), json.loads(line)
            with self._changed:
                if "state" in message:
                    self._store_state(message["state"], now_s)
                elif "id" in message:
                    self._answers[message["id"]] = (message["ok"], message.get("error", ""))
                elif "error" in message:
                    self._failure = message["error"]
                else:
                    self._ready_rig = True
                self._changed.notify_all()
        exit_code = self._process.wait()
        with self._changed:
            stderr_text = "; ".join(self._remount_command)
            self._failure = (
                self._failure or f"its process ended with {exit_code} {stderr_text}".strip()
            )
            self._changed.notify_all()

    def _store_state(self, state: dict, now_s: float) -> None:
        halted = state.pop("halted")
        if halted is not None:
            self._failure = self._failure or halted
        if not self._states or state["timestamp_s"] > self._states[-1].timestamp_s:
            self._advanced_s = now_s
        pose, speed = tuple(state.pop("pose")), tuple(state.pop("speed"))
        self._states.append(ReportedState(host_s=now_s, pose=pose, speed=speed, **state))

    def _read_stderr(self) -> None:
        assert self._process.stderr is not None
        for line in self._process.stderr:
            self._remount_command.append(line.strip())

    @property
    def failure(self) -> str | None:
        """Why the connection was lost; None while it works."""
        return self._failure

    @property
    def clock_s(self) -> float:
        """When the robot's own clock last advanced, by the host's."""
        return self._advanced_s

    @property
    def state(self) -> ReportedState:
        """The latest state; raises RobotError where none arrives within READY_S."""
        with self._changed:
            self._changed.wait_for(lambda: self._states or self._failure is not None, READY_S)
            if not self._states:
                raise RobotError(self._failure or "no state")
            return self._states[-1]

    def state_at(self, moment_s: float) -> ReportedState:
        """The state nearest to a moment of the host's clock."""
        with self._changed:
            return min(self._states, key=lambda state: abs(state.host_s - moment_s))

    def keep_alive(self) -> None:
        """Tell the worker that the host lives; without it the worker stops a moving robot."""
        if self._clock() - self._alive_s >= ALIVE_S:
            self._alive_s = self._clock()
            self._send({"do": "alive"})

    def wait(self, seconds: float) -> None:
        """Wait for a message of the robot, for `seconds` at most."""
        with self._changed:
            self._changed.wait(seconds)

    def request(self, command: str, **arguments: object) -> int:
        """Send a request; returns its number, for `answer`."""
        self._requests += 1
        self._send({"id": self._requests, "do": command, **arguments})
        return self._requests

    def answer(self, request: int) -> bool:
        """Whether a request was answered; raises RobotError where it was refused."""
        with self._changed:
            ok, error = self._answers.get(request, (None, ""))
        if ok is False:
            raise RobotError(error or "the robot refused a command")
        return ok is True

    def _send(self, message: dict) -> None:
        assert self._process.stdin is not None
        with contextlib.suppress(OSError, ValueError):  # a worker that is gone is told by `lost`
            self._process.stdin.write(json.dumps(message) + "\n")
            self._process.stdin.flush()

    def stop(self, deceleration_m_s2: float) -> str:
        """Stop the arm; returns the way that worked: `stopL` or `dashboard stop`.

        Raises RobotError where neither is known to have worked.
        """
        request = self.request("stop", deceleration=deceleration_m_s2)
        if self._stands_within(STOP_S, request):
            return "stopL"
        error = "it still moves"
        try:
            self.dashboard.ask("stop")
            if self._stands_within(DASHBOARD_STOP_S):
                return "dashboard stop"
            # Blind, but a controller without a program does not move its arm.
            if self.dashboard.ask("programState").upper().startswith("STOPPED"):
                return "dashboard stop"
        except OSError as dashboard_error:
            error = str(dashboard_error)
        raise RobotError(f"the robot is not seen to stand ({self._failure or error})")

    def _stands_within(self, seconds: float, request: int | None = None) -> bool:
        """Whether a state later than this call shows a standing arm, after `request` was answered:
        an earlier request may not have begun yet."""
        since_s = self._clock()

        def stands() -> bool:
            if request is not None and request not in self._answers:
                return False
            if not self._states or self._advanced_s <= since_s:
                return False
            state = self._states[-1]
            return state.is_still and state.host_s > since_s

        deadline_s = since_s + seconds
        while self._clock() < deadline_s and self._failure is None:
            self.keep_alive()
            with self._changed:
                if self._changed.wait_for(stands, ALIVE_S):
                    return True
        return False

    def close(self) -> None:
        """End the worker; the arm stops and the controller has no program any more."""
        assert self._process.stdin is not None
        with contextlib.suppress(OSError, ValueError):
            self._process.stdin.close()
        try:
            self._process.wait(timeout=5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        for thread in self._threads:
            thread.join(timeout=1.0)
        self.dashboard.close()
