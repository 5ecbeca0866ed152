"""The host's side of the robot: its latest state, requests with answers, and two ways to stop."""

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
STOP_S = 0.3
DASHBOARD_STOP_S = 2.0
KEPT_STATES = 8192
ALIVE_S = 0.05

Vector6D = tuple[float, float, float, float, float, float]  # as RTDE has poses and speeds


@dataclass(frozen=True)
class Reported:
    """A robot's state and when the host had it (monotonic s). Pose in m and rad, speed in m/s."""

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
    def still(self) -> bool:
        """Whether nothing moves and nothing is about to."""
        return not self.running and math.hypot(*self.speed[:3]) < STILL_M_S


class RobotError(Exception):
    """A robot that cannot be had or does not do as told; its text is for a person."""


class Robot:
    """The worker process and the dashboard. watchdog_Hz: how often the controller must hear of that
    process, or it stops the arm.

    Raises RobotError where the controller cannot be had within 15 s. A worker that ends later is
    told by `lost`.
    """

    def __init__(self, host: str, watchdog_Hz: float, clock: Callable[[], float] = time.monotonic):
        self._clock = clock
        self._changed = threading.Condition()
        self._states: deque[Reported] = deque(maxlen=KEPT_STATES)
        self._answers: dict[int, tuple[bool, str]] = {}
        self._said: deque[str] = deque(maxlen=20)
        self._ready = False
        self._lost: str | None = None
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
            threading.Thread(target=target, daemon=True) for target in (self._read, self._errors)
        ]
        try:
            for thread in self._threads:
                thread.start()
            with self._changed:
                self._changed.wait_for(lambda: self._ready or self._lost is not None, READY_S)
            if not self._ready:
                reason = self._lost or f"no answer within {READY_S:g} s"
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
                    self._take(message["state"], now_s)
                elif "id" in message:
                    self._answers[message["id"]] = (message["ok"], message.get("error", ""))
                elif "error" in message:
                    self._lost = message["error"]
                else:
                    self._ready = True
                self._changed.notify_all()
        code = self._process.wait()
        with self._changed:
            said = "; ".join(self._said)
            self._lost = self._lost or f"its process ended with {code} {said}".strip()
            self._changed.notify_all()

    def _take(self, state: dict, now_s: float) -> None:
        halted = state.pop("halted")
        if halted is not None:
            self._lost = self._lost or halted
        if not self._states or state["timestamp_s"] > self._states[-1].timestamp_s:
            self._advanced_s = now_s
        pose, speed = tuple(state.pop("pose")), tuple(state.pop("speed"))
        self._states.append(Reported(host_s=now_s, pose=pose, speed=speed, **state))

    def _errors(self) -> None:
        assert self._process.stderr is not None
        for line in self._process.stderr:
            self._said.append(line.strip())

    @property
    def lost(self) -> str | None:
        """Why there is no robot any more; None while there is."""
        return self._lost

    @property
    def clock_s(self) -> float:
        """When the robot's own clock was last seen to advance."""
        return self._advanced_s

    @property
    def state(self) -> Reported:
        """The latest state; raises RobotError before the first, or where none can come any more."""
        with self._changed:
            self._changed.wait_for(lambda: self._states or self._lost is not None, READY_S)
            if not self._states:
                raise RobotError(self._lost or "no state")
            return self._states[-1]

    def state_at(self, moment_s: float) -> Reported:
        """The state nearest to a moment of the host's clock."""
        with self._changed:
            return min(self._states, key=lambda state: abs(state.host_s - moment_s))

    def alive(self) -> None:
        """Tell the worker that the host is there; it stops a moving robot without."""
        if self._clock() - self._alive_s >= ALIVE_S:
            self._alive_s = self._clock()
            self._send({"do": "alive"})

    def wait(self, seconds: float) -> None:
        """Until the robot says something new, for `seconds` at most."""
        with self._changed:
            self._changed.wait(seconds)

    def request(self, do: str, **arguments: object) -> int:
        """Send a request; its number is for `answer`."""
        self._requests += 1
        self._send({"id": self._requests, "do": do, **arguments})
        return self._requests

    def answer(self, request: int) -> bool:
        """Whether a request is done; raises RobotError where it was refused."""
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
        """Stop the arm; returns the way that did it: `stopL` or `dashboard stop`.

        Raises RobotError where neither is seen to have worked.
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
        except OSError as refused:
            error = str(refused)
        raise RobotError(f"the robot is not seen to stand ({self._lost or error})")

    def _stands_within(self, seconds: float, request: int | None = None) -> bool:
        """Whether the arm is seen to stand, by news of this moment or later, and once `request` is
        answered: what was asked for before it may only be about to begin."""
        since_s = self._clock()

        def stands() -> bool:
            if request is not None and request not in self._answers:
                return False
            if not self._states or self._advanced_s <= since_s:
                return False
            last = self._states[-1]
            return last.still and last.host_s > since_s

        end_s = since_s + seconds
        while self._clock() < end_s and self._lost is None:
            self.alive()
            with self._changed:
                if self._changed.wait_for(stands, ALIVE_S):
                    return True
        return False

    def close(self) -> None:
        """End the worker: the arm stops, the controller is left without a program."""
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
