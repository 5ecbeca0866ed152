"""The command `eitskin`."""

import argparse
import contextlib
import os
import sys
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from eitskin import answers
from eitskin.atomic import held_folder
from eitskin.capture import cli as rig
from eitskin.data import check, importers, recording, stated
from eitskin.data.recording import Recording
from eitskin.errors import InputError, named, refused

REFUSED, UNUSABLE, INTERRUPTED = 1, 2, 130
SCHEMA = Path(__file__).parents[1] / "schemas" / "diagnosis.schema.yaml"
EXIT_CODES = """\
exit codes:
  0      done
  1      bad input, or a file that cannot be read or written: one line on stderr
  2      wrong usage, a recording that is not usable, or a rig that is not ready
  3      a capture that waits for another probe
  4      a capture that ended after a fault
  128+n  ended by signal n: 130 after Ctrl-C, 141 where nobody reads the output
"""
EXAMPLES = {
    "check": """\
examples:
  eitskin check skin.parquet
  eitskin check frames.csv --drive adjacent --measure adjacent
  eitskin check tank.mat --skin tank.yaml --json | jq .usable
""",
    "import": """\
examples:
  eitskin import setup_00001.eit skin.parquet
  eitskin import frames.csv skin.parquet --skin skin.yaml
""",
    "diagnose": """\
examples:
  eitskin diagnose skin.parquet
  eitskin diagnose skin.parquet --skin skin.yaml --out monday
  eitskin diagnose skin.parquet --query elsewhere.parquet --json > monday.json
""",
    "compare": """\
examples:
  eitskin compare monday.parquet friday.parquet
  eitskin compare tank.csv tank.csv --part target --out objects
""",
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; the exit code, one of EXIT_CODES.

    What is refused is one line on stderr; with --json an object on stdout says it as well. Wrong
    usage leaves through argparse, with its own message.
    """
    parsed = _parser().parse_args(arguments)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")  # a file's name need be no text
    try:
        code = parsed.run(parsed)
        sys.stdout.flush()
        return code
    except InputError as error:
        refusal = error
    except BrokenPipeError:
        _let_go_of_stdout()
        return 141
    except OSError as error:
        refusal = refused(error, error.filename or "standard output")
        if not error.filename:
            _let_go_of_stdout()
    except MemoryError as error:
        expected = "a smaller recording, or a larger machine"
        refusal = InputError("eitskin", "memory", str(error) or "none left", expected)
    except KeyboardInterrupt:
        print("eitskin: interrupted", file=sys.stderr)
        return INTERRUPTED
    print(refusal, file=sys.stderr)
    if getattr(parsed, "json", False):
        with contextlib.suppress(OSError):
            answers.write(answers.refusal(refusal))
    return REFUSED


def _let_go_of_stdout() -> None:
    """What is left to write goes nowhere, else Python would try again at its end."""
    with contextlib.suppress(OSError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)


def _parser() -> argparse.ArgumentParser:
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(
        prog="eitskin",
        description="Diagnoses of EIT tactile skins, and the recordings that they are made from.",
        epilog=EXIT_CODES,
        formatter_class=plain,
    )
    parser.add_argument("--version", action="version", version=f"eitskin {version('eitskin')}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    def command(name: str, run: object, what: str) -> argparse.ArgumentParser:
        added = commands.add_parser(
            name, help=what, description=what, epilog=EXAMPLES[name], formatter_class=plain
        )
        added.add_argument("--json", action="store_true", help="the answer as one JSON document")
        added.set_defaults(run=run)
        return added

    checking = command("check", _check, "say what a recording holds and cannot tell")
    _add_source(checking)
    importing = command("import", _import, "turn a recording into an eit-recording")
    _add_source(importing)
    importing.add_argument("out", help="the Parquet file to write")
    _add_anyway(importing)
    diagnosing = command("diagnose", _diagnose, "say what the simulation of a recording leaves out")
    _add_source(diagnosing)
    diagnosing.add_argument("--query", help="states, a recording without voltages, to predict")
    diagnosing.add_argument("--out", help="the folder to write, by default diagnosis-NAME")
    _add_anyway(diagnosing)
    comparing = command("compare", _compare, "say what changed between two recordings of one skin")
    comparing.add_argument("control", help="the earlier recording, in any known format")
    comparing.add_argument("later", help="the later one, read in the same way")
    _add_reading(comparing)
    part = "of LATER, frames otherwise left out: target (pyeidors-tank), v_rotate:K (iirc-tank)"
    comparing.add_argument("--part", help=part)
    comparing.add_argument("--out", help="the folder to write, by default comparison-A-vs-B")
    rig.add(commands)
    return parser


def _add_source(command: argparse.ArgumentParser) -> None:
    """The recording that a command reads."""
    command.add_argument("file", help="a recording in any known format")
    _add_reading(command)


def _add_reading(command: argparse.ArgumentParser) -> None:
    """What a file may not say of its own format, channels and skin."""
    formats = f"by default told by its content; {', '.join(importers.known())}"
    command.add_argument("--format", help=formats)
    steps = "adjacent, opposite or skip-<n>"
    command.add_argument("--order", help="the order of the readings, as check names it")
    command.add_argument("--drive", help=f"the pairs that drive: {steps}")
    command.add_argument("--measure", help=f"the pairs measured: {steps}, or one with -reversed")
    command.add_argument("--skin", help="YAML: what you know of the skin beside what the file says")


def _add_anyway(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--anyway", action="store_true", help="go on with what the check calls unusable"
    )


def _load(file: str, arguments: argparse.Namespace, part: str | None = None) -> Recording:
    """A recording, with what its owner states of its channels and of the skin."""
    protocol = arguments.order, arguments.drive, arguments.measure
    said = {} if arguments.skin is None else stated.read(arguments.skin)
    loaded = importers.load(file, arguments.format, *protocol, part)
    return stated.apply(said, loaded, arguments.skin)


def _checked(recorded: Recording, arguments: argparse.Namespace) -> check.Check | None:
    """The check of a recording that one may go on with; else None, and its reasons on stderr."""
    result = check.check(recorded, progress=True)
    if result.ok or arguments.anyway:
        return result
    for finding in result.of(check.ERROR):
        print(f"{arguments.file}: {finding.topic}: {finding.sentence}", file=sys.stderr)
    print("Not usable as it stands; --anyway goes on all the same.", file=sys.stderr)
    if arguments.json:
        answers.write(answers.checked(result, arguments.file))
    return None


def _check(arguments: argparse.Namespace) -> int:
    result = check.check(_load(arguments.file, arguments), progress=True)
    if arguments.json:
        answers.write(answers.checked(result, arguments.file))
    else:
        print(check.text(result), end="")
    return 0 if result.ok else UNUSABLE


def _import(arguments: argparse.Namespace) -> int:
    recorded = _load(arguments.file, arguments)
    result = _checked(recorded, arguments)
    if result is None:
        return UNUSABLE
    recording.write(recorded, arguments.out)
    if arguments.json:
        answers.write(answers.checked(result, arguments.file) | {"out": arguments.out})
    return 0


def _diagnose(arguments: argparse.Namespace) -> int:
    # seconds, which other commands spare
    from eitskin.diagnose import diagnosis, result, words
    from eitskin.diagnose.report import page

    recorded = _load(arguments.file, arguments)
    if arguments.query is not None:
        result.read_query(arguments.query, recorded)
    checked = _checked(recorded, arguments)
    if checked is None:
        return UNUSABLE
    beside = sys.stderr if arguments.json else sys.stdout
    for finding in (*checked.about("skin"), *checked.of(check.WARNING), *checked.of(check.ERROR)):
        print(f"{finding.topic}: {finding.sentence}", file=beside, flush=True)
    name = answers.name(arguments.file)
    with held_folder(arguments.out or f"diagnosis-{name}") as folder, named(arguments.file):
        report, source = folder / "report.html", folder / "recording.parquet"
        predicted = folder / "predicted.parquet"
        for earlier in (report, folder / "diagnosis.json", predicted):
            earlier.unlink(missing_ok=True)  # what is not whole has no answer
        recording.write(recorded, source)
        found = diagnosis.diagnose(recorded, progress=True)
        result.write(found, name, folder, SCHEMA, arguments.query)
        page.write(folder, source, SCHEMA, report, None if arguments.query is None else predicted)
    said = result.result(found, name)
    if arguments.json:
        answers.write(said | {"report": str(report)})
        return 0
    print(words.headline(said))
    for effect in said["effects"]:
        print(effect["sentence"])
    if said["other"]["sentence"]:
        print(f"What has no name: {said['other']['sentence']}")
    print(report)
    return 0


def _compare(arguments: argparse.Namespace) -> int:
    from eitskin.diagnose.comparison import difference_words, result
    from eitskin.diagnose.report import comparison_page

    files = (arguments.control, arguments.later)
    names = tuple(map(answers.name, files))
    if arguments.part is not None:
        names = (names[0], f"{names[1]}, {arguments.part}")
    elif names[0] == names[1]:
        names = files
    parts = None, arguments.part
    recordings = (_load(file, arguments, part) for file, part in zip(files, parts, strict=True))
    with named(" and ".join(files)):
        sentences, difference = difference_words.compared(*recordings, names)
    said = result.of_difference(list(names), sentences, difference)
    stems = "-vs-".join(map(answers.name, files))
    with held_folder(arguments.out or f"comparison-{stems}") as folder:
        report = folder / "comparison.html"
        report.unlink(missing_ok=True)
        result.write(said, folder / "comparison.json")
        comparison_page.write(said, report)
    if arguments.json:
        answers.write(said | {"report": str(report)})
    else:
        print("\n".join([*sentences, str(report)]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
