"""What a comparison found, in words."""

from eitskin.diagnose.comparison.joint import (
    CALIBRATED,
    Part,
    Shared,
    View,
)
from eitskin.diagnose.comparison.tested import Tested
from eitskin.diagnose.fitting.candidates import Candidate
from eitskin.diagnose.fitting.estimates import estimates
from eitskin.diagnose.verdict.words import CALIBRATIONS
from eitskin.diagnose.verdict.words import finding as in_words
from eitskin.effects.effect import SITES
from eitskin.quantities import interval, listed

NOTHING = "Nothing has changed that these recordings could show."


def _entry(candidate: Candidate, sites: tuple[int, ...] | None, parameters: dict) -> dict:
    """An effect as `words` reads it."""
    entry = {"name": candidate.name, **{kind: [] for kind in SITES}, "parameters": parameters}
    entry["scope"] = candidate.scope if sites is None else "sparse"
    if candidate.kind is not None and sites is not None:
        entry[candidate.kind] = list(sites)
    return entry


def found(test: Tested, part: Part, view: View, parameters: dict) -> str:
    """The effect tested in words, with its parameters at its site, as the inside of a sentence."""
    candidate = view.effects[part.which.index(test.effect)]
    sites = candidate.sites if candidate.scope == "sparse" else None
    entry = _entry(candidate, sites if test.site is None else (test.site,), parameters)
    return _inside(in_words(entry, candidate.effect))


def _inside(sentence: str) -> str:
    return f"{sentence[0].lower()}{sentence[1:]}".removesuffix(".")


def switched(
    test: Tested, candidate: Candidate, part: Part | None, present: dict[str, bool]
) -> str:
    """Since when an effect is there that is there or not."""
    if part is None:
        return f"Taken together, no part shows {candidate.name}."
    parameters = {}
    if candidate.names:
        view = View(part.fit.problem, part.fit.effects, part.fit.theta, part.spread)
        parameters = estimates(view, part.which.index(test.effect))
    finding = _inside(in_words(_entry(candidate, candidate.sites, parameters), candidate.effect))
    if not test.changed:
        return f"Throughout, {finding}."
    if len(test.groups) == 2:
        later = test.groups[1][0]
        if present[later]:
            return f"Since {later} {finding}; before it was not so."
        return f"Before {later}, {finding}; since then it is not so."
    names = listed([name for name, one in present.items() if one])
    return f"In {names}, {finding}; elsewhere it is not so."


def changed(test: Tested, combined: list[dict], finding: str, shared: list[Shared]) -> str:
    """What is tested in words: with its value, or with the values before and since."""
    calibrated = test.effect == CALIBRATED
    name = CALIBRATIONS[test.keys[0]] if calibrated else ""
    texts = [_valued(test, each, shared) for each in combined]
    if test.p is None:
        named = name or f"the {test.keys[0]} of {shared[test.effect].candidate.name}"
        return f"Only {test.groups[0][0]} tells {named}: {texts[0]}."
    if not test.changed:
        return f"Throughout, {finding}." if finding else f"Throughout, {name} is {texts[0]}."
    now = finding or f"{name} is {texts[-1]}"
    it = "it"
    if not calibrated and len(shared[test.effect].candidate.names) > 1 and len(test.keys) == 1:
        it = f"the {test.keys[0].partition('_')[0]}" if test.site is None else it
    if len(texts) == 2:
        return f"Since {test.groups[1][0]} {now}; before {it} was {texts[0]}."
    earlier = [
        f"{text} in {listed(run)}" for text, run in zip(texts[:-1], test.groups, strict=False)
    ]
    return f"Since {test.groups[-1][0]} {now}; {it} was {', then '.join(earlier)}."


def _valued(test: Tested, values: dict, shared: list[Shared]) -> str:
    """The values tested, in words; as a percentage where the effect's own sentence has them so."""
    texts = []
    for key, estimate in values.items():
        numbers, unit = [estimate[k] for k in ("value", "low", "high")], estimate["unit"]
        finding = "" if test.effect == CALIBRATED else shared[test.effect].candidate.effect.finding
        if f"{{{key}:%}}" in finding:
            numbers, unit = [100.0 * n for n in numbers], "%"
        texts.append(interval(numbers[0], numbers[1], numbers[2], unit))
    return " with ".join(texts)
