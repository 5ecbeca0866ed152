"""Figure 2: the method. A skin's voltages, the predictor of the touch, and what teaches it: a
voltage autoencoder, and a regressor that stands for the forward model, whose latents are compared.

Numbers on blocks are the stages of the training (`learn.train`), in brackets the paper's equations.
"""

from dataclasses import dataclass
from pathlib import Path

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import FancyBboxPatch

from eitskin import figure_files, plotting
from eitskin.plotting import AFTER, BEFORE, CENTRED, RIM, style

HEIGHT_MM = 74.0
DATA, NETWORK, LOSS = "data", "network", "loss"
FACES = {DATA: "white", NETWORK: "#dcecf7", LOSS: "#fbe6d4"}
NUMBERS = "1, 2, 3: order of training; (4) to (7): equations of the paper"
USE, TRAINING = "use and training", "training alone"
LINES: dict[str, tuple[str, tuple[int, tuple[int, ...]]]] = {
    USE: (AFTER, (0, ())),
    TRAINING: (BEFORE, (0, (3, 2))),
}


@dataclass(frozen=True)
class Block:
    """A block: its text, its `kind`, and centre and size in mm, y from the lower edge."""

    text: str
    kind: str
    x: float
    y: float
    width: float = 27.0
    height: float = 13.0


BLOCKS = {
    "skin": Block("EIT skin,\n16 electrodes", DATA, 16.0, 60.0),
    "voltages": Block("changes of the\nvoltages, ΔV", DATA, 54.0, 60.0),
    "predictor": Block("3  predictor f\nΔV → (x̂, ŷ, F̂)", NETWORK, 94.0, 60.0, 29.0),
    "touch": Block("estimated touch\n(x̂, ŷ, F̂)", DATA, 134.0, 60.0),
    "supervision": Block("error (4)", LOSS, 166.0, 60.0, 20.0, 9.0),
    "label": Block("labelled touch\n(x, y, F)", DATA, 166.0, 37.0, 24.0),
    "encoder": Block("1  encoder Eᵥ", NETWORK, 54.0, 37.0, 27.0, 9.0),
    "latent": Block("latent z", DATA, 54.0, 17.0, 27.0, 9.0),
    "decoder": Block("1  decoder Dᵥ", NETWORK, 16.0, 17.0, 27.0, 9.0),
    "reconstruction": Block("reconstruction (5)", LOSS, 16.0, 37.0, 30.0, 9.0),
    "regressor": Block("2  regressor gᵩ\ntouch → latent", NETWORK, 134.0, 37.0, 29.0),
    "predicted": Block("latent ẑ", DATA, 134.0, 17.0, 27.0, 9.0),
    "consistency": Block("consistency (6, 7)", LOSS, 94.0, 17.0, 31.0, 9.0),
}
ARROWS = (
    ("skin", "voltages", USE),
    ("voltages", "predictor", USE),
    ("predictor", "touch", USE),
    ("touch", "supervision", TRAINING),
    ("label", "supervision", TRAINING),
    ("label", "regressor", TRAINING),
    ("voltages", "encoder", TRAINING),
    ("encoder", "latent", TRAINING),
    ("latent", "decoder", TRAINING),
    ("decoder", "reconstruction", TRAINING),
    ("touch", "regressor", TRAINING),
    ("regressor", "predicted", TRAINING),
    ("latent", "consistency", TRAINING),
    ("predicted", "consistency", TRAINING),
)


def table() -> pd.DataFrame:
    """before, after (the blocks' texts) and `when` the arrow is used, one an arrow."""
    return pd.DataFrame(
        [
            {"before": _line(BLOCKS[a].text), "after": _line(BLOCKS[b].text), "when": when}
            for a, b, when in ARROWS
        ]
    )


def _line(text: str) -> str:
    return text.replace("\n", " ")


def draw() -> Figure:
    """Blocks and arrows, and a key."""
    with style():
        figure = plotting.sheet(plotting.FULL_MM, HEIGHT_MM)
        figure.set_layout_engine("none")
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set(xlim=(0, plotting.FULL_MM), ylim=(0, HEIGHT_MM))
        axes.set_axis_off()
        for block in BLOCKS.values():
            axes.add_patch(
                FancyBboxPatch(
                    (block.x - 0.5 * block.width, block.y - 0.5 * block.height),
                    block.width,
                    block.height,
                    boxstyle="round,pad=0,rounding_size=1.2",
                    facecolor=FACES[block.kind],
                    edgecolor=RIM,
                    linewidth=0.6,
                )
            )
            axes.text(block.x, block.y, block.text, fontsize=7, **CENTRED)
        for first, second, when in ARROWS:
            _draw_arrow(axes, BLOCKS[first], BLOCKS[second], when)
        lines = [
            Line2D([], [], color=colour, linestyle=dashes, label=when, linewidth=1.0)
            for when, (colour, dashes) in LINES.items()
        ]
        squares = [
            Line2D([], [], marker="s", linestyle="", color=RIM, mfc=face, label=kind, mew=0.6)
            for kind, face in FACES.items()
        ]
        axes.text(0.5 * plotting.FULL_MM, 8.0, NUMBERS, fontsize=6, **CENTRED)
        axes.legend(
            handles=[*lines, *squares], loc="lower center", ncols=5, bbox_to_anchor=(0.5, 0.0)
        )
    return figure


def _draw_arrow(axes: Axes, first: Block, second: Block, when: str) -> None:
    """A straight arrow between the sides that face each other; blocks share a row or a column."""
    colour, dashes = LINES[when]
    if first.y == second.y:
        side = 0.5 if second.x > first.x else -0.5
        start = first.x + side * first.width, first.y
        end = second.x - side * second.width, second.y
    else:
        side = 0.5 if second.y > first.y else -0.5
        start = first.x, first.y + side * first.height
        end = second.x, second.y - side * second.height
    arrow = {"arrowstyle": "-|>", "shrinkA": 0, "shrinkB": 0, "mutation_scale": 7}
    arrow |= {"color": colour, "linestyle": dashes, "linewidth": 1.0}
    axes.annotate("", end, start, arrowprops=arrow)


def write(vector: Path, image: Path, csv: Path) -> None:
    """Write figure 2 and its arrows as a table."""
    figure_files.write(draw(), table(), vector, image, csv)
