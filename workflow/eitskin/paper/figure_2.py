"""Figure 2: the pipeline, drawn from Snakemake's graph of the workflow's rules, each rule in the
stage named after its file.

Stages are in columns by the longest way to them; an arrow across a column has a lane there. Arrows
implied by others are left out of the drawing but not of the table.
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
WRAP = 12  # letters of a rule's name, before it is wrapped at an underscore: the width of a box
BOX, STAGE_GAP, LANE, TITLE = 6.2, 4.0, 2.6, 4.2  # heights in mm, for two lines of 6 point
BETWEEN, PAD = 1.2, 1.2  # mm between boxes, and around them
GAP = 8.0  # mm between columns, for the arrows' curves

Item = str | tuple[str, int]  # of a column: a stage, or the lane of a rule's arrows


@dataclass
class Rules:
    """A graph of rules: `edges` (before, after), the `stage` of each rule, and the rules that are
    `repeated`, following themselves."""

    edges: list[tuple[str, str]]
    stage: dict[str, str]
    repeated: set[str] = field(default_factory=set)

    def followers(self, rule: str) -> set[str]:
        """All rules that depend on a rule, directly or not."""
        reached: set[str] = set()
        queue = [rule]
        while queue:
            current = queue.pop()
            added = {
                successor for predecessor, successor in self.edges if predecessor == current
            } - reached
            reached |= added
            queue.extend(added)
        return reached

    def implied(self, edge: tuple[str, str]) -> bool:
        """Whether an edge is implied by a longer path."""
        predecessor, successor = edge
        siblings = {end for origin, end in self.edges if origin == predecessor} - {successor}
        return any(successor in self.followers(sibling) for sibling in siblings)


def rule_graph(targets: list[str], configfiles: list[str]) -> str:
    """The workflow's rule graph for `targets` in Graphviz's language, from Snakemake.

    Raises InputError where Snakemake fails.
    """
    command = [sys.executable, "-m", "snakemake", "--rulegraph", "dot"]
    if configfiles:
        command += ["--configfile", *configfiles]
    process = subprocess.run([*command, "--", *targets], capture_output=True, text=True)
    if process.returncode:
        lines = [line for line in process.stderr.splitlines() if line.strip()]
        raise InputError("Snakefile", "rule graph", lines[-1] if lines else "nothing", "a graph")
    return process.stdout


def stages(files: Iterable[str | Path]) -> dict[str, str]:
    """The stage of each rule defined in these files: the name of its file."""
    return {
        a or b: Path(file).stem.replace("_", " ")
        for file in files
        for a, b in RULE.findall(Path(file).read_text(encoding="utf-8"))
    }


def parse(dot: str, stage: dict[str, str]) -> Rules:
    """The rules that have a stage, and their order; raises InputError for a graph without edges
    between them."""
    names = {node[1]: node[2] for node in map(NODE.match, dot.splitlines()) if node}
    pairs = [(edge[1], edge[2]) for edge in map(EDGE.match, dot.splitlines()) if edge]
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
    """The column of each stage: the longest way to it from a stage without inputs. The stages of a
    cycle share a column."""
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
    """before, after, their stages, and whether the arrow is drawn or implied by others."""
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
    """The positions of all items, mm from the left and from the top: `box` (x, y of the centre) of
    each rule, `frame` (x, y, width, height; y the upper edge) of each stage, `lane` y by (rule,
    column), and the `width` of a box."""

    def __init__(self, rules: Rules):
        self.rules = rules
        self.drawn = [edge for edge in rules.edges if not rules.implied(edge)]
        self.column = columns(rules)
        self.count = max(self.column.values()) + 1
        self.width = (plotting.FULL_MM - 2.0 - GAP * (self.count - 1)) / self.count - 2 * PAD
        self.members = {stage: self._in_order(stage) for stage in self.column}
        self.lanes = {
            (a, column)
            for a, b in self.drawn
            for column in range(self._column_of(a) + 1, self._column_of(b))
        }
        self.items: list[list[Item]] = [
            [stage for stage, stage_column in self.column.items() if stage_column == column]
            + sorted(lane for lane in self.lanes if lane[1] == column)
            for column in range(self.count)
        ]
        self.middle: dict = {}
        self._stack()
        for _ in range(6):
            for forward in (True, False):
                self._sort(forward)

    def _column_of(self, rule: str) -> int:
        return self.column[self.rules.stage[rule]]

    def _in_order(self, stage: str) -> list[str]:
        members = [rule for rule in self.rules.stage if self.rules.stage[rule] == stage]
        return sorted(
            members,
            key=lambda rule: sum(rule in self.rules.followers(member) for member in members),
        )

    def _height(self, item: Item) -> float:
        if isinstance(item, tuple):
            return LANE
        count = len(self.members[item])
        return TITLE + count * BOX + (count - 1) * BETWEEN + PAD

    def _stack(self) -> None:
        """Set the positions of all items: each column in its order from the top, centred."""
        heights = [
            sum(map(self._height, items)) + sum(map(_gap, items, items[1:])) for items in self.items
        ]
        self.height = max(heights)
        for items, height in zip(self.items, heights, strict=True):
            y = 0.5 * (self.height - height)
            for item, next_item in zip(items, [*items[1:], items[-1]], strict=True):
                self.middle[item] = y + 0.5 * self._height(item)
                y += self._height(item) + _gap(item, next_item)
        self.frame, self.box, self.lane = {}, {}, {}
        for column, items in enumerate(self.items):
            x = 1.0 + column * (self.width + 2 * PAD + GAP)
            for item in items:
                top = self.middle[item] - 0.5 * self._height(item)
                if isinstance(item, tuple):
                    self.lane[item] = self.middle[item]
                    continue
                self.frame[item] = (x, top, self.width + 2 * PAD, self._height(item))
                for k, rule in enumerate(self.members[item]):
                    y = top + TITLE + k * (BOX + BETWEEN) + 0.5 * BOX
                    self.box[rule] = (x + PAD + 0.5 * self.width, y)

    def waypoints(self, edge: tuple[str, str]) -> list[tuple[float, float]]:
        """The points of an arrow between columns, from right edge to left edge."""
        a, b = edge
        (xa, ya), (xb, yb) = self.box[a], self.box[b]
        points = [(xa + 0.5 * self.width, ya)]
        for column in range(self._column_of(a) + 1, self._column_of(b)):
            x = 1.0 + column * (self.width + 2 * PAD + GAP)
            y = self.lane[a, column]
            points += [(x, y), (x + self.width + 2 * PAD, y)]
        return [*points, (xb - 0.5 * self.width, yb)]

    def _sort(self, forward: bool) -> None:
        """Order each column by the mean height of the neighbours of its items, before or after."""
        mean_heights: dict = {}
        for a, b in self.drawn:
            if self._column_of(a) == self._column_of(b):
                continue
            chain: list[Item] = [self.rules.stage[a]]
            chain += [(a, c) for c in range(self._column_of(a) + 1, self._column_of(b))]
            chain += [self.rules.stage[b]]
            ways = self.waypoints((a, b))
            for k, (item_before, item_after) in enumerate(pairwise(chain)):
                item, point = (
                    (item_after, ways[2 * k]) if forward else (item_before, ways[2 * k + 1])
                )
                mean_heights.setdefault(item, []).append(point[1])
        for items in self.items:
            items.sort(key=lambda item: float(np.mean(mean_heights.get(item, self.middle[item]))))
        self._stack()


def _gap(item: Item, next_item: Item) -> float:
    """The gap between two items of a column; lanes are adjacent."""
    return 0.0 if isinstance(item, tuple) and isinstance(next_item, tuple) else STAGE_GAP


def draw(rules: Rules) -> Figure:
    """Stages as columns from left to right, rules as boxes, dependencies as arrows."""
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
            label = _wrapped(rule) + (" ↻" if rule in rules.repeated else "")
            axes.text(x, y, label, fontsize=6, zorder=4, linespacing=1.0, **CENTRED)
    return figure


def _wrapped(rule: str) -> str:
    """The name, wrapped at the underscore nearest to its middle where it is long."""
    underscores = [cut for cut, letter in enumerate(rule) if letter == "_"]
    if len(rule) <= WRAP or not underscores:
        return rule
    cut = min(underscores, key=lambda cut: abs(cut - len(rule) / 2)) + 1
    return f"{rule[:cut]}\n{rule[cut:]}"


def _draw_arrow(axes: Axes, layout: Layout, edge: tuple[str, str]) -> None:
    a, b = edge
    (xa, ya), (xb, yb) = layout.box[a], layout.box[b]
    line = {"color": QUIET, "linewidth": 0.7, "shrinkA": 0, "shrinkB": 0, "arrowstyle": "-|>"}
    line |= {"mutation_scale": 5, "zorder": 2}
    if xa == xb:
        is_adjacent = abs(yb - ya) <= BOX + BETWEEN + 1e-6
        if is_adjacent:
            down = np.sign(yb - ya)
            ends = (xb, yb - down * 0.5 * BOX), (xa, ya + down * 0.5 * BOX)
            axes.annotate("", *ends, arrowprops=line)
        else:
            side = 0.5 * layout.width
            bend = {"connectionstyle": f"arc3,rad={np.sign(yb - ya) * 0.25}"}
            axes.annotate("", (xb - side, yb), (xa - side, ya), arrowprops=line | bend)
        return
    points = layout.waypoints(edge)
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
    rules = parse(rule_graph(targets, configfiles), stages(files))
    figure_files.write(draw(rules), table(rules), vector, image, csv)
