"""Figure 3: the correlation of each channel's change with x, y and the force."""

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from eitskin import figure_files, plotting
from eitskin.data.alignment import homogeneous_readings
from eitskin.data.dataset import TARGETS, Dataset
from eitskin.errors import InputError
from eitskin.physics.geometry import even_angles
from eitskin.plotting import AFTER, BEFORE, QUIET, style

LEVEL = 1.96  # standard errors, 1 / √N each, of the correlation of independent variables: 95 %

CHANCE = "r by chance alone, 95 %"


def correlations(dataset: Dataset) -> pd.DataFrame:
    """Pearson's r of each channel's change with each target: dataset, origin, target, channel, r,
    mean_abs_r (over the target's channels) and samples.

    For signed readings it is that of the change of the magnitude, comparable with a recording of
    magnitudes; signs are those of a homogeneous disc with evenly spaced electrodes. NaN for a
    constant channel.
    """
    metadata = dataset.metadata
    change = dataset.delta_V.astype(float)
    channels = np.array(metadata["channels"])
    if metadata["voltage"] == "signed":
        ideal = homogeneous_readings(channels, even_angles(int(channels.max()) + 1))
        change = change * np.where(ideal < 0, -1.0, 1.0)
    change = change - change.mean(axis=0)
    states = dataset.states()
    states = states - states.mean(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        r = (change / np.linalg.norm(change, axis=0)).T @ (states / np.linalg.norm(states, axis=0))
    head = {"dataset": metadata["name"], "origin": metadata["origin"]}
    return pd.concat(
        [
            pd.DataFrame(
                {
                    **head,
                    "target": target,
                    "channel": np.arange(len(r)),
                    "r": r[:, k],
                    "mean_abs_r": np.nanmean(np.abs(r[:, k])),
                    "samples": len(change),
                }
            )
            for k, target in enumerate(metadata["targets"])
        ],
        ignore_index=True,
    )


def draw(recorded: pd.DataFrame, simulated: pd.DataFrame) -> Figure:
    """One row for each target, the recording on the left and the simulation on the right."""
    columns = ((recorded, BEFORE), (simulated, AFTER))
    targets = [target for target in TARGETS if (simulated["target"] == target).any()]
    with style():
        figure = plotting.sheet(plotting.COLUMN_MM, 19.0 + 21.0 * len(targets))
        grid = figure.subplots(len(targets), 2, sharex="col", sharey=True, squeeze=False)
        for row, target in zip(grid, targets, strict=True):
            for axes, (table, colour) in zip(row, columns, strict=True):
                target_rows = table[table["target"] == target]
                if target_rows.empty:
                    axes.text(0.5, 0.5, "not known", transform=axes.transAxes, ha="center")
                    continue
                chance = LEVEL / np.sqrt(target_rows["samples"].iloc[0])
                axes.axhspan(-chance, chance, color=QUIET, alpha=0.35, linewidth=0.3)
                axes.plot(target_rows["channel"], target_rows["r"], color=colour, linewidth=0.6)
                axes.set_title(
                    f"mean |r| {target_rows['mean_abs_r'].iloc[0]:.2f}", loc="right", pad=2
                )
                axes.set_xlim(0, target_rows["channel"].max())
            row[0].set_ylabel(f"r with {target}")
        chance_patch = Patch(color=QUIET, alpha=0.35, linewidth=0.3, label=CHANCE)
        figure.legend(handles=[chance_patch], loc="outside lower center")
        largest = 1.05 * max(float(table["r"].abs().max()) for table, _ in columns)
        grid[0, 0].set_ylim(-largest, largest)
        for axes in grid[-1]:
            axes.set_xlabel("channel")
        kinds = ("recording", "simulated set")
        for axes, kind, (table, colour) in zip(grid[0], kinds, columns, strict=True):
            axes.annotate(
                f"{kind}:\n{table['dataset'].iloc[0]}",
                (0.5, 1.0),
                (0, 13),
                xycoords="axes fraction",
                textcoords="offset points",
                ha="center",
                color=colour,
                weight="bold",
            )
    return figure


def write(recorded: Dataset, simulated: Dataset, vector: Path, image: Path, csv: Path) -> None:
    """Figure 3 of a recording's touches and a simulated set; raises InputError where they share no
    target."""
    recorded_rows, simulated_rows = correlations(recorded), correlations(simulated)
    if not set(recorded_rows["target"]) & set(simulated_rows["target"]):
        target_names = ", ".join(recorded.metadata["targets"])
        raise InputError(recorded.metadata["name"], "targets", target_names, "one of x, y, F")
    table = pd.concat([recorded_rows, simulated_rows], ignore_index=True)
    figure_files.write(draw(recorded_rows, simulated_rows), table, vector, image, csv)
