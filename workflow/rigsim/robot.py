"""A UR controller without its network: safety, motion, registers and the running program."""

import hashlib
import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rigsim import motion
from rigsim.log import EventLog

POWER_OFF, IDLE, RUNNING = 3, 5, 7  # robot_mode
NORMAL, PROTECTIVE_STOP, EMERGENCY_STOP = 1, 3, 7  # safety_mode
SAFETY_BITS = {NORMAL: 1 << 0, PROTECTIVE_STOP: 1 << 2 | 1 << 10, EMERGENCY_STOP: 3 << 6 | 1 << 10}
STOPPED, PLAYING = 1, 2  # runtime_state
READY, DONE = 1, 2  # output_int_register_0
SAFETY_STOP_M_S2 = 20.0  # at a pressing speed a stop within a fraction of a millimetre
PROGRAM_STOP_M_S2 = 4.0  # the end of a program is gentler than a safety stop
START_S = 0.1  # from a program's upload to its first line
UNLOCK_S = 5.0  # at least, from a protective stop to its release: Universal Robots' rule
MAX_DELAY_S = 0.02  # of a cycle; beyond it the robot's clock waits

# sha256[:16] of ur_rtde 1.6.5's control script as it reaches a controller, by polyscope version.
SCRIPTS = {
    "89072a7e930d7a02": "ur_rtde 1.6.5 for 3.11",
    "03eab57fade59ca0": "ur_rtde 1.6.5 for 3.15",
    "596761a93dfb1753": "ur_rtde 1.6.5 for 5.12",
    "5462851f747f0a22": "ur_rtde 1.6.5 for 5.23",
}


@dataclass(frozen=True)
class Series:
    """A robot's identity. version: major, minor, bugfix, build; cycle_Hz: RTDE's highest rate."""

    version: tuple[int, int, int, int]
    cycle_Hz: float
    serial: str
    model: str

    @property
    def polyscope(self) -> str:
        """The dashboard's answer to PolyscopeVersion; no real robot calls itself emulated."""
        return f"URSoftware {'.'.join(map(str, self.version))} (EMULATED)"


# The serial number of an e-series is numeric, as ur_rtde requires, and begins with its year.
SERIES = {
    "cb3": Series((3, 15, 8, 106339), 125.0, "EMULATED000001", "UR5"),
    "e": Series((5, 12, 6, 1102099), 500.0, "00000000001", "UR5"),
}


class Controller:
    """A robot arm and its controller. `now`: its clock, s since its start, which pauses while the
    emulator gets no processor time, so that no watchdog expires for that.

    speedup s: motions run s times as fast along the same path (with s² the acceleration). rules:
    those of the configuration for a driver; a broken one is logged. force_entry: the world's true
    force, for entries of motion.
    """

    def __init__(self, series: str, pose: list[float], speedup: float, rules: dict, log: EventLog):
        self.series = SERIES[series]
        self.log, self.rules, self.speedup = log, rules, speedup
        self.now = 0.0
        self.motion = motion.Motion.rest(np.array(pose, dtype=float))
        self.robot_mode, self.safety_mode = RUNNING, NORMAL
        self.inputs: dict[str, float] = {}
        self.int_out = [0] * 48
        self.double_out = [0.0] * 48
        self.tcp_force_N = 0.0
        self.program: ControlProgram | None = None
        self.force_entry: Callable[[], dict[str, float]] = dict
        self._uploaded: tuple[float, bytes] | None = None
        self._stopped_at = 0.0
        self._was_moving = False

    @property
    def playing(self) -> bool:
        """Whether a program runs."""
        return self.program is not None

    @property
    def pose(self) -> np.ndarray:
        """The present pose (6,) of the tool."""
        return self.motion.at(self.now)[0]

    @property
    def moving(self) -> bool:
        """Whether the tool moves."""
        return self.motion.moving(self.now)

    def tick(self, elapsed_s: float) -> None:
        """The controller's actions in each cycle, `elapsed_s` after the previous one."""
        self.now += min(elapsed_s, MAX_DELAY_S)
        moving = self.moving
        if moving != self._was_moving:
            self.log_motion("moving" if moving else "still")
            self._was_moving = moving
        if self._uploaded is not None and self.now >= self._uploaded[0]:
            self._play(self._uploaded[1])
        if self.program is not None:
            self.program.tick()

    def log_motion(self, event: str) -> None:
        """Log an event with the pose, the velocity and the true force."""
        pose, velocity = (value.round(7).tolist() for value in self.motion.at(self.now))
        self.log.write(event, pose=pose, velocity=velocity, **self.force_entry())

    def move(self, target: np.ndarray, speed: float, acceleration: float) -> None:
        """Begin a straight motion from the present pose to `target`."""
        s = self.speedup
        self.motion = motion.line(self.pose, target, speed * s, acceleration * s * s, self.now)

    def go(self, velocity: np.ndarray, acceleration: float) -> None:
        """Change to a constant velocity (6,)."""
        s = self.speedup
        self.motion = motion.change_speed(self.motion, velocity * s, acceleration * s * s, self.now)

    def halt(self, deceleration: float) -> None:
        """Bring the tool to rest."""
        if self.moving:
            self.motion = motion.stop(self.motion, deceleration * self.speedup**2, self.now)

    def start(self, script: bytes) -> None:
        """Run an uploaded program, START_S later."""
        if self.robot_mode != RUNNING or self.safety_mode != NORMAL:
            self.log.write("program refused", robot_mode=self.robot_mode, safety=self.safety_mode)
            return
        self.stop_program("another program")
        self._uploaded = self.now + START_S, script

    def _play(self, script: bytes) -> None:
        self._uploaded = None
        script_digest = digest(script)
        self.log.write(
            "program", bytes=len(script), sha256=script_digest, known=SCRIPTS.get(script_digest)
        )
        for rule, broken in {
            "script without version marks": b"$" in script,
            "script known": script_digest not in SCRIPTS,
        }.items():
            if broken:
                self.log.violation(rule, sha256=script_digest, bytes=len(script))
        self.program = ControlProgram(self, _offset(script, b"int"), _offset(script, b"float"))

    def stop_program(self, reason: str) -> None:
        """End the running or uploaded program, if any; the arm comes to rest."""
        self._uploaded = None
        if self.program is None:
            return
        longest_s = round(self.program.longest_silence_s, 4)
        self.program = None
        self.log.write("program stopped", reason=reason, longest_silence_s=longest_s)
        self.halt(PROGRAM_STOP_M_S2)

    def protective_stop(self) -> None:
        """The controller's stop on a fault: the arm stops, the program ends."""
        self.safety_mode, self._stopped_at = PROTECTIVE_STOP, self.now
        self._safety_stop("protective stop")

    def emergency_stop(self) -> None:
        """The stop by the button: the arm stops and loses power."""
        self.safety_mode, self.robot_mode = EMERGENCY_STOP, POWER_OFF
        self._safety_stop("emergency stop")

    def _safety_stop(self, reason: str) -> None:
        self.halt(SAFETY_STOP_M_S2)
        self.log_motion(reason)
        self.stop_program(reason)

    def unlock(self) -> bool:
        """Release a protective stop, not before UNLOCK_S; returns whether it is released."""
        waited = self.now - self._stopped_at >= UNLOCK_S / self.speedup
        if self.safety_mode != PROTECTIVE_STOP or not waited:
            return False
        self.safety_mode = NORMAL
        self.log.write("unlocked")
        return True

    def release_emergency(self) -> None:
        """Release the button; the arm remains without power."""
        if self.safety_mode == EMERGENCY_STOP:
            self.safety_mode = NORMAL
            self.log.write("emergency stop released")

    def receive(self, values: dict[str, float]) -> None:
        """Take the inputs of one data package, by the names of its recipe."""
        self.inputs.update(values)
        if self.program is not None:
            self.program.received(values)

    def outputs(self) -> dict[str, float | list[float]]:
        """The present output variables that are not 0, without the registers."""
        pose, velocity = self.motion.at(self.now)
        pose, velocity = pose.tolist(), velocity.tolist()
        force = [0.0, 0.0, self.tcp_force_N, 0.0, 0.0, 0.0]
        return {
            "timestamp": self.now,
            "actual_TCP_pose": pose,
            "target_TCP_pose": pose,
            "actual_TCP_speed": velocity,
            "target_TCP_speed": velocity,
            "actual_TCP_force": force,
            "tcp_force_scalar": abs(self.tcp_force_N),
            "robot_mode": self.robot_mode,
            "safety_mode": self.safety_mode,
            "safety_status_bits": SAFETY_BITS[self.safety_mode],
            "robot_status_bits": int(self.robot_mode >= IDLE) | 2 * int(self.playing),
            "runtime_state": PLAYING if self.playing else STOPPED,
            "joint_mode": [253] * 6,  # running
            "speed_scaling": 1.0,
            "target_speed_fraction": 1.0,
            "actual_main_voltage": 48.0,
            "actual_robot_voltage": 48.0,
        }


def digest(script: bytes) -> str:
    """The key of a script in SCRIPTS."""
    return hashlib.sha256(script).hexdigest()[:16]


def _offset(script: bytes, kind: bytes) -> int:
    """The number of the first register that the script uses, which ur_rtde writes after a mark."""
    match = re.search(rb"# " + kind + rb" register offset\n[^\n]*?(\d+)", script)
    return int(match[1]) if match else 0


class ControlProgram:
    """The behaviour of ur_rtde's control script.

    A command is a number in input int register 0. The program is READY, takes a command, is DONE
    when the command ends (an asynchronous one: when it has begun), and READY again once the command
    is 0. Other commands are lost.
    """

    REALTIME = (9, 10, 11)  # taken in any cycle and never acknowledged

    def __init__(self, controller: Controller, int_offset: int, double_offset: int):
        self.robot, self.log, self.rules = controller, controller.log, controller.rules
        self.int_offset, self.double_offset = int_offset, double_offset
        self.watchdog_s: float | None = None
        self.fed_s = controller.now
        self.longest_silence_s = 0.0  # of the host, since a watchdog is set
        self.command_end_s: float | None = None  # when a command that takes time is over
        self.running = False  # an asynchronous motion
        self.operation = self.writes = 0
        self._say(READY)

    def _say(self, state: int) -> None:
        self.state = state
        self.robot.int_out[self.int_offset] = state

    def tick(self) -> None:
        """Acknowledge ended commands; stop where the host is silent."""
        if self.command_end_s is not None and self.robot.now >= self.command_end_s:
            self.command_end_s = None
            self._say(DONE)
        if self.running and not self.robot.moving:
            self._progress(False)
        if self.watchdog_s is not None:
            silence_s = self.robot.now - self.fed_s
            self.longest_silence_s = max(self.longest_silence_s, silence_s)
            if silence_s > self.watchdog_s:
                self.robot.log_motion("watchdog")
                self.robot.stop_program("watchdog")

    def received(self, values: dict[str, float]) -> None:
        """Handle one data package."""
        name = f"input_int_register_{self.int_offset}"
        if name not in values:
            return
        self.fed_s = self.robot.now
        command = int(values[name])
        if command in self.REALTIME:
            self._run(command)
        elif command == 0:
            if self.state == DONE and self.command_end_s is None:
                self._say(READY)
        elif command == 255:
            self.robot.stop_program("the host's")
        elif self.state == READY and self.command_end_s is None:
            self.state = 0
            self.robot.int_out[self.int_offset] = 0
            self._run(command)
        else:
            self.robot.log.violation("one command at a time", command=command)

    def _double(self, k: int) -> float:
        return self.robot.inputs.get(f"input_double_register_{self.double_offset + k}", 0.0)

    def _doubles(self, n: int) -> np.ndarray:
        return np.array([self._double(k) for k in range(n)])

    def _run(self, command: int) -> None:
        handlers = {
            3: self._move_l,
            10: self._speed_l,
            15: self._speed_stop,
            29: self._set_tcp,
            31: self._protective_stop,
            33: self._stop,
            34: self._stop,
            35: self._set_watchdog,
        }
        if command not in handlers:
            self.log.violation("a command that is emulated", command=command)
            self.command_end_s = self.robot.now
            return
        handlers[command]()

    def _asynchronous(self) -> bool:
        return bool(self.robot.inputs.get(f"input_int_register_{self.int_offset + 1}", 0))

    def _move_l(self) -> None:
        target, speed, acceleration = self._doubles(6), self._double(6), self._double(7)
        asynchronous = self._asynchronous()
        self.log.write(
            "moveL",
            target=target.round(7).tolist(),
            speed=speed,
            acceleration=acceleration,
            asynchronous=asynchronous,
        )
        self._check_motion(target, speed, acceleration)
        if self.rules["asynchronous"] and not asynchronous:
            self.log.violation("asynchronous moves only")
        self.robot.move(target, speed, acceleration)
        if asynchronous:
            self._progress(True)
            self.command_end_s = self.robot.now
        else:
            self.command_end_s = self.robot.motion.end

    def _speed_l(self) -> None:
        velocity, acceleration = self._doubles(6), self._double(6)
        self.log.write("speedL", velocity=velocity.tolist(), acceleration=acceleration)
        self._check_motion(None, float(np.linalg.norm(velocity[:3])), acceleration)
        self.robot.go(velocity, acceleration)

    def _check_motion(self, target: np.ndarray | None, speed: float, acceleration: float) -> None:
        rules = self.rules
        if target is not None and self.robot.moving:
            self.log.violation("moves begin at rest")
        if rules["watchdog"] and self.watchdog_s is None:
            self.log.violation("a watchdog before any motion")
        requested = {"max_speed_m_s": speed, "max_acceleration_m_s2": acceleration}
        for rule, value in requested.items():
            if rules[rule] is not None and value > rules[rule] * (1 + 1e-6):
                self.log.violation(rule, value=value, limit=rules[rule])
        box = rules["box_m"]
        if target is not None and box is not None:
            low, high = np.transpose(box)
            if (target[:3] < low - 1e-6).any() or (target[:3] > high + 1e-6).any():
                self.log.violation("box_m", target=target[:3].tolist(), limit=box)

    def _speed_stop(self) -> None:
        self.log.write("speedStop")
        self.robot.halt(self._double(0) or PROGRAM_STOP_M_S2)
        self.command_end_s = self.robot.motion.end

    def _stop(self) -> None:
        self.log.write("stopL", deceleration=self._double(0))
        self.robot.log_motion("stopping")
        self.robot.halt(self._double(0) or PROGRAM_STOP_M_S2)
        self._progress(False)
        self.command_end_s = (
            self.robot.now if self._asynchronous() else max(self.robot.motion.end, self.robot.now)
        )

    def _set_tcp(self) -> None:
        self.log.write("setTcp", offset=self._doubles(6).tolist())
        self.command_end_s = self.robot.now

    def _protective_stop(self) -> None:
        self.robot.protective_stop()

    def _set_watchdog(self) -> None:
        frequency = self._double(0)
        self.watchdog_s = 1.0 / frequency if frequency > 0 else None
        self.fed_s = self.robot.now
        self.log.write("setWatchdog", frequency=frequency)
        self.command_end_s = self.robot.now

    def _progress(self, running: bool) -> None:
        """Set output int register 2: whether an asynchronous motion runs, and its number."""
        if running:
            self.operation = (self.operation + 1) % 128
        self.running = running
        self.writes = (self.writes + 1) % 128
        value = int(running) << 15 | self.writes << 16 | self.operation << 24
        self.robot.int_out[self.int_offset + 2] = value
