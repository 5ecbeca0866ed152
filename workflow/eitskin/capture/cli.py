"""`eitskin rig check | run | resume`."""

import argparse
import sys
from pathlib import Path

from eitskin.capture import configuration

NOT_READY = 2
FOLDER = Path("captures")


def add(commands: argparse._SubParsersAction) -> None:
    """Add the command `rig` to those of `eitskin`."""
    rig = commands.add_parser("rig", help="capture with a robot, a load cell and an EIT board")
    doing = rig.add_subparsers(required=True, metavar="COMMAND")
    checking = doing.add_parser("check", help="look at every device; nothing moves")
    checking.add_argument("config", help="YAML with the mapping rig")
    checking.set_defaults(run=_check, usage=checking)
    for name, what in (
        ("run", "capture everything that the configuration plans"),
        ("resume", "go on at the first contact that is not finished"),
    ):
        capturing = doing.add_parser(name, help=what)
        capturing.add_argument("config", help="YAML with the mapping rig")
        capturing.add_argument("--journal", help=f"by default {FOLDER}/NAME.jsonl")
        capturing.add_argument("--out", help=f"the recording, by default {FOLDER}/NAME.parquet")
        capturing.add_argument("--probe", type=float, help="diameter of the mounted probe in mm")
        capturing.set_defaults(run=_capture, resume=name == "resume", usage=capturing)


def _check(arguments: argparse.Namespace) -> int:
    from eitskin.capture import preflight  # pyserial, which other commands do without

    findings = preflight.check(configuration.read(arguments.config))
    for finding in findings:
        print(f"{'ok ' if finding.ok else 'NOT'} {finding.name}: {finding.text}")
    return 0 if all(finding.ok for finding in findings) else NOT_READY


def _capture(arguments: argparse.Namespace) -> int:
    from eitskin.capture.captured import capture_recording

    config = configuration.read(arguments.config)
    journal = Path(arguments.journal or FOLDER / f"{config['name']}.jsonl")
    out = Path(arguments.out or FOLDER / f"{config['name']}.parquet")
    stopped = capture_recording(
        config,
        arguments.config,
        journal,
        arguments.resume,
        arguments.probe,
        (out, out.with_suffix(".manifest.json")),
    )
    if stopped is not None:
        print(stopped, file=sys.stderr)
        return stopped.code
    print(out)
    return 0
