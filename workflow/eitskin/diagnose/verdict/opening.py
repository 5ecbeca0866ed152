"""What a report says before its reader scrolls: what is certain, what to do, what is not known.

Plain sentences without statistics: every number in them is a value of diagnosis.json, or one that
an experiment of experiment.json is made with.
"""

import re
from collections.abc import Sequence

import numpy as np

from eitskin.diagnose.search.gates import DISTINCT, NOTHING_UNNAMED
from eitskin.diagnose.verdict.words import (
    bound_sentences,
    is_certain,
    last_scores,
    repair_advice,
    sites_text,
)
from eitskin.effects import EFFECTS
from eitskin.effects.effect import SITES
from eitskin.quantities import listed, quantity

INTERVAL = re.compile(r" \(90 %: [^)]*\)")
INSTEAD = ". Instead "  # begins another cause of the same readings
SENTENCE_END = re.compile(r"(?<=\.) (?=[A-Z])")
CLEARLY_MORE = 1.1  # times the noise of a reading
HARDLY_CHANGED = 0.9  # of the error before: more than that is hardly a change
MOST_NAMES = 3  # of a list in a sentence; the rest are others
SHARED_MISFIT = 1.05  # chi squared a degree of freedom: more than the noise is left
# Names from what a person sees at the bench to what only a model tells, those of a line alike.
PLAINEST = (
    ("electrode-swap", "electrode-open"),
    ("electrode-position", "electrode-width", "contact-impedance"),
    ("offset", "measurement-gain", "drive-gain", "channel-gain", "ground-leak"),
    ("registration", "probe-radius", "force-offset", "force-lag"),
    ("touch-contrast", "contact-law", "contact-area-growth"),
    ("domain-shape", "ellipse", "conductivity-gradient", "conductivity-patch"),
)
CONSISTENT = (
    "Nothing is missing that this recording could show: the simulation can be used as it is."
)
PRESSES = "presses at known places and forces, from light to hard, with two known probes"
OF_TOUCHES = tuple(name for name, effect in EFFECTS.items() if effect.stage == "touch")
WORTH = "The one experiment worth doing"
UNNAMED = "Something is wrong that has no name here"


def opening(diagnosis: dict, channels: np.ndarray) -> str:
    """The first sentence of a report: of what is certain the finding that explains most, and what
    to do about it; where nothing is, what to try first. channels (M, 4): the recording's."""
    certain, candidates = findings(diagnosis)
    if certain:
        sentence = certain[0]["sentence"]
        mark = ";" if ": " in _bare(sentence) else ":"
        if INSTEAD in sentence:
            mark = " (or what reads the same, below); to try first:"
        return f"{_bare(sentence)}{mark} {_advice(certain[0], channels)}."
    trial_text = ""
    if candidates:
        trial_text = f"to try first: {_advice(plainest(candidates[0]), channels)}."
    if diagnosis.get("families"):
        text = f"No single part is certainly at fault; {_lowered(_bare(_largest(diagnosis)))}"
        return f"{text}; {trial_text}" if trial_text else f"{text}."
    if candidates:
        return f"Nothing is certain yet; {trial_text}"
    if diagnosis["verdict"] != "unexplained":
        return CONSISTENT
    place = sites_text(diagnosis["other"])
    if place:
        return f"{UNNAMED}; look first at {place}."
    text = _first(diagnosis["other"]["sentence"])
    return f"{UNNAMED}: {_lowered(text)}"


def findings(diagnosis: dict) -> tuple[list[dict], list[dict]]:
    """The effects of diagnosis.json that are certain, and the candidates, each from that with the
    largest share of the misfit on."""
    effects = sorted(diagnosis["effects"], key=lambda effect: -effect["share"])
    certain = [effect for effect in effects if is_certain(effect)]
    return certain, [effect for effect in effects if not is_certain(effect)]


def extent(diagnosis: dict) -> str:
    """How much of the difference the named causes explain, a sentence; "" where there is none."""
    certain, candidates = findings(diagnosis)
    if diagnosis["verdict"] == "consistent":
        return ""
    if diagnosis["verdict"] == "explained":
        text = "This explains the difference between simulation and recording"
        return f"{text}, which is small here." if _hardly_changes(diagnosis) else f"{text}."
    if certain or diagnosis.get("families"):
        return "This explains a part of the difference between simulation and recording."
    if candidates:
        return "Simulation and recording differ; the candidates below may be the cause."
    return "Simulation and recording differ by more than the noise."


def error_sentence(diagnosis: dict, unit: str) -> str:
    """The error of the simulation on readings that the diagnosis did not use, before and after;
    unit: of the readings."""
    scores = last_scores(diagnosis)
    role = "that the diagnosis never used"
    if "last" not in diagnosis["fit"]:
        role = "that were left out in turn"
    before, after = (scores[f"rms_{key}_V"] for key in ("before", "after"))
    noise = f"the noise of a reading is {quantity(diagnosis['noise_V'], unit)}"
    is_accounted_for = diagnosis["verdict"] in ("consistent", "explained")
    if is_accounted_for and after > CLEARLY_MORE * diagnosis["noise_V"]:
        noise += ", and errors of the rig come on top"
    if before == after:
        return f"On readings {role} the simulation is off by {quantity(after, unit)}; {noise}."
    change = f"from {quantity(before, unit)} to {quantity(after, unit)}"
    if _hardly_changes(diagnosis):
        return f"On readings {role} the error of the simulation hardly changes, {change}; {noise}."
    if after > before:
        return f"On readings {role} the error of the simulation does not fall: {change}; {noise}."
    return f"On readings {role} the error of the simulation falls {change}; {noise}."


def _hardly_changes(diagnosis: dict) -> bool:
    """Whether the error on readings that the diagnosis did not use falls by little."""
    scores = last_scores(diagnosis)
    return HARDLY_CHANGED * scores["rms_before_V"] < scores["rms_after_V"] <= scores["rms_before_V"]


def plainest(effect: dict) -> dict:
    """An effect of diagnosis.json, or in its place the plainest name that this recording cannot
    tell from it, with its sites where the other name may be at such."""
    name = min([effect["name"], *effect["alternatives"]], key=_rank)
    sites = {kind: effect[kind] if kind in EFFECTS[name].sites else [] for kind in SITES}
    return effect if name == effect["name"] else effect | {"name": name} | sites


def candidate_sentence(effect: dict) -> str:
    """A candidate of diagnosis.json: by the plainest of the names that cannot be told apart."""
    spoken = plainest(effect)
    rivals = [name for name in [effect["name"], *effect["alternatives"]] if name != spoken["name"]]
    text = effect["sentence"]
    if not text.startswith("Perhaps "):  # of an earlier version
        text = f"Perhaps {_lowered(text)}"
    if not rivals:
        return text
    if spoken is effect:
        return f"{text} This recording cannot tell it from {names_text(rivals)}."
    place = sites_text(spoken)
    location = f" of {place}" if place else ""
    return (
        f"Perhaps it is the {plain(spoken['name'])}{location}: this recording cannot tell it from"
        f" {names_text(rivals)}. If it is {plain(effect['name'])}, {_lowered(text[8:])}"
    )


def unknown_sentences(diagnosis: dict) -> list[str]:
    """What a diagnosis leaves open, a sentence each."""
    other, lines = diagnosis["other"], []
    if not NOTHING_UNNAMED.admits(other["probability"]):
        lines.append(f"What has no name: {_lowered(other['sentence'])}")
    elif (
        diagnosis["verdict"] == "partly-explained"
        and last_scores(diagnosis)["chi2_per_dof_after"] > SHARED_MISFIT
    ):
        lines.append("More is left than the noise accounts for.")
    if {*OF_TOUCHES} <= {*diagnosis["unobservable"]}:
        lines.append("This recording could not have shown what touches do.")
    elif diagnosis["unobservable"]:
        names = names_text(diagnosis["unobservable"])
        lines.append(f"This recording could not have shown {names}.")
    return lines + bound_sentences(diagnosis["calibration"])


def experiment_sentence(diagnosis: dict, experiment: dict) -> str:
    """The one experiment worth doing: that which tells most names apart, or would show most of what
    this recording could not; "" for none. experiment: as experiment.json has it."""
    by_recipe: dict[str, list[dict]] = {}
    for pair in experiment["pairs"]:
        if DISTINCT.admits(pair["gap_then"]):
            by_recipe.setdefault(pair["recipe"], []).append(pair)
    if by_recipe:
        recipe = max(by_recipe, key=lambda text: len(by_recipe[text]))
        rivals: dict[str, list[str]] = {}
        for pair in by_recipe[recipe][:MOST_NAMES]:
            rivals.setdefault(pair["a"], []).append(plain(pair["b"]))
        pair_texts = [f"{plain(name)} from {listed(names)}" for name, names in rivals.items()]
        return f"{WORTH}: {_lowered(recipe).rstrip('.')}; that would tell {'; '.join(pair_texts)}."
    if experiment["pairs"]:
        pair = experiment["pairs"][0]
        return f"Nothing that was tried would tell {plain(pair['a'])} from {plain(pair['b'])}."
    by_recording: dict[str, list[str]] = {}
    for name in diagnosis["unobservable"]:
        by_recording.setdefault(EFFECTS[name].shown_by, []).append(name)
    if not by_recording:
        return ""
    if {*OF_TOUCHES} <= {*diagnosis["unobservable"]}:
        return f"{WORTH}: {PRESSES}."
    recording = max(by_recording, key=lambda text: len(by_recording[text]))
    return f"{WORTH}: {recording}; it could show {names_text(by_recording[recording])}."


def use_sentence(diagnosis: dict) -> tuple[str, bool]:
    """What the simulator that effects.yaml corrects is good for, and whether it is worth an
    estimator of touches."""
    certain, candidates = findings(diagnosis)
    scores = last_scores(diagnosis)
    if not (diagnosis["effects"] or diagnosis.get("families")):
        if diagnosis["verdict"] == "consistent":
            return "The simulation needs no correction.", True
        text = (
            "Nothing is corrected, as nothing has a name. Look in this order at what eitskin check"
            " warns of, at numbers of the skin that were guessed, and at the labels of touches;"
            " then record a known skin and compare."
        )
        return text, False
    if scores["rms_after_V"] > scores["rms_before_V"]:
        text = (
            "The corrected simulator is no better on readings that it never saw: use it for nothing"
            " before that is understood."
        )
        return text, False
    if candidates and not certain:
        return "effects.yaml corrects the simulator by the candidates: try them first.", True
    if candidates:
        return "effects.yaml corrects the simulator by what is certain and by the candidates.", True
    return "effects.yaml corrects the simulator by all of this.", True


def plain(name: str) -> str:
    """A name of the catalogue as words of a sentence."""
    return re.sub(r"\badc\b", "ADC", name.replace("-", " "))


def names_text(names: Sequence[str]) -> str:
    """Names in a sentence, the plainest first; of many some."""
    texts = [plain(name) for name in sorted(names, key=_rank)]
    return listed([*texts[:MOST_NAMES], "others"] if len(texts) > MOST_NAMES + 1 else texts)


def _rank(name: str) -> int:
    """The line of PLAINEST that a name is in; later ones come after all."""
    return next((rank for rank, line in enumerate(PLAINEST) if name in line), len(PLAINEST))


def _advice(effect: dict, channels: np.ndarray) -> str:
    return _lowered(repair_advice(effect, channels)).rstrip(".")


def _largest(diagnosis: dict) -> str:
    """The sentence on the family that accounts for most of the misfit."""
    return max(diagnosis["families"], key=lambda family: family["share"])["sentence"]


def _first(text: str) -> str:
    """The first sentence of a text."""
    return SENTENCE_END.split(text)[0]


def _bare(text: str) -> str:
    """The first sentence of a text, without its intervals and its full stop."""
    return INTERVAL.sub("", _first(text)).rstrip(".")


def _lowered(text: str) -> str:
    return f"{text[0].lower()}{text[1:]}"
