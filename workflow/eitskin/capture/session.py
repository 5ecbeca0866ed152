"""A capture from beginning to end: pre-flight, contact after contact, and a safe end whatever
happens."""

import contextlib
import platform
import signal
import subprocess
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import asdict
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from eitskin.capture import journal, preflight
from eitskin.capture.press import press
from eitskin.capture.press_plan import Contact, contacts, plan_sha256
from eitskin.capture.rig import Fault, Interrupted, Rig
from eitskin.capture.robot import Robot, RobotError
from eitskin.errors import InputError

PACKAGES = ("eitskin", "numpy", "pyserial", "ur-rtde")
PROBE_CHANGE_S = 600.0
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
COMMAND_FAILED = "the probe was not changed"


class Stopped(Exception):
    """A capture that ended early, safely or as said; `code` is for the shell."""

    def __init__(self, text: str, code: int):
        super().__init__(text)
        self.code = code


PROBE, FAULT, SIGNAL = 3, 4, 128


def capture(
    config: dict,
    file: str | Path,
    path: str | Path,
    resume: bool,
    mounted_mm: float | None,
    show: Callable[[dict], None],
) -> None:
    """Take every contact that the journal at `path` does not hold yet.

    mounted_mm: the probe on the robot, where no command changes it. `show` gets what a person
    wants to see. Raises InputError for a journal of another plan or that another capture writes, a
    probe said to be mounted that is not the one or that a command changes, a rig that is not ready
    or a device that is not there, before anything moves; Stopped where the capture ended early. The
    arm stands then, lifted off where it could be.
    """
    if config["probe_change"] is not None and mounted_mm is not None:
        expected = "none: rig.probe_change is a command, which mounts every probe"
        raise InputError(file, "mounted probe", f"{mounted_mm:g} mm", expected)
    planned = contacts(config["plan"])
    if journal.taken_away(path):
        resume = False
    found = journal.read(path) if resume else None
    if found is not None and found.records[0]["plan_sha256"] != plan_sha256(config):
        expected = "the rig and plan that the journal was begun with"
        raise InputError(file, "rig", "another rig or plan", f"{expected} ({path})")
    finished = {r["contact"] for r in found.records if r["kind"] == "end"} if found else set()
    todo = [contact for contact in planned if contact.number not in finished]
    if not todo:
        return
    _check_probe(config, file, todo[0], mounted_mm)
    begun = found is None
    if found is None:
        _refuse([preflight.plan(config)], file)
        head = {"kind": "capture", "format": "eit-capture", "version": 1}
        journal.begin(path, {**head, "config": config, "plan_sha256": plan_sha256(config)})
        found = journal.read(path)
    run = sum(record["kind"] == "run" for record in found.records)
    with contextlib.closing(journal.Writer(path, found)) as writer:
        try:
            with _ready(config, file) as (rig, identity):
                writer.append(_run_record(config, run, identity))
                begun = False
                _drive(rig, todo, len(planned), run, found, writer, mounted_mm, show)
        finally:
            if begun:  # a capture that is refused leaves no journal
                Path(path).unlink(missing_ok=True)


@contextlib.contextmanager
def _ready(config: dict, file: str | Path) -> Iterator[tuple[Rig, dict]]:
    """The rig, open, checked and off the skin, and what its robot is."""
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
    """Off the skin, where an earlier run left the probe on it: many load cells take their zero when
    their port is opened."""
    if not rig.hovers:
        did = rig.stop_and_retreat()
        if not rig.hovers:
            raise Stopped(f"the probe is on the skin; {'; '.join(did)}", FAULT)


def _drive(
    rig: Rig,
    todo: list[Contact],
    total: int,
    run: int,
    found: journal.Journal,
    writer: journal.Writer,
    mounted_mm: float | None,
    show: Callable[[dict], None],
) -> None:
    """Press after press; whatever ends it, the arm is stopped and lifted first, and what became of
    it is told."""
    began_s, probe_mm = time.monotonic(), mounted_mm
    cause: BaseException | None = None
    try:
        for done, contact in enumerate(todo):
            spent_s = time.monotonic() - began_s
            left_s = spent_s / done * (len(todo) - done) if done else None
            if contact.probe_mm != probe_mm:
                _change_probe(rig, contact.probe_mm)
                probe_mm = contact.probe_mm
                writer.append({"kind": "probe", "run": run, "probe_mm": probe_mm})
            attempt = found.attempts(contact.number)
            about = {"contact": contact.number, "attempt": attempt, "run": run}
            writer.append({"kind": "begin", **about, **_planned(contact), **_clocks()})

            def keep(frame: dict, about: dict = about) -> None:
                writer.append(*rig.take_rejects(), {"kind": "frame", **about, **frame})
                show({"frame": frame})

            number = total - len(todo) + done + 1
            show({"contact": contact, "number": number, "of": total, "left_s": left_s})
            end = press(rig, contact, keep, show)
            writer.append(*rig.take_rejects(), {"kind": "end", **about, "end": end, **_clocks()})
        _park(rig)
        writer.append({"kind": "done", "run": run, **_clocks()})
        return
    except _ProbeNeeded as needed:
        text = f"mount the probe of {needed.probe_mm:g} mm and go on, {_said(needed.probe_mm)}"
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
    last_N = rig.last_force_N
    did = rig.stop_and_retreat()
    text = f"{stopped}; {'; '.join(did)}"
    said = {"reason": reason, "message": text, "force_N": last_N}
    if cause is not None:
        said["traceback"] = "".join(traceback.format_exception(cause))
    try:
        writer.append(*rig.take_rejects(), {"kind": "stop", "run": run, **said, **_clocks()})
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
    """Above the centre, by the configuration's command; raises where a person must do it."""
    _park(rig)
    if rig.config["probe_change"] is None:
        raise _ProbeNeeded(probe_mm)
    command = [*rig.config["probe_change"], f"{probe_mm:g}"]
    try:
        begun = subprocess.Popen(command, stdin=subprocess.DEVNULL)
    except OSError as error:
        raise RobotError(f"{COMMAND_FAILED}: {error}") from error
    with begun as process:
        try:
            code = rig.watch(process.poll, PROBE_CHANGE_S, "the change of the probe")
        except BaseException:
            process.kill()
            raise
    if code != 0:
        raise RobotError(f"{COMMAND_FAILED}: {command} ended with {code}")


def _check_probe(config: dict, file: str | Path, first: Contact, mounted_mm: float | None) -> None:
    """Where a person changes probes, the one that the next contact needs must be said to be on."""
    if config["probe_change"] is None and mounted_mm != first.probe_mm:
        found = "none" if mounted_mm is None else f"{mounted_mm:g} mm"
        expected = (
            f"the probe of {first.probe_mm:g} mm: mount it and go on, {_said(first.probe_mm)}"
        )
        raise InputError(file, "mounted probe", found, expected)


def _said(probe_mm: float) -> str:
    """How a person says which probe is mounted."""
    told = f"`snakemake capture … --config mounted_mm={probe_mm:g}`"
    return f"{told} or `eitskin rig resume … --probe {probe_mm:g}`"


def _refuse(findings: list[preflight.Finding], file: str | Path) -> None:
    for finding in findings:
        if not finding.ok:
            raise InputError(file, finding.name, finding.text, "a rig that is ready")


@contextlib.contextmanager
def _signals(rig: Rig) -> Iterator[None]:
    """SIGINT, SIGTERM and SIGHUP are told to the rig; further ones change nothing."""

    def handle(number: int, _frame: object) -> None:
        rig.signal = rig.signal or number

    before = {number: signal.signal(number, handle) for number in SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _run_record(config: dict, run: int, identity: dict) -> dict:
    return {
        "kind": "run",
        "run": run,
        "robot": identity,
        **{key: config[key] for key in ("board", "load_cell", "session", "motion", "limits")},
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
