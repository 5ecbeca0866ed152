"""The command `eitskin`."""

import argparse
import contextlib
import json
import os
import re
import shlex
import sys
from collections.abc import Sequence
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import TextIO

import shtab
from threadpoolctl import threadpool_limits

from eitskin import answers
from eitskin.atomic import held_folder
from eitskin.capture import cli as rig
from eitskin.data import check, importers, recording
from eitskin.data.reading import read
from eitskin.data.recording import Recording
from eitskin.diagnose.fitting.excerpt import LIMIT_GIB
from eitskin.errors import InputError, named, printable, refused
from eitskin.physics.outline import EXPECTED, not_simulated
from eitskin.quantities import listed, plain
from eitskin.stream import cli as streaming

REFUSED, UNUSABLE, INTERRUPTED = 1, 2, 130
TABLE_TOPICS = ("order", "polarity", "numbering")  # of the check: errors of the channel table
EXIT_CODES = """\
exit codes:
  0      done
  1      bad input, or a file that cannot be read or written: one line on stderr
  2      wrong usage, a recording that is not usable, or a rig that is not ready
  3      a capture that waits for another probe
  4      a capture or a stream that ended after a fault
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
  eitskin diagnose tank.csv --part target
  eitskin diagnose skin.parquet --query elsewhere.parquet --json > monday.json
  eitskin diagnose longer.parquet --earlier monday/effects.yaml
""",
    "explain": """\
examples:
  eitskin explain monday
  eitskin explain monday contact-impedance
""",
    "why": """\
examples:
  eitskin why results/tables/table_1.md
  eitskin why results/datasets/simulated-authors.parquet --json | jq '.steps[].changed'
""",
    "compare": """\
examples:
  eitskin compare monday.parquet friday.parquet
  eitskin compare tank.csv tank.csv --part target --out objects
  eitskin compare day.csv day.csv --control-frames 0:99 --later-frames 100:240
""",
    "skin": """\
examples:
  eitskin skin skin.yaml --drive adjacent --view
  eitskin skin skin.dxf > skin.yaml
  eitskin skin outline.svg --unit px:0.2646 --out understood.svg
  eitskin skin frames.csv --drive adjacent --measure adjacent --skin skin.yaml
""",
    "train": """\
examples:
  eitskin train monday
  eitskin train monday --target tuesday.parquet --perturbations config.yaml
  eitskin stream tuesday.parquet --model monday/estimator/estimator.npz
""",
    "stream": """\
examples:
  eitskin stream /dev/ttyACM1 --model mlp.npz
  eitskin stream /dev/ttyACM1 --model mlp.npz --json --out monday.parquet | robot
  eitskin stream monday.parquet --model mlp.npz --fast
  eitskin stream monday.parquet --model mlp.npz --view
""",
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns its exit code, one of EXIT_CODES.

    A refusal is one line on stderr, and with --json also an object on stdout. Wrong usage exits
    through argparse, with its own message.
    """
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")  # a file's name need be no text
    parsed = None
    try:
        parsed, unknown = _parser().parse_known_args(arguments)
        if unknown:
            parsed.usage.error(printable(f"unrecognized arguments: {' '.join(unknown)}"))
        # Products are small: shared out among cores by BLAS they take twice as long.
        with threadpool_limits(limits=1, user_api="blas"):
            code = parsed.run(parsed)
        sys.stdout.flush()
        return code
    except InputError as error:
        refusal = error
    except BrokenPipeError:
        _discard_stdout()
        return 141
    except OSError as error:
        refusal = refused(error, error.filename or "standard output")
        if not error.filename:
            _discard_stdout()
    except MemoryError as error:
        expected = "a smaller recording, or a larger machine"
        refusal = InputError("eitskin", "memory", str(error) or "none left", expected)
    except KeyboardInterrupt:
        print("eitskin: interrupted", file=sys.stderr)
        return INTERRUPTED
    print(refusal, file=sys.stderr)
    if parsed is not None and getattr(parsed, "json", False):
        with contextlib.suppress(OSError):
            answers.write(answers.refusal(refusal), parsed.run is streaming.stream)
    return REFUSED


def _discard_stdout() -> None:
    """Redirect stdout to the null device, as Python would try to flush the rest again on exit."""
    with contextlib.suppress(OSError):
        null_device = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null_device, sys.stdout.fileno())
        os.close(null_device)


def _parser() -> argparse.ArgumentParser:
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(
        prog="eitskin",
        description="Diagnoses of EIT tactile skins, and the recordings that they are made from.",
        epilog=EXIT_CODES,
        formatter_class=plain,
    )
    parser.add_argument("--version", action="version", version=f"eitskin {version('eitskin')}")
    words = "what a shell completes commands, options and files by"
    shtab.add_argument_to(parser, "--print-completion", help=words)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    def command(name: str, run: object, purpose: str) -> argparse.ArgumentParser:
        added = commands.add_parser(
            name, help=purpose, description=purpose, epilog=EXAMPLES[name], formatter_class=plain
        )
        document = "a JSON object a line" if name == "stream" else "the answer as one JSON document"
        added.add_argument("--json", action="store_true", help=document)
        added.set_defaults(run=run, usage=added)
        return added

    checking = command("check", _check, "say what a recording holds and cannot tell")
    _add_source(checking)
    importing = command("import", _import, "turn a recording into an eit-recording")
    _add_source(importing)
    _add_path(importing, "out", "the Parquet file to write")
    _add_anyway_flag(importing)
    diagnosing = command("diagnose", _diagnose, "say what the simulation of a recording leaves out")
    _add_source(diagnosing)
    _add_path(diagnosing, "--query", "states, a recording without voltages, to predict")
    _add_path(diagnosing, "--out", "the folder to write, by default diagnosis-NAME", shtab.DIR)
    diagnosing.add_argument(
        "--memory",
        type=float,
        default=LIMIT_GIB,
        metavar="GIB",
        help="what it may take, by default %(default)s GiB: as many frames as fit are diagnosed",
    )
    words = "the effects.yaml of an earlier diagnosis: what it found is tried first"
    _add_path(diagnosing, "--earlier", words)
    _add_anyway_flag(diagnosing)
    words = "say why a diagnosis does not name an effect: the rule at which it stopped"
    explaining = command("explain", _explain, words)
    _add_path(explaining, "folder", "the folder of a diagnosis", shtab.DIR)
    words = "an effect of the catalogue, by default each of them"
    explaining.add_argument("name", nargs="?", help=words)
    words = "say what made a product of the workflow, from what, and what has changed since"
    _add_path(command("why", _why, words), "file", "a file of results/")
    comparing = command("compare", _compare, "say what changed between two recordings of one skin")
    _add_path(comparing, "control", "the earlier recording, in any known format")
    _add_path(comparing, "later", "the later one, read in the same way")
    _add_reading(comparing)
    _add_part(comparing, "of LATER, ")
    _add_frames(comparing, "--control-frames", "of CONTROL, these frames alone")
    _add_frames(comparing, "--later-frames", "of LATER, or its part, these alone")
    _add_path(comparing, "--out", "the folder to write, by default comparison-A-vs-B", shtab.DIR)
    _add_anyway_flag(comparing)
    words = "draw what a drawing, a statement or a recording says of a skin, before any simulation"
    drawing = command("skin", _skin, words)
    _add_path(drawing, "file", "a drawing (SVG, DXF), a statement (YAML), or a recording")
    _add_reading(drawing)
    words = "of a drawing: what its unit is; mm, cm, in, or px:0.2646 for mm a pixel"
    drawing.add_argument("--unit", type=_unit_mm, metavar="UNIT", help=words)
    words = "of a drawing: it shows the side that is not touched"
    drawing.add_argument("--mirrored", action="store_true", help=words)
    _add_path(drawing, "--out", "the SVG file to write, by default skin-NAME.svg")
    drawing.add_argument("--view", action="store_true", help="open it in a browser")
    words = "train an estimator of touches on the corrected simulator of a diagnosis"
    training = command("train", _train, words)
    _add_path(training, "folder", "what eitskin diagnose wrote", shtab.DIR)
    _add_path(training, "--out", "the folder to write, by default FOLDER/estimator", shtab.DIR)
    _add_path(training, "--target", "another recording of the skin, whose labels test it")
    purpose = "a configuration with the perturbations of `authors`, for a row beside"
    _add_path(training, "--perturbations", purpose)
    training.add_argument("--samples", type=int, help="of a training set, by default 20000")
    training.add_argument("--epochs", type=int, help="of a training, by default 40")
    training.add_argument("--seeds", type=int, help="of the weights, by default 3")
    words = "say of every frame whether the skin is touched, where and how hard"
    following = command("stream", streaming.stream, words)
    _add_path(following, "source", "a board's serial port, or a recording in any known format")
    _add_path(following, "--model", "an exported predictor").required = True
    _add_path(following, "--out", "the recording to write, its states as estimated")
    streaming.add(following)
    parser.set_defaults(usage=parser)
    rig.add(commands)
    return parser


def _add_path(
    command: argparse.ArgumentParser,
    name: str,
    purpose: str,
    kind: dict = shtab.FILE,
) -> argparse.Action:
    """A path of a kind that a shell completes."""
    action = command.add_argument(name, help=purpose)
    action.complete = kind  # type: ignore[attr-defined]  # shtab's, which argparse's stubs lack
    return action


def _add_source(command: argparse.ArgumentParser) -> None:
    """The recording that a command reads."""
    _add_path(command, "file", "a recording in any known format")
    _add_reading(command)
    _add_part(command, "")
    _add_frames(command, "--frames", "of these frames alone")


def _add_part(command: argparse.ArgumentParser, whose: str) -> None:
    """Frames that a format leaves out unless they are asked for."""
    words = "frames otherwise left out, read as untouched: target (pyeidors-tank), v_rotate:K"
    command.add_argument("--part", help=f"{whose}{words} (iirc-tank)")


def _add_frames(command: argparse.ArgumentParser, name: str, purpose: str) -> None:
    """A stretch of a recording."""
    purpose += ", numbered from 0 as in the file, both counted"
    command.add_argument(name, type=_stretch, metavar="FIRST:LAST", help=purpose)


def _add_reading(command: argparse.ArgumentParser) -> None:
    """Options for the format, channels and skin of a file."""
    formats = f"by default told by its content; {', '.join(importers.format_names())}"
    command.add_argument("--format", help=formats)
    steps = "adjacent, opposite or skip-<n>"
    command.add_argument("--order", help="the order of the readings, as check names it")
    command.add_argument("--drive", help=f"the pairs that drive: {steps}")
    command.add_argument("--measure", help=f"the pairs measured: {steps}, or one with -reversed")
    command.add_argument("--array", help="of several arrays in a file, the one with the readings")
    words = "of several frequencies, the one to read"
    command.add_argument("--frequency", type=float, metavar="HZ", help=words)
    _add_path(command, "--skin", "YAML: what you know of the skin beside what the file says")


def _add_anyway_flag(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--anyway", action="store_true", help="go on with what the check calls unusable"
    )


def _load(
    file: str,
    arguments: argparse.Namespace,
    frames: tuple[int, int] | None,
    part: str | None = None,
) -> Recording:
    """A recording, or a stretch of it, with its owner's statements about channels and skin."""
    keys = ("format", "order", "drive", "measure", "array", "frequency")
    settings = {key: getattr(arguments, key) for key in keys}
    return read(file, arguments.skin, frames, part=part, **settings)


def _stem(file: str, frames: tuple[int, int] | None, part: str | None = None) -> str:
    """Part of the default name of a folder: the name of a recording, or of a part or a stretch of
    it."""
    name = answers.name(file) if part is None else f"{answers.name(file)}-{part.replace(':', '-')}"
    return name if frames is None else "{}-frames-{}-{}".format(name, *frames)


def _unit_mm(text: str) -> float:
    """How many mm are in a unit: mm, cm, in, or px:NUMBER."""
    pixel = re.fullmatch(r"px:(\d+\.?\d*|\.\d+)", text)
    unit_mm = {"mm": 1.0, "cm": 10.0, "in": 25.4}.get(text, float(pixel[1]) if pixel else 0.0)
    if not unit_mm > 0:
        expected = "mm, cm, in, or px: and the mm of a pixel, such as px:0.2646"
        raise argparse.ArgumentTypeError(f"found {text!r}, expected {expected}")
    return unit_mm


def _stretch(text: str) -> tuple[int, int]:
    """The first and the last frame of FIRST:LAST."""
    numbers = re.fullmatch(r"(\d+):(\d+)", text)
    if numbers is None:
        raise argparse.ArgumentTypeError(f"found {text!r}, expected FIRST:LAST, such as 0:99")
    return int(numbers[1]), int(numbers[2])


def _source(arguments: argparse.Namespace) -> Recording:
    """The command's recording, or the requested stretch of it."""
    return _load(arguments.file, arguments, arguments.frames, arguments.part)


def _checked(
    recorded: Recording,
    arguments: argparse.Namespace,
    file: str | None = None,
    topics: Sequence[str] | None = None,
) -> check.Check | None:
    """The check of a recording if the command may go on with it; else None, with the reasons on
    stderr. topics: the topics whose errors count; by default all."""
    file = arguments.file if file is None else file
    full_check = check.check(recorded, progress=True)
    errors = [
        finding
        for finding in full_check.of_severity(check.ERROR)
        if topics is None or finding.topic in topics
    ]
    if not errors or arguments.anyway:
        return full_check
    for finding in errors:
        _say(f"{file}: {finding.topic}: {finding.sentence}", sys.stderr)
    print("Not usable as it stands; --anyway goes on all the same.", file=sys.stderr)
    if arguments.json:
        answers.write(answers.checked(full_check, file))
    return None


def _say(text: str, stream: TextIO | None = None) -> None:
    """Print sentences or a path, by default on stdout, as `plain` has them."""
    print(plain(text), file=stream, flush=True)


def _print_step_commands(checked: check.Check, count: int, arguments: argparse.Namespace) -> None:
    """For a recording of `count` frames with steps, print the commands that diagnose its parts, of
    many the longest."""
    start = arguments.frames[0] if arguments.frames else 0
    frames = [finding.frame for finding in checked.of_topic("step") if finding.frame is not None]
    steps = sorted(start + frame for frame in frames)
    stretches = [item.stretch for item in checked.findings if item.stretch is not None]
    if not steps and not stretches:
        return
    argument_values = vars(arguments)
    options = ("format", "order", "drive", "measure", "array", "frequency", "part", "skin", "query")
    option_values = [
        (f"--{key}", str(argument_values[key]))
        for key in options
        if argument_values.get(key) is not None
    ]
    command = [
        "eitskin",
        "diagnose",
        arguments.file,
        *(word for pair in option_values for word in pair),
    ]
    sentence = (
        f"A step at frame {steps[0]}" if len(steps) == 1 else f"Steps at frames {listed(steps)}"
    )
    sentence += ": what lies before and after is diagnosed apart. A report of each:"
    parts = list(pairwise([start, *steps, start + count]))
    if stretches:
        sentence = "A report of the longest part without a step:"
        parts = [(start + first, start + last + 1) for first, last in stretches]
    _say(sentence)
    for first_frame, end_frame in parts:
        _say(f"  {shlex.join([*command, '--frames', f'{first_frame}:{end_frame - 1}'])}")


def _print_before(checked: check.Check, count: int, arguments: argparse.Namespace) -> None:
    """Print the remarks that precede the diagnosis of a recording of `count` frames."""
    if arguments.frames is not None:
        print(
            "frames: {} to {} of the file, from here on numbered from 0.".format(*arguments.frames)
        )
    for finding in (
        *checked.of_topic("skin"),
        *checked.of_severity(check.WARNING),
        *checked.of_severity(check.ERROR),
    ):
        _say(f"{finding.topic}: {finding.sentence}")
    _print_step_commands(checked, count, arguments)


def _not_simulated(recorded: Recording, arguments: argparse.Namespace) -> bool:
    """Whether the outline or the electrodes of a skin rule out its simulation; a line on stderr
    says so."""
    refusal = not_simulated(recorded.skin)
    if refusal is not None:
        error = InputError(arguments.skin or arguments.file, *refusal, EXPECTED)
        print(error, file=sys.stderr)
        if arguments.json:
            answers.write(answers.refusal(error))
    return refusal is not None


def _check(arguments: argparse.Namespace) -> int:
    recorded = _source(arguments)
    full_check = check.check(recorded, progress=True)
    if arguments.json:
        answers.write(answers.checked(full_check, arguments.file))
    else:
        print(check.text(full_check), end="")
        _print_step_commands(full_check, len(recorded.frames), arguments)
    return 0 if full_check.ok else UNUSABLE


def _import(arguments: argparse.Namespace) -> int:
    recorded = _source(arguments)
    full_check = _checked(recorded, arguments)
    if full_check is None:
        return UNUSABLE
    if not arguments.anyway and _not_simulated(recorded, arguments):
        return UNUSABLE
    recording.write(recorded, arguments.out)
    if arguments.json:
        answers.write(answers.checked(full_check, arguments.file) | {"out": arguments.out})
        return 0
    extent = (*full_check.of_topic("frames"), *full_check.of_topic("channels"))
    for finding in (
        *extent,
        *full_check.of_severity(check.WARNING),
        *full_check.of_severity(check.ERROR),
    ):
        _say(f"{finding.topic}: {finding.sentence}")
    _say(arguments.out)
    return 0


def _diagnose(arguments: argparse.Namespace) -> int:
    # seconds, which other commands spare
    from eitskin import answer_folder
    from eitskin.diagnose import parts
    from eitskin.diagnose.fitting import memory
    from eitskin.diagnose.search import starting_point
    from eitskin.diagnose.verdict import words
    from eitskin.diagnose.verdict.record import read_query, record

    recorded = _source(arguments)
    recording.voltages(recorded, arguments.file)
    query = None if arguments.query is None else read_query(arguments.query, recorded)
    earlier = None
    if arguments.earlier is not None:
        earlier = starting_point.read(arguments.earlier, recorded.channels)
    name = _stem(arguments.file, arguments.frames, arguments.part)
    folder_path = Path(arguments.out or f"diagnosis-{name}")
    if folder_path.is_dir():
        with held_folder(folder_path):
            answer_folder.forget(folder_path)
    if _not_simulated(recorded, arguments):
        return UNUSABLE
    memory.frame_limit(recorded, arguments.memory, arguments.file)
    full_check = _checked(recorded, arguments)
    if full_check is None:
        return UNUSABLE
    with contextlib.redirect_stdout(sys.stderr if arguments.json else sys.stdout):
        _print_before(full_check, len(recorded.frames), arguments)
    with held_folder(folder_path) as folder, named(arguments.file):
        answer_folder.begin(folder, recorded)
        diagnosis = parts.diagnose(
            recorded, progress=True, memory_GiB=arguments.memory, earlier=earlier
        )
        answered = record(diagnosis, name, query)
        if not arguments.json:
            for sentence in words.all_sentences(answered.document):
                _say(sentence)
            sys.stdout.flush()
        report = answer_folder.finish(folder, answered, arguments.query)
    if arguments.json:
        answers.write(answered.document | {"report": str(report)})
    else:
        _say(str(report))
    return 0


def _explain(arguments: argparse.Namespace) -> int:
    from eitskin.diagnose.verdict import refusals

    folder = Path(arguments.folder)
    document, decisions = refusals.read(folder)
    sentences = refusals.sentences(decisions, document, arguments.name)
    if arguments.json:
        answers.write({"folder": str(folder), "sentences": sentences})
        return 0
    for sentence in sentences:
        _say(sentence)
    return 0


def _skin(arguments: argparse.Namespace) -> int:
    import yaml

    from eitskin.atomic import atomic_path
    from eitskin.drawing import picture, source

    file = arguments.file
    kind = source.kind(file)
    keys = ("format", "order", "drive", "measure", "array", "frequency")
    settings = {key: getattr(arguments, key) for key in keys}
    stated_options = {key for key, value in settings.items() if value is not None}
    stated_options |= {key for key in ("skin", "unit", "mirrored") if getattr(arguments, key)}
    allowed = {
        "drawing": {"drive", "unit", "mirrored"},
        "statement": {"drive"},
        "recording": {*keys, "skin"},
    }
    for key in sorted(stated_options - allowed[kind]):
        arguments.usage.error(f"--{key} says nothing of a {kind}")
    with named(file):
        if kind == "drawing":
            drawn = source.drawing(file, arguments.unit, arguments.mirrored, arguments.drive)
        elif kind == "statement":
            drawn = source.statement(file, arguments.drive)
        else:
            drawn = source.recording(file, arguments.skin, settings)
        out = Path(arguments.out or f"skin-{answers.name(file)}.svg")
        if out.resolve() == Path(file).resolve():
            raise InputError(file, "--out", "the file that is read", "another")
        title = answers.name(file)
        svg = picture.picture(drawn.skin, drawn.drives, drawn.n_electrodes, title)
    with atomic_path(out) as path:
        path.write_text(svg, encoding="utf-8")
    if arguments.json:
        answers.write(
            {
                "format": "eit-skin",
                "version": answers.VERSION,
                "file": file,
                "out": str(out),
                "skin": drawn.block,
                "drives": drawn.drives.tolist(),
                "sentences": list(drawn.sentences),
            }
        )
    else:
        for sentence in (*drawn.sentences, f"Drawn in {out}."):
            _say(f"# {sentence}")
        _say(
            yaml.safe_dump(
                {"skin": drawn.block}, sort_keys=False, default_flow_style=None, width=98
            ).rstrip()
        )
    if arguments.view:
        import webbrowser

        webbrowser.open(out.resolve().as_uri())
    return 0


def _train(arguments: argparse.Namespace) -> int:
    try:
        from eitskin.estimators import training
    except ModuleNotFoundError as error:
        expected = "it: pip install '.[workflow]'"
        raise InputError("eitskin train", f"module {error.name}", "none", expected) from error
    from eitskin.configuration import perturbations

    target = None if arguments.target is None else read(arguments.target)
    effects = None if arguments.perturbations is None else perturbations(arguments.perturbations)
    keys = ("samples", "epochs", "seeds")
    stated_values = {key: getattr(arguments, key) for key in keys}
    plan = training.Plan(**{k: v for k, v in stated_values.items() if v is not None})
    with named(arguments.folder):
        estimator = training.trained(arguments.folder, target, effects, plan)
    paths = estimator.write(arguments.out or Path(arguments.folder) / "estimator")
    if arguments.json:
        card = json.loads(estimator.card.to_json(orient="records"))
        answers.write({"format": "eit-estimator", "files": list(map(str, paths)), "card": card})
        return 0
    for line in (*training.sentences(estimator.card), *map(str, paths)):
        _say(line)
    return 0


def _why(arguments: argparse.Namespace) -> int:
    from eitskin import why

    steps = why.chain(arguments.file)
    if arguments.json:
        answers.write({"file": arguments.file, "steps": steps})
        return 0
    for step in steps:
        space = "  " * step["depth"]
        _say(f"{space}{step['product']}")
        if "rule" in step:
            values = [f"{key} {json.dumps(value)}" for key, value in step["parameters"].items()]
            _say(f"{space}  made by {step['rule']}: {', '.join(values) or 'no parameters'}")
        for sentence in step["changed"]:
            _say(f"{space}  changed since: {sentence}")
    return 0


def _titles(
    files: tuple[str, str], stretches: tuple[tuple[int, int] | None, ...], part: str | None
) -> tuple[str, str]:
    """Titles of two recordings: their names and what is read of them; their paths where the
    names agree."""

    def title_pair(control_name: str, later_name: str) -> tuple[str, str]:
        control_title, later_title = (
            name if stretch is None else "{}, frames {} to {}".format(name, *stretch)
            for name, stretch in zip((control_name, later_name), stretches, strict=True)
        )
        return control_title, later_title if part is None else f"{later_title}, {part}"

    names = title_pair(answers.name(files[0]), answers.name(files[1]))
    return title_pair(*files) if names[0] == names[1] else names


def _compare(arguments: argparse.Namespace) -> int:
    from eitskin.diagnose.compare import page, result

    files = (arguments.control, arguments.later)
    stretches = (arguments.control_frames, arguments.later_frames)
    names = _titles(files, stretches, arguments.part)
    with named(" and ".join(files)):
        control = _load(files[0], arguments, stretches[0])
        later = _load(files[1], arguments, stretches[1], arguments.part)
        for file, recorded in zip(files, (control, later), strict=True):
            recording.voltages(recorded, file)
            if _checked(recorded, arguments, file, TABLE_TOPICS) is None:
                return UNUSABLE
        document = result.comparison(control, later, names)
    stems = "-vs-".join(map(_stem, files, stretches))
    with held_folder(arguments.out or f"comparison-{stems}") as folder:
        report = folder / "comparison.html"
        report.unlink(missing_ok=True)
        result.write(document, folder / "comparison.json")
        page.write(document, report)
    if arguments.json:
        answers.write(document | {"report": str(report)})
    else:
        _say("\n".join(document["sentences"]))
        _say(str(report))
    return 0


if __name__ == "__main__":
    sys.exit(main())
