"""What the answer of a diagnosis rests on, as HTML: each section of the report below the answer."""

import platform
from html import escape
from importlib.metadata import version

import numpy as np
import pandas as pd

from eitskin.diagnose.report.answer import expected_misfit, last_amount, own_sizes_misfit
from eitskin.diagnose.report.evidence import Evidence
from eitskin.diagnose.report.figures import has_hidden_errors, is_corrected
from eitskin.diagnose.report.markup import code, figure_row, numbers_unbroken, table
from eitskin.diagnose.search.gates import CLEARLY_DISTINCT, DISTINCT
from eitskin.diagnose.search.journal import CUT_SHORT, START
from eitskin.diagnose.verdict import refusals, rig_words
from eitskin.diagnose.verdict.atlas import DISCOVERY
from eitskin.diagnose.verdict.words import (
    frame_range,
    is_certain,
    last_scores,
    part_sentences,
    sites_text,
    value_texts,
)
from eitskin.effects import catalogue_names
from eitskin.quantities import NONE, chance, listed, number, percent, quantity

MOST_ROWS = 25  # of one atlas: with their sentences they fill a page of paper
LEAST_STRENGTH = 0.01  # noise units: weaker signatures differ in nothing that matters
PACKAGES = ("eitskin", "numpy", "scipy", "pandas", "matplotlib")  # that the numbers depend on


def parts(evidence: Evidence) -> str:
    """Of a recording with steps: which part the report is of, the findings in every part, and what
    each step changed; "" for a recording without steps."""
    parts_and_steps = part_sentences(evidence.diagnosis)
    if not parts_and_steps:
        return ""
    entries = evidence.diagnosis["parts"]
    stretches = [f"{frame_range(part['frames'])}, " for part in entries if "told" in part]
    lines = [
        "<h2>Before and after each step</h2>",
        "<p>The readings step, so that this recording is of more than one state of skin and rig."
        f" The rest of this report is of {''.join(stretches)}the longest part that could be"
        " diagnosed. What a step changed is found without a model of the skin.</p>",
    ]
    for head, sentences in parts_and_steps:
        lines.append(f"<h3>{escape(head)}</h3>")
        lines += [f"<p>{escape(sentence)}</p>" for sentence in sentences]
    return "\n".join(lines)


def corrected_by(evidence: Evidence) -> str:
    """With what the simulation after differs from that before, a phrase; "" for nothing."""
    diagnosis = evidence.diagnosis
    causes = [effect for effect in diagnosis["effects"] if is_certain(effect)]
    parts = ["what is certain"] if causes else []
    parts += ["the candidates"] if len(causes) < len(diagnosis["effects"]) else []
    parts += ["what is a little wrong everywhere"] if diagnosis.get("families") else []
    return f"with {listed(parts)}" if parts else ""


def hidden_caption(evidence: Evidence) -> dict[str, str]:
    """What the caption of the error before and after says of its readings, and of after."""
    of = "On the readings that the diagnosis never used."
    if not has_hidden_errors(evidence):
        of = "On the readings that the diagnosis used: none that it did not are kept here."
    after = corrected_by(evidence)
    is_apart = has_hidden_errors(evidence) and evidence.last_channels.any()
    comparison = ", before and after, in one scale" if is_corrected(evidence) else ""
    return {
        "channels": f"in {'the channels put aside' if is_apart else 'every channel'}{comparison}",
        "of": of,
        "after": f" After: {after}." if after else "",
        "white": "used by the diagnosis, or not read" if is_apart else "not read",
    }


def misfit_legend(evidence: Evidence) -> str:
    """What the figures of the misfit show, and what before and after stand for."""
    white_noise = "Noise alone gives 1."
    if evidence.has_rig_errors:
        white_noise = "Here it is white noise, which alone gives 1; the rig's errors come on top."
    after = corrected_by(evidence) or "the same, for nothing is named"
    return (
        "<p>Misfit is χ² per reading: the mean square of recording minus simulation in units of"
        f" the noise. {white_noise} <span class='before'>Before</span>: what its owner"
        f" believes of the skin, calibrated. <span class='after'>After</span>: {after}."
        "</p>"
    )


def last(evidence: Evidence) -> str:
    """The misfit of the readings that decided nothing, before and after; of those held out in turn
    where none were put aside."""
    scores, unit = last_scores(evidence.diagnosis), evidence.reading_unit
    heads = ["", "χ² per degree of freedom", "rms residual"]
    rows = [
        [
            f"<span class='{key}'>{key}</span>",
            number(scores[f"chi2_per_dof_{key}"]),
            quantity(scores[f"rms_{key}_V"], unit),
        ]
        for key in ("before", "after")
    ]
    lines = ["<h2>What decided nothing</h2>"]
    if evidence.has_last:
        lines.append(
            f"<p>{last_amount(evidence)} were put aside before anything was looked at, and read"
            " when all was decided.</p>"
        )
    else:
        lines = ["<h2>What was held out</h2>"]
    clause = expected_misfit(evidence)
    caption = f"{clause[0].upper()}{clause[1:]}."
    if evidence.has_rig_errors:
        heads.insert(2, "against white noise alone")
        for row, key in zip(rows, ("before", "after"), strict=True):
            row.insert(2, number(scores[f"white_chi2_per_dof_{key}"]))
        own = own_sizes_misfit(evidence)
        if own is not None:
            caption += (
                " Before and after have the rig's errors in the sizes that were learned after; in"
                f" the sizes learned before, the misfit before is {number(own)}."
            )
    return "\n".join([*lines, table(heads, rows, heads[1:], caption)])


def rig(evidence: Evidence) -> str:
    """The errors of the rig, a sentence each, and their sizes."""
    noise_entry = evidence.diagnosis.get("noise")
    if noise_entry is None:
        return ""
    sentences = rig_words.noise_sentences(noise_entry) or [
        "The recording shows no error of the rig."
    ]
    paragraphs = [f"<p>{numbers_unbroken(sentence)}</p>" for sentence in sentences]
    lines = ["<h2>The rig</h2>", *paragraphs]
    if evidence.diagnosis["verdict"] in ("partly-explained", "unexplained"):
        lines.append("<p>Part of what the simulation leaves out may count as the rig's here.</p>")
    if noise_entry.get("loud_frames") or noise_entry.get("jumps"):
        lines.append("<p class='quiet'>Frames are numbered from 0.</p>")
    if not evidence.has_rig_errors:
        return "\n".join(lines)
    rows = [
        [
            code(component["name"]),
            numbers_unbroken(rig_words.size_text(component)),
            "the recording" if component["learned"] else "assumed",
        ]
        for component in noise_entry["components"]
        if component["sd"] > 0.0
    ]
    caption = "Part of the noise that the recording is held against, not of what is missing."
    return "\n".join([*lines, table(["error", "size", "from"], rows, caption=caption)])


def unnamed(evidence: Evidence) -> str:
    """What has no name in the catalogue: its probability, and what its remainder looks like."""
    remainder = evidence.diagnosis["other"]
    probability = number(100 * remainder["probability"], 2)
    lines = [
        "<h2>What has no name</h2>",
        f"<p>Probability that something outside the catalogue is present: {probability} %.</p>",
    ]
    if remainder["sentence"]:
        lines.append(f"<p>{escape(remainder['sentence'])}</p>")
    facts = {
        "where": sites_text(remainder),
        "varies with": (
            remainder["driver"] if remainder["driver"] != "static" else "nothing (static)"
        ),
        "law": remainder["law"],
    }
    rows = [[label, escape(fact)] for label, fact in facts.items() if fact]
    return "\n".join([*lines, table(["what is left", ""], rows) if rows else ""])


def next_experiment(evidence: Evidence, figure: str) -> str:
    """The experiment proposed, and the gaps between names with it; figure: these as HTML."""
    experiment = evidence.experiment
    lines = ["<h2>The next experiment</h2>", f"<p>{escape(experiment['sentence'])}</p>"]
    if not experiment["pairs"]:
        return "\n".join(lines)
    rows = [
        [
            f"{code(pair['a'])} or {code(pair['b'])}",
            number(pair["gap_now"], 2),
            number(pair["gap_then"], 2),
            escape(pair["recipe"]),
        ]
        for pair in experiment["pairs"]
    ]
    heads = ["tells apart", "gap now", "gap then", "how"]
    caption = "Proved by simulating the frames proposed. Names with a gap under 3 are one class."
    return "\n".join([*lines, table(heads, rows, heads[1:3], caption), figure_row(figure)])


def unobservable(evidence: Evidence) -> str:
    """The names that this recording could not have shown, each with an experiment that would."""
    names = evidence.diagnosis["unobservable"]
    head = "<h2>What this recording could not have shown</h2>"
    if not names:
        return f"{head}\n<p>Every name of the catalogue would have shown.</p>"
    recipes = evidence.tables["identifiability"].set_index("name")["experiment"]
    rows = [[code(name), escape(recipes.get(name, "")) or NONE] for name in names]
    return f"{head}\n{table(['name', 'the experiment that would show it'], rows)}"


def why_not(evidence: Evidence) -> str:
    """The gate at which every name of the catalogue stopped that is not among the effects, with
    the value and the threshold there, in a table that unfolds."""
    head = "<h2>Why not …?</h2>"
    decisions = evidence.tables.get("decisions")
    if decisions is None:
        return (
            f"{head}\n<p>Where the other names of the catalogue stopped is not known: this"
            " diagnosis is of an earlier version, which did not record the decisions of its search."
            "</p>"
        )
    effects = [effect["name"] for effect in evidence.diagnosis["effects"]]
    stops = {stop.name: stop for stop in refusals.stops(decisions, effects)}
    rows = []
    for name in sorted(set(catalogue_names()) - set(effects)):
        if name not in stops:
            rows.append([code(name), NONE, NONE, NONE, "It met no gate."])
            continue
        stop = stops[name]
        passes = f"{stop.gate.passes} {stop.gate.threshold_text}"
        cells = [code(name), code(stop.gate.name), number(stop.value), passes]
        rows.append([*cells, escape(stop.sentence)])
    heads = ["name", "gate", "value", "passes", "in words"]
    caption = (
        "Gate: the rule that refused the name when it was last tried beside what is named above, or"
        " else when it was last tried at all. Value: the gate's statistic for this name; passes:"
        " the values that the gate lets through. <code>eitskin explain</code> prints the same."
    )
    summary = f"Where the {len(rows)} other names of the catalogue stopped"
    stops_table = table(heads, rows, ("value", "passes"), caption)
    return f"{head}\n<details><summary>{summary}</summary>\n{stops_table}\n</details>"


def identifiability(evidence: Evidence) -> str:
    """Strength of each name's signature, and its gap to the nearest rival."""
    rows = []
    effects = {effect["name"] for effect in evidence.diagnosis["effects"]}
    for row in evidence.tables["identifiability"].itertuples():
        if not row.observable:
            distinction = "not observable"
        elif np.isnan(row.gap) and row.name in effects:
            distinction = "yes, no rival"
        elif np.isnan(row.gap):
            observable = "taken as observable" if np.isnan(row.snr) else "observable"
            distinction = f"{observable}; not compared"
        elif not DISTINCT.admits(row.gap):
            distinction = "no, one class"
        else:
            distinction = "yes" if CLEARLY_DISTINCT.admits(row.gap) else "weakly"
        rival = code(row.nearest) if row.nearest else NONE
        strength = number(row.snr) if not 0 < row.snr < LEAST_STRENGTH else f"<{LEAST_STRENGTH}"
        cells = [code(row.name), escape(strength), rival, number(row.gap)]
        rows.append([*cells, distinction, escape(row.experiment)])
    heads = ["name", "strength", "nearest rival", "gap", "told apart?", "experiment"]
    caption = (
        "Strength: length in noise units of the signature at typical size; none is found of gross"
        " faults, of single channels and of a tone. Gap, of what is named: what is left of it after"
        " the rival has been fitted to it; under 3 the two are one class, under 5 they are told"
        " apart weakly."
    )
    names_table = table(heads, rows, ("strength", "gap"), caption)
    return f"<h2>What this recording can tell apart</h2>\n{names_table}"


def atlas(evidence: Evidence) -> str:
    """The statistics that are significant, before and after."""
    lines = ["<h2>The atlas: where simulation and recording differ</h2>"]
    for key in ("before", "after"):
        statistics = evidence.tables[f"atlas_{key}"]
        discoveries = statistics[statistics["q"] < DISCOVERY].sort_values("p", kind="stable")
        head = "Before" if key == "before" else "Left after"
        lines.append(f"<h3>{head}</h3>")
        count = f"{len(discoveries)} of {len(statistics)} statistics"
        if discoveries.empty:
            lines.append(f"<p>None of {len(statistics)} statistics is significant.</p>")
            continue
        heads = ["statistic", "site", "value", "dof", "p", "q", "free p", "in words"]
        rows = [
            [
                escape(row.statistic),
                escape(row.site),
                *(number(size) for size in (row.value, row.dof)),
                *(escape(chance(probability)) for probability in (row.p, row.q, row.free_p)),
                escape(row.sentence),
            ]
            for row in discoveries.head(MOST_ROWS).itertuples()
        ]
        excerpt = f"; the first {MOST_ROWS} are shown" if len(discoveries) > MOST_ROWS else ""
        caption = (
            f"{count} at a false discovery rate of {percent(DISCOVERY)}{excerpt}. Value: its χ², as"
            " large as dof where nothing is missing; p: the chance of as much then; q: the expected"
            " share of false discoveries among it and all rows above it; free p: the chance of as"
            " much beside its odd half of reciprocity, whatever the noise lasts."
        )
        lines.append(table(heads, rows, ("value", "dof", "p", "q", "free p"), caption))
    return "\n".join(lines)


def calibration(evidence: Evidence) -> str:
    """The calibrated values with their intervals."""
    head = "<h2>Calibrated values</h2>"
    rows = [
        [code(name), numbers_unbroken("; ".join(value_texts(estimate)))]
        for name, estimate in evidence.diagnosis["calibration"].items()
    ]
    if not rows:
        return f"{head}\n<p>Nothing was calibrated.</p>"
    return f"{head}\n{table(['name', 'value'], rows)}"


def noise(evidence: Evidence) -> str:
    """The noise of a reading, its range over the channels, and from what it was estimated."""
    unit, sd = evidence.reading_unit, evidence.noise_sd_V[np.isfinite(evidence.noise_sd_V)]
    smallest, largest = quantity(sd.min(), unit), quantity(sd.max(), unit)
    channel_range = f"{smallest} to {largest} over the channels"
    if smallest == largest:
        channel_range = "and in all others"
    return (
        "<h2>The noise</h2>\n"
        f"<p>Standard deviation of a reading: {quantity(evidence.diagnosis['noise_V'], unit)} in"
        f" the median channel, {channel_range}. Found from: {escape(evidence.noise_source)}"
        f" ({number(evidence.noise_dof)} degrees of freedom).</p>"
    )


def record(evidence: Evidence) -> str:
    """The steps of the search, the versions of the packages, and the hashes of the files."""
    lines = ["<h2>For the record</h2>", "<h3>The path of the search</h3>"]
    steps = evidence.tables["search"]
    if steps.empty:
        lines.append("<p>No step gained enough to be taken.</p>")
    else:
        lines.append(_steps_table(steps))
    if (steps["action"] == START).any():
        lines.append(
            f"<p>{START.capitalize()}: found before, on the frames in which nobody touches or on"
            " some of all, with p there, and fitted to all frames; those of an earlier diagnosis"
            " have no p there. χ² and log evidence of several stand at the last of them, for they"
            " are of all together.</p>"
        )
    if (steps["action"] == CUT_SHORT).any():
        lines.append(
            "<p>The search, or the comparison with other names after it, was cut short: it had"
            " solved as many skins as it may. Effects not tried by then are not excluded, and gaps"
            " found by then are those of the linearised model.</p>"
        )
    versions = [f"Python {platform.python_version()}"]
    versions += [f"{package} {version(package)}" for package in PACKAGES]
    lines.append(f"<h3>Versions</h3>\n<p>{escape(', '.join(versions))}</p>")
    rows = [[code(file), code(digest)] for file, digest in evidence.file_hashes.items()]
    lines.append(f"<h3>Files</h3>\n{table(['file', 'SHA-256'], rows)}")
    return "\n".join(lines)


def _steps_table(steps: pd.DataFrame) -> str:
    """The steps of the search; of several effects that it started with, χ² and log evidence stand
    in the row of the last."""
    started = steps["action"] == START
    continues = started & started.shift(-1, fill_value=False)
    continues &= steps["chi2"] == steps["chi2"].shift(-1)
    rows = [
        [
            number(row.step, 1),
            escape(row.action),
            code(row.effect),
            escape(row.sites),
            *(("", "") if is_continued else (number(row.chi2, 5), number(row.log_evidence, 5))),
            escape(chance(row.p_value)),
        ]
        for row, is_continued in zip(steps.itertuples(), continues, strict=True)
    ]
    heads = ["step", "action", "effect", "sites", "χ²", "log evidence", "p"]
    return table(heads, rows, ("step", "χ²", "log evidence", "p"))
