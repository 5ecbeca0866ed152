"""A diagnosis in words: sites, findings, what to do at the bench."""

import re

import numpy as np

from eitskin.diagnose.fitting.estimates import UNINFORMATIVE_RATIO
from eitskin.effects import EFFECTS
from eitskin.effects.effect import Effect, site_of
from eitskin.quantities import interval, listed, number, quantity, written_alike

MOST_LISTED = 6  # sites; more are counted
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
MOST_LISTED, NEAREST = 6, 3  # names that an effect cannot be told from; of more, so many are said
CANDIDATES = (
    "The simulation leaves something out; names below that begin with Perhaps are candidates: the"
    " fit as a whole is not acceptable, they do not stand out from what has no name, or that may be"
    " all that tells them from another name."
)
CALIBRATIONS = {
    "conductivity_S_per_m": "the gel's conductivity",
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
ABOUT = "about"  # many values that cannot be told apart
BOUNDS = {"low": "least", "high": "largest"}
UNITS = {"V": "V", "ohm": "Ω", "arbitrary": "arbitrary units"}  # of readings


def sites(item: dict) -> str:
    """Where an effect, or what has no name, is; "" where it names no site."""
    parts = []
    for kind, (one, several) in NOUNS.items():
        found = item.get(kind) or []
        if len(found) > MOST_LISTED:
            parts.append(f"{len(found)} {COUNTED[kind]}")
        elif found:
            parts.append(f"{one if len(found) == 1 else several} {listed(found)}")
    return "; ".join(parts)


def where(effect: dict) -> str:
    """The sites of an effect of diagnosis.json in words, or the part of the rig that it is in."""
    known = EFFECTS[effect["name"]]
    everywhere = f"all {COUNTED[known.sites[0]]}" if known.sites else PARTS[known.stage]
    return sites(effect) or everywhere


def certain(entry: dict) -> bool:
    """Whether an effect of diagnosis.json is a finding; else it is a candidate."""
    return entry.get("certain", True)


def headline(diagnosis: dict) -> str:
    """The verdict of diagnosis.json in a sentence."""
    if all(certain(effect) for effect in diagnosis["effects"]):
        return VERDICTS[diagnosis["verdict"]]
    return CANDIDATES


def told(diagnosis: dict) -> list[str]:
    """What a diagnosis, or a part of one, found, a sentence each: the verdict, the effects, what
    has no name."""
    found = [headline(diagnosis)]
    for effect in diagnosis["effects"]:
        found.append(" ".join(filter(None, [effect["sentence"], confused(effect)])))
    if diagnosis["other"]["sentence"]:
        found.append(f"What has no name: {diagnosis['other']['sentence']}")
    return found


def stretch(frames: list[int]) -> str:
    """The frames of a part: `frames 3 to 60`."""
    return "frames {} to {}".format(*frames)


def of_parts(diagnosis: dict) -> list[tuple[str, list[str]]]:
    """Of a recording with steps, what each step changed and what was found of each part, in order
    of time: a head and sentences each."""
    found = [
        (
            stretch(part["frames"]).capitalize(),
            [part["refused"]] if "refused" in part else told(part),
        )
        for part in diagnosis.get("parts", [])
    ]
    for place, step in enumerate(diagnosis.get("steps", [])):
        found.insert(2 * place + 1, (f"The step at frame {step['frame']}", step["sentences"]))
    return found


def finding(entry: dict, effect: Effect) -> str:
    """An effect of diagnosis.json in a sentence: its `finding`, sites and values filled in; of a
    candidate, with a perhaps. Values that might be anything, where the sentence does without them,
    are said to be untold; `amounts` stand for the values that come to them."""
    given = entry["parameters"]
    values = {key: estimate["value"] for key, estimate in given.items()}
    text = effect.finding_at(values)
    if "amounts" in entry and effect.combination is not None:
        text, given = effect.combination.finding(values), given | entry["amounts"]
    optional = {key.partition(":")[0] for p in PART.findall(text) for key in GAP.findall(p)}
    untold = [key for key in given if key in optional and _untold(given[key])]

    def part(found: re.Match) -> str:
        keys = [key.partition(":")[0] for key in GAP.findall(found[1])]
        return found[1] if all(key in given and key not in untold for key in keys) else ""

    def fill(found: re.Match) -> str:
        if "|" in found[1]:
            return found[1].split("|")[not _single(entry)]
        if found[1] == "site":
            return _all_sites(entry, effect)
        key, _, form = found[1].partition(":")
        whole = key in effect.parameters and effect.parameters[key].whole
        return _estimate(given[key], whole, form == "%")

    text = GAP.sub(fill, PART.sub(part, text))
    if untold:
        text += f" Its {listed(untold)} cannot be told from these readings."
    if not certain(entry):
        return f"Perhaps {text[0].lower()}{text[1:]}"
    return f"{text[0].upper()}{text[1:]}"


def confused(effect: dict) -> str:
    """The names that an effect of diagnosis.json cannot be told from, a sentence; of many the
    nearest; "" for none."""
    names = effect["alternatives"]
    if len(names) > MOST_LISTED:
        names = [*names[:NEAREST], f"{len(names) - NEAREST} further names"]
    return f"This recording cannot tell it from {listed(names)}." if names else ""


def _untold(estimate: dict) -> bool:
    """Whether the one value of a size above 0 might be anything, by its interval."""
    value, low, high = (estimate[key] for key in ("value", "low", "high"))
    return np.ndim(value) == 0 and low > 0.0 and high > UNINFORMATIVE_RATIO * low


def mend(effect: dict, channels: np.ndarray) -> str:
    """What to do at the bench about an effect of diagnosis.json: its `mend`, the sites filled in.

    channels (M, 4): the recording's, to name the electrodes of a gain that is given by channels.
    """
    known = EFFECTS[effect["name"]]
    text = known.mend
    kind = next((kind for kind in NOUNS if effect[kind]), None)
    found = effect[kind] if kind else []
    of_electrode = "electrode {site}" in text or "electrodes {site}" in text
    if kind == "channels" and of_electrode:
        found = sorted({int(e) for e in site_of(known.sites[0], channels)[found]})
    for one in ("electrode", "channel"):
        if not found:
            text = text.replace(f"{one}s {{site}}", f"all {one}s")
            text = text.replace(f"{one} {{site}}", f"every {one}")
        elif len(found) > 1:
            text = text.replace(f"{one} {{site}}", f"{one}s {{site}}")
    if not found:
        site = "every measuring pair"
    elif kind in ("measures", "channels") and not of_electrode and "channel" not in text:
        site = sites({kind: found})
    else:
        site = listed(found)
    text = text.replace("{site}", site)
    return f"{text[0].upper()}{text[1:]}."


def _single(entry: dict) -> bool:
    return sum(len(entry[kind]) for kind in NOUNS) == 1


def _all_sites(entry: dict, effect: Effect) -> str:
    """The sites of an effect as a noun; of a dense or common one, all of them."""
    count = max(len(entry[kind]) for kind in NOUNS)
    if entry["scope"] == "sparse" or count == 1:
        return sites(entry)
    kind = next((kind for kind in NOUNS if entry[kind]), effect.sites[0])
    return f"all {count} {COUNTED[kind]}" if count else f"all {COUNTED[kind]}"


def valued(estimate: dict, factor: float = 1.0, unit: str | None = None) -> list[str]:
    """Each value of an estimate of diagnosis.json with its 90 % interval, times a factor in a unit
    of its own; one that ended at a bound of what is tried without, for it has none."""
    unit = estimate["unit"] if unit is None else unit
    numbers = factor * np.array([np.atleast_1d(estimate[k]) for k in ("value", "low", "high")]).T
    ended = np.atleast_1d(np.array(estimate.get("at_bound"), dtype=object))
    return [
        interval(value, low, high, unit) if bound is None else _ended(value, unit, bound)
        for (value, low, high), bound in zip(
            numbers, np.broadcast_to(ended, len(numbers)), strict=True
        )
    ]


def spread(estimate: dict, texts: list[str]) -> str:
    """Many values of an estimate of diagnosis.json as the least and the largest; where the wider of
    their intervals cannot tell these apart, as that one. texts: of all, as of `valued`."""
    value, low, high = (np.array(estimate[key]) for key in ("value", "low", "high"))
    ended = estimate.get("at_bound") or [None] * len(value)
    reach = np.where([each is None for each in ended], np.fmax(value - low, high - value), 0.0)
    least, most = value.argmin(), value.argmax()
    wide = max(least, most, key=lambda i: reach[i])
    if texts[least] == texts[most] or written_alike(value[least], value[most], reach[wide]):
        return f"{ABOUT} {texts[wide]}"
    return f"anything from {texts[least]} to {texts[most]}"


def _ended(value: float, unit: str, bound: str) -> str:
    return f"{quantity(value, unit)} (the {BOUNDS[bound]} value tried, without an interval)"


def pinned(calibration: dict) -> list[str]:
    """A sentence for each calibration of diagnosis.json that ended at a bound of what is tried."""
    found = []
    for key, each in calibration.items():
        if "at_bound" in each:
            name, value = CALIBRATIONS.get(key, key), quantity(each["value"], each["unit"])
            ended = f"ended at the {BOUNDS[each['at_bound']]} value tried, {value}"
            found.append(f"{name[0].upper()}{name[1:]} {ended}; its interval means nothing.")
    return found


def _estimate(estimate: dict, whole: bool, percent: bool) -> str:
    """A value with its 90 % interval and unit; several in the order of their sites."""
    values = np.atleast_1d(estimate["value"])
    if whole:
        return number(values[0])
    texts = valued(estimate, 100.0, "%") if percent else valued(estimate)
    if len(texts) > MOST_VALUES:
        return spread(estimate, texts)
    return texts[0] if len(texts) == 1 else f"respectively {listed(texts)}"
