"""A diagnosis in words: sites, effects, what to do at the bench."""

import re

import numpy as np

from eitskin.data.check.unlabelled import stretch_text
from eitskin.diagnose.fitting.estimates import UNINFORMATIVE_RATIO
from eitskin.diagnose.verdict.nothing import holds_nothing, may_be_none, measures_size
from eitskin.effects import EFFECTS
from eitskin.effects.effect import Effect, site_of
from eitskin.quantities import interval, listed, number, quantity, written_alike

MOST_VALUES = 4  # of one parameter; of more, the least and the largest
PART, GAP = re.compile(r"\[([^][]*)\]"), re.compile(r"\{([^{}]*)\}")
NOUNS = {
    "electrodes": ("electrode", "electrodes"),
    "drives": ("the drive from electrode", "the drives from electrodes"),
    "measures": ("the measuring pair at electrode", "the measuring pairs at electrodes"),
    "channels": ("channel", "channels"),
}
COUNTED = {
    "electrodes": "electrodes",
    "drives": "drives",
    "measures": "measuring pairs",
    "channels": "channels",
}
PARTS = {
    "touch": "the touches",
    "skin": "the skin",
    "wiring": "the wiring",
    "instrument": "the instrument",
    "clock": "the scan",
}
VERDICTS = {
    "consistent": "Simulation and recording agree: no physics is missing that this recording could"
    " show.",
    "explained": "The simulation leaves something out, and what is named below explains it.",
    "partly-explained": "The simulation leaves something out; what is named below explains part"
    " of it.",
    "unexplained": "The simulation leaves something out for which there is no name here.",
}
MOST_LISTED, NEAREST = 6, 3  # sites, and names of alternatives; of more names the nearest
CANDIDATES = (
    "The simulation leaves something out; nothing is certain yet, and what begins with Perhaps is"
    " to be tried."
)
SOME_CERTAIN = (
    "The simulation leaves something out; what begins with Perhaps is to be tried, the rest is"
    " certain."
)
CALIBRATIONS = {
    "conductivity_S_per_m": "the skin's conductivity",
    "radius_mm": "the skin's radius",
    "thickness_mm": "the skin's thickness",
    "contact_impedivity_ohm_m2": "the contact impedivity of all electrodes",
    "contrast_per_N": "the contrast of a touch per newton",
    "electrode_rotation_deg": "the angle by which all electrodes are turned",
    "electrode_width_mm": "the width of all electrodes",
    "current_A": "the current",
    "factor": "the factor of the readings' unit",
    "robot_scale": "the scale of the robot's frame",
    "robot_rotation_deg": "the angle of the robot's frame",
    "robot_x_mm": "the shift of the robot's frame along x",
    "robot_y_mm": "the shift of the robot's frame along y",
}
NATS = (
    "1 nat more, and what was held out is predicted e = 2.7 times more probably; 10 nats, 22000"
    " times."
)
UNTOLD = {  # parameters, as a reader is told that they cannot be told
    "tau_s": "time constant",
    "range_mm": "range",
    "depth_mm": "depth",
    "electrode_height_mm": "electrodes' height",
    "electrode_z_mm": "electrodes' level",
    "limit_V": "limit",
    "cubic": "curvature",
    "F_mid_N": "middle force",
    "shift_deg": "angle",
    "shift_mm": "place",
    "dx_mm": "place along x",
    "dy_mm": "place along y",
}
APPROXIMATELY = "about"  # before many values that their intervals cannot distinguish
BOUNDS = {"low": "least", "high": "largest"}
UNITS = {"V": "V", "ohm": "Ω", "arbitrary": "arbitrary units"}  # of readings


def sites_text(item: dict) -> str:
    """Where an effect, or what has no name, is; "" where it names no site."""
    parts = []
    for kind, (singular, plural) in NOUNS.items():
        sites = item.get(kind) or []
        if len(sites) > MOST_LISTED:
            parts.append(f"{len(sites)} {COUNTED[kind]}")
        elif sites:
            parts.append(f"{singular if len(sites) == 1 else plural} {listed(sites)}")
    return "; ".join(parts)


def place_text(effect: dict) -> str:
    """The sites of an effect of diagnosis.json in words, or the part of the rig that it is in."""
    kind = EFFECTS[effect["name"]]
    everywhere = f"all {COUNTED[kind.sites[0]]}" if kind.sites else PARTS[kind.stage]
    return sites_text(effect) or everywhere


def is_certain(entry: dict) -> bool:
    """Whether an effect of diagnosis.json is a finding; else it is a candidate, as one of an
    earlier version is whose stated size may be nothing."""
    return entry.get("certain", True) and not holds_nothing(entry)


def last_scores(diagnosis: dict) -> dict:
    """The scores of diagnosis.json on readings that no decision read; where none were put aside,
    and in files of earlier versions, those held out."""
    return diagnosis["fit"].get("last") or diagnosis["fit"]["held_out"]


def headline(diagnosis: dict) -> str:
    """The verdict of diagnosis.json in a sentence."""
    certainties = [is_certain(effect) for effect in diagnosis["effects"]]
    if all(certainties):
        return VERDICTS[diagnosis["verdict"]]
    return SOME_CERTAIN if any(certainties) else CANDIDATES


def sentences(diagnosis: dict) -> list[str]:
    """diagnosis.json, or a part of it, a sentence each: the verdict, the effects, what has no
    name."""
    lines = [headline(diagnosis)]
    for effect in diagnosis["effects"]:
        lines.append(" ".join(filter(None, [effect["sentence"], alternatives_sentence(effect)])))
    lines += [family["sentence"] for family in diagnosis.get("families", [])]
    if diagnosis["other"]["sentence"]:
        lines.append(f"What has no name: {diagnosis['other']['sentence']}")
    return lines


def all_sentences(diagnosis: dict) -> list[str]:
    """The sentences that `eitskin diagnose` prints of a diagnosis.json, or of its parts."""
    lines = []
    for head, paragraph in part_sentences(diagnosis) or [("", sentences(diagnosis))]:
        lines += [f"{head}:", *paragraph] if head else paragraph
    return [
        *lines,
        *size_sentences(diagnosis),
        *unlabelled_sentences(diagnosis),
        *bound_sentences(diagnosis["calibration"]),
    ]


def size_sentences(diagnosis: dict) -> list[str]:
    """What the lengths of a diagnosis.json are, in a sentence, where no length of the skin is
    known."""
    if "scale" not in diagnosis:
        return []
    radius = quantity(diagnosis["scale"]["radius_mm"], "mm")
    return [
        f"No length that tells the skin's size is stated, and readings are alike at every size:"
        f" lengths in mm are those of a skin of {radius} radius, and only their ratios count."
    ]


def unlabelled_sentences(diagnosis: dict) -> list[str]:
    """A sentence for each stretch of frames of diagnosis.json with a touch that no label tells,
    beside a labelled one or without one."""
    lines = []
    for first, last in diagnosis.get("noise", {}).get("unlabelled", []):
        frames = "this frame is" if first == last else "these frames are"
        lines.append(
            f"In {stretch_text((first, last))} there is a touch that no label tells; {frames} left"
            " out."
        )
    return lines


def frame_range(frames: list[int]) -> str:
    """The frames of a part: `frames 3 to 60`."""
    return "frames {} to {}".format(*frames)


def part_sentences(diagnosis: dict) -> list[tuple[str, list[str]]]:
    """Of a recording with steps, what each step changed and the diagnosis of each part, in order of
    time: a head and sentences each."""
    paragraphs = [
        (
            frame_range(part["frames"]).capitalize(),
            [part["refused"]] if "refused" in part else sentences(part),
        )
        for part in diagnosis.get("parts", [])
    ]
    for place, step in enumerate(diagnosis.get("steps", [])):
        head = f"The step at frame {step['frame']}"
        paragraphs.insert(2 * place + 1, (head, step["sentences"]))
    return paragraphs


def effect_sentence(entry: dict, effect: Effect) -> str:
    """An effect of diagnosis.json in a sentence: its `finding`, sites and values filled in; of a
    candidate, with a perhaps. Where the sentence does without them, values that might be anything
    are named as such, and sizes that may be nothing left out beside one that is something;
    `amounts` stand for the values that they combine."""
    estimates = entry["parameters"]
    values = {key: estimate["value"] for key, estimate in estimates.items()}
    text = effect.finding_at(values)
    if "amounts" in entry and effect.combination is not None:
        text, estimates = effect.combination.finding(values), estimates | entry["amounts"]
    has_opposite = effect.opposite is not None and effect.opposite[0] in text
    if effect.opposite is not None and has_opposite and _are_negative(estimates):
        text = text.replace(*effect.opposite)
        estimates = {key: _negated(estimate) for key, estimate in estimates.items()}
    elif has_opposite and _have_both_signs(estimates):
        text = text.replace("towards", "counted towards")
    optional = {key.partition(":")[0] for p in PART.findall(text) for key in GAP.findall(p)}
    unbounded = [key for key in estimates if key in optional and _is_unbounded(estimates[key])]
    sizes = {
        key: bool(np.all(may_be_none(effect, key, estimates[key])))
        for key in estimates
        if key in effect.parameters and measures_size(effect, key)
    }
    nothing = [] if all(sizes.values()) else [key for key in sizes if sizes[key]]

    def part(match: re.Match) -> str:
        keys = [key.partition(":")[0] for key in GAP.findall(match[1])]
        left_out = {*unbounded, *nothing}
        return match[1] if all(key in estimates and key not in left_out for key in keys) else ""

    def fill(match: re.Match) -> str:
        if "|" in match[1]:
            return match[1].split("|")[not _is_single(entry)]
        if match[1] == "site":
            return _all_sites(entry, effect)
        key, _, form = match[1].partition(":")
        if form in estimates:
            return value_texts(_first_direction(estimates[key], int(estimates[form]["value"])))[0]
        if effect.polar is not None and key == effect.polar[1]:
            return value_texts(_turned(estimates[key], 360.0 / effect.polar[2]))[0]
        is_integer = key in effect.parameters and effect.parameters[key].whole
        return _estimate_text(estimates[key], is_integer, form == "%")

    text = GAP.sub(fill, PART.sub(part, text))
    if unbounded:
        quantities = [UNTOLD.get(key, key) for key in unbounded]
        text += f" These readings do not tell its {listed(quantities)}."
    if not is_certain(entry):
        return f"Perhaps {text[0].lower()}{text[1:]}"
    return f"{text[0].upper()}{text[1:]}"


def alternatives_sentence(effect: dict) -> str:
    """The names from which an effect of diagnosis.json is not distinguishable, a sentence; of many
    the nearest; "" for none."""
    names = effect["alternatives"]
    if len(names) > MOST_LISTED:
        names = [*names[:NEAREST], f"{len(names) - NEAREST} further names"]
    return f"This recording cannot tell it from {listed(names)}." if names else ""


def _are_negative(estimates: dict) -> bool:
    return all(np.max(estimate["value"]) < 0.0 for estimate in estimates.values())


def _have_both_signs(estimates: dict) -> bool:
    return any(np.min(e["value"]) < 0.0 < np.max(e["value"]) for e in estimates.values())


def _negated(estimate: dict) -> dict:
    """An estimate of diagnosis.json with the opposite sign, its interval turned round."""
    ends = {"value": "value", "low": "high", "high": "low"}
    negated = {key: (-np.array(estimate[source])).tolist() for key, source in ends.items()}
    if "at_bound" in estimate:
        turned = {"low": "high", "high": "low", None: None}
        bounds = estimate["at_bound"]
        is_list = isinstance(bounds, list)
        negated["at_bound"] = [turned[b] for b in bounds] if is_list else turned[bounds]
    return estimate | negated


def _first_direction(estimate: dict, count: int) -> dict:
    """The first of the directions, `count` of them evenly around, in which a harmonic of this
    phase is largest, deg from 0 on."""
    directions = {key: estimate[key] / count for key in ("value", "low", "high")}
    return _turned(estimate | directions, 360.0 / count)


def _turned(estimate: dict, period_deg: float) -> dict:
    """A direction of diagnosis.json by whole periods, from 0 on."""
    turn = estimate["value"] - estimate["value"] % period_deg
    return estimate | {key: estimate[key] - turn for key in ("value", "low", "high")}


def _is_unbounded(estimate: dict) -> bool:
    """Whether the one value of a size above 0 might be anything, by its interval."""
    value, low, high = (estimate[key] for key in ("value", "low", "high"))
    return np.ndim(value) == 0 and low > 0.0 and high > UNINFORMATIVE_RATIO * low


def repair_advice(effect: dict, channels: np.ndarray) -> str:
    """What to do at the bench about an effect of diagnosis.json: its `mend`, the sites filled in.

    channels (M, 4): the recording's, to name the electrodes of a gain that is given by channels.
    """
    catalogue_effect = EFFECTS[effect["name"]]
    text = catalogue_effect.mend_at({k: e["value"] for k, e in effect["parameters"].items()})
    kind = next((kind for kind in NOUNS if effect[kind]), None)
    sites = effect[kind] if kind else []
    of_electrode = "electrode {site}" in text or "electrodes {site}" in text
    if kind == "channels" and of_electrode:
        electrode_of_channel = site_of(catalogue_effect.sites[0], channels)
        sites = sorted({int(electrode) for electrode in electrode_of_channel[sites]})
    if effect["scope"] == "dense" and len(sites) > MOST_LISTED:
        sites = []  # all of them
    for noun in ("electrode", "channel"):
        if not sites:
            text = text.replace(f"{noun}s {{site}}", f"all {noun}s")
            text = text.replace(f"{noun} {{site}}", f"every {noun}")
        elif len(sites) > 1:
            text = text.replace(f"{noun} {{site}}", f"{noun}s {{site}}")
    if not sites:
        place = "every measuring pair"
    elif kind in ("measures", "channels") and not of_electrode and "channel" not in text:
        place = sites_text({kind: sites})
    else:
        place = listed(sites)
    text = text.replace("{site}", place)
    return f"{text[0].upper()}{text[1:]}."


def _is_single(entry: dict) -> bool:
    return sum(len(entry[kind]) for kind in NOUNS) == 1


def _all_sites(entry: dict, effect: Effect) -> str:
    """The sites of an effect as a noun; of a dense or common one, all of them."""
    count = max(len(entry[kind]) for kind in NOUNS)
    if entry["scope"] == "sparse" or count == 1:
        return sites_text(entry)
    kind = next((kind for kind in NOUNS if entry[kind]), effect.sites[0])
    return f"all {count} {COUNTED[kind]}" if count else f"all {COUNTED[kind]}"


def value_texts(estimate: dict, factor: float = 1.0, unit: str | None = None) -> list[str]:
    """Every value of an estimate of diagnosis.json with its 90 % interval, times a factor, in the
    estimate's unit or another; a value at a bound has no interval."""
    unit = estimate["unit"] if unit is None else unit
    numbers = factor * np.array([np.atleast_1d(estimate[k]) for k in ("value", "low", "high")]).T
    bounds = np.atleast_1d(np.array(estimate.get("at_bound"), dtype=object))
    return [
        interval(value, low, high, unit) if bound is None else _bound_text(value, unit, bound)
        for (value, low, high), bound in zip(
            numbers, np.broadcast_to(bounds, len(numbers)), strict=True
        )
    ]


def range_text(estimate: dict, texts: list[str]) -> str:
    """Many values of an estimate of diagnosis.json as the smallest and the largest; where the wider
    of their intervals cannot distinguish these, as that one. texts: the `value_texts`."""
    value, low, high = (np.array(estimate[key]) for key in ("value", "low", "high"))
    bounds = estimate.get("at_bound") or [None] * len(value)
    margin = np.where([bound is None for bound in bounds], np.fmax(value - low, high - value), 0.0)
    lowest, highest = value.argmin(), value.argmax()
    wide = max(lowest, highest, key=lambda i: margin[i])
    ends = value[lowest], value[highest]
    if texts[lowest] == texts[highest] or written_alike(*ends, margin[wide]):
        return f"{APPROXIMATELY} {texts[wide]}"
    return f"anything from {texts[lowest]} to {texts[highest]}"


def _bound_text(value: float, unit: str, bound: str) -> str:
    return f"{quantity(value, unit)} (the {BOUNDS[bound]} value tried, without an interval)"


def bound_sentences(calibration: dict) -> list[str]:
    """A sentence for each calibration of diagnosis.json that ended at a bound of what is tried."""
    lines = []
    for key, estimate in calibration.items():
        if "at_bound" in estimate:
            name = CALIBRATIONS.get(key, key)
            value = quantity(estimate["value"], estimate["unit"])
            bound = f"ended at the {BOUNDS[estimate['at_bound']]} value tried, {value}"
            lines.append(f"{name[0].upper()}{name[1:]} {bound}; its interval means nothing.")
    return lines


def _estimate_text(estimate: dict, is_integer: bool, in_percent: bool) -> str:
    """A value with its 90 % interval and unit; several in the order of their sites."""
    values = np.atleast_1d(estimate["value"])
    if is_integer:
        return number(values[0])
    texts = value_texts(estimate, 100.0, "%") if in_percent else value_texts(estimate)
    if len(texts) > MOST_VALUES:
        return range_text(estimate, texts)
    return texts[0] if len(texts) == 1 else f"respectively {listed(texts)}"
