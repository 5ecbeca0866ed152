"""The process that holds ur_rtde: commands as JSON lines on stdin, the robot's state on stdout.

It is a process of its own because the library ends it with SIGSEGV when the controller's connection
drops, and waits for ever for a controller that accepts and stays mute. The robot stops when the
host's lines end or stay away, and by the controller's own watchdog when this process does.
"""

import contextlib
import json
import math
import os
import queue
import signal
import sys
import threading
import time
from typing import TextIO

import rtde_control
import rtde_receive

from eitskin.capture.interlock import PLAYING, STILL_M_S
from eitskin.capture.rtde import VARIABLES

RATE_HZ = 125.0
STATE_S = 0.008  # from one state to the next
KICK_S = 0.02  # half the shortest period that the watchdog may have, at most
REFUSED_KICKS = 5  # in a row
PLAYS_S = 5.0
SILENT_S = 0.5  # without a line from the host, while the robot moves
STOP_M_S2 = 1.0
END_S = 1.0


class Worker:
    """The library's two connections and what the host wants of them. The controller stops the arm
    where it hears nothing from them for 1 / watchdog_Hz s."""

    def __init__(self, host: str, watchdog_Hz: float, out: TextIO):
        self._out, self._watchdog_Hz = out, watchdog_Hz
        self._receive = rtde_receive.RTDEReceiveInterface(host, RATE_HZ, [*VARIABLES])
        self._control = rtde_control.RTDEControlInterface(host, RATE_HZ)
        if not self._control.setWatchdog(watchdog_Hz):
            raise RuntimeError("the controller refuses the watchdog")
        self._halted: str | None = None
        self._kicked_s = -math.inf
        self._refused = 0  # kicks in a row

    def serve(self, commands: queue.SimpleQueue) -> None:
        """Do as told until told to end (None); the robot stands when this returns."""
        heard_s = time.monotonic()
        self._say({"ready": True})
        try:
            while True:
                with contextlib.suppress(queue.Empty):
                    command = commands.get(timeout=STATE_S)
                    if command is None:
                        return
                    if command["do"] != "alive":
                        self._do(command)
                    heard_s = time.monotonic()  # a command that took long is no silence
                if time.monotonic() - heard_s > SILENT_S and self._moving():
                    self._control.stopL(STOP_M_S2, True)
                    self._halted = f"its host was silent for {SILENT_S} s while the robot moved"
                self._kick()
                self._say({"state": self._state()})
        finally:
            self._end()

    def _do(self, command: dict) -> None:
        answer = {"id": command["id"]}
        try:
            answer["ok"] = self._obey(command)
        except (RuntimeError, ValueError) as error:
            answer |= {"ok": False, "error": str(error)}
        self._say(answer)

    def _obey(self, command: dict) -> bool:
        match command["do"]:
            case "move":
                if self._halted is not None:
                    return False
                pose, speed, acceleration = (command[k] for k in ("pose", "speed", "acceleration"))
                return bool(self._control.moveL(pose, speed, acceleration, asynchronous=True))
            case "stop":
                self._control.stopL(command["deceleration"], True)
                return True
            case "reupload":
                return self._reupload()
        raise ValueError(f"unknown command {command['do']!r}")

    def _reupload(self) -> bool:
        """Start the program again; the library does not wait until it plays."""
        if not self._control.reuploadScript():
            return False
        end_s = time.monotonic() + PLAYS_S
        while self._receive.getRuntimeState() != PLAYING or not self._control.isProgramRunning():
            if time.monotonic() > end_s:
                return False
            time.sleep(STATE_S)
        return bool(self._control.setWatchdog(self._watchdog_Hz))

    def _kick(self) -> None:
        """Keep the controller's watchdog quiet; a program that is not there has none."""
        now = time.monotonic()
        if now - self._kicked_s >= KICK_S and self._receive.getRuntimeState() == PLAYING:
            self._kicked_s = now
            # A program that was just stopped refuses a kick before its state says so.
            self._refused = 0 if self._control.kickWatchdog() else self._refused + 1
            if self._refused >= REFUSED_KICKS:
                self._halted = "the controller does not take the watchdog's kicks"

    def _moving(self) -> bool:
        running = self._control.getAsyncOperationProgressEx().isAsyncOperationRunning()
        speed = math.hypot(*self._receive.getActualTCPSpeed()[:3])
        return running or speed > STILL_M_S

    def _state(self) -> dict:
        receive = self._receive
        return {
            "timestamp_s": receive.getTimestamp(),
            "pose": receive.getActualTCPPose(),
            "speed": receive.getActualTCPSpeed(),
            "robot_mode": receive.getRobotMode(),
            "safety_mode": receive.getSafetyMode(),
            "safety_bits": receive.getSafetyStatusBits(),
            "runtime_state": receive.getRuntimeState(),
            "running": self._control.getAsyncOperationProgressEx().isAsyncOperationRunning(),
            "halted": self._halted,
        }

    def _end(self) -> None:
        """Stop the arm, wait until it stands, and leave the controller without a program."""
        if self._receive.getRuntimeState() == PLAYING:
            self._control.stopL(STOP_M_S2, True)
            end_s = time.monotonic() + END_S
            while time.monotonic() < end_s and self._moving():
                self._kick()
                time.sleep(STATE_S)
            self._control.stopScript()
        self._control.disconnect()
        self._receive.disconnect()

    def _say(self, message: dict) -> None:
        self._out.write(json.dumps(message) + "\n")
        self._out.flush()


def _listen(commands: queue.SimpleQueue) -> None:
    for line in sys.stdin:
        commands.put(json.loads(line))
    commands.put(None)


def main() -> int:
    """Serve the controller named by the first argument, its watchdog at the second's Hz; 1 where it
    cannot be had."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    # The library prints to stdout; the host reads JSON there.
    out = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    try:
        worker = Worker(sys.argv[1], float(sys.argv[2]), out)
    except RuntimeError as error:
        out.write(json.dumps({"error": str(error)}) + "\n")
        out.flush()
        return 1
    commands: queue.SimpleQueue = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(commands,), daemon=True).start()
    try:
        worker.serve(commands)
    except BrokenPipeError:
        return 1
    except (RuntimeError, ValueError) as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    # No interpreter shutdown: the library's threads outlive it and crash.
    os._exit(main())
