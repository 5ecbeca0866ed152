"""Robot, load cell and board together: every wait watches all interlocks."""

import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TypeVar

import numpy as np

from eitskin.capture import interlock
from eitskin.capture.configuration import board_of, limits
from eitskin.capture.interlock import State, Stop
from eitskin.capture.lines import Line, Port, is_frame_after
from eitskin.capture.load_cell import Restart
from eitskin.capture.robot import Robot, RobotError
from eitskin.data.board import Reject

Outcome = TypeVar("Outcome")

POLL_S = 0.005  # from one check of all devices to the next: below the load cell's period
ARRIVED_M = 2e-4  # twice a UR's pose repeatability
ARRIVAL_MARGIN_S = 3.0  # for the controller to begin and to settle
SLOWEST_CLOCK = 4.0  # host's seconds in one of the robot's, whose emulator may lag
ANSWER_S = 5.0  # for the worker, which answers within some ms
RELOADED_S = 10.0  # the library uploads its script within 5 s
FRAMES_WAITED = 12  # board periods in which a good frame must come, some lines refused
MAX_FORCES = 65536  # minutes at 80 Hz; a frame needs those of a second


class Fault(Exception):
    """The arm must stop; `reason` is a word to count by, the text is for a person."""

    def __init__(self, stop: Stop):
        super().__init__(stop.message)
        self.reason = stop.reason


class Interrupted(Exception):
    """A signal asked for the end; `signal` is its number."""

    def __init__(self, signal: int):
        super().__init__(f"signal {signal}")
        self.signal = signal


@dataclass(frozen=True)
class Force:
    """Statistics of the load cell during a frame.

    Median, range, and the second half's mean minus the first's, all in N, and their number.
    """

    median_N: float
    spread_N: float
    drift_N: float
    readings: int


class Rig:
    """Robot, load cell and board of a configuration; the caller opens and closes them.

    Before `listen` the robot may only retreat.
    """

    def __init__(
        self,
        config: dict,
        robot: Robot,
        clock: Callable[[], float] = time.monotonic,
    ):
        self.config, self.robot = config, robot
        self._load: Port[float | Restart] | None = None
        self._board: Port[np.ndarray] | None = None
        self.signal: int | None = None  # set by a signal's handler
        self.zero_N = 0.0  # what the untouched load cell reads
        self._clock = clock
        self._limits = limits(config)
        self._box = tuple(tuple(side) for side in config["pose"]["box_m"])
        self._profile = board_of(config)
        self._forces: deque[tuple[float, float]] = deque(maxlen=MAX_FORCES)
        self._load_number = self._board_number = 0
        self._load_rejects = self._load_restarts = self._frozen = self._board_rejects = 0
        self._rejects: list[dict] = []
        self._jump_N = 0.0
        self._retreat_from_N: float | None = None

    def listen(self, load: Port[float | Restart], board: Port[np.ndarray]) -> None:
        """Use the load cell's and the board's ports, from their first line on."""
        self._load, self._board = load, board

    # Watching

    def watch(
        self, until: Callable[[], Outcome | None], timeout_s: float, activity: str
    ) -> Outcome:
        """Wait until `until` returns a value, checking all interlocks, and return it.

        Raises Fault where an interlock trips or `activity` takes longer than `timeout_s`, and
        Interrupted after a signal, except during a retreat.
        """
        deadline_s = self._clock() + timeout_s
        while True:
            self.robot.keep_alive()
            stop = interlock.judge(self._state(), self._limits, self._box)
            if stop is not None:
                raise Fault(stop)
            if self.signal is not None and self._retreat_from_N is None:
                raise Interrupted(self.signal)
            outcome = until()
            if outcome is not None:
                return outcome
            if self._clock() > deadline_s:
                raise Fault(Stop("late", f"{activity} took longer than {timeout_s:.1f} s"))
            self.robot.wait(POLL_S)

    def _state(self) -> State:
        if self._load is not None:
            self._read_load(self._load)
        if self._board is not None:
            self._read_board(self._board)
        state = self.robot.state
        force_s, force_N = self._forces[-1] if self._forces else (-math.inf, math.nan)
        jump_N, self._jump_N = self._jump_N, 0.0
        return State(
            now_s=self._clock(),
            force_N=force_N,
            zero_N=self.zero_N,
            force_s=force_s,
            jump_N=jump_N,
            load_rejects=self._load_rejects,
            frozen_readings=self._frozen,
            load_restarts=self._load_restarts,
            load_failure="not open" if self._load is None else self._load.failure,
            robot_failure=self.robot.failure,
            robot_clock_s=self.robot.clock_s,
            robot_mode=state.robot_mode,
            safety_mode=state.safety_mode,
            safety_bits=state.safety_bits,
            runtime_state=state.runtime_state,
            pose_m=state.pose[:3],
            retreat_from_N=self._retreat_from_N,
        )

    def _read_load(self, load: Port[float | Restart]) -> None:
        for line in load.since(self._load_number):
            self._load_number = line.number
            if isinstance(line.value, Restart):
                # The greeting of a cell that our opening of the port has restarted is no fault.
                self._load_restarts += bool(self._forces)
            elif isinstance(line.value, Reject):
                self._load_rejects += 1
                self._record_reject("load cell", line, line.value)
            else:
                self._load_rejects = 0
                if self._forces:
                    previous_N = self._forces[-1][1]
                    self._jump_N = max(self._jump_N, abs(line.value - previous_N))
                    self._frozen = self._frozen + 1 if line.value == previous_N else 1
                self._forces.append((line.end_s, line.value))

    def _read_board(self, board: Port[np.ndarray]) -> None:
        for line in board.since(self._board_number):
            self._board_number = line.number
            if isinstance(line.value, Reject):
                self._board_rejects += 1
                self._record_reject("board", line, line.value)
            else:
                self._board_rejects = 0

    def _record_reject(self, port_name: str, line: Line, reject: Reject) -> None:
        self._rejects.append(
            {
                "kind": "reject",
                "port": port_name,
                "reason": reject.reason,
                "detail": reject.detail,
                "raw": line.raw.decode("latin-1"),
                "end_s": line.end_s,
            }
        )

    def take_rejects(self) -> list[dict]:
        """The lines rejected since the last call, as records of the journal."""
        rejects, self._rejects = self._rejects, []
        return rejects

    @property
    def force_N(self) -> float:
        """The last reading less that of the untouched cell."""
        return self._forces[-1][1] - self.zero_N

    @property
    def last_force_N(self) -> float | None:
        """The last reading, its zero not subtracted; None before the first."""
        return self._forces[-1][1] if self._forces else None

    def touches(self, force_N: float) -> bool:
        """Whether the last two readings reach a force; one alone may be a spike."""
        if len(self._forces) < 2:
            return False
        return min(self._forces[-1][1], self._forces[-2][1]) - self.zero_N >= force_N

    # Moving

    @property
    def position_m(self) -> tuple[float, float, float]:
        """The TCP's x, y, z in the base frame."""
        return self.robot.state.pose[:3]

    def move(
        self,
        position_m: tuple[float, float, float],
        speed_m_s: float,
        acceleration_m_s2: float,
        until: Callable[[], bool] | None = None,
    ) -> bool:
        """Move straight to a position with the tool's orientation at the centre.

        Returns whether it arrived; the arm is stopped on the way where `until` becomes true. Raises
        Fault and Interrupted as `watch`, and RobotError where the robot refuses.
        """
        pose = [*position_m, *self.config["pose"]["centre"][3:]]
        distance_m = math.dist(position_m, self.position_m)
        if distance_m <= ARRIVED_M and self.robot.state.is_still:
            return True
        request = self.robot.request(
            "move", pose=pose, speed=speed_m_s, acceleration=acceleration_m_s2
        )
        self.watch(lambda: self.robot.answer(request) or None, ANSWER_S, "the robot's answer")
        request_s, begin_s = self._clock(), self.robot.state.timestamp_s
        longest_s = distance_m / speed_m_s + 2.0 * speed_m_s / acceleration_m_s2
        longest_s += ARRIVAL_MARGIN_S

        def arrival() -> bool | None:
            if until is not None and until():
                return False
            state = self.robot.state
            if state.timestamp_s - begin_s > longest_s:  # by the robot's clock, which is watched
                detail = f"a move took longer than {longest_s:.1f} s"
                raise Fault(Stop("late", detail))
            if state.host_s <= request_s or not state.is_still:
                return None
            return True if math.dist(position_m, state.pose[:3]) <= ARRIVED_M else None

        arrived = self.watch(arrival, SLOWEST_CLOCK * longest_s, "a move")
        if not arrived:
            self.robot.stop(self.config["motion"]["stop_m_s2"])
        return arrived

    @property
    def hovers(self) -> bool:
        """Whether the probe is at the hovering height or above."""
        return self.position_m[2] >= self.config["pose"]["centre"][2] - ARRIVED_M

    def stop_and_retreat(self) -> list[str]:
        """Stop the arm by any way that works, then lift the probe straight to the hovering height.

        Returns the actions taken, for a person. Never raises for a device.
        """
        actions = []
        try:
            stop_way = self.robot.stop(self.config["motion"]["stop_m_s2"])
            actions.append(f"stopped by {stop_way}")
            if self.hovers:
                return actions
            self._retreat_from_N = abs(self._forces[-1][1]) if self._forces else math.nan
            if stop_way != "stopL" or self.robot.state.runtime_state != interlock.PLAYING:
                self._reupload()
            motion, (x, y, _) = self.config["motion"], self.position_m
            height_m = self.config["pose"]["centre"][2]
            self.move((x, y, height_m), motion["press_m_s"], motion["travel_m_s2"])
            actions.append("lifted off")
        except RobotError as error:
            actions.append(f"NOT lifted off: {error}; use the emergency stop and lift by hand")
        except Fault as fault:
            stop_way = self._stop_again()
            actions.append(f"NOT lifted off: {fault}; {stop_way}; lift by hand")
        finally:
            self._retreat_from_N = None
        return actions

    def _stop_again(self) -> str:
        try:
            return f"stopped by {self.robot.stop(self.config['motion']['stop_m_s2'])}"
        except RobotError as error:
            return f"{error}; use the emergency stop"

    def _reupload(self) -> None:
        """Start the robot's program again after it was stopped, and wait for a newer state."""
        if self.robot.state.safety_mode != interlock.NORMAL_SAFETY:
            raise RobotError("its safety system holds it")
        request = self.robot.request("reupload")
        self._wait_without_program(lambda: self.robot.answer(request))
        answered_s = self._clock()
        self._wait_without_program(lambda: self.robot.clock_s > answered_s)

    def _wait_without_program(self, is_done: Callable[[], bool]) -> None:
        """Wait for an arm that has no program and cannot move; no interlock is checked."""
        deadline_s = self._clock() + RELOADED_S
        while not is_done():
            if self.robot.failure is not None or self._clock() > deadline_s:
                raise RobotError(self.robot.failure or "its program does not start again")
            self.robot.keep_alive()
            self.robot.wait(POLL_S)

    # Sampling

    def wait(self, seconds: float) -> None:
        """Wait, checking all interlocks."""
        end_s = self._clock() + seconds
        self.watch(lambda: self._clock() >= end_s or None, seconds + 1.0, "a wait")

    def frame(self, settle_s: float) -> dict:
        """Settle, then take the next frame that began after that, as a record of the journal.

        It holds the raw line, force and robot's pose during the frame, and its quality. Raises as
        `watch`.
        """
        self.wait(settle_s)
        settled_s, n_rejects_before = self._clock(), len(self._rejects)
        period_s, port = self._profile.period_s, self._board
        assert port is not None
        last_number = [self._board_number]

        def next_frame() -> Line[np.ndarray] | None:
            if port.failure is not None:
                raise Fault(Stop("board lost", f"the board's port is gone: {port.failure}"))
            if self._board_rejects >= self._limits.rejects:
                detail = f"{self._board_rejects} lines in a row were no frame"
                raise Fault(Stop("board rejects", f"the board cannot be read: {detail}"))
            for line in port.since(last_number[0]):
                last_number[0] = line.number
                is_after_settling = is_frame_after(line, settled_s, period_s)
                if is_after_settling and self._force(line) is not None:
                    return line
            return None

        longest_s = FRAMES_WAITED * period_s + 2.0
        line = self.watch(next_frame, longest_s, "a frame of the board")
        return self._record(line, settled_s, len(self._rejects) - n_rejects_before)

    def _force(self, line: Line[np.ndarray]) -> Force | None:
        """The force while a frame was measured; None without readings."""
        readings_N = np.array(
            [N for s, N in self._forces if line.previous_end_s <= s <= line.end_s]
        )
        if len(readings_N) == 0:
            return None
        first_half, second_half = (
            np.array_split(readings_N, 2) if len(readings_N) > 1 else (readings_N, readings_N)
        )
        return Force(
            float(np.median(readings_N)),
            float(np.ptp(readings_N)),
            float(second_half.mean() - first_half.mean()),
            len(readings_N),
        )

    def _record(self, line: Line[np.ndarray], settled_s: float, n_rejects: int) -> dict:
        force = self._force(line)
        assert force is not None
        assert not isinstance(line.value, Reject)
        begin_state, end_state = (
            self.robot.state_at(line.previous_end_s),
            self.robot.state_at(line.end_s),
        )
        return {
            "line": line.number,
            "raw": line.raw.decode("ascii"),
            "settled_s": settled_s,
            "before_s": line.previous_end_s,
            "end_s": line.end_s,
            "end_utc": self._utc(line.end_s),
            "force_N": force.median_N,
            "force_spread_N": force.spread_N,
            "force_drift_N": force.drift_N,
            "force_readings": force.readings,
            "zero_N": self.zero_N,
            "pose_before": list(begin_state.pose),
            "pose_end": list(end_state.pose),
            "robot_before_s": begin_state.timestamp_s,
            "robot_end_s": end_state.timestamp_s,
            "saturated": int(self._profile.saturated(line.value).sum()),
            "rejected_before": n_rejects,
        }

    def _utc(self, moment_s: float) -> str:
        """A moment of the host's monotonic clock as UTC."""
        seconds = datetime.now(UTC).timestamp() - (self._clock() - moment_s)
        return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="microseconds")
