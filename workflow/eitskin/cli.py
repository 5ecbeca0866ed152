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
    checking.set_defaults(run=_check)
    importing = commands.add_parser("import", help="turn a recording into an eit-recording")
    importing.add_argument("file", help="a recording in any known format")
    importing.add_argument("out", help="the Parquet file to write")
    importing.add_argument("--format", help=formats)
    importing.set_defaults(run=_import)
    diagnosing = commands.add_parser(
        "diagnose", help="say what the simulation of a recording leaves out"
    )
    diagnosing.add_argument("file", help="a recording in any known format")
    diagnosing.add_argument("--query", help="states, a recording without voltages, to predict")
    diagnosing.add_argument("--out", help="the folder to write, by default diagnosis-NAME")
    diagnosing.add_argument("--format", help=formats)
    diagnosing.set_defaults(run=_diagnose)
    comparing = commands.add_parser(
        "compare", help="say what changed between two recordings of one skin"
    )
    comparing.add_argument("control", help="the earlier recording, in any known format")
    comparing.add_argument("later", help="the later one, read in the same way")
    comparing.add_argument("--out", help="the folder to write, by default comparison-A-vs-B")
    comparing.set_defaults(run=_compare)
    rig.add(commands)
    return parser


def _check(arguments: argparse.Namespace) -> int:
    result = check.check(importers.load(arguments.file, arguments.format))
    print(check.text(result), end="")
    return 0 if result.ok else UNUSABLE


def _import(arguments: argparse.Namespace) -> int:
    recording.write(importers.load(arguments.file, arguments.format), arguments.out)
    return 0


def _diagnose(arguments: argparse.Namespace) -> int:
    # seconds, which other commands spare
    from eitskin.diagnose import diagnosis, result, words
    from eitskin.diagnose.report import page

    recorded = importers.load(arguments.file, arguments.format)
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


def _compare(arguments: argparse.Namespace) -> int:
    from eitskin.diagnose.comparison import difference_words, result
    from eitskin.diagnose.report import comparison_page

    files = (arguments.control, arguments.later)
    names = tuple(Path(file).stem for file in files)
    if names[0] == names[1]:
        names = files
    recordings = (importers.load(file) for file in files)
    sentences, difference = difference_words.compared(*recordings, names)
    said = result.of_difference(list(names), sentences, difference)
    stems = "-vs-".join(Path(file).stem for file in files)
    folder = Path(arguments.out or f"comparison-{stems}")
    folder.mkdir(parents=True, exist_ok=True)
    result.write(said, folder / "comparison.json")
    comparison_page.write(said, folder / "comparison.html")
    print("\n".join([*sentences, str(folder / "comparison.html")]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
