"""A capture from start to end: pre-flight checks, contact after contact, and a safe stop."""

import contextlib
import platform
import signal
import subprocess
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from eitskin.capture import journal, preflight
from eitskin.capture.configuration import board_of
from eitskin.capture.press import press
from eitskin.capture.press_plan import Contact, contacts, plan_sha256
from eitskin.capture.rig import Fault, Interrupted, Rig
from eitskin.capture.robot import Robot, RobotError
from eitskin.data import board
from eitskin.errors import InputError

PACKAGES = ("eitskin", "numpy", "pyserial", "ur-rtde")
PROBE_CHANGE_S = 600.0  # for the configuration's command
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
COMMAND_FAILED = "the probe was not changed"


class Stopped(Exception):
    """A capture that ended early; the text says why and how the arm stands, `code` is for the
    shell."""

    def __init__(self, text: str, code: int):
        super().__init__(text)
        self.code = code


PROBE, FAULT, SIGNAL = 3, 4, 128  # exit codes; to SIGNAL its number is added, as shells do


def capture(
    config: dict,
    file: str | Path,
    journal_path: str | Path,
    resume: bool,
    mounted_mm: float | None,
    show: Callable[[dict], None],
) -> None:
    """Take every contact that the journal at `journal_path` does not hold yet.

    `mounted_mm` is the diameter of the probe on the robot, None where a command changes it; `show`
    gets the progress. Raises InputError before anything moves: for a journal of another plan or in
    use, a wrong probe, and a rig that is not ready. Raises Stopped where the capture ended early;
    then the arm stands, lifted off if possible.
    """
    if config["probe_change"] is not None and mounted_mm is not None:
        expected = "none: rig.probe_change is a command, which mounts every probe"
        raise InputError(file, "mounted probe", f"{mounted_mm:g} mm", expected)
    planned_contacts = contacts(config["plan"])
    if journal.remove_if_empty(journal_path):
        resume = False
    capture_journal = journal.read(journal_path) if resume else None
    if capture_journal is not None and capture_journal.records[0]["plan_sha256"] != plan_sha256(
        config
    ):
        expected = "the rig and plan that the journal was begun with"
        raise InputError(file, "rig", "another rig or plan", f"{expected} ({journal_path})")
    finished_contacts = (
        {r["contact"] for r in capture_journal.records if r["kind"] == "end"}
        if capture_journal
        else set()
    )
    remaining_contacts = [
        contact for contact in planned_contacts if contact.number not in finished_contacts
    ]
    if not remaining_contacts:
        return
    _check_probe(config, file, remaining_contacts[0], mounted_mm)
    is_new = capture_journal is None
    if capture_journal is None:
        _refuse([preflight.plan(config)], file)
        header: dict = {"kind": "capture", "format": "eit-capture", "version": 1}
        header |= {"config": config, "plan_sha256": plan_sha256(config)}
        journal.begin(journal_path, header | {"board": board_of(config).description})
        capture_journal = journal.read(journal_path)
    run = sum(record["kind"] == "run" for record in capture_journal.records)
    with contextlib.closing(journal.Writer(journal_path, capture_journal)) as writer:
        try:
            with _ready_rig(config, file) as (rig, identity):
                writer.append(_run_record(config, run, identity))
                is_new = False
                _drive(
                    rig,
                    _Run(run, remaining_contacts, len(planned_contacts), capture_journal, writer),
                    mounted_mm,
                    show,
                )
        finally:
            if is_new:  # a capture that is refused leaves no journal
                Path(journal_path).unlink(missing_ok=True)


@contextlib.contextmanager
def _ready_rig(config: dict, file: str | Path) -> Iterator[tuple[Rig, dict]]:
    """The rig, opened, checked and lifted off the skin, and its robot's identity."""
    findings, identity = preflight.robot(config)
    _refuse(findings, file)
    try:
        robot = Robot(config["robot"]["host"], config["limits"]["watchdog_Hz"])
    except RobotError as error:
        raise InputError(file, "robot", error, "a robot that lets itself be driven") from error
    rig = Rig(config, robot)
    with contextlib.closing(robot), _signals(rig):
        _lift(rig)
        with (
            preflight.opened_load_cell(config) as load,
            preflight.opened_board(config) as board,
        ):
            _refuse([preflight.load_cell(load, config), preflight.board(board, config)], file)
            rig.listen(load, board)
            yield rig, identity


def _lift(rig: Rig) -> None:
    """Lift the probe off the skin: many load cells take their zero when their port is opened."""
    if not rig.hovers:
        actions = rig.stop_and_retreat()
        if not rig.hovers:
            raise Stopped(f"the probe is on the skin; {'; '.join(actions)}", FAULT)


@dataclass(frozen=True)
class _Run:
    """One run of a capture: its contacts of `n_planned`, the earlier journal and its writer."""

    number: int
    contacts: list[Contact]
    n_planned: int
    history: journal.Journal
    writer: journal.Writer


def _drive(rig: Rig, run: _Run, mounted_mm: float | None, show: Callable[[dict], None]) -> None:
    """Press after press; whatever ends the run, the arm is stopped and lifted first, and the reason
    is recorded."""
    writer = run.writer
    start_s, probe_mm = time.monotonic(), mounted_mm
    cause: BaseException | None = None
    try:
        for n_done, contact in enumerate(run.contacts):
            spent_s = time.monotonic() - start_s
            remaining_s = spent_s / n_done * (len(run.contacts) - n_done) if n_done else None
            if contact.probe_mm != probe_mm:
                _change_probe(rig, contact.probe_mm)
                probe_mm = contact.probe_mm
                writer.append({"kind": "probe", "run": run.number, "probe_mm": probe_mm})
            attempt = run.history.attempts(contact.number)
            attempt_key = {"contact": contact.number, "attempt": attempt, "run": run.number}
            writer.append({"kind": "begin", **attempt_key, **_planned(contact), **_clocks()})

            def record_frame(frame: dict, attempt_key: dict = attempt_key) -> None:
                writer.append(*rig.take_rejects(), {"kind": "frame", **attempt_key, **frame})
                show({"frame": frame})

            number = run.n_planned - len(run.contacts) + n_done + 1
            show({"contact": contact, "number": number, "of": run.n_planned, "left_s": remaining_s})
            end = press(rig, contact, record_frame, show)
            writer.append(
                *rig.take_rejects(), {"kind": "end", **attempt_key, "end": end, **_clocks()}
            )
        _park(rig)
        writer.append({"kind": "done", "run": run.number, **_clocks()})
        return
    except _ProbeNeeded as missing_probe:
        probe_mm = missing_probe.probe_mm
        text = f"mount the probe of {probe_mm:g} mm and go on, {_remount_command(probe_mm)}"
        stopped, reason = Stopped(text, PROBE), "probe"
    except Interrupted as interrupted:
        stopped = Stopped(str(interrupted), SIGNAL + interrupted.signal)
        reason = "signal"
    except Fault as fault:
        stopped, reason = Stopped(str(fault), FAULT), fault.reason
    except RobotError as error:
        stopped, reason = Stopped(str(error), FAULT), "robot"
    except BaseException as error:
        stopped, reason = Stopped(f"{type(error).__name__}: {error}", FAULT), "error"
        cause = error
    force_N = rig.last_force_N
    actions = rig.stop_and_retreat()
    text = f"{stopped}; {'; '.join(actions)}"
    stop_record = {"reason": reason, "message": text, "force_N": force_N}
    if cause is not None:
        stop_record["traceback"] = "".join(traceback.format_exception(cause))
    try:
        writer.append(
            *rig.take_rejects(), {"kind": "stop", "run": run.number, **stop_record, **_clocks()}
        )
    except (OSError, ValueError) as error:
        text += f"; the journal does not tell of it: {error}"
    raise Stopped(text, stopped.code) from cause


class _ProbeNeeded(Exception):
    def __init__(self, probe_mm: float):
        super().__init__(probe_mm)
        self.probe_mm = probe_mm


def _park(rig: Rig) -> None:
    """Straight up, then above the skin's centre."""
    centre, motion = rig.config["pose"]["centre"], rig.config["motion"]
    travel = (motion["travel_m_s"], motion["travel_m_s2"])
    rig.move((*rig.position_m[:2], centre[2]), *travel)
    rig.move(tuple(centre[:3]), *travel)


def _change_probe(rig: Rig, probe_mm: float) -> None:
    """Change the probe above the centre by the configuration's command.

    Raises _ProbeNeeded where there is none and a person must do it.
    """
    _park(rig)
    if rig.config["probe_change"] is None:
        raise _ProbeNeeded(probe_mm)
    command = [*rig.config["probe_change"], f"{probe_mm:g}"]
    try:
        probe_changer = subprocess.Popen(command, stdin=subprocess.DEVNULL)
    except OSError as error:
        raise RobotError(f"{COMMAND_FAILED}: {error}") from error
    with probe_changer as process:
        try:
            exit_code = rig.watch(process.poll, PROBE_CHANGE_S, "the change of the probe")
        except BaseException:
            process.kill()
            raise
    if exit_code != 0:
        raise RobotError(f"{COMMAND_FAILED}: {command} ended with {exit_code}")


def _check_probe(
    config: dict, file: str | Path, contact: Contact, mounted_mm: float | None
) -> None:
    """Raise InputError where a person changes probes and the next contact's is not mounted."""
    if config["probe_change"] is None and mounted_mm != contact.probe_mm:
        mounted_text = "none" if mounted_mm is None else f"{mounted_mm:g} mm"
        command = _remount_command(contact.probe_mm)
        expected = f"the probe of {contact.probe_mm:g} mm: mount it and go on, {command}"
        raise InputError(file, "mounted probe", mounted_text, expected)


def _remount_command(probe_mm: float) -> str:
    """The commands by which a person states which probe is mounted."""
    capture_command = f"`snakemake capture … --config mounted_mm={probe_mm:g}`"
    return f"{capture_command} or `eitskin rig resume … --probe {probe_mm:g}`"


def _refuse(findings: list[preflight.Finding], file: str | Path) -> None:
    for finding in findings:
        if not finding.ok:
            raise InputError(file, finding.name, finding.text, "a rig that is ready")


@contextlib.contextmanager
def _signals(rig: Rig) -> Iterator[None]:
    """Pass the first of SIGINT, SIGTERM and SIGHUP to the rig."""

    def handle(number: int, _frame: object) -> None:
        rig.signal = rig.signal or number

    previous_handlers = {number: signal.signal(number, handle) for number in SIGNALS}
    try:
        yield
    finally:
        for number, handler in previous_handlers.items():
            signal.signal(number, handler)


def _run_record(config: dict, run: int, identity: dict) -> dict:
    description = board_of(config).description
    return {
        "kind": "run",
        "run": run,
        "robot": identity,
        "board": {**config["board"], **{key: description[key] for key in board.TIMING}},
        **{key: config[key] for key in ("load_cell", "session", "motion", "limits")},
        "packages": {name: version(name) for name in PACKAGES},
        "python": platform.python_version(),
        **_clocks(),
    }


def _planned(contact: Contact) -> dict:
    return {"planned": asdict(contact)}


def _clocks() -> dict:
    """Both of the host's clocks at one moment."""
    return {
        "monotonic_s": time.monotonic(),
        "utc": datetime.now(UTC).isoformat(timespec="microseconds"),
    }
