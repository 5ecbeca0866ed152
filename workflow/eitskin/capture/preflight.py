"""Checks of all devices before anything moves, in plain words."""

import contextlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from eitskin.capture.configuration import believed_skin, board_of, pressing_m_s
from eitskin.capture.dashboard import Dashboard
from eitskin.capture.interlock import NORMAL_SAFETY, RUNNING, SAFE_BITS, STILL_M_S
from eitskin.capture.lines import Line, Port, Value, plausible_period_s
from eitskin.capture.load_cell import LOAD_CELLS, Restart
from eitskin.capture.press_plan import places
from eitskin.capture.rtde import RobotState, RtdeError, robot_state
from eitskin.data.board import Reject
from eitskin.errors import InputError

EMULATED = "EMULATED"  # stands in an emulated robot's serial number or PolyScope version
MAJOR = {"cb3": 3, "e": 5}
READINGS = 5  # of the load cell: fewer cannot show that it is frozen
FRAMES = 3  # of the board: two periods
WAIT_S = 5.0  # for them, at periods of up to a second
LISTEN_S = 0.02  # from one look at the port to the next
# Values of robot_mode and safety_mode: Universal Robots, RTDE guide.
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
    """The outcome of one check: whether it passed, and why."""

    name: str
    ok: bool
    text: str


def plan(config: dict) -> Finding:
    """Whether every press lies on the skin, where its radius or its outline is known."""
    skin, probe_mm = believed_skin(config), max(config["plan"]["probes_mm"])
    if skin.rim is not None:
        place = places(config["plan"])[["x_mm", "y_mm"]].to_numpy() @ np.array([1.0, 1.0j])
        clearance_mm = float(skin.rim.depth(place).min()) - 0.5 * probe_mm
        description = (
            f"a probe of {probe_mm:g} mm stays {abs(clearance_mm):.1f} mm within the skin's outline"
            if clearance_mm >= 0.0
            else f"a probe of {probe_mm:g} mm goes {-clearance_mm:.1f} mm over the skin's outline"
        )
        return Finding("plan", clearance_mm >= 0.0, description)
    radius_mm = skin.radius_mm
    reach_mm = np.hypot(*places(config["plan"])[["x_mm", "y_mm"]].T.to_numpy()).max()
    reach_mm = float(reach_mm) + 0.5 * probe_mm
    description = f"a probe of {probe_mm:g} mm reaches {reach_mm:.1f} mm from the centre"
    if radius_mm is None or reach_mm <= radius_mm:
        return Finding("plan", True, description)
    return Finding("plan", False, f"{description}, over the rim of the skin at {radius_mm:g} mm")


def robot(config: dict) -> tuple[list[Finding], dict]:
    """Findings on the controller's state, and its identity: serial number and versions."""
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
        is_remote = series == "cb3" or dashboard.ask("is in remote control").lower() == "true"
    except OSError as error:
        findings.append(Finding("dashboard", False, f"the dashboard does not answer: {error}"))
        return findings, identity
    finally:
        dashboard.close()
    description = f"serial number {serial}, {polyscope}"
    if not is_remote:
        findings.append(Finding("dashboard", False, "the robot is not in remote control"))
    identity["emulated"] = is_emulated = EMULATED in serial + polyscope
    if is_emulated != config["emulated"]:
        configured_kind = "emulated" if config["emulated"] else "real"
        text = f"{description}: not what the configuration says, {configured_kind}"
        findings.append(Finding("dashboard", False, text))
    if len(findings) == 1:
        findings.append(Finding("dashboard", True, description))
    return findings, identity


def _state_finding(state: RobotState, series: str, box_m: list[list[float]]) -> Finding:
    major, position = state.version[0], state.pose[:3]
    outside_axes = [
        f"{axis} = {value:.4f} m, not {low} to {high} m"
        for axis, value, (low, high) in zip("xyz", position, box_m, strict=True)
        if not low <= value <= high
    ]
    fault = None
    if major != MAJOR[series]:
        fault = f"its software is version {major}, the configuration says {series}"
    elif state.safety_mode != NORMAL_SAFETY or state.safety_bits != SAFE_BITS:
        safety_text = SAFETY.get(state.safety_mode, f"safety mode {state.safety_mode}")
        fault = f"its safety system says {safety_text} (bits {state.safety_bits:#x})"
    elif state.robot_mode != RUNNING:
        fault = f"it is not running: {MODES.get(state.robot_mode, f'mode {state.robot_mode}')}"
    elif not state.advanced_s > 0.0:
        fault = "its clock stands still"
    elif float(np.linalg.norm(state.speed[:3])) > STILL_M_S:
        fault = "it moves"
    elif outside_axes:
        fault = f"its TCP is outside the box: {'; '.join(outside_axes)}; jog it inside"
    if fault is not None:
        return Finding("robot", False, f"the robot is not ready: {fault}")
    place = ", ".join(f"{value:.4f}" for value in position)
    return Finding("robot", True, f"running, safety normal, TCP at {place} m, inside the box")


def watchdog(config: dict) -> Finding:
    """How far the arm may move without its host; always ok, as the configuration was checked."""
    limits, motion = config["limits"], config["motion"]
    silent_s = 1.0 / limits["watchdog_Hz"]
    text = (
        f"the controller stops the arm {silent_s:g} s after it last heard of its host: at most "
        f"{1e3 * motion['travel_m_s'] * silent_s:g} mm above the skin and "
        f"{1e3 * pressing_m_s(motion) * silent_s:g} mm into it farther"
    )
    return Finding("watchdog", True, text)


def load_cell(port: Port[float | Restart], config: dict) -> Finding:
    """Whether the load cell sends changing readings near zero."""
    lines = _listen(port, READINGS, lambda line: isinstance(line.value, float))
    values = np.array([line.value for line in lines if isinstance(line.value, float)])
    if len(values) < READINGS:
        return Finding("load cell", False, _silence_text(port, lines, f"{len(values)} readings"))
    limit_N, median_N = config["limits"]["zero_N"], float(np.median(values))
    description = f"{median_N:.4f} N with nothing touched, {np.ptp(values):.4f} N between readings"
    if not np.abs(values).max() < limit_N:
        return Finding(
            "load cell", False, f"{description}: expected less than {limit_N} N; unload, restart"
        )
    if np.ptp(values) == 0.0:
        return Finding("load cell", False, f"{description}: no reading differs from the next")
    return Finding("load cell", True, description)


def board(port: Port[np.ndarray], config: dict) -> Finding:
    """Whether the board sends complete frames, and how much of the converter's range they use."""
    profile = board_of(config)
    lines = _listen(port, FRAMES, lambda line: isinstance(line.value, np.ndarray))
    frames = [(line.end_s, line.value) for line in lines if isinstance(line.value, np.ndarray)]
    if len(frames) < FRAMES:
        return Finding("board", False, _silence_text(port, lines, f"{len(frames)} frames"))
    readings = np.array([reading for _, reading in frames])
    period_s = np.median(np.diff([end_s for end_s, _ in frames]))
    n_saturated = int(profile.saturated(readings).any(axis=0).sum())
    description = (
        f"{len(frames)} whole frames, {period_s:.3f} s apart, {readings.min():.4f} to "
        f"{readings.max():.4f} {profile.unit_text}, {n_saturated} channels above the linear "
        f"{profile.ceiling:g} {profile.unit}"
    )
    shortest_s, longest_s = plausible_period_s(profile.period_s)
    if not shortest_s <= period_s <= longest_s:
        return Finding("board", False, f"{description}: the board's period_s is {profile.period_s}")
    if not readings.any():
        return Finding("board", False, f"{description}: no current flows")
    return Finding("board", True, description)


def _listen(
    port: Port[Value], n_wanted: int, is_wanted: Callable[[Line[Value]], bool]
) -> list[Line[Value]]:
    """The lines of a port until `n_wanted` of them are wanted ones, or for WAIT_S."""
    lines: list[Line[Value]] = []
    deadline_s = time.monotonic() + WAIT_S
    while time.monotonic() < deadline_s and port.failure is None:
        last_number = lines[-1].number if lines else 0
        port.wait(last_number, LISTEN_S)
        lines += port.since(last_number)
        if sum(map(is_wanted, lines)) >= n_wanted:
            break
    return lines


def _silence_text(port: Port[Value], lines: list[Line[Value]], count_text: str) -> str:
    rejects = [line.value for line in lines if isinstance(line.value, Reject)]
    if port.failure is not None:
        return f"the port is gone: {port.failure}"
    description = f"{count_text} in {WAIT_S:g} s, {len(rejects)} lines refused"
    if rejects:
        description += f", the last: {rejects[-1].reason}, {rejects[-1].detail}"
    if any(isinstance(line.value, Restart) for line in lines):
        description += "; it has just started"
    return description


@contextlib.contextmanager
def opened_load_cell(config: dict) -> Iterator[Port[float | Restart]]:
    """The load cell's port; raises InputError where it cannot be opened."""
    cell = config["load_cell"]

    def open_port() -> Port[float | Restart]:
        return Port(cell["port"], cell["baud"], LOAD_CELLS[cell["profile"]])

    with _closing_port("load_cell", cell["port"], open_port) as port:
        yield port


@contextlib.contextmanager
def opened_board(config: dict) -> Iterator[Port[np.ndarray]]:
    """The board's port; raises InputError where it cannot be opened."""
    device, profile = config["board"]["port"], board_of(config)

    def open_port() -> Port[np.ndarray]:
        return Port(device, profile.baud, profile.parse, profile.start)

    with _closing_port("board", device, open_port) as port:
        yield port


@contextlib.contextmanager
def _closing_port(
    device_name: str, device: str, open_port: Callable[[], Port[Value]]
) -> Iterator[Port[Value]]:
    try:
        port = open_port()
    except OSError as error:
        expected = "a serial port that nobody else holds"
        raise InputError("rig", f"{device_name}.port {device}", str(error), expected) from error
    try:
        yield port
    finally:
        port.close()


def check(config: dict) -> list[Finding]:
    """All findings, each device by itself; nothing moves."""
    findings = [plan(config), *robot(config)[0]]
    findings.append(watchdog(config))
    findings.append(_check_device("load cell", opened_load_cell, load_cell, config))
    findings.append(_check_device("board", opened_board, board, config))
    return findings


def _check_device(
    name: str,
    opened_port: Callable[[dict], contextlib.AbstractContextManager[Port[Value]]],
    check_port: Callable[[Port[Value], dict], Finding],
    config: dict,
) -> Finding:
    try:
        with opened_port(config) as port:
            return check_port(port, config)
    except InputError as error:
        return Finding(name, False, str(error))
