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

RATE_HZ = 125.0  # of a CB3's RTDE
STATE_S = 0.008  # from one state to the next: 1 / RATE_HZ
KICK_S = 0.02  # half the shortest period that the watchdog may have, at most
REFUSED_KICKS = 5  # in a row: one may be refused by a program that was just stopped
PLAYS_S = 5.0  # for a program to start
SILENT_S = 0.5  # without a line from the host, while the robot moves
STOP_M_S2 = 1.0  # at the speed of a press the arm stands within 1 mm
END_S = 1.0  # for the arm to stand at the end


class Worker:
    """Serves the host's commands by the library's two connections.

    The controller stops the arm where it hears nothing for 1 / `watchdog_Hz` s.
    """

    def __init__(self, host: str, watchdog_Hz: float, output: TextIO):
        self._stream, self._watchdog_Hz = output, watchdog_Hz
        self._receive = rtde_receive.RTDEReceiveInterface(host, RATE_HZ, [*VARIABLES])
        self._control = rtde_control.RTDEControlInterface(host, RATE_HZ)
        if not self._control.setWatchdog(watchdog_Hz):
            raise RuntimeError("the controller refuses the watchdog")
        self._halted: str | None = None
        self._kicked_s = -math.inf
        self._refused_kicks = 0  # kicks in a row

    def serve(self, commands: queue.SimpleQueue) -> None:
        """Execute commands until None comes; the robot stands when this returns."""
        last_command_s = time.monotonic()
        self._send({"ready": True})
        try:
            while True:
                with contextlib.suppress(queue.Empty):
                    command = commands.get(timeout=STATE_S)
                    if command is None:
                        return
                    if command["do"] != "alive":
                        self._answer(command)
                    last_command_s = time.monotonic()  # a command that took long is no silence
                if time.monotonic() - last_command_s > SILENT_S and self._moving():
                    self._control.stopL(STOP_M_S2, True)
                    self._halted = f"its host was silent for {SILENT_S} s while the robot moved"
                self._kick()
                self._send({"state": self._state()})
        finally:
            self._end()

    def _answer(self, command: dict) -> None:
        answer = {"id": command["id"]}
        try:
            answer["ok"] = self._execute(command)
        except (RuntimeError, ValueError) as error:
            answer |= {"ok": False, "error": str(error)}
        self._send(answer)

    def _execute(self, command: dict) -> bool:
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
        """Start the program again and wait until it plays, which the library does not."""
        if not self._control.reuploadScript():
            return False
        deadline_s = time.monotonic() + PLAYS_S
        while self._receive.getRuntimeState() != PLAYING or not self._control.isProgramRunning():
            if time.monotonic() > deadline_s:
                return False
            time.sleep(STATE_S)
        return bool(self._control.setWatchdog(self._watchdog_Hz))

    def _kick(self) -> None:
        """Kick the controller's watchdog, if its program plays."""
        now_s = time.monotonic()
        if now_s - self._kicked_s >= KICK_S and self._receive.getRuntimeState() == PLAYING:
            self._kicked_s = now_s
            # A program that was just stopped refuses a kick before its state says so.
            self._refused_kicks = 0 if self._control.kickWatchdog() else self._refused_kicks + 1
            if self._refused_kicks >= REFUSED_KICKS:
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
            deadline_s = time.monotonic() + END_S
            while time.monotonic() < deadline_s and self._moving():
                self._kick()
                time.sleep(STATE_S)
            self._control.stopScript()
        self._control.disconnect()
        self._receive.disconnect()

    def _send(self, message: dict) -> None:
        self._stream.write(json.dumps(message) + "\n")
        self._stream.flush()


def _listen(commands: queue.SimpleQueue) -> None:
    for line in sys.stdin:
        commands.put(json.loads(line))
    commands.put(None)


def main() -> int:
    """Serve the controller at argument 1 with a watchdog of argument 2 Hz; 1 where it fails."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    # The library prints to stdout; the host reads JSON there.
    output = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    try:
        worker = Worker(sys.argv[1], float(sys.argv[2]), output)
    except RuntimeError as error:
        output.write(json.dumps({"error": str(error)}) + "\n")
        output.flush()
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
