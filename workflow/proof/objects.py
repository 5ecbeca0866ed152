"""`python -m proof.objects OUT`: objects in real tanks, found or not, in files without names.

Every file with objects that another laboratory published (below the environment's EITSKIN_DATA:
lct-tank's nine, six of pyeidors-tank, every fifth frame with iirc-tank's rod), and pairs of empty
tanks, are copied with their controls to names that say nothing, in an order of their own, and
compared as `eitskin compare` does. What the files were is opened only once all answers are written.
"""

import json
import os
import shutil
import sys
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from zlib import crc32

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from eitskin import cli
from eitskin.atomic import atomic_path
from eitskin.diagnose.compare.objects import NAME
from eitskin.physics.geometry import even_angles
from eitskin.plotting import png
from eitskin.quantities import MINUS, percent
from proof import markdown
from proof.intervals import wilson

LCT, PYEIDORS, ROD = "lct-tank", "pyeidors-tank", "iirc-tank"
TARGETS = "measurements/tank/2026-03-14_latest_tank_data"  # folders that name what stands where
MATERIALS = {"metal": True, "plastic": False}  # whether it conducts better than saline
ANGLES = even_angles(16)
GATED_DEG = 11.0  # half the pitch of 16 electrodes, rounded down
ROD_FRAMES = range(0, 100, 5)  # every fifth: neighbours are nearly alike
TEN = range(0, 100, 10)  # of these, the ten that are judged
COLOURS = {True: "#d95f0e", False: "#2c7fb8"}
Truth = tuple[tuple[bool, float | None], ...]


@dataclass(frozen=True)
class Case:
    """A comparison: files of the control and later, the part of the latter; truth: of each object
    whether it conducts and its electrode's angle in degrees, each None where nobody knows; None
    without any knowledge, () for empty tanks. currents: of control and later, by their names."""

    name: str
    control: tuple[Path, ...]
    later: Path
    part: str | None
    truth: Truth | None
    currents: tuple[str, str] | None = None


def cases(data: Path) -> list[Case]:
    """All of them, by name."""
    comparisons = []
    empty = tuple(sorted((data / LCT / "homogeneous").glob("*.txt")))
    for file in sorted((data / LCT / "objects").glob("*.txt")):
        material, count = file.stem.split("_")[:2]
        truth: Truth | None = None
        if material in MATERIALS:
            truth = ((MATERIALS[material], None),) * int(count)
        comparisons.append(Case(f"{LCT} {file.stem}", empty, file, None, truth))
    for file in empty:
        controls = tuple(later for later in empty if later != file)
        comparisons.append(Case(f"{LCT} empty {file.stem}", controls, file, None, ()))
    targets = sorted((data / PYEIDORS / TARGETS).glob("*/*.csv"))
    for file in targets:
        words = file.parent.name.split("_")
        pairs = zip(words[::2], words[1::2], strict=True)
        truth = tuple(
            (MATERIALS[material], float(ANGLES[int(electrode.removeprefix("electrode")) - 1]))
            for electrode, material in pairs
        )
        name = f"{PYEIDORS} {file.parent.name} {file.stem.split('_')[0]}"
        comparisons.append(Case(name, (file,), file, "target", truth))
    for earlier, later in pairwise(targets):
        times = " ".join(file.stem.split("_")[0][11:] for file in (earlier, later))
        currents = earlier.stem.split("_")[3], later.stem.split("_")[3]
        comparisons.append(Case(f"{PYEIDORS} empty {times}", (earlier,), later, None, (), currents))
    tank = data / ROD / "iirc_data_2006.mat"
    if tank.exists():
        for k in ROD_FRAMES:
            comparisons.append(Case(f"{ROD} rod {k:02d}", (tank,), tank, f"v_rotate:{k}", None))
    return comparisons


def answer(case: Case, number: int, folder: Path) -> dict:
    """comparison.json of a case, copied to names that say only its number."""
    case_folder = folder / f"{number:03d}"
    with TemporaryDirectory() as copies:
        control = Path(copies) / "control"
        if len(case.control) > 1:
            control.mkdir()
            for i, file in enumerate(case.control):
                shutil.copyfile(file, control / f"control_{i}{file.suffix}")
        else:
            control = control.with_suffix(case.control[0].suffix)
            shutil.copyfile(case.control[0], control)
        later = Path(copies) / f"later{case.later.suffix}"
        shutil.copyfile(case.later, later)
        command = ["compare", str(control), str(later), "--out", str(case_folder)]
        with redirect_stdout(StringIO()):
            code = cli.main(command + (["--part", case.part] if case.part else []))
    if code:
        raise RuntimeError(f"eitskin compare ended with {code} on case {number}")
    return json.loads((case_folder / "comparison.json").read_text("utf-8"))


def judged(case: Case, comparison: dict) -> dict:
    """A row of the table: what was said, and, with the truth opened, whether that is right."""
    named = [entry for entry in comparison["difference"]["found"] if entry["named"]]
    patches = [entry for entry in named if entry["name"] == NAME]
    objects = [disc for entry in patches for disc in entry["objects"]]
    row = {
        "case": case.name,
        "named": bool(patches),
        "beside": ", ".join(entry["name"] for entry in named if entry["name"] != NAME),
        "objects": len(objects),
        "conducting": " ".join("+" if o["conducting"] else "-" for o in objects),
        "angle_deg": " ".join(f"{o['angle_deg']:.1f}" for o in objects),
        "x": " ".join(f"{o['x_of_radius']['value']:.3f}" for o in objects),
        "y": " ".join(f"{o['y_of_radius']['value']:.3f}" for o in objects),
        "radius": " ".join(f"{o['radius_of_radius']['value']:.2f}" for o in objects),
        "nats": max((entry["evidence_nats"] for entry in patches), default=np.nan),
        "explained": max((entry["explained"] for entry in patches), default=np.nan),
        "held_out_left": np.nan,
        "sign_right": None,
        "worst_deg": np.nan,
        "currents": "",
        "line_offset_V": np.nan,
        "line_left": np.nan,
    }
    if case.currents and len(set(case.currents)) > 1:
        row["currents"] = " ".join(case.currents)
        row["line_offset_V"], row["line_left"] = line(case.control[0], case.later)
    if patches:
        held_out = patches[0]["held_out"]
        row["held_out_left"] = held_out["rms_after"] / held_out["rms_before"]
    if case.truth and objects:
        row |= _against(case.truth, objects)
    return row


def line(control: Path, later: Path) -> tuple[float, float]:
    """Offset, V, of the straight line that one file's reference readings (real part) are of the
    other's, and the rms that it leaves over that of a line through 0. No model has a part in it."""
    x, y = (np.loadtxt(file, delimiter=",", usecols=0) for file in (control, later))
    design = np.column_stack([x, np.ones(len(x))])
    slope, offset = np.linalg.lstsq(design, y)[0]
    residual, through_0 = y - slope * x - offset, y - (x @ y) / (x @ x) * x
    return float(offset), float(np.linalg.norm(residual) / np.linalg.norm(through_0))


def _against(truth: Truth, objects: list[dict]) -> dict:
    """Signs and angles of objects against what stood there, each matched to the nearest angle."""
    signs = sorted(sign for sign, _ in truth) == sorted(o["conducting"] for o in objects)
    placed = [(sign, angle) for sign, angle in truth if angle is not None]
    if len(placed) < len(truth):
        return {"sign_right": signs}
    deviations = []
    for sign, angle in placed:
        distances = [abs((o["angle_deg"] - angle + 180.0) % 360.0 - 180.0) for o in objects]
        nearest = int(np.argmin(distances))
        signs = signs and objects[nearest]["conducting"] is sign
        deviations.append(distances[nearest])
    return {"sign_right": signs, "worst_deg": max(deviations)}


def circle(table: pd.DataFrame) -> dict:
    """The circle through the rod's places, in units of the tank's radius (least squares of x² + y²
    = a x + b y + c), the rms off it and off even steps on it, and the steps, in degrees."""
    x, y = (table[key].astype(float).to_numpy() for key in ("x", "y"))
    a, b, c = np.linalg.lstsq(np.column_stack([x, y, np.ones(len(x))]), x**2 + y**2, rcond=None)[0]
    centre, radius = np.array([a, b]) / 2.0, np.sqrt(c + (a * a + b * b) / 4.0)
    radial_error = np.hypot(x - centre[0], y - centre[1]) - radius
    turn = np.degrees(np.unwrap(np.arctan2(y - centre[1], x - centre[0])))
    steps = np.diff(turn)
    even_turn = np.polyval(np.polyfit(np.arange(len(x)), turn, 1), np.arange(len(x)))
    step_error = x + 1j * y - complex(*centre) - radius * np.exp(1j * np.radians(even_turn))
    return {
        "centre": centre,
        "radius": float(radius),
        "rms": float(np.sqrt((radial_error**2).mean())),
        "rms_even": float(np.sqrt((np.abs(step_error) ** 2).mean())),
        "steps_deg": (
            float(steps.mean()),
            float(steps.std()),
            float(steps.min()),
            float(steps.max()),
        ),
    }


def text(table: pd.DataFrame) -> str:
    """Markdown: the shares that are right, then every case but for most of the rod's frames."""
    rod = table[table["case"].str.startswith(f"{ROD} rod")]
    ten = rod[rod["case"].isin([f"{ROD} rod {k:02d}" for k in TEN])]
    empty = table[table["case"].str.contains(" empty ")]
    files = table.drop(rod.index).drop(empty.index)
    two_currents = empty[empty["currents"] != ""]
    lines = [*_shares(files, rod, ten, empty), "", *_cases(pd.concat([files, ten, empty]))]
    return "\n".join([*lines, "", *_lines_through(two_currents)]) + "\n"


def _shares(
    files: pd.DataFrame, rod: pd.DataFrame, ten: pd.DataFrame, empty: pd.DataFrame
) -> list[str]:
    judged_on = pd.concat([files, ten])
    known_signs = judged_on[judged_on["named"] & judged_on["sign_right"].notna()]
    placed = files[files["worst_deg"].notna()]
    any_named = empty["named"] | (empty["beside"] != "")
    worst = f"worst {placed['worst_deg'].max():.1f}°"
    one_current = empty["currents"] == ""
    lines = [
        (f"{len(files)} files and ten of the rod's frames: named", _share(judged_on["named"])),
        ("every fifth frame of the rod: named", _share(rod["named"])),
        (
            "every sign right and none too many, where named and known",
            _share(known_signs["sign_right"]),
        ),
        (
            "misfit on held-out pairs falls, where named",
            _share(judged_on[judged_on["named"]]["held_out_left"] < 1.0),
        ),
        (
            f"within {GATED_DEG:g}° of the folder's electrodes",
            f"{_share(placed['worst_deg'] <= GATED_DEG)}; {worst}",
        ),
        (
            "something named between two empty tanks, read with one current",
            _share(any_named[one_current]),
        ),
        ("the same, read with two currents", _share(any_named[~one_current])),
        ("a fault named beside the objects", _share(judged_on["beside"] != "")),
    ]
    for name, frames in (("ten frames of the rod", ten), ("every fifth frame of the rod", rod)):
        frames = frames[frames["objects"] == 1]
        if len(frames) > 3:
            fitted_circle = circle(frames)
            mean, sd, low, high = fitted_circle["steps_deg"]
            radius, rms = fitted_circle["radius"], fitted_circle["rms"]
            words = (
                f"radius {radius:.3f} of the tank's, rms off it {rms:.3f} ({percent(rms / radius)}"
                f" of its own radius), off even steps on it {fitted_circle['rms_even']:.3f};"
                f" steps {mean:.1f}° ± {sd:.1f}° ({low:.1f}° to {high:.1f}°)"
            )
            lines.append((f"{name}: circle", words))
    return markdown.table(("what", "found"), lines)


def _cases(table: pd.DataFrame) -> list[str]:
    head = (
        *("file", "named", "objects: + conducts", "at, degrees", "misfit left on held-out pairs"),
        *("sign right", "off, degrees"),
    )
    lines = []
    for row in table.to_dict("records"):
        remainder = "" if np.isnan(row["held_out_left"]) else f"{row['held_out_left']:.2f}"
        deviation = "" if np.isnan(row["worst_deg"]) else f"{row['worst_deg']:.1f}"
        sign_right = {True: "yes", False: "no"}.get(row["sign_right"], "")
        names = "; ".join(filter(None, ["yes" if row["named"] else "", row["beside"]])) or "nothing"
        signs = row["conducting"].replace("-", MINUS)
        objects = (names, signs, row["angle_deg"])
        lines.append((row["case"], *objects, remainder, sign_right, deviation))
    return markdown.table(head, lines)


def _lines_through(empty: pd.DataFrame) -> list[str]:
    """Of empty tanks read with two currents: the straight line through both readings."""
    head = (
        *("empty tanks read with two currents", "named", "straight line: offset, mV"),
        "rms that it leaves, of a line's through 0",
    )
    lines = []
    for row in empty.to_dict("records"):
        offset = f"{1e3 * row['line_offset_V']:.2f}".replace("-", MINUS)
        pair = f"{row['case'].split('empty ')[1]}, {row['currents']}"
        lines.append((pair, row["beside"] or "nothing", offset, f"{row['line_left']:.2f}"))
    return markdown.table(head, lines)


def _share(hits: pd.Series) -> str:
    n, k = len(hits), int(hits.sum())
    low, high = wilson(k, n) if n else (0.0, 1.0)
    return f"{k} of {n} ({percent(low)} to {percent(high)})"


def picture(table: pd.DataFrame, truths: dict[str, tuple | None]) -> Figure:
    """Every tank from above: discs as found, the electrodes that a folder names as dots outside,
    what each colour is."""
    rod = table["case"].str.startswith(f"{ROD} rod")
    tanks = table[~rod & ~table["case"].str.contains(" empty ")].to_dict("records")
    columns = 4
    rows = -(-(len(tanks) + 1) // columns)
    figure = Figure(figsize=(2.2 * columns, 2.5 * rows), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, columns).ravel()
    for ax, row in zip(axes, tanks, strict=False):
        _tank(ax, _title(row["case"]))
        _draw(ax, row)
        for sign, angle in truths[row["case"]] or ():
            if angle is not None:
                place = 1.15 * np.exp(1j * np.radians(angle))
                ax.plot(place.real, place.imag, "o", color=COLOURS[sign], ms=6)
    _tank(axes[len(tanks)], f"iirc: rod, {int(rod.sum())} frames, centres")
    for row in table[rod].to_dict("records"):
        if row["objects"] == 1:
            axes[len(tanks)].plot(float(row["x"]), float(row["y"]), ".", color=COLOURS[False], ms=3)
    for ax in axes[len(tanks) + 1 :]:
        ax.axis("off")
    dot: dict[str, Any] = {"marker": "o", "linestyle": ""}
    handles = [
        Line2D([], [], color=COLOURS[sign], ms=size, label=words, **dot)
        for sign, size, words in (
            (True, 10, "found: conducts better than the saline"),
            (False, 10, "found: conducts worse"),
            (True, 5, "outside: the electrode where the folder names metal"),
            (False, 5, "or plastic"),
        )
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=6.5, frameon=False)
    return figure


def _title(case: str) -> str:
    words = case.split()
    folder_words = words[1].replace("electrode", "").replace("_adj", "").replace("_", " ")
    moment = "".join(f", {word[11:]}" for word in words[2:])
    return f"{words[0].removesuffix('-tank')}{moment}\n{folder_words}"


def _tank(ax: Axes, title: str) -> None:
    angle = np.radians(ANGLES)
    ax.plot(*np.exp(1j * np.linspace(0, 2 * np.pi, 200)).view(float).reshape(-1, 2).T, "k", lw=0.8)
    ax.plot(np.cos(angle), np.sin(angle), "k.", ms=3)
    ax.set(xlim=(-1.25, 1.25), ylim=(-1.25, 1.25), aspect="equal")
    ax.axis("off")
    ax.set_title(title, fontsize=6.5)


def _draw(ax: Axes, row: dict) -> None:
    signs = row["conducting"].split()
    numbers = [[float(v) for v in row[key].split()] for key in ("x", "y", "radius")]
    turn = np.exp(1j * np.linspace(0, 2 * np.pi, 80))
    for sign, x, y, radius in zip(signs, *numbers, strict=True):
        edge = complex(x, y) + radius * turn
        ax.fill(edge.real, edge.imag, color=COLOURS[sign == "+"], alpha=0.7, lw=0)


def main(folder: Path) -> None:
    """Write objects.csv, objects.md and objects.png."""
    data = Path(os.environ["EITSKIN_DATA"])
    comparisons = cases(data)
    order = sorted(range(len(comparisons)), key=lambda i: crc32(comparisons[i].name.encode()))
    answers = {i: answer(comparisons[i], number, folder) for number, i in enumerate(order)}
    table = pd.DataFrame([judged(case, answers[i]) for i, case in enumerate(comparisons)])
    page_text = text(table)
    figure = picture(table, {case.name: case.truth for case in comparisons})
    with atomic_path(folder / "objects.csv") as temporary:
        temporary.write_text(table.to_csv(index=False), "utf-8")
    with atomic_path(folder / "objects.md") as temporary:
        temporary.write_text(page_text, "utf-8")
    with atomic_path(folder / "objects.png") as temporary:
        temporary.write_bytes(png(figure))
    print(page_text, end="")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
