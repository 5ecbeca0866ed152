"""The report of a diagnosis: one HTML file for a person, with the figures inside and beside it."""

import platform
import re
from collections.abc import Iterable
from html import escape
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pandas as pd

from eitskin import cores, plotting
from eitskin.atomic import atomic_path
from eitskin.data import check
from eitskin.diagnose.report import evidence, figures
from eitskin.diagnose.report.evidence import Evidence
from eitskin.diagnose.search.gates import CLEARLY_DISTINCT, DISTINCT, NOTHING_UNNAMED
from eitskin.diagnose.search.journal import CUT_SHORT, START
from eitskin.diagnose.verdict import rig_words
from eitskin.diagnose.verdict.words import (
    APPROXIMATELY,
    NATS,
    UNITS,
    alternatives_sentence,
    bound_sentences,
    frame_range,
    headline,
    is_certain,
    part_sentences,
    place_text,
    range_text,
    repair_advice,
    sites_text,
    value_texts,
)
from eitskin.effects.effect import SITES
from eitskin.quantities import (
    NONE,
    chance,
    listed,
    number,
    percent,
    quantity,
)

MISFIT = 1.05  # chi squared per degree of freedom from which shares of it are told
SIGNIFICANT = 0.05  # false discovery rate below which a row of the atlas counts
MOST_ROWS = 25
NEEDED = ["x_mm", "y_mm", "force_N", "probe_mm"]  # of a touch, to be simulated
LEAST_STRENGTH = 0.01  # noise units: smaller ones are not told apart
PACKAGES = ("eitskin", "numpy", "scipy", "pandas", "matplotlib")
CAPTIONS = {
    "electrodes": "The ring of electrodes, numbered from 0. Numbers in discs mark what is named"
    " above, at its electrodes or place; arrows are drives, dotted lines measuring pairs.",
    "residual_matrix": "Every channel: what the simulation leaves, in one colour scale, or in one"
    f" each where they differ by more than {figures.APART} times. A dash: well below the"
    " simulation. Grey: channels that are not read. An electrode's fault shows as its two rows and"
    " columns, a gain as one row or column.",
    "misfit_force": "Misfit against force. Dots are frames, lines their means: before with squares,"
    " after with circles.",
    "misfit_time": "Misfit against time. Dots are frames, lines their means: before with squares,"
    " after with circles.",
    "misfit_place": "Misfit over the skin.",
    "held_out": "The misfit of what was held out: before a square, after a circle.",
    "rivals": "Each name taken out again, and others in its place: what was not put aside is held"
    " out in turn and predicted from the rest, against the noise and rig errors of all that is"
    " named. In brackets: the difference in log predictive density; below 0 is worse.",
    "next_experiment": "What the next experiment would tell apart. Shaded: a gap under 3, where"
    " names are one class.",
}
CSS = """
:root { color-scheme: light; background: #fff; }
body { font: 15px/1.5 system-ui, sans-serif; color: #1a1a1a; background: #fff; margin: 0 auto;
  padding: 1.5em; max-width: 60em; }
h1 { font-size: 1.5em; line-height: 1.25; margin: 0.2em 0; }
h2 { font-size: 1.15em; margin: 2em 0 0.4em; border-bottom: 1px solid #ccc; }
h3 { font-size: 1em; margin: 1.2em 0 0.3em; }
p { margin: 0.4em 0; max-width: 46em; }
.quiet, .caption, figcaption { color: #595959; }
.effect { border-left: 4px solid #8b1a6b; padding: 0.1em 0 0.1em 0.9em; margin: 1em 0;
  display: flex; flex-wrap: wrap; gap: 1.2em; align-items: flex-start; }
.effect > div { flex: 1 1 24em; }
.effect > div > p:first-of-type { font-size: 1.1em; font-weight: 600; }
.effect > figure { flex: 0 1 15em; margin: 0.3em 0; }
.warning { border: 1px solid #b84f00; padding: 0.2em 0.9em; margin: 0.6em 0; max-width: 46em; }
.candidate { border-left-style: dashed; }
.before { color: #b84f00; font-weight: 600; } .after { color: #0072b2; font-weight: 600; }
.row { display: flex; flex-wrap: wrap; gap: 1.2em; align-items: flex-start; }
figure { margin: 0.8em 0; flex: 1 1 22em; max-width: 29em; break-inside: avoid; }
figure svg { width: 100%; height: auto; display: block; }
figcaption, .caption { font-size: 0.87em; margin-top: 0.4em; }
.caption { margin: 0.6em 0 0; max-width: 53em; }
.wide { overflow-x: auto; margin: 0.2em 0 0.6em; }
table { border-collapse: collapse; font-size: 0.87em; width: 100%; }
th, td { text-align: left; padding: 0.2em 0.7em 0.2em 0; border-bottom: 1px solid #e4e4e4;
  vertical-align: top; }
th { border-bottom: 1px solid #888; }
td.n, th.n { text-align: right; white-space: nowrap; font-variant-numeric: tabular-nums; }
code { font-size: 0.93em; overflow-wrap: anywhere; } .kept { white-space: nowrap; }
@media screen { td code { white-space: nowrap; }
  td:nth-child(n + 4):last-child:not(.n) { min-width: 18em; } }
@media print { body { font-size: 10pt; padding: 0; max-width: none; } .wide { overflow: visible; }
  tr, .row, .effect { break-inside: avoid; } h2, h3, thead { break-after: avoid; } }
"""


def write(
    folder: str | Path,
    recording_path: str | Path,
    schema: str | Path,
    out: str | Path,
    predicted: str | Path | None = None,
) -> None:
    """Write the report of the diagnosis in `folder` to `out`, and figures/*.svg, *.png beside it;
    predicted: what was predicted of a query, where there was one.

    Equal inputs give equal bytes. Raises InputError as `evidence.read` does.
    """
    found = evidence.read(folder, recording_path, schema, predicted)
    drawn = figures.draw(found)
    pictures = cores.forked(lambda one: (plotting.svg(one), plotting.png(one)), drawn.values())
    inline = {}
    for (name, figure), (vectors, pixels) in zip(drawn.items(), pictures, strict=True):
        inline[name] = f"<p>{escape(figure)}</p>" if isinstance(figure, str) else vectors
        beside = Path(out).parent / "figures" / name
        with atomic_path(beside.with_suffix(".svg")) as path:
            path.write_text(vectors, encoding="utf-8")
        with atomic_path(beside.with_suffix(".png")) as path:
            path.write_bytes(pixels)
    changes = [plotting.svg(figure) if figure else "" for figure in figures.changes(found)]
    with atomic_path(out) as path:
        path.write_text(page(found, inline, changes), encoding="utf-8")


def page(found: Evidence, drawn: dict[str, str], changes: list[str]) -> str:
    """The report as HTML: no scripts, and nothing that it would have to fetch.

    drawn: each figure as SVG, or a paragraph that says why there is none; changes: what each effect
    changes, as SVG, or nothing.
    """
    name = escape(found.diagnosis["recording"])
    shown = {key: _figure(key, drawn[key], CAPTIONS[key]) for key in figures.FIGURES}
    sections = [
        _warnings(found),
        _answer(found, changes),
        _apart(found),
        "<h2>Where</h2>",
        _row(shown["electrodes"], shown["residual_matrix"]),
        "<h2>Where the misfit is, and where it went</h2>",
        "<p>Misfit is χ² per reading: the mean square of recording minus simulation in units of"
        f" the noise. {_white(found)} <span class='before'>Before</span>: what its owner"
        f" believes of the skin, calibrated. <span class='after'>After</span>: {_corrected(found)}."
        "</p>",
        _row(shown["misfit_force"], shown["misfit_time"], shown["misfit_place"]),
        _held_out(found),
        _row(shown["held_out"], shown["rivals"]),
        _rig(found),
        _other(found),
        _next(found, shown["next_experiment"]),
        _unobservable(found),
        _identifiability(found),
        _atlas(found),
        _calibration(found),
        _noise(found),
        _record(found),
    ]
    body = "\n".join(filter(None, sections))
    return (
        "<!DOCTYPE html>\n<html lang='en'>\n<head>\n<meta charset='utf-8'>\n"
        "<meta name='viewport' content='width=device-width, initial-scale=1'>\n"
        f"<title>Diagnosis of {name}</title>\n<style>{CSS}</style>\n</head>\n<body>\n"
        f"<p class='quiet'>Diagnosis of {name}</p>\n{body}\n</body>\n</html>\n"
    )


def inlined(svg: str, name: str, caption: str) -> str:
    """An SVG file's picture as an element of HTML: no prologue, no namespaces, ids of its own.

    name: what tells its ids from other figures'; caption: what is read out for it.
    """
    picture = svg[svg.index("<svg ") :]
    picture = re.sub(r"<metadata>.*?</metadata>", "", picture, flags=re.DOTALL)
    picture = re.sub(r' xmlns(:xlink)?="[^"]*"', "", picture).replace("xlink:href=", "href=")
    picture = re.sub(r'\bid="', f'id="{name}-', picture)
    picture = re.sub(r'href="#', f'href="#{name}-', picture)
    picture = picture.replace("url(#", f"url(#{name}-")
    label = escape(caption, quote=True)
    return picture.replace("<svg ", f'<svg role="img" aria-label="{label}" ', 1)


def _figure(name: str, drawn: str, caption: str) -> str:
    if not drawn.startswith("<?xml"):
        return drawn
    below = f"<figcaption>{escape(caption)}</figcaption>"
    return f"<figure>{inlined(drawn, name, caption)}{below}</figure>"


def _row(*items: str) -> str:
    """Figures side by side, then the sentences that stand for others."""
    pictures = [item for item in items if item.startswith("<figure")]
    row = f"<div class='row'>{''.join(pictures)}</div>" if pictures else ""
    return row + "".join(item for item in items if item not in pictures)


def _table(
    heads: list[str], rows: Iterable[list[str]], numbers: Iterable[str] = (), caption: str = ""
) -> str:
    """A table of cells that are HTML; the columns of `numbers` are aligned to the right."""
    kind = [" class='n'" if head in numbers else "" for head in heads]
    head = "".join(f"<th{k}>{h}</th>" for k, h in zip(kind, heads, strict=True))
    lines = [
        "<tr>" + "".join(f"<td{k}>{c}</td>" for k, c in zip(kind, row, strict=True)) + "</tr>"
        for row in rows
    ]
    above = f"<p class='caption'>{caption}</p>" if caption else ""
    table = f"{above}<div class='wide'><table><thead><tr>{head}</tr></thead>"
    return f"{table}<tbody>\n{chr(10).join(lines)}\n</tbody></table></div>"


def _warnings(found: Evidence) -> str:
    """What the recording's check warns of."""
    checked = check.check(found.recording)
    rows = [
        f"<li>{escape(finding.topic)}: {escape(finding.sentence)}</li>"
        for finding in (*checked.of_severity(check.ERROR), *checked.of_severity(check.WARNING))
    ]
    if not rows:
        return ""
    head = "The check of this recording warns:" if checked.ok else "This recording is not usable:"
    apart = ""
    if checked.of_topic("step"):
        apart = (
            "<p>What lies before a step and after it is diagnosed apart; <code>eitskin check</code>"
            " prints the commands that make a report of each part.</p>"
        )
    return f"<div class='warning'><p>{head}</p><ul>{''.join(rows)}</ul>{apart}</div>"


def _answer(found: Evidence, changes: list[str]) -> str:
    """The verdict in words, each effect in words, numbers and what to do."""
    diagnosis = found.diagnosis
    fit = diagnosis["fit"]["held_out"]
    parts = [f"<h1>{headline(diagnosis)}</h1>"]
    before, after = (
        f"<span class='{key}'>{number(fit[f'chi2_per_dof_{key}'])}</span>"
        for key in ("before", "after")
    )
    course = f"goes from {before} to {after}" if diagnosis["effects"] else f"is {before}"
    parts.append(
        f"<p>On {_put_aside(found)} held out, the misfit (χ² per degree of freedom) {course};"
        f" {_expected(found)}.</p>"
    )
    parts += [f"<p>{sentence}</p>" for sentence in _took_part(found)]
    if not NOTHING_UNNAMED.admits(diagnosis["other"]["probability"]):
        parts.append(f"<p>What has no name: {escape(diagnosis['other']['sentence'])}</p>")
    elif diagnosis["verdict"] == "partly-explained":
        parts.append("<p>What is left there is more than the noise.</p>")
    if diagnosis["effects"]:
        over = "A gain is over the best set without the effect, with another name in its place too."
        if len(diagnosis["effects"]) > 1:
            over += (
                " A share of the misfit is what comes back without the effect; shares need not add"
                " up to 100 %."
            )
        parts.append(f"<p class='quiet'>Gains are told in nats: {NATS} {over}</p>")
    for k, effect in enumerate(diagnosis["effects"]):
        change = _changed(k, changes[k], found) if any(changes[k : k + 1]) else ""
        parts.append(_effect(k + 1, effect, found, change))
    parts += [
        f"<p>{escape(sentence)}</p>" for sentence in bound_sentences(diagnosis["calibration"])
    ]
    if diagnosis["effects"]:
        parts.append(
            "<p class='quiet'>Electrodes and channels are numbered from 0; brackets hold 90 %"
            " intervals. The corrected simulator is <code>effects.yaml</code>, in the form that"
            " the configuration takes.</p>"
        )
    if found.predicted is not None:
        parts.append(_predicted(found))
    return "\n".join(parts)


def _apart(found: Evidence) -> str:
    """Of a recording with steps: which part the report is of, what was found of all of them, and
    what each step changed."""
    told = part_sentences(found.diagnosis)
    if not told:
        return ""
    of = [f"{frame_range(part['frames'])}, " for part in found.diagnosis["parts"] if "told" in part]
    lines = [
        "<h2>Before and after each step</h2>",
        "<p>The readings step, so that this recording is of more than one state of skin and rig."
        f" The rest of this report is of {''.join(of)}the longest part that could be diagnosed."
        " What a step changed is found without a model of the skin.</p>",
    ]
    for head, sentences in told:
        lines.append(f"<h3>{escape(head)}</h3>")
        lines += [f"<p>{escape(sentence)}</p>" for sentence in sentences]
    return "\n".join(lines)


def _changed(k: int, drawn: str, found: Evidence) -> str:
    """The picture of what effect k changes, in words of the frame that it is of."""
    frame = found.frames.iloc[found.changed_frame[k]]
    state = "an untouched frame"
    if frame["touch"]:
        known = np.isfinite(frame["force_N"])
        state = f"a frame touched with {number(frame['force_N'])} N" if known else "a touched frame"
    caption = (
        f"What it changes in {state}, that in which it changes most; a dash: the reading falls."
    )
    return _figure(f"change_{k}", drawn, caption)


def _effect(k: int, effect: dict, found: Evidence, change: str) -> str:
    lines = [f"<p>{k}. {_kept(effect['sentence'])}</p>"]
    place = place_text(effect)
    varies = "static" if effect["driver"] == "static" else f"varies with {effect['driver']}"
    named = f"<code>{escape(effect['name'])}</code>"
    sure = is_certain(effect)
    head = f"{named}{'' if sure else ', a candidate'}, {escape(place)}, {escape(varies)}"
    told = effect["parameters"] | effect.get("amounts", {})
    values = [_parameter(key, each, effect) for key, each in told.items()]
    lines.append(f"<p>{'; '.join([head, *values])}.</p>")
    bench = "At the bench" if sure else "At the bench, to try"
    lines.append(f"<p>{bench}: {escape(repair_advice(effect, found.channels))}</p>")
    evidence_ = effect["evidence"]
    error = float(f"{evidence_['elpd_se']:.2g}")
    gain = f"gains {number(evidence_['elpd_gain'])} ± {number(error, 2)} nats"
    text = f"On what was held out it {gain}"
    if found.diagnosis["fit"]["held_out"]["chi2_per_dof_before"] > MISFIT:
        share = f"It explains {number(100 * effect['share'])} % of the misfit on what was held out"
        text = f"{share}, {gain} there"
    chance_ = chance(evidence_["p_value"])
    lines.append(f"<p>{_kept(f'{text}; p = {chance_}.')}</p>")
    if effect["alternatives"]:
        lines.append(f"<p>{escape(alternatives_sentence(effect))}</p>")
    elif effect["gap"] is not None:
        gap = number(effect["gap"])
        lines.append(f"<p>The gap to the nearest other name is {gap} in noise units.</p>")
    else:
        lines.append("<p>No other name looks like it.</p>")
    kind = "effect" if sure else "effect candidate"
    said = "\n".join(lines)
    return f"<div class='{kind}'><div>{said}</div>{change}</div>"


def _parameter(name: str, estimate: dict, effect: dict) -> str:
    """One parameter with its interval; of a list, its range and, where values are told apart, where
    it is farthest out."""
    label, texts = f"<code>{escape(name)}</code>", value_texts(estimate)
    if not isinstance(estimate["value"], list):
        return f"{label} = {_kept(texts[0])}"
    value = np.array(estimate["value"])
    kind = next(kind for kind in SITES if effect[kind])
    if len(value) <= 4:
        each = [
            f"{text} at {sites_text({kind: [site]})}"
            for site, text in zip(effect[kind], texts, strict=True)
        ]
        return f"{label} = {_kept(listed(each))}"
    text = range_text(estimate, texts)
    if not text.startswith(APPROXIMATELY):
        far = int(np.argmax(np.abs(value - np.median(value))))
        text = f"{text}, farthest out at {sites_text({kind: [effect[kind][far]]})}"
    return f"{label} {_kept(text)}"


def _kept(text: str) -> str:
    """A text as HTML whose numbers stay on one line with their signs and units."""
    kept = r"(?<!\S)(?:\(90 %:|± \S+ \S+|p = \S+)"
    return re.sub(kept, r"<span class='kept'>\g<0></span>", escape(text))


def _unit(found: Evidence) -> str:
    return UNITS[found.recording.metadata["unit"]]


def _predicted(found: Evidence) -> str:
    table = found.predicted
    assert table is not None
    sd, size = (float(table[key].median()) for key in ("std_V", "voltage_V"))
    return (
        f"<p>The {len(table)} states of the query are predicted in <code>predicted.parquet</code>:"
        f" median reading {quantity(size, _unit(found))}, standard deviation of the prediction"
        f" {quantity(sd, _unit(found), 2)}.</p>"
    )


def _expected(found: Evidence) -> str:
    """What the misfit is where nothing is missing."""
    if figures.learned(found):
        return "noise and the rig's errors alone give 1"
    return "noise alone gives 1"


def _white(found: Evidence) -> str:
    """What the misfit of a frame is where nothing is missing."""
    if figures.learned(found):
        return "Here it is white noise, which alone gives 1; the rig's errors come on top."
    return "Noise alone gives 1."


def _corrected(found: Evidence) -> str:
    """What "after" stands for."""
    if found.diagnosis["effects"]:
        return "with what is named above"
    return "the same, for nothing is named"


def _put_aside(found: Evidence) -> str:
    """What was held out, as a noun."""
    channels = found.held_out_channels
    if channels.any():
        return f"{channels.sum()} of {len(channels)} channels"
    return f"{found.diagnosis['fit']['held_out']['frames']} frames"


def _took_part(found: Evidence) -> list[str]:
    """Which frames took no part in the diagnosis, a sentence each."""
    said = []
    count, whole = len(found.frames), len(found.recording.frames)
    if count < whole:
        said.append(f"An excerpt was diagnosed: {count} of {whole} frames.")
    touched = found.frames[found.frames["touch"]]
    unknown = touched[NEEDED].isna().any(axis=1).sum()
    if unknown:
        said.append(
            f"Of {len(touched)} touched frames {unknown} took no part: their place, force or probe"
            " is not known."
        )
    return said


def _held_out(found: Evidence) -> str:
    fit, unit = found.diagnosis["fit"]["held_out"], _unit(found)
    heads = ["", "χ² per degree of freedom", "rms residual"]
    rows = [
        [
            f"<span class='{key}'>{key}</span>",
            number(fit[f"chi2_per_dof_{key}"]),
            quantity(fit[f"rms_{key}_V"], unit),
        ]
        for key in ("before", "after")
    ]
    lines = ["<h2>What was held out</h2>"]
    if found.frames["held_out"].any() or found.held_out_channels.any():
        lines.append(
            f"<p>{_put_aside(found)} were put aside before anything was looked at; what was found"
            " is held against them.</p>"
        )
    if figures.learned(found):
        heads.insert(2, "against white noise alone")
        for row, key in zip(rows, ("before", "after"), strict=True):
            row.insert(2, number(fit[f"white_chi2_per_dof_{key}"]))
    expected = _expected(found)
    caption = f"{expected[0].upper()}{expected[1:]}."
    return "\n".join([*lines, _table(heads, rows, heads[1:], caption)])


def _rig(found: Evidence) -> str:
    """What was found of the rig: a sentence each, and the sizes."""
    noise = found.diagnosis.get("noise")
    if noise is None:
        return ""
    told = rig_words.noise_sentences(noise) or ["The recording shows no error of the rig."]
    lines = ["<h2>The rig</h2>", *(f"<p>{_kept(sentence)}</p>" for sentence in told)]
    if found.diagnosis["verdict"] in ("partly-explained", "unexplained"):
        lines.append("<p>Part of what the simulation leaves out may count as the rig's here.</p>")
    if noise.get("loud_frames") or noise.get("jumps"):
        lines.append("<p class='quiet'>Frames are numbered from 0.</p>")
    if not noise["components"]:
        return "\n".join(lines)
    rows = [
        [
            f"<code>{escape(component['name'])}</code>",
            _kept(rig_words.size_text(component)),
            "the recording" if component["learned"] else "assumed",
        ]
        for component in noise["components"]
    ]
    caption = "Part of the noise that the recording is held against, not of what is missing."
    return "\n".join([*lines, _table(["error", "size", "from"], rows, caption=caption)])


def _other(found: Evidence) -> str:
    other = found.diagnosis["other"]
    likely = number(100 * other["probability"], 2)
    lines = [
        "<h2>What has no name</h2>",
        f"<p>Probability that something outside the catalogue is present: {likely} %.</p>",
    ]
    if other["sentence"]:
        lines.append(f"<p>{escape(other['sentence'])}</p>")
    facts = {
        "where": sites_text(other),
        "varies with": other["driver"] if other["driver"] != "static" else "nothing (static)",
        "law": other["law"],
    }
    rows = [[label, escape(fact)] for label, fact in facts.items() if fact]
    return "\n".join([*lines, _table(["what is left", ""], rows) if rows else ""])


def _next(found: Evidence, figure: str) -> str:
    experiment = found.experiment
    lines = ["<h2>The next experiment</h2>", f"<p>{escape(experiment['sentence'])}</p>"]
    if not experiment["pairs"]:
        return "\n".join(lines)
    rows = [
        [
            f"<code>{escape(pair['a'])}</code> or <code>{escape(pair['b'])}</code>",
            number(pair["gap_now"], 2),
            number(pair["gap_then"], 2),
            escape(pair["recipe"]),
        ]
        for pair in experiment["pairs"]
    ]
    heads = ["tells apart", "gap now", "gap then", "how"]
    caption = "Proved by simulating the frames proposed. Names with a gap under 3 are one class."
    return "\n".join([*lines, _table(heads, rows, heads[1:3], caption), _row(figure)])


def _unobservable(found: Evidence) -> str:
    names = found.diagnosis["unobservable"]
    head = "<h2>What this recording could not have shown</h2>"
    if not names:
        return f"{head}\n<p>Every name of the catalogue would have shown.</p>"
    table = found.tables["identifiability"].set_index("name")["experiment"]
    rows = [[f"<code>{escape(name)}</code>", escape(table.get(name, "")) or NONE] for name in names]
    return f"{head}\n{_table(['name', 'the experiment that would show it'], rows)}"


def _identifiability(found: Evidence) -> str:
    rows = []
    named = {effect["name"] for effect in found.diagnosis["effects"]}
    for row in found.tables["identifiability"].itertuples():
        if not row.observable:
            told = "not observable"
        elif np.isnan(row.gap) and row.name in named:
            told = "yes, no rival"
        elif np.isnan(row.gap):
            seen = "taken as observable" if np.isnan(row.snr) else "observable"
            told = f"{seen}; not compared"
        elif not DISTINCT.admits(row.gap):
            told = "no, one class"
        else:
            told = "yes" if CLEARLY_DISTINCT.admits(row.gap) else "weakly"
        nearest = f"<code>{escape(row.nearest)}</code>" if row.nearest else NONE
        strength = number(row.snr) if not 0 < row.snr < LEAST_STRENGTH else f"<{LEAST_STRENGTH}"
        cells = [f"<code>{escape(row.name)}</code>", escape(strength), nearest, number(row.gap)]
        rows.append([*cells, told, escape(row.experiment)])
    heads = ["name", "strength", "nearest rival", "gap", "told apart?", "experiment"]
    caption = (
        "Strength: length in noise units of the signature at typical size; none is found of gross"
        " faults, of single channels and of a tone. Gap, of what is named: what is left of it after"
        " the rival has been fitted to it; under 3 the two are one class, under 5 they are told"
        " apart weakly."
    )
    table = _table(heads, rows, ("strength", "gap"), caption)
    return f"<h2>What this recording can tell apart</h2>\n{table}"


def _atlas(found: Evidence) -> str:
    parts = ["<h2>The atlas: where simulation and recording differ</h2>"]
    for key in ("before", "after"):
        table = found.tables[f"atlas_{key}"]
        rows = table[table["q"] < SIGNIFICANT].sort_values("p", kind="stable")
        word = "Before" if key == "before" else "Left after"
        parts.append(f"<h3>{word}</h3>")
        count = f"{len(rows)} of {len(table)} statistics"
        if rows.empty:
            parts.append(f"<p>None of {len(table)} statistics is significant.</p>")
            continue
        heads = ["statistic", "site", "value", "dof", "p", "q", "in words"]
        cells = [
            [
                escape(row.statistic),
                escape(row.site),
                *(number(x) for x in (row.value, row.dof)),
                *(escape(chance(x)) for x in (row.p, row.q)),
                escape(row.sentence),
            ]
            for row in rows.head(MOST_ROWS).itertuples()
        ]
        more = f"; the first {MOST_ROWS} are shown" if len(rows) > MOST_ROWS else ""
        caption = (
            f"{count} at a false discovery rate of {percent(SIGNIFICANT)}{more}. Value: its χ², as"
            " large as dof where nothing is missing; p: the chance of as much then; q: the expected"
            " share of false discoveries among it and all rows above it."
        )
        parts.append(_table(heads, cells, ("value", "dof", "p", "q"), caption))
    return "\n".join(parts)


def _calibration(found: Evidence) -> str:
    head = "<h2>Calibrated values</h2>"
    rows = [
        [f"<code>{escape(name)}</code>", _kept("; ".join(value_texts(each)))]
        for name, each in found.diagnosis["calibration"].items()
    ]
    if not rows:
        return f"{head}\n<p>Nothing was calibrated.</p>"
    return f"{head}\n{_table(['name', 'value'], rows)}"


def _noise(found: Evidence) -> str:
    unit, sd = _unit(found), found.noise_V[np.isfinite(found.noise_V)]
    least, most = quantity(sd.min(), unit), quantity(sd.max(), unit)
    over = f"{least} to {most} over the channels" if least != most else "and in all others"
    return (
        "<h2>The noise</h2>\n"
        f"<p>Standard deviation of a reading: {quantity(found.diagnosis['noise_V'], unit)} in the"
        f" median channel, {over}. Found from: {escape(found.noise_source)}"
        f" ({number(found.noise_dof)} degrees of freedom).</p>"
    )


def _record(found: Evidence) -> str:
    parts = ["<h2>For the record</h2>", "<h3>The path of the search</h3>"]
    search = found.tables["search"]
    if search.empty:
        parts.append("<p>No step gained enough to be taken.</p>")
    else:
        started = search["action"] == START
        goes_on = started & started.shift(-1, fill_value=False)
        goes_on &= search["chi2"] == search["chi2"].shift(-1)
        rows = [
            [
                number(row.step, 1),
                escape(row.action),
                f"<code>{escape(row.effect)}</code>",
                escape(row.sites),
                *(("", "") if on else (number(row.chi2, 5), number(row.log_evidence, 5))),
                escape(chance(row.p_value)),
            ]
            for row, on in zip(search.itertuples(), goes_on, strict=True)
        ]
        heads = ["step", "action", "effect", "sites", "χ²", "log evidence", "p"]
        parts.append(_table(heads, rows, ("step", "χ²", "log evidence", "p")))
    if (search["action"] == START).any():
        parts.append(
            f"<p>{START.capitalize()}: found before, on the frames in which nobody touches or on"
            " some of all, with p there, and fitted to all frames; those of an earlier diagnosis"
            " have no p there. χ² and log evidence of several stand at the last of them, for they"
            " are of all together.</p>"
        )
    if (search["action"] == CUT_SHORT).any():
        parts.append(
            "<p>The search, or the comparison with other names after it, was cut short: it had"
            " solved as many skins as it may. Effects not tried by then are not excluded, and gaps"
            " found by then are those of the linearised model.</p>"
        )
    versions = [f"Python {platform.python_version()}"]
    versions += [f"{package} {version(package)}" for package in PACKAGES]
    parts.append(f"<h3>Versions</h3>\n<p>{escape(', '.join(versions))}</p>")
    files = pd.Series(found.hashes).items()
    rows = [[f"<code>{escape(file)}</code>", f"<code>{digest}</code>"] for file, digest in files]
    parts.append(f"<h3>Files</h3>\n{_table(['file', 'SHA-256'], rows)}")
    return "\n".join(parts)
