"""The answer of a diagnosis as HTML: what is certain and what it changed, what is a little wrong
everywhere, candidates, what is not known, and how to use it."""

import re
from html import escape

import numpy as np
import pandas as pd

from eitskin.data import check
from eitskin.data.dataset import no_training
from eitskin.diagnose.noise.noise_model import NORMAL_90
from eitskin.diagnose.report.evidence import Evidence
from eitskin.diagnose.report.markup import code, figure, numbers_unbroken
from eitskin.diagnose.verdict import opening
from eitskin.diagnose.verdict.words import (
    APPROXIMATELY,
    MOST_VALUES,
    alternatives_sentence,
    headline,
    is_certain,
    last_scores,
    place_text,
    range_text,
    repair_advice,
    sites_text,
    size_sentences,
    unlabelled_sentences,
    value_texts,
)
from eitskin.effects.effect import SITES
from eitskin.quantities import chance, interval, listed, number, quantity

SITE_NOUNS = {  # of members of families
    "drive-gain": "the drive from electrode",
    "measurement-gain": "the measuring pair at electrode",
    "offset": "the measuring pair at electrode",
    "electrode-position": "electrode",
    "electrode-width": "electrode",
    "contact-impedance": "electrode",
    "ground-leak": "electrode",
}
TOUCH_COLUMNS = {  # that the simulation of a touch needs
    "x_mm": "place",
    "y_mm": "place",
    "force_N": "force",
    "probe_mm": "probe",
}


def warnings(evidence: Evidence) -> str:
    """What the check of the recording warns of, folded unless it is unusable; "" for nothing."""
    report = check.check(evidence.recording)
    found = (*report.of_severity(check.ERROR), *report.of_severity(check.WARNING))
    items = [f"<li>{escape(finding.topic)}: {_marked(finding.sentence)}</li>" for finding in found]
    if not items:
        return ""
    advice = ""
    if report.of_topic("step"):
        advice = (
            "<p>What lies before a step and after it is diagnosed apart; <code>eitskin check</code>"
            " prints the commands that make a report of each part.</p>"
        )
    if len(items) == 1 and report.ok and not advice:
        return f"<div class='warning'><p>The check warns: {_marked(found[0].sentence)}</p></div>"
    listing = f"<ul>{''.join(items)}</ul>{advice}"
    if not report.ok:
        return f"<div class='warning'><p>This recording is not usable:</p>{listing}</div>"
    topics = listed([*dict.fromkeys(finding.topic for finding in found)])
    head = f"The check of this recording warns: {escape(topics)}"
    return f"<details class='warning'><summary>{head}</summary>{listing}</details>"


def _marked(sentence: str) -> str:
    """A sentence of the check as HTML, what a person types in it as code."""
    return re.sub("`([^`]+)`", r"<code>\1</code>", escape(sentence))


def answer(evidence: Evidence, hidden: str) -> str:
    """What is certain and what to do about it, what it changed, what is a little wrong everywhere,
    what may be so, what is not known, and what to use it for; hidden: the picture of the error on
    readings that decided nothing, as HTML."""
    diagnosis = evidence.diagnosis
    certain, candidates = opening.findings(diagnosis)
    lead = opening.extent(diagnosis)
    error = opening.error_sentence(diagnosis, evidence.reading_unit)
    parts = [
        f"<h1>{numbers_unbroken(opening.opening(diagnosis, evidence.channels))}</h1>",
        f"<p>{numbers_unbroken(' '.join(filter(None, [lead, error])))}</p>",
    ]
    if certain:
        parts.append(_findings("What is certain", certain, evidence))
    changed = f"<div class='changed'>{hidden}</div>" if hidden else ""
    rest = _families(diagnosis.get("families", []))
    if candidates:
        rest.append(_findings("Candidates, to be tried", candidates, evidence))
    unknown = [*size_sentences(diagnosis), *_unknown_touches(evidence)]
    unknown += opening.unknown_sentences(diagnosis)
    experiment = opening.experiment_sentence(diagnosis, evidence.experiment)
    if unknown or experiment:
        rest.append("<h2>What is not known</h2>")
        items = [f"<li>{numbers_unbroken(sentence)}</li>" for sentence in unknown]
        rest += [f"<ul>{''.join(items)}</ul>"] if items else []
        rest += [f"<p><b>{numbers_unbroken(experiment)}</b></p>"] if experiment else []
    rest.append(_use(evidence))
    text = "\n".join(parts), "\n".join(rest)
    return f"<main>\n<div>{text[0]}</div>\n{changed}\n<div>{text[1]}</div>\n</main>"


def _findings(head: str, effects: list[dict], evidence: Evidence) -> str:
    """Effects of diagnosis.json under a heading: each in a sentence, with what to do."""
    items = []
    for effect in effects:
        effect_is_certain = is_certain(effect)
        sentence = effect["sentence"] if effect_is_certain else opening.candidate_sentence(effect)
        spoken = effect if effect_is_certain else opening.plainest(effect)
        advice = repair_advice(spoken, evidence.channels)
        html_class = "effect" if effect_is_certain else "effect candidate"
        items.append(
            f"<div class='{html_class}'><div><p>{numbers_unbroken(sentence)}</p>"
            f"<p>At the bench: {escape(advice)}</p></div></div>"
        )
    return f"<h2>{head}</h2>\n{''.join(items)}"


def _use(evidence: Evidence) -> str:
    """How to use the corrected simulator."""
    sentence, is_worth_training = opening.use_sentence(evidence.diagnosis)
    text = sentence.replace("effects.yaml", "<code>effects.yaml</code>")
    if is_worth_training and no_training(evidence.recording) is None:
        text += (
            " <code>eitskin train FOLDER</code>, the folder of this page, makes an estimator of"
            " touches from it."
        )
    return f"<h2>Use it</h2>\n<p>{text}</p>"


def names(evidence: Evidence, change_drawings: list[str]) -> str:
    """The verdict with its misfit, and each effect with its values and its evidence.

    change_drawings: what each effect changes, as SVG, "" where it has no picture.
    """
    diagnosis = evidence.diagnosis
    scores = last_scores(diagnosis)
    before, after = (
        f"<span class='{key}'>{number(scores[f'chi2_per_dof_{key}'])}</span>"
        for key in ("before", "after")
    )
    change = f"is {before}"
    if diagnosis["effects"] or diagnosis.get("families"):
        earlier_sizes = own_sizes_misfit(evidence)
        text = "" if earlier_sizes is None else number(earlier_sizes)
        is_other = text not in ("", number(scores["chi2_per_dof_before"]))
        aside = f" ({text} with the rig's errors as learned before)" if is_other else ""
        change = f"goes from {before}{aside} to {after}"
    role = "that decided nothing" if evidence.has_last else "held out in turn"
    parts = [
        "<h2>The verdict</h2>",
        f"<p>{headline(diagnosis)}</p>",
        f"<p>On {last_amount(evidence)} {role}, the misfit (χ² per degree of freedom) {change};"
        f" {expected_misfit(evidence)}.</p>",
    ]
    parts += [f"<p>{sentence}</p>" for sentence in omitted_frames(evidence)]
    if diagnosis["effects"]:
        note = (
            "A gain, in nats, is over the best set without the name, another name in its place too."
        )
        if len(diagnosis["effects"]) > 1:
            note += (
                " A share of the misfit is what comes back without the name; shares need not add"
                " up to 100 %."
            )
        parts.append(f"<p class='quiet'>{note}</p>")
    for k, effect in enumerate(diagnosis["effects"]):
        has_picture = any(change_drawings[k : k + 1])
        picture = _change_figure(k, change_drawings[k], evidence) if has_picture else ""
        parts.append(_effect(k + 1, effect, evidence, picture))
    if diagnosis["effects"]:
        parts.append("<p class='quiet'>Electrodes and channels are numbered from 0.</p>")
    if evidence.prediction is not None:
        parts.append(_prediction(evidence))
    return "\n".join(parts)


def last_amount(evidence: Evidence) -> str:
    """How many frames or channels were put aside, as a noun; where none were, how many were held
    out."""
    channels = evidence.last_channels
    if channels.any():
        return f"{channels.sum()} of {len(channels)} channels"
    return f"{last_scores(evidence.diagnosis)['frames']} frames"


def own_sizes_misfit(evidence: Evidence) -> float | None:
    """The misfit before with the rig's errors in the sizes learned without an effect; None where
    these are the same, or not known."""
    if not (evidence.has_rig_errors and evidence.diagnosis["effects"]):
        return None
    return last_scores(evidence.diagnosis).get("chi2_per_dof_before_own_sizes")


def expected_misfit(evidence: Evidence) -> str:
    """The misfit per degree of freedom where nothing is missing, as a clause."""
    if evidence.has_rig_errors:
        return "noise and the rig's errors alone give 1"
    return "noise alone gives 1"


def omitted_frames(evidence: Evidence) -> list[str]:
    """Which frames took no part in the diagnosis, a sentence each."""
    sentences = unlabelled_sentences(evidence.diagnosis)
    stretches = evidence.diagnosis.get("noise", {}).get("unlabelled", [])
    count, total = len(evidence.frames), len(evidence.recording.frames)
    frames_each = evidence.diagnosis.get("noise", {}).get("frames_each")
    if frames_each is not None:
        sentences.append(
            f"Averages of about {frames_each:.2g} frames were diagnosed, {count} of them: what"
            " changes from frame to frame was not sought, and a reading below is an average."
        )
    elif count < total - sum(last + 1 - first for first, last in stretches):
        sentences.append(f"An excerpt was diagnosed: {count} of {total} frames.")
    is_unknown = _unknown_values(evidence)
    incomplete = is_unknown.any(axis=1).sum()
    if incomplete:
        sentences.append(
            f"Of {len(is_unknown)} touched frames {incomplete} took no part:"
            f" {_unknown_text(is_unknown)}."
        )
    return sentences


def _unknown_touches(evidence: Evidence) -> list[str]:
    """That touched frames took no part, in a sentence without numbers; none where all did."""
    is_unknown = _unknown_values(evidence)
    is_incomplete = is_unknown.any(axis=1)
    if not is_incomplete.any():
        return []
    which = "No" if is_incomplete.all() else "Not every"
    return [f"{which} touched frame took part: {_unknown_text(is_unknown)}."]


def _unknown_values(evidence: Evidence) -> pd.DataFrame:
    """Of every touched frame, which of TOUCH_COLUMNS are unknown."""
    return evidence.frames[evidence.frames["touch"]][TOUCH_COLUMNS.keys()].isna()


def _unknown_text(is_unknown: pd.DataFrame) -> str:
    """`the force is not known`, of touches with such columns that are unknown."""
    nouns = [noun for key, noun in TOUCH_COLUMNS.items() if is_unknown[key].any()]
    return f"the {' or '.join(dict.fromkeys(nouns))} is not known"


def _change_figure(k: int, drawing: str, evidence: Evidence) -> str:
    """The picture of what effect k changes, captioned with the frame that it is of."""
    frame = evidence.frames.iloc[evidence.change_frames[k]]
    state = "an untouched frame"
    if frame["touch"]:
        force = frame["force_N"]
        state = (
            f"a frame touched with {number(force)} N" if np.isfinite(force) else "a touched frame"
        )
    caption = (
        f"What it changes in {state}, that in which it changes most; a dash: the reading falls."
    )
    return figure(f"change_{k}", drawing, caption)


def _effect(rank: int, effect: dict, evidence: Evidence, picture: str) -> str:
    """An effect of diagnosis.json, numbered, with the picture of what it changes beside it."""
    paragraphs = [f"<p>{rank}. {numbers_unbroken(effect['sentence'])}</p>"]
    driver = "static" if effect["driver"] == "static" else f"varies with {effect['driver']}"
    effect_is_certain = is_certain(effect)
    candidate = "" if effect_is_certain else ", a candidate"
    head = f"{code(effect['name'])}{candidate}, {escape(place_text(effect))}, {escape(driver)}"
    estimates = effect["parameters"] | effect.get("amounts", {})
    values = [_parameter(key, estimate, effect) for key, estimate in estimates.items()]
    paragraphs.append(f"<p>{'; '.join([head, *values])}.</p>")
    score = effect["evidence"]
    standard_error = float(f"{score['elpd_se']:.2g}")
    gain = f"gains {number(score['elpd_gain'])} ± {number(standard_error, 2)} nats"
    text = f"On what was held out in turn it {gain}"
    if evidence.diagnosis["fit"]["held_out"]["chi2_per_dof_before"] > opening.SHARED_MISFIT:
        share = f"It explains {number(100 * effect['share'])} % of the misfit of what was held out"
        text = f"{share} in turn, {gain} there"
    p_value = chance(score["p_value"])
    paragraphs.append(f"<p>{numbers_unbroken(f'{text}; p = {p_value}.')}</p>")
    if effect["alternatives"]:
        paragraphs.append(f"<p>{escape(alternatives_sentence(effect))}</p>")
    elif effect["gap"] is not None:
        table = evidence.tables["identifiability"].set_index("name")
        rival = table["nearest"].get(effect["name"])
        nearest = f"the nearest other name, {code(rival)}," if rival else "the nearest other name"
        gap = number(effect["gap"])
        paragraphs.append(f"<p>The gap to {nearest} is {gap} in noise units.</p>")
    else:
        paragraphs.append("<p>No other name looks like it.</p>")
    html_class = "effect" if effect_is_certain else "effect candidate"
    text = "\n".join(paragraphs)
    return f"<div class='{html_class}'><div>{text}</div>{picture}</div>"


def _families(entries: list[dict]) -> list[str]:
    """What is a little wrong at every site: a sentence each, and the member farthest out; of a
    rim, which has none, the sentence alone."""
    if not entries:
        return []
    items = []
    for entry in entries:
        sentence = entry["sentence"]
        if entry["name"] in SITE_NOUNS:
            farthest = int(np.argmax(np.abs(entry["values"])))
            factor, unit = (
                (100.0, "%") if entry["sd"]["unit"] == "1" else (1.0, entry["sd"]["unit"])
            )
            value, spread = (factor * entry[key][farthest] for key in ("values", "values_sd"))
            size = interval(value, value - NORMAL_90 * spread, value + NORMAL_90 * spread, unit)
            place = f"{SITE_NOUNS[entry['name']]} {entry['sites'][farthest]}"
            sentence += f" Farthest out is {place}, by {opening.INTERVAL.sub('', size)}."
        items.append(f"<li>{numbers_unbroken(sentence)}</li>")
    return ["<h2>A little wrong everywhere</h2>", f"<ul>{''.join(items)}</ul>"]


def _parameter(name: str, estimate: dict, effect: dict) -> str:
    """One parameter with its interval; of a list, its range and, where values differ by more than
    their intervals, the site whose value is farthest from the median."""
    label, texts = code(name), value_texts(estimate)
    if not isinstance(estimate["value"], list):
        return f"{label} = {numbers_unbroken(texts[0])}"
    values = np.array(estimate["value"])
    kind = next(kind for kind in SITES if effect[kind])
    if len(values) <= MOST_VALUES:
        values_at_sites = [
            f"{text} at {sites_text({kind: [site]})}"
            for site, text in zip(effect[kind], texts, strict=True)
        ]
        return f"{label} = {numbers_unbroken(listed(values_at_sites))}"
    text = range_text(estimate, texts)
    if not text.startswith(APPROXIMATELY):
        outlier = int(np.argmax(np.abs(values - np.median(values))))
        text = f"{text}, farthest out at {sites_text({kind: [effect[kind][outlier]]})}"
    return f"{label} {numbers_unbroken(text)}"


def _prediction(evidence: Evidence) -> str:
    """A paragraph on what was predicted of the query."""
    prediction = evidence.prediction
    assert prediction is not None
    sd, magnitude = (float(prediction[key].median()) for key in ("std_V", "voltage_V"))
    unit = evidence.reading_unit
    return (
        f"<p>The {len(prediction)} states of the query are predicted in"
        f" <code>predicted.parquet</code>: median reading {quantity(magnitude, unit)}, standard"
        f" deviation of the prediction {quantity(sd, unit, 2)}.</p>"
    )
