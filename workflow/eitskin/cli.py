"""The command `eitskin`."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from eitskin.capture import cli as rig
from eitskin.data import check, importers, recording
from eitskin.errors import InputError

UNUSABLE = 2
SCHEMA = Path(__file__).parents[1] / "schemas" / "diagnosis.schema.yaml"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; the exit code: 0, 1 for bad input or a file that cannot be read or written
    (one line on stderr), 2 for an unusable recording or a rig that is not ready; of a capture that
    ended early 3 where a person must change the probe, 4 after a fault, 128 + n after signal n.

    Wrong usage leaves through argparse, with its own message and code 2.
    """
    parsed = _parser().parse_args(arguments)
    try:
        return parsed.run(parsed)
    except InputError as error:
        print(error, file=sys.stderr)
    except OSError as error:
        print(f"{error.filename or 'eitskin'}: {error.strerror or error}", file=sys.stderr)
    return 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="eitskin", description="Recordings of EIT tactile skins.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    formats = f"by default told by its content; {', '.join(importers.known())}"
    checking = commands.add_parser("check", help="say what a recording holds and cannot tell")
    checking.add_argument("file", help="a recording in any known format")
    checking.add_argument("--format", help=formats)
    _add_protocol(checking)
    checking.set_defaults(run=_check)
    importing = commands.add_parser("import", help="turn a recording into an eit-recording")
    importing.add_argument("file", help="a recording in any known format")
    importing.add_argument("out", help="the Parquet file to write")
    importing.add_argument("--format", help=formats)
    _add_protocol(importing)
    importing.set_defaults(run=_import)
    diagnosing = commands.add_parser(
        "diagnose", help="say what the simulation of a recording leaves out"
    )
    diagnosing.add_argument("file", help="a recording in any known format")
    diagnosing.add_argument("--query", help="states, a recording without voltages, to predict")
    diagnosing.add_argument("--out", help="the folder to write, by default diagnosis-NAME")
    diagnosing.add_argument("--format", help=formats)
    _add_protocol(diagnosing)
    diagnosing.set_defaults(run=_diagnose)
    rig.add(commands)
    return parser


def _add_protocol(command: argparse.ArgumentParser) -> None:
    """What a file may not say of its own channels."""
    steps = "adjacent, opposite or skip-<n>"
    command.add_argument("--order", help="the order of the readings, as check names it")
    command.add_argument("--drive", help=f"the pairs that drive: {steps}")
    command.add_argument("--measure", help=f"the pairs measured: {steps}, or one with -reversed")


def _load(arguments: argparse.Namespace) -> recording.Recording:
    protocol = arguments.order, arguments.drive, arguments.measure
    return importers.load(arguments.file, arguments.format, *protocol)


def _check(arguments: argparse.Namespace) -> int:
    result = check.check(_load(arguments))
    print(check.text(result), end="")
    return 0 if result.ok else UNUSABLE


def _import(arguments: argparse.Namespace) -> int:
    recording.write(_load(arguments), arguments.out)
    return 0


def _diagnose(arguments: argparse.Namespace) -> int:
    # seconds, which other commands spare
    from eitskin.diagnose import diagnosis, result, words
    from eitskin.diagnose.report import page

    recorded = _load(arguments)
    if arguments.query is not None:
        result.read_query(arguments.query, recorded)
    name = Path(arguments.file).stem
    folder = Path(arguments.out or f"diagnosis-{name}")
    folder.mkdir(parents=True, exist_ok=True)
    source = folder / "recording.parquet"
    recording.write(recorded, source)
    found = diagnosis.diagnose(recorded, progress=True)
    result.write(found, name, folder, SCHEMA, arguments.query)
    predicted = folder / "predicted.parquet"
    if arguments.query is None:
        predicted.unlink(missing_ok=True)  # an earlier query's
        predicted = None
    page.write(folder, source, SCHEMA, folder / "report.html", predicted)
    said = result.result(found, name)
    print(words.headline(said))
    for effect in said["effects"]:
        print(effect["sentence"])
    if said["other"]["sentence"]:
        print(f"What has no name: {said['other']['sentence']}")
    print(folder / "report.html")
    return 0


if __name__ == "__main__":
    sys.exit(main())
