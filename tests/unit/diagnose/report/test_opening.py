"""What a report says first: plain, certain only where it is, every number one of diagnosis.json's.

Diagnoses are drawn: of the blocks that are shipped, as they were found, and of the whole catalogue
with values, intervals and other names by chance.
"""

import json
import re
import tarfile
from html import unescape
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from eitskin.diagnose.report.answer import answer
from eitskin.diagnose.search.gates import DISTINCT
from eitskin.diagnose.verdict import family_words, opening, words
from eitskin.diagnose.verdict.nothing import holds_nothing
from eitskin.diagnose.verdict.remainder import NO_PATTERN
from eitskin.effects import EFFECTS, catalogue_names
from eitskin.effects.effect import SITES
from eitskin.physics.protocol import channel_table
from eitskin.quantities import MINUS
from small_skin import small_recording

RECORDED = small_recording(places=1)
BLOCKS = Path(__file__).parents[4] / "docs" / "calibration"
PRIVATE = re.compile(r"\bnats?\b|χ|\bp\b|\bgaps?\b|\bphases?\b|\bharmonic|\belpd\b|\bdof\b")
NUMBER = re.compile(rf"(?<![\w.]){MINUS}?\d+(?:\.\d+)?(?:·10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)?")
DRAWN, SHIPPED = 40, 60
MOST_WORDS = 50  # of the first sentence: read aloud in a quarter of a minute


def said_again(document: dict) -> dict:
    """A document as it is said today: blocks of earlier versions call names certain that are not
    told apart, and have rows of the atlas without evidence."""
    if (document["other"]["sentence"] or "").startswith("No evidence"):
        document["other"]["sentence"] = NO_PATTERN
    for effect in document["effects"]:
        effect["certain"] = words.is_certain(effect) and not effect["alternatives"]
        effect["sentence"] = words.effect_sentence(effect, EFFECTS[effect["name"]])
    for family in document.get("families", []):
        family["sentence"] = family_words.family_sentence(family)
    return document


def shipped(count: int) -> list[dict]:
    """Documents of the block of ordinary rigs and of errors of other forms: of every verdict and
    number of effects alike many."""
    groups: dict[tuple, list[dict]] = {}
    for block in ("ordinary-report", "alien-report"):
        with tarfile.open(BLOCKS / block / "trials.tar.xz") as archive:
            for member in archive:
                if not member.name.endswith(".json"):
                    continue
                document = json.load(archive.extractfile(member))["said"]
                if set(effect["name"] for effect in document["effects"]) <= set(EFFECTS):
                    certain = sum(effect["certain"] for effect in document["effects"])
                    key = document["verdict"], len(document["effects"]), certain
                    groups.setdefault(key, []).append(document)
    assert {verdict for verdict, *_ in groups} == {*words.VERDICTS}
    each = -(-count // len(groups))
    return [said_again(document) for group in groups.values() for document in group[:each]]


def drawn(seed: int) -> dict:
    """A document of any verdict by chance: effects of the whole catalogue, some of them with other
    names, families, and intervals that hold nothing or not."""
    draw = np.random.default_rng(seed)
    names = draw.choice(sorted(set(EFFECTS) - {"ellipse"}), draw.integers(0, 4), replace=False)
    effects = [drawn_effect(str(name), draw) for name in names]
    families = [drawn_family(draw)] if draw.random() < 0.4 else []
    likely = bool(draw.random() < 0.4)
    where = draw.choice(["electrodes", "drives", "measures", "nowhere"])
    other = {kind: [3] if kind == where else [] for kind in ("electrodes", "drives", "measures")}
    other |= {"probability": 0.98 if likely else 0.05}
    other["sentence"] = "All channels differ from the simulation, by one share." if likely else None
    verdict = "unexplained" if likely else "consistent"
    if effects or families:
        is_whole = not likely and all(words.is_certain(effect) for effect in effects)
        verdict = "explained" if is_whole else "partly-explained"
    before, after = np.sort(10.0 ** draw.uniform(-6, -3, 2))[::-1]
    if not (effects or families):
        before = after
    scores = {"frames": 12, "rms_before_V": float(before), "rms_after_V": float(after)}
    scores |= {"chi2_per_dof_before": 9.0, "chi2_per_dof_after": float(draw.uniform(0.9, 2.0))}
    hidden = draw.choice(sorted(catalogue_names()), draw.integers(0, 6), replace=False).tolist()
    document = {"verdict": verdict, "effects": effects, "other": other, "unobservable": hidden}
    document |= {"noise_V": 1.5e-6, "fit": {"held_out": scores, "last": scores}, "calibration": {}}
    return document | ({"families": families} if families else {})


def drawn_effect(name: str, draw: np.random.Generator) -> dict:
    effect = EFFECTS[name]
    kind = next(iter(effect.sites), None)
    sites = {each: [] for each in SITES}
    if kind is not None:
        sites[kind] = sorted(draw.choice(16, effect.site_number or 2, replace=False).tolist())
    parameters = {}
    for key, parameter in effect.parameters.items():
        at = 0.0 if parameter.neutral is None else parameter.neutral
        value, half = at + draw.normal(), 10.0 ** draw.uniform(-3, 1)
        if parameter.whole:
            value, half = float(draw.integers(0, 6)), 0.0
        ends = {"value": value, "low": value - half, "high": value + half}
        is_listed = kind is not None and parameter.dense
        parameters[key] = {k: [v, v] if is_listed else v for k, v in ends.items()}
        parameters[key]["unit"] = parameter.unit
    entry = {"name": name, "scope": "sparse" if kind else "common", **sites}
    entry |= {"driver": effect.driver, "parameters": parameters, "share": float(draw.random())}
    entry |= {"alternatives": [], "certain": not holds_nothing(entry) and draw.random() < 0.6}
    if not entry["certain"] and draw.random() < 0.5:
        entry["alternatives"] = list(effect.confusable)
    entry["sentence"] = words.effect_sentence(entry, effect)
    return entry


def drawn_family(draw: np.random.Generator) -> dict:
    sd = {"value": 0.05, "low": 0.03, "high": 0.08, "unit": "1"}
    name = str(draw.choice([*family_words.SENTENCES]))
    family = {"name": name, "sd": sd, "share": float(draw.random()), "confused_with": []}
    family |= {"sites": [4, 7], "values": [0.02, -0.11], "values_sd": [0.01, 0.02]}
    return family | {"sentence": family_words.family_sentence(family)}


def experiment_of(document: dict) -> dict:
    """An experiment for the first pair of names that are not told apart."""
    pairs = [
        {"a": effect["name"], "b": name, "gap_now": 1.2, "gap_then": 7.0, "recipe": "do so 3 times"}
        for effect in document["effects"]
        for name in effect["alternatives"][:1]
    ]
    return {"sentence": "", "pairs": pairs}


def first_screen(document: dict) -> str:
    """The text of a report above what folds; headings and paragraphs a line each."""
    shown = SimpleNamespace(
        diagnosis=document,
        recording=RECORDED,
        frames=RECORDED.frames,
        channels=channel_table(16),
        reading_unit="V",
        experiment=experiment_of(document),
    )
    text = re.sub(r"</(?:h1|h2|p|li)>", "\n", answer(shown, ""))
    return unescape(re.sub(r"<[^>]+>", "", text))


def numbers(value: object) -> list[float]:
    """All numbers of a document."""
    if isinstance(value, dict):
        return [one for part in value.values() for one in numbers(part)]
    if isinstance(value, list):
        return [one for part in value for one in numbers(part)]
    return [float(value)] if isinstance(value, int | float) else []


def is_of(text: str, values: np.ndarray) -> bool:
    """Whether a number in a text is one of these, in its digits, by thousands or in per cent."""
    plain = float(text.replace(MINUS, "-").partition("·")[0])
    half = 0.5001 * 10.0 ** -len(text.partition("·")[0].partition(".")[2])
    factors = np.array([1.0, 100.0, *10.0 ** np.arange(-6.0, 13.0, 3.0)])
    return bool((np.abs(np.outer(values, factors) - plain) <= half).any())


DOCUMENTS = [*shipped(SHIPPED), *map(drawn, range(DRAWN))]


@pytest.mark.parametrize("document", DOCUMENTS, ids=range(len(DOCUMENTS)))
def test_the_first_screen_is_plain_and_says_what_diagnosis_json_says(document):
    text = first_screen(document)
    assert not PRIVATE.search(text), PRIVATE.search(text)
    assert not re.search(r"[{}|\[\]]|\bNone\b|\bnan\b|\.\.|  |: ?\.", text), text
    first = text.strip().split("\n")[0]
    assert first[0].isupper() and first.endswith(".") and len(first.split()) <= MOST_WORDS, first
    told = json.dumps([document, experiment_of(document)], ensure_ascii=False)
    values = np.array(numbers(document))
    for token in NUMBER.findall(text.replace("90 %:", "")):
        assert token in NUMBER.findall(told) or is_of(token, values), (token, text)


@pytest.mark.parametrize("document", DOCUMENTS, ids=range(len(DOCUMENTS)))
def test_nothing_certain_may_be_nothing(document):
    certain, candidates = opening.findings(document)
    for effect in certain:
        assert not holds_nothing(effect) and not effect["sentence"].startswith("Perhaps")
    text = first_screen(document)
    assert ("What is certain" in text) == bool(certain)
    assert ("Candidates, to be tried" in text) == bool(candidates)
    for effect in candidates:
        assert text.index("Perhaps") > text.index("Candidates, to be tried")
        assert f"\n{effect['sentence'].removeprefix('Perhaps ')}" not in text
    if certain:
        assert "Nothing is certain" not in text


def test_of_names_that_cannot_be_told_apart_the_plainest_speaks():
    document = drawn(0)
    effect = drawn_effect("anisotropy", np.random.default_rng(1))
    effect |= {"certain": False, "alternatives": ["domain-shape", "electrode-position"]}
    effect["sentence"] = words.effect_sentence(effect, EFFECTS["anisotropy"])
    document |= {"effects": [effect], "verdict": "partly-explained"}
    document.pop("families", None)
    text = first_screen(document)
    assert "Nothing is certain yet; to try first: measure the angle of every electrode." in text
    said = "Perhaps it is the electrode position: this recording cannot tell it from"
    assert f"{said} domain shape and anisotropy. If it is anisotropy, the skin conducts" in text
    for alternatives in ([], ["common-mode"]):
        assert opening.plainest(effect | {"alternatives": alternatives}) == effect | {
            "alternatives": alternatives
        }


def test_of_causes_that_read_the_same_the_advice_for_one_is_a_first_try():
    effect = drawn_effect("anisotropy", np.random.default_rng(1))
    effect |= {"certain": True, "alternatives": [], "parameters": {}}
    effect["sentence"] = "The skin conducts 2 times as well along as across. Instead it may not."
    text = opening.opening(drawn(0) | {"effects": [effect]}, RECORDED.channels)
    assert "(or what reads the same, below); to try first: " in text


def test_a_small_difference_and_the_errors_of_the_rig_are_said():
    scores = {"rms_before_V": 3.0e-5, "rms_after_V": 2.9e-5}
    document = drawn(0) | {"verdict": "explained", "fit": {"last": scores, "held_out": scores}}
    document |= {"noise_V": 2.0e-5}
    assert opening.extent(document).endswith(", which is small here.")
    assert opening.error_sentence(document, "V").endswith(", and errors of the rig come on top.")
    document["fit"]["last"] = {"rms_before_V": 9.0e-5, "rms_after_V": 2.0e-5}
    assert opening.extent(document).endswith("between simulation and recording.")
    assert "errors of the rig" not in opening.error_sentence(document, "V")


def test_the_one_experiment_tells_most_apart():
    pair = {"a": "offset", "b": "channel-gain", "gap_now": 1.0, "gap_then": 9.0, "recipe": "Wait."}
    others = [pair | {"b": name, "recipe": "Press harder"} for name in ("gain-walk", "ground-leak")]
    weak = pair | {"recipe": "Repeat", "gap_then": DISTINCT.threshold - 1.0}
    document = drawn(0)
    text = opening.experiment_sentence(document, {"pairs": [pair, *others, weak, weak, weak]})
    assert text == (
        "The one experiment worth doing: press harder; that would tell offset from gain walk and"
        " ground leak."
    )
    assert "Nothing that was tried" in opening.experiment_sentence(document, {"pairs": [weak]})
    hidden = document | {"unobservable": ["force-lag", "frame-skew", "offset"]}
    text = opening.experiment_sentence(hidden, {"pairs": []})
    assert text.endswith("; it could show force lag and frame skew.")
    assert opening.experiment_sentence(document | {"unobservable": []}, {"pairs": []}) == ""
    untouched = document | {"unobservable": [*opening.OF_TOUCHES, "contact-drift"]}
    text = opening.experiment_sentence(untouched, {"pairs": []})
    assert text == f"{opening.WORTH}: {opening.PRESSES}."
    assert "could not have shown what touches do." in " ".join(opening.unknown_sentences(untouched))


def test_a_correction_that_does_not_help_is_not_praised():
    document = next(d for d in DOCUMENTS if d["effects"])
    worse = document["fit"]["held_out"] | {"rms_before_V": 1e-6, "rms_after_V": 2e-6}
    document = document | {"fit": {"held_out": worse, "last": worse}}
    text = first_screen(document)
    assert "does not fall" in text and "use it for nothing" in text
