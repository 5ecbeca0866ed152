"""`eitskin rig check | run | resume`."""

import argparse
import sys
from pathlib import Path

from eitskin.capture import configuration
from eitskin.quantities import plain

NOT_READY = 2  # exit code of a check that refuses
FOLDER = Path("captures")


def add(commands: argparse._SubParsersAction) -> None:
    """Add the command `rig` to those of `eitskin`."""
    rig = commands.add_parser("rig", help="capture with a robot, a load cell and an EIT board")
    subcommands = rig.add_subparsers(required=True, metavar="COMMAND")
    check_parser = subcommands.add_parser("check", help="look at every device; nothing moves")
    check_parser.add_argument("config", help="YAML with the mapping rig")
    check_parser.set_defaults(run=_check, usage=check_parser)
    for name, help_text in (
        ("run", "capture everything that the configuration plans"),
        ("resume", "go on at the first contact that is not finished"),
    ):
        capture_parser = subcommands.add_parser(name, help=help_text)
        capture_parser.add_argument("config", help="YAML with the mapping rig")
        capture_parser.add_argument("--journal", help=f"by default {FOLDER}/NAME.jsonl")
        capture_parser.add_argument(
            "--out", help=f"the recording, by default {FOLDER}/NAME.parquet"
        )
        capture_parser.add_argument(
            "--probe", type=float, help="diameter of the mounted probe in mm"
        )
        capture_parser.set_defaults(run=_capture, resume=name == "resume", usage=capture_parser)


def _check(arguments: argparse.Namespace) -> int:
    from eitskin.capture import preflight  # pyserial, which other commands do without

    findings = preflight.check(configuration.read(arguments.config))
    for finding in findings:
        print(plain(f"{'ok ' if finding.ok else 'NOT'} {finding.name}: {finding.text}"))
    return 0 if all(finding.ok for finding in findings) else NOT_READY


def _capture(arguments: argparse.Namespace) -> int:
    from eitskin.capture.run import capture_recording

    config = configuration.read(arguments.config)
    journal_path = Path(arguments.journal or FOLDER / f"{config['name']}.jsonl")
    recording_path = Path(arguments.out or FOLDER / f"{config['name']}.parquet")
    stopped = capture_recording(
        config,
        arguments.config,
        journal_path,
        arguments.resume,
        arguments.probe,
        (recording_path, recording_path.with_suffix(".manifest.json")),
    )
    if stopped is not None:
        print(plain(str(stopped)), file=sys.stderr)
        return stopped.code
    print(plain(str(recording_path)))
    return 0
