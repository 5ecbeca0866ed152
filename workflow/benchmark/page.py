"""benchmarks/README.md from the files of `benchmark.speed` beside it:
`python -m benchmark.page`."""

import json
import math
import re
from pathlib import Path

from benchmark.rows import ROOT
from eitskin.atomic import atomic_path

FOLDER = ROOT / "benchmarks"
HEAD = """\
# How fast

`make bench` measures all of this and writes this page. `python -m benchmark.speed NAME` measures a
part, `python -m benchmark.page` writes the page again, from the `NAME.json` beside it. A value is
the median of the runs, or what its row says; in brackets are the least and the greatest. The ratio
is ours over what stands beside it, both measured in the same run. What needs one core is measured
in processor seconds: what else the machine does is not in them, or only where it slows memory down.
"""
COMPARED = {
    "clean": """\
Samples a processor second of the same 208 voltages, 192 places with 260 strengths of touch:
eitskin's forward model at `train` accuracy, and its closed form in the strength on pyEIT's own
mesh, beside pyEIT and SciPy on that mesh. Mesh and element matrices are there before. The third
peer is what a careful user would write; the fourth keeps what eitskin's own eigenproblem keeps.""",
    "skins": """\
New skins a second by the clock, each with a rim and electrodes of its own, pressed at all 192
places with five forces (`crossed` of `config.yaml`), written as a stage of a set: on two cores,
beside one, and beside five times what was measured before sessions were shared among cores.""",
    "electrodes": """\
New skins of 16, 32 and 64 electrodes, driven and measured between neighbours: processor seconds of
one pressed at 192 places with five forces, beside 16 electrodes; of the derivatives by everything
(58, 106, 202 parameters) with one touch, beside five solves of it; and the root mean square error
of untouched voltages, beside a good rig's noise.""",
    "together": """\
Samples of 16 new skins, each with electrodes of its own, pressed at 192 places with five forces,
from geometries to changed voltages: a processor second, all skins at once, as
`eitskin.physics.sheets` has them, on NumPy and on PyTorch, beside one by one. Where there is a GPU,
256 skins on it a second by the clock, beside a million samples.""",
    "perturbed": """\
Processor seconds of the perturbed sets of `config.yaml`, from nothing to the data set, in one
process, beside what they may take. `crossed` presses every skin at all places. The authors' set
with 20 times the places is there for its memory: sets are made a group of sessions at a time.""",
    "trained": """\
Samples a processor second of the training loop of a perceptron of 512, 256, 128, as it is, and with
numbers under the least normal one computed with.""",
    "diagnosed": """\
By the clock, diagnoses of drawn recordings of 500 frames, report and all, each as `eitskin
diagnose` does on two cores, then two at once on one each, beside what they may take. A run is a
recording.""",
    "scaled": """\
By the clock, diagnoses on two cores, report and all: of a recording with an impedance left out by a
rig with errors, against its frames; of six presses of the twin, against its electrodes; and against
how many names the catalogue has. A run is a recording.""",
    "grown": """\
By the clock, diagnoses on two cores, report and all, of recordings that have grown from 500 frames
to 550, an impedance left out by a rig with errors: with the effects of the first 500 to begin with
(`--earlier`), beside begun anew. A run is a recording.""",
    "swept": """\
Diagnoses an hour by the workflow, the first 32 recordings of the calibration's block
`ordinary-report` in four jobs: on one slot, and on more beside as many times what one does; and the
processor seconds of a diagnosis, Snakemake's own among them.""",
    "planned": """\
Processor seconds of a dry run from nothing that would read and check many recordings, Snakemake's
start with it, beside what it may take; and what provenance costs a job: to be planned, all that
Snakemake plans with it, and to be recorded, with a new input of 1 MiB.""",
    "streamed": """\
From a frame to its verdict on one core, for models of Table I, beside a limit of 1 ms: by the
clock, and in this thread's processor time; the state alone beside PyTorch; the MLP without an
electrode, and the whole loop.""",
}
REASONS = (  # why rows fall short: the first whose pattern matches
    (r"perturbed, memory of", "the states of all samples are drawn at once, 56 bytes each"),
    (
        r"streamed, (cnn|transformer)\b",
        "the network alone takes a third of it or more, as its `state alone` shows",
    ),
    (
        r"state alone, (cnn|transformer)\b",
        "a convolution or attention is several NumPy calls here, and one kernel in PyTorch",
    ),
    (r"streamed, (?!.*processor time)", "by the clock, what else the machine does counts in"),
    (r"new skin of", "it has more electrodes than what stands beside it"),
    (r"diagnosis, 1000", "it has twice the frames"),
    (r"diagnosis, .* 32", "it has 928 channels in place of 208"),
    (r"sweep, 4 slots$", "there are two cores"),
    (
        r"plan, 1000 ",
        "a start takes two fifths of it, and other work shared the cores' caches",
    ),
    (r"diagnosed", "the rig's errors are learned anew for every set of effects that is tried"),
)
UNKNOWN = "the reason is not known"


def page(folder: Path) -> str:
    """The page, with one section for each bench; one without a file is stated as not measured."""
    return "\n".join([HEAD, *(section(name, folder / f"{name}.json") for name in COMPARED)])


def section(name: str, file: Path) -> str:
    """The section of a bench: the comparison, the conditions, a line for each row, shortfalls."""
    head = f"## {name}\n\n{COMPARED[name]}\n"
    if not file.exists():
        return f"{head}\nNot measured yet: `python -m benchmark.speed {name}`.\n"
    rows = json.loads(file.read_text(encoding="utf-8"))
    table = ["| | unit | ours | beside | | ratio | runs |", "|---|---|---|---|---|---|---|"]
    short_lines = [f"- {shortfall(row)}" for row in rows if falls_short(row)]
    shortfalls = (
        ["What falls short:", "", *short_lines] if short_lines else ["Nothing here falls short."]
    )
    return "\n".join([head, conditions(rows[0]), "", *table, *map(line, rows), "", *shortfalls, ""])


def conditions(row: dict) -> str:
    """The command, the commit, the machine, and the cores used by other work."""
    machine = row["machine"]
    return (
        f"`{row['command']}`, commit `{row['commit']}`, on {machine['processor']}, "
        f"{machine['cores']} cores, {machine['memory_GiB']:.0f} GiB of memory. "
        f"Other work took {row['others_cores']:.1f} cores meanwhile."
    )


def line(row: dict) -> str:
    """A row of the table."""
    cells = (
        row["name"],
        row["unit"],
        spread(row["ours"], row["ours_runs"]),
        row["peer_name"],
        spread(row["peer"], row["peer_runs"]),
        digits(row["ratio"]),
        str(row["runs"]),
    )
    return f"| {' | '.join(cells)} |"


def spread(value: float, runs: list[float]) -> str:
    """A value, with the least and the greatest of several runs."""
    if len(runs) == 1:
        return digits(value)
    return f"{digits(value)} ({digits(min(runs))} to {digits(max(runs))})"


def digits(value: float) -> str:
    """Four significant digits, never as a power of ten."""
    rounded = float(f"{value:.4g}")
    places = 3 - math.floor(math.log10(abs(rounded))) if rounded else 0
    return f"{rounded:,.{max(places, 0)}f}"


def falls_short(row: dict) -> bool:
    """Whether our value is worse than the peer's: lower for a rate, otherwise higher."""
    return row["ratio"] < 1.0 if row["unit"].endswith(("/s", "/h")) else row["ratio"] > 1.0


def shortfall(row: dict) -> str:
    """A sentence on a row that falls short, with the reason."""
    reason = next((text for name, text in REASONS if re.match(name, row["name"])), UNKNOWN)
    ours, peer = digits(row["ours"]), digits(row["peer"])
    return f"{row['name']}, {ours} {row['unit']}; {row['peer_name']}, {peer}: {reason}."


if __name__ == "__main__":
    with atomic_path(FOLDER / "README.md") as path:
        path.write_text(page(FOLDER), encoding="utf-8")
