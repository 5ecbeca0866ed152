"""What must be right before anything moves, said in plain words."""

import contextlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from eitskin.capture.configuration import believed_skin, pressing_m_s
from eitskin.capture.dashboard import Dashboard
from eitskin.capture.interlock import NORMAL_SAFETY, RUNNING, SAFE_BITS, STILL_M_S
from eitskin.capture.lines import Line, Port, Value, plausible_s
from eitskin.capture.press_plan import places
from eitskin.capture.rtde import RobotState, RtdeError, robot_state
from eitskin.capture.wire import BOARDS, LOAD_CELLS, Reject, Restart, measured
from eitskin.errors import InputError

EMULATED = "EMULATED"  # stands in an emulated robot's serial number or PolyScope version
MAJOR = {"cb3": 3, "e": 5}
READINGS = 5  # of the load cell
FRAMES = 3  # of the board
WAIT_S = 5.0
LISTEN_S = 0.02
MODES = {
    3: "powered off",
    4: "powered on",
    5: "idle: its brakes are on",
    6: "in freedrive",
}
SAFETY = {
    2: "reduced mode",
    3: "a protective stop",
    4: "recovery mode",
    5: "a safeguard stop",
    6: "an emergency stop of the system",
    7: "an emergency stop",
    8: "a violation",
    9: "a fault",
}


@dataclass(frozen=True)
class Finding:
    """One thing looked at: whether it is right, and what was seen."""

    name: str
    ok: bool
    text: str


def plan(config: dict) -> Finding:
    """Whether every press lies on the skin, where its radius is known."""
    probe_mm, radius_mm = max(config["plan"]["probes_mm"]), believed_skin(config).radius_mm
    reach_mm = np.hypot(*places(config["plan"])[["x_mm", "y_mm"]].T.to_numpy()).max()
    reach_mm = float(reach_mm) + 0.5 * probe_mm
    said = f"a probe of {probe_mm:g} mm reaches {reach_mm:.1f} mm from the centre"
    if radius_mm is None or reach_mm <= radius_mm:
        return Finding("plan", True, said)
    return Finding("plan", False, f"{said}, over the rim of the skin at {radius_mm:g} mm")


def robot(config: dict) -> tuple[list[Finding], dict]:
    """The controller's state by RTDE and dashboard, and what it is: serial, versions."""
    host, series = config["robot"]["host"], config["robot"]["series"]
    try:
        state = robot_state(host)
    except RtdeError as error:
        return [Finding("robot", False, f"no state of the robot: {error}")], {}
    findings = [_state_finding(state, series, config["pose"]["box_m"])]
    identity: dict[str, str | bool] = {"controller": ".".join(map(str, state.version))}
    dashboard = Dashboard(host)
    try:
        identity["serial"] = serial = dashboard.ask("get serial number")
        identity["polyscope"] = polyscope = dashboard.ask("PolyscopeVersion")
        remote = series == "cb3" or dashboard.ask("is in remote control").lower() == "true"
    except OSError as error:
        findings.append(Finding("dashboard", False, f"the dashboard does not answer: {error}"))
        return findings, identity
    finally:
        dashboard.close()
    said = f"serial number {serial}, {polyscope}"
    if not remote:
        findings.append(Finding("dashboard", False, "the robot is not in remote control"))
    identity["emulated"] = emulated = EMULATED in serial + polyscope
    if emulated != config["emulated"]:
        claimed = "emulated" if config["emulated"] else "real"
        text = f"{said}: not what the configuration says, {claimed}"
        findings.append(Finding("dashboard", False, text))
    if len(findings) == 1:
        findings.append(Finding("dashboard", True, said))
    return findings, identity


def _state_finding(state: RobotState, series: str, box_m: list[list[float]]) -> Finding:
    major, position = state.version[0], state.pose[:3]
    outside = [
        f"{axis} = {value:.4f} m, not {low} to {high} m"
        for axis, value, (low, high) in zip("xyz", position, box_m, strict=True)
        if not low <= value <= high
    ]
    wrong = None
    if major != MAJOR[series]:
        wrong = f"its software is version {major}, the configuration says {series}"
    elif state.safety_mode != NORMAL_SAFETY or state.safety_bits != SAFE_BITS:
        said = SAFETY.get(state.safety_mode, f"safety mode {state.safety_mode}")
        wrong = f"its safety system says {said} (bits {state.safety_bits:#x})"
    elif state.robot_mode != RUNNING:
        wrong = f"it is not running: {MODES.get(state.robot_mode, f'mode {state.robot_mode}')}"
    elif not state.advanced_s > 0.0:
        wrong = "its clock stands still"
    elif float(np.linalg.norm(state.speed[:3])) > STILL_M_S:
        wrong = "it moves"
    elif outside:
        wrong = f"its TCP is outside the box: {'; '.join(outside)}; jog it inside"
    if wrong is not None:
        return Finding("robot", False, f"the robot is not ready: {wrong}")
    place = ", ".join(f"{value:.4f}" for value in position)
    return Finding("robot", True, f"running, safety normal, TCP at {place} m, inside the box")


def watchdog(config: dict) -> Finding:
    """How far the arm may go without its host; what a rig's configuration allows is never wrong."""
    limits, motion = config["limits"], config["motion"]
    silent_s = 1.0 / limits["watchdog_Hz"]
    text = (
        f"the controller stops the arm {silent_s:g} s after it last heard of its host: at most "
        f"{1e3 * motion['travel_m_s'] * silent_s:g} mm above the skin and "
        f"{1e3 * pressing_m_s(motion) * silent_s:g} mm into it farther"
    )
    return Finding("watchdog", True, text)


def load_cell(port: Port[float | Restart], config: dict) -> Finding:
    """Whether the load cell is heard, fresh, not frozen and at zero."""
    lines = _listen(port, READINGS, lambda line: isinstance(line.value, float))
    values = np.array([line.value for line in lines if isinstance(line.value, float)])
    if len(values) < READINGS:
        return Finding("load cell", False, _unheard(port, lines, f"{len(values)} readings"))
    limit, middle = config["limits"]["zero_N"], float(np.median(values))
    said = f"{middle:.4f} N with nothing touched, {np.ptp(values):.4f} N between readings"
    if not np.abs(values).max() < limit:
        return Finding("load cell", False, f"{said}: expected less than {limit} N; unload, restart")
    if np.ptp(values) == 0.0:
        return Finding("load cell", False, f"{said}: no reading differs from the next")
    return Finding("load cell", True, said)


def board(port: Port[np.ndarray], config: dict) -> Finding:
    """Whether the board sends whole frames, and how much of the converter they use."""
    profile = BOARDS[config["board"]["profile"]]
    lines = _listen(port, FRAMES, lambda line: isinstance(line.value, np.ndarray))
    frames = [(line.end_s, line.value) for line in lines if isinstance(line.value, np.ndarray)]
    if len(frames) < FRAMES:
        return Finding("board", False, _unheard(port, lines, f"{len(frames)} frames"))
    readings = np.array([frame[measured(profile.n_electrodes)] for _, frame in frames])
    period = np.median(np.diff([end_s for end_s, _ in frames]))
    saturated = int((readings > profile.linear_V).any(axis=0).sum())
    said = (
        f"{len(frames)} whole frames, {period:.3f} s apart, {readings.min():.4f} to "
        f"{readings.max():.4f} V RMS, {saturated} channels above the linear {profile.linear_V} V"
    )
    expected = config["board"]["period_s"]
    shortest_s, longest_s = plausible_s(expected)
    if not shortest_s <= period <= longest_s:
        return Finding("board", False, f"{said}: the configuration says {expected} s apart")
    if not readings.any():
        return Finding("board", False, f"{said}: no current flows")
    return Finding("board", True, said)


def _listen(
    port: Port[Value], wanted: int, counts: Callable[[Line[Value]], bool]
) -> list[Line[Value]]:
    """The lines of a port until `wanted` of them count, or for 5 s."""
    lines: list[Line[Value]] = []
    end_s = time.monotonic() + WAIT_S
    while time.monotonic() < end_s and port.lost is None:
        last = lines[-1].number if lines else 0
        port.wait(last, LISTEN_S)
        lines += port.since(last)
        if sum(map(counts, lines)) >= wanted:
            break
    return lines


def _unheard(port: Port[Value], lines: list[Line[Value]], seen: str) -> str:
    rejects = [line.value for line in lines if isinstance(line.value, Reject)]
    if port.lost is not None:
        return f"the port is gone: {port.lost}"
    said = f"{seen} in {WAIT_S:g} s, {len(rejects)} lines refused"
    if rejects:
        said += f", the last: {rejects[-1].reason}, {rejects[-1].detail}"
    if any(isinstance(line.value, Restart) for line in lines):
        said += "; it has just started"
    return said


@contextlib.contextmanager
def opened_load_cell(config: dict) -> Iterator[Port[float | Restart]]:
    """The load cell's port; raises InputError where it cannot be opened."""
    cell = config["load_cell"]

    def opening() -> Port[float | Restart]:
        return Port(cell["port"], cell["baud"], LOAD_CELLS[cell["profile"]])

    with _opened("load_cell", cell["port"], opening) as port:
        yield port


@contextlib.contextmanager
def opened_board(config: dict) -> Iterator[Port[np.ndarray]]:
    """The board's port; raises InputError where it cannot be opened."""
    board = config["board"]
    profile = BOARDS[board["profile"]]

    def opening() -> Port[np.ndarray]:
        return Port(board["port"], board["baud"], profile.parse, profile.start)

    with _opened("board", board["port"], opening) as port:
        yield port


@contextlib.contextmanager
def _opened(name: str, device: str, opening: Callable[[], Port[Value]]) -> Iterator[Port[Value]]:
    try:
        port = opening()
    except OSError as error:
        expected = "a serial port that nobody else holds"
        raise InputError("rig", f"{name}.port {device}", str(error), expected) from error
    try:
        yield port
    finally:
        port.close()


def check(config: dict) -> list[Finding]:
    """Everything, one after another, each by itself; nothing moves."""
    findings = [plan(config), *robot(config)[0]]
    findings.append(watchdog(config))
    findings.append(_looked_at("load cell", opened_load_cell, load_cell, config))
    findings.append(_looked_at("board", opened_board, board, config))
    return findings


def _looked_at(
    name: str,
    opened: Callable[[dict], contextlib.AbstractContextManager[Port[Value]]],
    look: Callable[[Port[Value], dict], Finding],
    config: dict,
) -> Finding:
    try:
        with opened(config) as port:
            return look(port, config)
    except InputError as error:
        return Finding(name, False, str(error))
