"""The page of a comparison: what changed, what is shared, and one figure."""

import base64
from collections.abc import Callable, Iterable
from html import escape
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from eitskin.atomic import atomic_path
from eitskin.diagnose.comparison.sentences import NOTHING
from eitskin.diagnose.report.page import CSS
from eitskin.diagnose.verdict.words import NATS, sites
from eitskin.plotting import AFTER, CULPRIT, QUIET, WIDTH_IN, style, svg
from eitskin.quantities import chance, listed, number

MOST_PANELS = 6
MOST_ROWS = 40
SHORT = 12  # letters of a part's name that stand level under an axis of two parts
CAPTION = (
    "The values most likely to have changed, part by part, with 90 % intervals: purple diamonds"
    " where they did change, grey circles where they did not. Blue bands: the value of the parts"
    " that share one, with its 90 % interval."
)


def page(said: dict) -> str:
    """A comparison (comparison.json) as HTML: no scripts, and nothing that it would fetch."""
    if said["held_out"] is None:
        return _html(escape(listed(said["parts"])), _of_difference(said))
    changed = [row for row in said["tested"] if row["changed"]]
    shared = [row for row in said["tested"] if not row["changed"]]
    of = escape(listed(said["parts"]))
    lines = [f"<p class='quiet'>{of}: one skin compared</p>"]
    if said.get("difference"):
        lines = [*_of_difference(said), "<h2>Between the diagnoses</h2>"]
    sentences = [row["sentence"] for row in changed] or [NOTHING]
    if changed:
        several = f"{len(changed)} values have" if len(changed) > 1 else "One value has"
        lines.append(f"<h1>{several} changed.</h1>")
        lines += [f"<div class='effect'><p>{escape(s)}</p></div>" for s in sentences]
    else:
        lines += [f"<h1>{escape(s)}</h1>" for s in sentences]
    lines.append(_held_out(said["held_out"], bool(changed)))
    if not changed and said["p_value"] is not None:
        lines.append(
            "<p>Single tests ask for changes, but all of them together make the joint fit no better"
            f" than noise would (p = {escape(chance(said['p_value']))}).</p>"
        )
    picture = figure(said)
    if picture is not None:
        data = base64.b64encode(svg(picture).encode()).decode()
        image = f"<img src='data:image/svg+xml;base64,{data}' alt='{CAPTION}' style='width:100%'>"
        lines.append(f"<figure>{image}<figcaption>{CAPTION}</figcaption></figure>")
    lines.append("<h2>What is shared</h2>")
    told = sorted((r for r in shared if r["runs"][0]["parts"]), key=_p)
    lines += [f"<p>{escape(row['sentence'])}</p>" for row in told[:MOST_ROWS]]
    if len(told) > MOST_ROWS:
        lines.append(f"<p>And {len(told) - MOST_ROWS} more, in comparison.json.</p>")
    lines.append("<h2>Every test</h2>")
    rows = sorted(said["tested"], key=_p)
    heads = ["value", "where", "χ²", "dof", "p", "q", "changed"]
    caption = "Equality over all parts that have the value. q: the share of false discoveries."
    if len(rows) > MOST_ROWS:
        caption += f" The first {MOST_ROWS} of {len(rows)} are shown."
    lines.append(_table(heads, (_cells(row) for row in rows[:MOST_ROWS]), caption))
    return _html(of, lines)


def _html(title: str, lines: list[str]) -> str:
    body = "\n".join(lines)
    return (
        "<!DOCTYPE html>\n<html lang='en'>\n<head>\n<meta charset='utf-8'>\n"
        "<meta name='viewport' content='width=device-width, initial-scale=1'>\n"
        f"<title>{title}</title>\n<style>{CSS}</style>\n</head>\n<body>\n{body}\n</body>\n</html>\n"
    )


def _of_difference(said: dict) -> list[str]:
    """What the readings themselves say, without a model of the skin."""
    found = said["difference"]
    told = len(found["found"]) or bool(found["lost_channels"])
    own = [one["sentence"] for one in found["found"]]
    before = {row["sentence"] for row in said["tested"]}
    rest = [s for s in said["sentences"] if s not in own and s not in before]
    first = own or rest[:1]
    lines = [f"<p class='quiet'>{escape(listed(said['parts']))}: one skin compared</p>"]
    head = "Between the readings something changed." if told else first[0]
    lines.append(f"<h1>{escape(head)}</h1>")
    if told:
        lines += [f"<div class='effect'><p>{escape(s)}</p></div>" for s in [*own, *rest]]
    else:
        lines += [f"<p>{escape(s)}</p>" for s in rest[1:]]
    frames = " and ".join(str(n) for n in found["untouched_frames"])
    lines.append(
        f"<p class='quiet'>Found from {frames} untouched frames, but for objects without a model of"
        f" the skin. A name needs {number(found['threshold_nats'])} nats of evidence and"
        f" {number(found['margin_nats'])} more than any other site: with 1 nat more the readings"
        " are e = 2.7 times more probable, with 10 nats 22000 times.</p>"
    )
    return lines


def _p(row: dict) -> float:
    return 2.0 if row["p"] is None else row["p"]


def _held_out(held: dict, changed: bool) -> str:
    found = number(held["chi2_per_dof_as_found"])
    if not changed:
        return (
            f"<p>With one value for all parts, the misfit on {held['frames']} frames held out (χ²"
            f" per degree of freedom) is <span class='after'>{found}</span>; noise alone gives 1."
            "</p>"
        )
    shared = number(held["chi2_per_dof_all_shared"])
    gain, error = number(held["elpd_gain"]), number(held["elpd_se"], 2)
    return (
        f"<p>On {held['frames']} frames held out, the misfit (χ² per degree of freedom) is"
        f" <span class='before'>{shared}</span> if nothing changed and"
        f" <span class='after'>{found}</span> with these changes, which gain {gain} ± {error} nats;"
        f" noise alone gives 1.</p>\n<p class='quiet'>{NATS}</p>"
    )


def _cells(row: dict) -> list[str]:
    name = row["name"] if row["calibration"] else " ".join([row["name"], *row["parameters"]])
    dof = "" if row["dof"] is None else str(row["dof"])
    shown = ["" if row[k] is None else escape(form(row[k])) for k, form in FORMS.items()]
    shown.insert(1, dof)
    told = "" if row["p"] is None else "yes" if row["changed"] else "no"
    return [f"<code>{escape(name)}</code>", escape(sites(row)), *shown, told]


FORMS: dict[str, Callable[[float], str]] = {"chi2": number, "p": chance, "q": chance}


def _table(heads: list[str], rows: Iterable[list[str]], caption: str) -> str:
    """A table of cells that are HTML; but for the first two and the last, numbers."""
    kinds = ["", "", *[" class='n'"] * (len(heads) - 3), ""]
    head = "".join(f"<th{k}>{h}</th>" for k, h in zip(kinds, heads, strict=True))
    lines = [
        "<tr>" + "".join(f"<td{k}>{c}</td>" for k, c in zip(kinds, row, strict=True)) + "</tr>"
        for row in rows
    ]
    table = (
        f"<p class='caption'>{caption}</p><div class='wide'><table><thead><tr>{head}</tr></thead>"
    )
    return f"{table}<tbody>\n{chr(10).join(lines)}\n</tbody></table></div>"


def figure(said: dict) -> Figure | None:
    """The values with the smallest p, a panel each, over the parts; None where there are none."""
    rows = sorted((r for r in said["tested"] if r["p"] is not None and r["parts"]), key=_p)
    rows = rows[:MOST_PANELS]
    if not rows:
        return None
    names = said["parts"]
    ticks = [name.removeprefix("session ") for name in names]
    columns = min(len(rows), 2)
    longest = max(map(len, ticks))
    level = len(names) * longest <= SHORT * 2
    height = 34.0 if level else 32.0 + 0.7 * longest
    with style():
        found = Figure(figsize=(WIDTH_IN, (2 + height * -(-len(rows) // columns)) / 25.4))
        FigureCanvasAgg(found)
        panels = np.atleast_1d(found.subplots(-(-len(rows) // columns), columns)).ravel()
        for axes, row in zip(panels, rows, strict=False):
            _panel(axes, row, names)
            axes.set_xticks(range(len(names)), ticks)
            axes.set_xlabel("session" if ticks != names else "")
            if not level:
                axes.tick_params(axis="x", rotation=35)
                for tick in axes.get_xticklabels():
                    tick.set(ha="right", rotation_mode="anchor")
        for axes in panels[len(rows) :]:
            axes.set_axis_off()
    return found


def _panel(axes: Axes, row: dict, names: list[str]) -> None:
    key = row["parameters"][0]
    colour, marker = (CULPRIT, "D") if row["changed"] else (QUIET, "o")
    for run in row["runs"]:
        at = [names.index(name) for name in run["parts"]]
        if len(at) < 2 and len(row["runs"]) < 2:
            continue
        value = run["values"][key]
        ends = min(at) - 0.3, max(at) + 0.3
        axes.fill_between(ends, value["low"], value["high"], color=AFTER, alpha=0.25, linewidth=0)
        axes.plot(ends, [value["value"]] * 2, color=AFTER, linewidth=0.9)
    for name, values in row["parts"].items():
        value, there = values[key], names.index(name)
        axes.plot([there, there], [value["low"], value["high"]], color=colour, linewidth=1.2)
        axes.plot(there, value["value"], marker, color=colour, markersize=3.2)
    unit = next(iter(row["parts"].values()))[key]["unit"]
    where = sites(row)
    title = row["name"] if not row["calibration"] else "calibration"
    axes.set_title(f"{title}\n{where}" if where else title, color=colour)
    label = key.removesuffix(f"_{unit}").replace("_S_per_m", "").replace("_", " ")
    axes.set_ylabel(label if unit == "1" else f"{label}, {unit}")
    axes.set_xlim(-0.5, len(names) - 0.5)
    axes.ticklabel_format(axis="y", useOffset=False)
    axes.locator_params(axis="y", nbins=4)


def write(said: dict, path: str | Path) -> None:
    """Write the page of a comparison, whole or not at all."""
    with atomic_path(path) as temporary:
        temporary.write_text(page(said), "utf-8")
