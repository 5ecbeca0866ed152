"""Figure 2: the pipeline, drawn from the workflow: Snakemake's own graph of its rules, each rule in
the stage that its file is named after.

Stages stand in columns by how much has to be done before them; what passes a column by has a lane
of its own there. An arrow that follows from others is left out of the drawing, not of the table.
"""

import re
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch, PathPatch
from matplotlib.path import Path as Curve
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from eitskin import figure_files, plotting
from eitskin.errors import InputError
from eitskin.plotting import AFTER, CENTRED, QUIET, style

NODE = re.compile(r'^\s*(\d+)\[label = "([^"\\]+)')
EDGE = re.compile(r"^\s*(\d+) -> (\d+)")
RULE = re.compile(r"^(?:rule|checkpoint) (\w+):|^use rule \w+ as (\w+) with:", re.MULTILINE)
WRAP = 12  # letters of a rule's name before it is broken at an underscore
BOX, STAGE_GAP, LANE, TITLE = 6.2, 4.0, 2.6, 4.2  # heights in mm
BETWEEN, PAD = 1.2, 1.2
GAP = 8.0  # between columns

Item = str | tuple[str, int]  # of a column: a stage, or the lane of a rule's arrows


@dataclass
class Rules:
    """A graph of rules: `edges` (before, after), `stage` of each rule, `repeated` ones, which
    follow themselves."""

    edges: list[tuple[str, str]]
    stage: dict[str, str]
    repeated: set[str] = field(default_factory=set)

    def followers(self, rule: str) -> set[str]:
        """All rules that come after one, directly or not."""
        found: set[str] = set()
        waiting = [rule]
        while waiting:
            here = waiting.pop()
            new = {after for before, after in self.edges if before == here} - found
            found |= new
            waiting.extend(new)
        return found

    def implied(self, edge: tuple[str, str]) -> bool:
        """Whether an edge follows from others: a longer way leads along it."""
        before, after = edge
        others = {b for a, b in self.edges if a == before} - {after}
        return any(after in self.followers(other) for other in others)


def ask(targets: list[str], configfiles: list[str]) -> str:
    """The workflow's rule graph for `targets` in Graphviz's language, from Snakemake.

    Raises InputError where Snakemake has none to give.
    """
    command = [sys.executable, "-m", "snakemake", "--rulegraph", "dot"]
    if configfiles:
        command += ["--configfile", *configfiles]
    done = subprocess.run([*command, "--", *targets], capture_output=True, text=True)
    if done.returncode:
        lines = [line for line in done.stderr.splitlines() if line.strip()]
        raise InputError("Snakefile", "rule graph", lines[-1] if lines else "nothing", "a graph")
    return done.stdout


def stages(files: Iterable[str | Path]) -> dict[str, str]:
    """The stage of each rule defined in these files: the name of its file."""
    return {
        a or b: Path(file).stem.replace("_", " ")
        for file in files
        for a, b in RULE.findall(Path(file).read_text(encoding="utf-8"))
    }


def parse(dot: str, stage: dict[str, str]) -> Rules:
    """The rules that have a stage, and what must be done before what; raises InputError for a graph
    without any."""
    names = {found[1]: found[2] for found in map(NODE.match, dot.splitlines()) if found}
    pairs = [(f[1], f[2]) for f in map(EDGE.match, dot.splitlines()) if f]
    edges = sorted({(names[a], names[b]) for a, b in pairs})
    edges = [(a, b) for a, b in edges if a in stage and b in stage]
    if not edges:
        raise InputError("Snakefile", "rule graph", "no two rules in turn", "some")
    used = {name for name in names.values() if name in stage}
    return Rules(
        [(a, b) for a, b in edges if a != b],
        {rule: stage[rule] for rule in stage if rule in used},
        {a for a, b in edges if a == b},
    )


def columns(rules: Rules) -> dict[str, int]:
    """The column of each stage: the longest way to it from a stage that needs nothing. Stages that
    need one another share a column."""
    names = list(dict.fromkeys(rules.stage.values()))
    needs = {(rules.stage[a], rules.stage[b]) for a, b in rules.edges}
    pairs = [(names.index(a), names.index(b)) for a, b in needs if a != b]
    row, column = np.array(pairs, dtype=int).reshape(-1, 2).T
    graph = csr_array((np.ones(len(row)), (row, column)), shape=(len(names), len(names)))
    _, group = connected_components(graph, connection="strong")
    rank = np.zeros(group.max() + 1, dtype=int)
    for _ in rank:
        for a, b in zip(group[row], group[column], strict=True):
            if a != b:
                rank[b] = max(rank[b], rank[a] + 1)
    return {name: int(rank[g]) for name, g in zip(names, group, strict=True)}


def table(rules: Rules) -> pd.DataFrame:
    """before, after, their stages, and whether the arrow is drawn or follows from others."""
    return pd.DataFrame(
        [
            {
                "before": a,
                "after": b,
                "stage_before": rules.stage[a],
                "stage_after": rules.stage[b],
                "drawn": not rules.implied((a, b)),
            }
            for a, b in rules.edges
        ]
    )


class Layout:
    """Where everything stands, mm from the left and from the top: `box` (x, y of the centre) of
    each rule, `frame` (x, y, width, height; y the upper edge) of each stage, `lane` y by (rule,
    column), and the `width` of a box."""

    def __init__(self, rules: Rules):
        self.rules = rules
        self.drawn = [edge for edge in rules.edges if not rules.implied(edge)]
        self.column = columns(rules)
        self.count = max(self.column.values()) + 1
        self.width = (plotting.FULL_MM - 2.0 - GAP * (self.count - 1)) / self.count - 2 * PAD
        self.members = {stage: self._in_order(stage) for stage in self.column}
        self.lanes = {(a, c) for a, b in self.drawn for c in range(self._of(a) + 1, self._of(b))}
        self.items: list[list[Item]] = [
            [stage for stage, at in self.column.items() if at == c]
            + sorted(lane for lane in self.lanes if lane[1] == c)
            for c in range(self.count)
        ]
        self.middle: dict = {}
        self._stack()
        for _ in range(6):
            for forward in (True, False):
                self._sort(forward)

    def _of(self, rule: str) -> int:
        return self.column[self.rules.stage[rule]]

    def _in_order(self, stage: str) -> list[str]:
        own = [rule for rule in self.rules.stage if self.rules.stage[rule] == stage]
        return sorted(own, key=lambda rule: sum(rule in self.rules.followers(o) for o in own))

    def _height(self, item: Item) -> float:
        if isinstance(item, tuple):
            return LANE
        count = len(self.members[item])
        return TITLE + count * BOX + (count - 1) * BETWEEN + PAD

    def _stack(self) -> None:
        """Places of all items, each column from the top of its own order, in the middle."""
        heights = [
            sum(map(self._height, items)) + sum(map(_gap, items, items[1:])) for items in self.items
        ]
        self.height = max(heights)
        for items, height in zip(self.items, heights, strict=True):
            y = 0.5 * (self.height - height)
            for item, after in zip(items, [*items[1:], items[-1]], strict=True):
                self.middle[item] = y + 0.5 * self._height(item)
                y += self._height(item) + _gap(item, after)
        self.frame, self.box, self.lane = {}, {}, {}
        for c, items in enumerate(self.items):
            x = 1.0 + c * (self.width + 2 * PAD + GAP)
            for item in items:
                top = self.middle[item] - 0.5 * self._height(item)
                if isinstance(item, tuple):
                    self.lane[item] = self.middle[item]
                    continue
                self.frame[item] = (x, top, self.width + 2 * PAD, self._height(item))
                for k, rule in enumerate(self.members[item]):
                    y = top + TITLE + k * (BOX + BETWEEN) + 0.5 * BOX
                    self.box[rule] = (x + PAD + 0.5 * self.width, y)

    def way(self, edge: tuple[str, str]) -> list[tuple[float, float]]:
        """Points that an arrow between columns passes, from right edge to left edge."""
        a, b = edge
        (xa, ya), (xb, yb) = self.box[a], self.box[b]
        points = [(xa + 0.5 * self.width, ya)]
        for c in range(self._of(a) + 1, self._of(b)):
            x = 1.0 + c * (self.width + 2 * PAD + GAP)
            y = self.lane[a, c]
            points += [(x, y), (x + self.width + 2 * PAD, y)]
        return [*points, (xb - 0.5 * self.width, yb)]

    def _sort(self, forward: bool) -> None:
        """Order each column by the mean height of what its items hang on, before or after."""
        wanted: dict = {}
        for a, b in self.drawn:
            if self._of(a) == self._of(b):
                continue
            chain: list[Item] = [self.rules.stage[a]]
            chain += [(a, c) for c in range(self._of(a) + 1, self._of(b))]
            chain += [self.rules.stage[b]]
            ways = self.way((a, b))
            for k, (first, second) in enumerate(pairwise(chain)):
                here, there = (second, ways[2 * k]) if forward else (first, ways[2 * k + 1])
                wanted.setdefault(here, []).append(there[1])
        for items in self.items:
            items.sort(key=lambda item: float(np.mean(wanted.get(item, self.middle[item]))))
        self._stack()


def _gap(item: Item, after: Item) -> float:
    """Between two items of a column; lanes may lie close."""
    return 0.0 if isinstance(item, tuple) and isinstance(after, tuple) else STAGE_GAP


def draw(rules: Rules) -> Figure:
    """Stages as columns from left to right, rules as boxes, what needs what as arrows."""
    layout = Layout(rules)
    with style():
        figure = plotting.sheet(plotting.FULL_MM, layout.height + 4.0)
        figure.set_layout_engine("none")
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set(xlim=(0, plotting.FULL_MM), ylim=(layout.height + 2.0, -2.0))
        axes.set_axis_off()
        for stage, (x, y, width, height) in layout.frame.items():
            shape = FancyBboxPatch(
                (x, y),
                width,
                height,
                boxstyle="round,pad=0,rounding_size=1.2",
                facecolor="#eef2f6",
                edgecolor="#b8c4d0",
                linewidth=0.5,
                zorder=0,
            )
            axes.add_patch(shape)
            axes.text(
                x + 0.5 * width,
                y + 0.5 * TITLE,
                stage,
                color=AFTER,
                weight="bold",
                fontsize=7,
                **CENTRED,
            )
        for edge in layout.drawn:
            _draw_arrow(axes, layout, edge)
        for rule, (x, y) in layout.box.items():
            shape = FancyBboxPatch(
                (x - 0.5 * layout.width, y - 0.5 * BOX),
                layout.width,
                BOX,
                boxstyle="round,pad=0,rounding_size=0.8",
                facecolor="white",
                edgecolor=plotting.RIM,
                linewidth=0.5,
                zorder=3,
            )
            axes.add_patch(shape)
            label = _broken(rule) + (" ↻" if rule in rules.repeated else "")
            axes.text(x, y, label, fontsize=6, zorder=4, linespacing=1.0, **CENTRED)
    return figure


def _broken(rule: str) -> str:
    """The name, on two lines where it is long, broken at the underscore nearest to its middle."""
    at = [k for k, letter in enumerate(rule) if letter == "_"]
    if len(rule) <= WRAP or not at:
        return rule
    k = min(at, key=lambda k: abs(k - len(rule) / 2)) + 1
    return f"{rule[:k]}\n{rule[k:]}"


def _draw_arrow(axes: Axes, layout: Layout, edge: tuple[str, str]) -> None:
    a, b = edge
    (xa, ya), (xb, yb) = layout.box[a], layout.box[b]
    line = {"color": QUIET, "linewidth": 0.7, "shrinkA": 0, "shrinkB": 0, "arrowstyle": "-|>"}
    line |= {"mutation_scale": 5, "zorder": 2}
    if xa == xb:
        near = abs(yb - ya) <= BOX + BETWEEN + 1e-6
        if near:
            down = np.sign(yb - ya)
            ends = (xb, yb - down * 0.5 * BOX), (xa, ya + down * 0.5 * BOX)
            axes.annotate("", *ends, arrowprops=line)
        else:
            side = 0.5 * layout.width
            bend = {"connectionstyle": f"arc3,rad={np.sign(yb - ya) * 0.25}"}
            axes.annotate("", (xb - side, yb), (xa - side, ya), arrowprops=line | bend)
        return
    points = layout.way(edge)
    vertices, codes = [points[0]], [Curve.MOVETO]
    for k, (start, end) in enumerate(pairwise(points)):
        if k % 2:
            vertices.append(end)
            codes.append(Curve.LINETO)
            continue
        middle = 0.5 * (start[0] + end[0])
        vertices += [(middle, start[1]), (middle, end[1]), end]
        codes += [Curve.CURVE4] * 3
    path = Curve(vertices, codes)
    axes.add_patch(PathPatch(path, facecolor="none", edgecolor=QUIET, linewidth=0.7, zorder=2))
    end = points[-1]
    axes.annotate("", end, (end[0] - 0.8, end[1]), arrowprops=line)


def write(
    targets: list[str],
    configfiles: list[str],
    files: list[str],
    vector: Path,
    image: Path,
    csv: Path,
) -> None:
    """Figure 2 of the rules, defined in `files`, that make `targets`; raises InputError as
    `parse`."""
    rules = parse(ask(targets, configfiles), stages(files))
    figure_files.write(draw(rules), table(rules), vector, image, csv)
