"""Faults of the emulated rig, by script: when each begins, its action, and when it ends."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from eitskin.errors import InputError
from rigsim.eit import Board, text
from rigsim.load import KG, LBS, LoadCell, OpenScale
from rigsim.log import EventLog
from rigsim.robot import Controller
from rigsim.ur import RtdeServer
from rigsim.world import World

DRIVEN_V = 0.0215  # of a pair with a driven electrode: ten steps of the converter
SPIKE_N, OFFSET_N, DRIFT_N_PER_S = 30.0, 2.0, 1.0  # far above noise, unless the fault gives a size
SATURATED_N, GAIN = 1.0, 0.5  # unless the fault gives a size
LINES = ("short", "long", "joined", "garbled", "duplicated", "driven", "saturated")
LONG_VALUES = 512  # as in the first line of logs by DSHardman's lab


@dataclass(frozen=True)
class Parts:
    """The parts of the rig that faults act on."""

    world: World
    robot: Controller
    rtde: RtdeServer
    board: Board
    cell: LoadCell


class Faults:
    """The pending and the lasting faults.

    A fault: {fault: its name, the conditions for its begin (contact, depth_mm, force_N,
    pressing_s, time_s, moving), for_s, end, count, size}, as in the configuration's schema.
    refuse: closes (True) and opens RTDE's port; start: the world's beginning, s.
    """

    def __init__(
        self,
        parts: Parts,
        log: EventLog,
        refuse: Callable[[bool], None],
        seed: int,
        start: float,
    ):
        self.world, self.robot, self.rtde = parts.world, parts.robot, parts.rtde
        self.board, self.cell = parts.board, parts.cell
        self.log, self.refuse = log, refuse
        self.rng = np.random.default_rng([seed, 4])
        self.pending: list[dict] = []
        self._lasting: list[tuple[float, str, Callable[[], None]]] = []
        self._start = start

    def tick(self, t: float) -> None:
        """Begin and end the faults that are due at t s."""
        for fault in [fault for fault in self.pending if self._due(fault, t)]:
            self.pending.remove(fault)
            self.begin(fault, t)
        self._end([lasting for lasting in self._lasting if lasting[0] <= t])

    def _end(self, ended: list[tuple[float, str, Callable[[], None]]]) -> None:
        for lasting in ended:
            self._lasting.remove(lasting)
            lasting[2]()
            self.log.write("fault over", fault=lasting[1])

    def _due(self, fault: dict, t: float) -> bool:
        world = self.world
        if "contact" in fault and world.contacts < fault["contact"]:
            return False
        if "depth_mm" in fault and world.depth_mm < fault["depth_mm"]:
            return False
        if "force_N" in fault and world.force_N < fault["force_N"]:
            return False
        if "pressing_s" in fault and t - self._start - world.touched_at < fault["pressing_s"]:
            return False
        if "moving" in fault and self.robot.moving != fault["moving"]:
            return False
        return t - self._start >= fault.get("time_s", 0.0)

    def begin(self, fault: dict, t: float) -> None:
        """Begin a fault at t s, or end a lasting one."""
        name = fault["fault"]
        if fault.get("end"):
            self._end([lasting for lasting in self._lasting if lasting[1] == name])
            return
        self.log.write(
            "fault",
            **fault,
            now={
                "contact": self.world.contacts,
                "depth_mm": round(self.world.depth_mm, 4),
                **self.world.force_entry(),
            },
        )
        device, _, action = name.partition("_")
        if device == "board" and action in LINES:
            self._spoil(getattr(self, f"_{action}"), fault.get("count", 1))
            return
        undo = getattr(self, f"_{name}")(fault, t)
        if undo is not None:
            self._lasting.append((t + fault.get("for_s", np.inf), name, undo))

    # Board: changes of a line.

    def _spoil(self, change: Callable, count: int) -> None:
        remaining = [count]

        def corrupt(values: np.ndarray, line: bytes) -> bytes:
            remaining[0] -= 1
            if remaining[0] <= 0:
                self.board.corrupt = unspoiled
            return change(values, line)

        self.board.corrupt = corrupt

    def _short(self, values: np.ndarray, line: bytes) -> bytes:
        return self._text(values[: int(self.rng.integers(1, len(values)))])

    def _long(self, values: np.ndarray, line: bytes) -> bytes:
        return self._text(np.concatenate([values, np.resize(values, LONG_VALUES)]))

    def _joined(self, values: np.ndarray, line: bytes) -> bytes:
        return line[:-1] + line

    def _garbled(self, values: np.ndarray, line: bytes) -> bytes:
        data = np.frombuffer(line[:-1], dtype=np.uint8).copy()
        data[self.rng.choice(len(data), size=8, replace=False)] |= 0x80
        return data.tobytes() + b"\n"

    def _duplicated(self, values: np.ndarray, line: bytes) -> bytes:
        return line + line

    def _driven(self, values: np.ndarray, line: bytes) -> bytes:
        return self._text(np.where(self.board.eit_board.is_recorded, values, DRIVEN_V))

    def _saturated(self, values: np.ndarray, line: bytes) -> bytes:
        largest = self.board.eit_board.description["range"][1]
        return self._text(np.where(values >= np.quantile(values, 0.9), largest, values))

    def _text(self, values: np.ndarray) -> bytes:
        return text(values, self.board.eit_board)

    def _print(self, corrupt: Callable[[np.ndarray, bytes], bytes]) -> Callable[[], None]:
        self.board.corrupt = corrupt

        def undo() -> None:
            self.board.corrupt = unspoiled

        return undo

    def _board_silent(self, fault: dict, t: float) -> Callable[[], None]:
        return self._print(lambda values, line: b"")

    def _board_frozen(self, fault: dict, t: float) -> Callable[[], None]:
        lines: list[bytes] = []

        def first_line(values: np.ndarray, line: bytes) -> bytes:
            lines.append(line)
            return lines[0]

        return self._print(first_line)

    def _board_unplugged(self, fault: dict, t: float) -> Callable[[], None]:
        self.board.port.unplug()
        return self.board.port.plug_in

    # Load cell.

    def _say(self, line_fault: Callable[[bytes], bytes | None]) -> Callable[[], None]:
        self.cell.line_fault = line_fault

        def undo() -> None:
            self.cell.line_fault = lambda line: line

        return undo

    def _feel(self, force_fault: Callable[[float], float]) -> Callable[[], None]:
        self.cell.force_fault = force_fault

        def undo() -> None:
            self.cell.force_fault = lambda force: force

        return undo

    def _load_cell_silent(self, fault: dict, t: float) -> Callable[[], None]:
        return self._say(lambda line: None)

    def _load_cell_nan(self, fault: dict, t: float) -> Callable[[], None]:
        return self._say(lambda line: b"nan\r\n")

    def _load_cell_frozen(self, fault: dict, t: float) -> Callable[[], None]:
        lines: list[bytes] = []

        def first_line(line: bytes) -> bytes:
            lines.append(line)
            return lines[0]

        return self._say(first_line)

    def _load_cell_spike(self, fault: dict, t: float) -> None:
        def spiked(force: float) -> float:
            undo()
            return force + fault.get("size", SPIKE_N)

        undo = self._feel(spiked)

    def _load_cell_drift(self, fault: dict, t: float) -> Callable[[], None]:
        rate = fault.get("size", DRIFT_N_PER_S)
        return self._feel(lambda force: force + rate * (time.monotonic() - t))

    def _load_cell_offset(self, fault: dict, t: float) -> Callable[[], None]:
        return self._feel(lambda force: force + fault.get("size", OFFSET_N))

    def _load_cell_stuck(self, fault: dict, t: float) -> Callable[[], None]:
        stuck_N = fault.get("size", self.world.force_N)
        return self._feel(lambda force: stuck_N)

    def _load_cell_saturated(self, fault: dict, t: float) -> Callable[[], None]:
        return self._feel(lambda force: min(force, fault.get("size", SATURATED_N)))

    def _load_cell_gain(self, fault: dict, t: float) -> Callable[[], None]:
        return self._feel(lambda force: fault.get("size", GAIN) * force)

    def _load_cell_reset(self, fault: dict, t: float) -> None:
        self.cell.resets = True

    def _load_cell_unplugged(self, fault: dict, t: float) -> Callable[[], None]:
        self.cell.port.unplug()
        return self.cell.port.plug_in

    def _load_cell_lbs(self, fault: dict, t: float) -> Callable[[], None]:
        cell = self.cell
        if not isinstance(cell, OpenScale):
            raise InputError("fault", "fault", "load_cell_lbs", "it with an OpenScale")
        cell.unit = LBS

        def undo() -> None:
            cell.unit = KG

        return undo

    # Robot.

    def _rtde_stalled(self, fault: dict, t: float) -> Callable[[], None]:
        self.rtde.stalled = True

        def undo() -> None:
            self.rtde.stalled = False

        return undo

    def _rtde_reset(self, fault: dict, t: float) -> None:
        self.rtde.reset()

    def _rtde_mute(self, fault: dict, t: float) -> Callable[[], None]:
        self.rtde.muted = self.rtde.stalled = True

        def undo() -> None:
            self.rtde.muted = self.rtde.stalled = False

        return undo

    def _rtde_refused(self, fault: dict, t: float) -> Callable[[], None]:
        self.refuse(True)
        self.rtde.reset()
        return lambda: self.refuse(False)

    def _rtde_in_use(self, fault: dict, t: float) -> Callable[[], None]:
        owner = object()
        self.rtde.claim_all(owner)
        return lambda: self.rtde.release_all(owner)

    def _protective_stop(self, fault: dict, t: float) -> None:
        self.robot.protective_stop()

    def _emergency_stop(self, fault: dict, t: float) -> Callable[[], None]:
        self.robot.emergency_stop()
        return self.robot.release_emergency

    def _program_killed(self, fault: dict, t: float) -> None:
        self.robot.stop_program("killed")


def unspoiled(values: np.ndarray, line: bytes) -> bytes:
    """The line of a board without a fault."""
    return line
