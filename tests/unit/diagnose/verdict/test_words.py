"""A diagnosis in words: every effect's sentence, for one site, several, all alike, each its own."""

import re

import numpy as np
import pytest

from eitskin import quantities
from eitskin.diagnose.verdict import words
from eitskin.effects import EFFECTS
from eitskin.effects.electrode_position import INSIDE, RIM

COUNTS = {"electrodes": 16, "drives": 16, "measures": 16, "channels": 208}


def entry(name: str, kind: str | None = None, count: int = 0, scope: str = "common") -> dict:
    """An effect of diagnosis.json with made-up values, all of its parameters given."""
    effect = EFFECTS[name]
    parameters = {}
    for key, parameter in effect.parameters.items():
        value = 2.0 if parameter.whole else 0.5 + 0.01 * np.arange(max(count, 1))
        if np.ndim(value) and not (parameter.dense and count):
            value = value[0]
        margin = 0.0 if parameter.whole else 0.02
        parameters[key] = {
            "value": np.asarray(value).tolist(),
            "low": (value - np.float64(margin)).tolist(),
            "high": (value + np.float64(margin)).tolist(),
            "unit": parameter.unit,
        }
    sites = {each: [] for each in words.NOUNS}
    if kind is not None:
        sites[kind] = list(range(3, 3 + count)) if scope == "sparse" else list(range(count))
    return {"name": name, "scope": scope, **sites, "parameters": parameters}


CERTAIN = entry("crosstalk") | {"certain": True}


def forms(name: str) -> list[tuple[str, list[str]]]:
    """The sentences of an effect, with gaps, and the parameters of each: of electrodes' places
    those on the rim, and those inside."""
    effect = EFFECTS[name]
    groups = [RIM, INSIDE] if name == "electrode-position" else [tuple(effect.parameters)]
    inside = {key: 0.5 for key in INSIDE}
    texts = [effect.finding, effect.finding_at(inside)] if len(groups) > 1 else [effect.finding]
    return list(zip(texts, map(list, groups), strict=True))


def entries(name: str):
    """An effect at one, two and five of its sites, at all alike, and at each its own way."""
    for _, keys in forms(name):
        for whole in entries_of_all(name):
            parameters = {key: whole["parameters"][key] for key in keys}
            yield {**whole, "parameters": parameters}


def entries_of_all(name: str):
    effect = EFFECTS[name]
    for kind in effect.sites:
        for count in (effect.site_number,) if effect.site_number else (1, 2, 5, 9):
            yield entry(name, kind, count, "sparse")
        if effect.site_number is None:
            yield entry(name, kind, COUNTS[kind], "dense")
    if effect.site_number is None:
        yield entry(name)


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_every_placeholder_is_a_parameter_and_every_parameter_has_one(name):
    effect = EFFECTS[name]
    texts = [text for text, _ in forms(name)]
    gaps = {g.partition(":")[0] for t in texts for g in words.GAP.findall(t) if "|" not in g}
    own = effect.parameters.items()
    flags = {key for key, parameter in own if parameter.whole and parameter.optional}
    untold = {effect.polar[1]} if effect.tone else set()  # a tone's phase is of the clock alone
    assert gaps == {*effect.parameters, *(["site"] if effect.sites else [])} - flags - untold
    optional = {key for key, parameter in own if parameter.optional} - flags
    parts = {
        g.partition(":")[0]
        for t in texts
        for p in words.PART.findall(t)
        for g in words.GAP.findall(p)
    }
    assert optional - untold <= parts and all(key in words.UNTOLD for key in optional - untold)
    assert effect.shown_by and not re.search(r"[{}\[\]]|\.$", effect.shown_by)


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_every_sentence_is_whole(name):
    for each in entries(name):
        text = words.effect_sentence(each, EFFECTS[name])
        assert "phase" not in text
        assert not re.search(r"[{}|\[\]]|None|nan|  ", text), text
        assert (text[0].isupper() or text[0].isdigit()) and text.endswith("."), text
        effect = EFFECTS[name]
        untold = [effect.polar[1]] if effect.tone else []
        measured = [k for k in each["parameters"] if not effect.parameters[k].whole]
        measured = [k for k in measured if k not in untold]
        assert text.count("90 %: ") >= len(measured), text


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_what_is_not_given_is_not_said(name):
    effect = EFFECTS[name]
    untold = {effect.polar[1]} if effect.tone else set()
    for full in entries(name):
        optional = {key for key in full["parameters"] if effect.parameters[key].optional}
        for key in optional - untold:
            some = {k: v for k, v in full["parameters"].items() if k != key}
            shorter = words.effect_sentence({**full, "parameters": some}, effect)
            assert len(shorter) < len(words.effect_sentence(full, effect))
            assert shorter.endswith(".") and "[" not in shorter


def said(name: str, *arguments, **values) -> str:
    made = entry(name, *arguments)
    for key, (value, low, high) in values.items():
        made["parameters"][key] |= {"value": value, "low": low, "high": high}
    return words.effect_sentence(made, EFFECTS[name])


def test_one_site():
    assert said(
        "contact-impedance", "electrodes", 1, "sparse", ratio=([2.104], [2.087], [2.121])
    ) == (
        "Electrode 3 has 2.104 (90 %: 2.087 to 2.121) times the contact"
        " impedance that the simulation assumes."
    )


def test_values_of_both_signs_are_counted_towards_larger_angles():
    made = entry("electrode-position", "electrodes", 2, "sparse")
    shifts = {"value": [-0.4, 0.3], "low": [-0.5, 0.2], "high": [-0.3, 0.4], "unit": "deg"}
    text = words.effect_sentence(
        made | {"parameters": {"shift_deg": shifts}}, EFFECTS["electrode-position"]
    )
    assert text.endswith("counted towards larger angles.")


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_a_candidate_is_said_with_a_perhaps(name):
    for each in entries(name):
        sure, text = (
            words.effect_sentence(each | {"certain": c}, EFFECTS[name]) for c in (True, False)
        )
        assert sure == words.effect_sentence(each, EFFECTS[name])
        assert text == f"Perhaps {sure[0].lower()}{sure[1:]}"


def test_the_headline_is_the_verdict_s_unless_candidates_are_named():
    for verdict, text in words.VERDICTS.items():
        effects = [] if verdict in ("consistent", "unexplained") else [CERTAIN]
        assert words.headline({"verdict": verdict, "effects": effects}) == text
    said = words.headline({"verdict": "partly-explained", "effects": [{"certain": False}]})
    assert said == words.CANDIDATES
    both = [CERTAIN, CERTAIN | {"certain": False}]
    said = words.headline({"verdict": "partly-explained", "effects": both})
    assert said == words.SOME_CERTAIN


@pytest.mark.parametrize(
    "contrast, how, what", [(1.003, "better", "perfect conductor"), (0.95, "worse", "hole")]
)
def test_what_cannot_be_told_apart_is_said_together(contrast, how, what):
    made = entry("conductivity-patch")
    made["parameters"]["contrast"] |= {"value": contrast, "low": 0.9, "high": 1.1}
    written_alike = {"value": 0.384, "low": 0.352, "high": 0.419, "unit": "mm"}
    amounts = {"amounts": {"equivalent_radius_mm": written_alike}}
    text = words.effect_sentence(made | amounts, EFFECTS["conductivity-patch"])
    assert text.startswith(f"The skin conducts {how} about the place x = 0.500 (")
    assert f"a {what} of radius 0.384 (90 %: 0.352 to 0.419)\xa0mm" in text
    assert text.endswith("cannot be told apart.")
    assert "times as well within 0.500" in words.effect_sentence(
        made, EFFECTS["conductivity-patch"]
    )


def test_two_sites_in_their_order():
    text = said("drive-gain", "drives", 2, "sparse", gain=([1.3, 0.7], [1.2, 0.6], [1.4, 0.8]))
    assert text == (
        "The drives from electrodes 3 and 4 carry respectively 1.30 (90 %: 1.20 to 1.40) and 0.70"
        " (90 %: 0.60 to 0.80) times the current that the simulation assumes."
    )


def test_all_alike():
    text = said("contact-drift", per_minute=(-0.02, -0.03, -0.01))
    assert text == (
        "The contact impedance of all electrodes changes by -2.0 (90 %: -3.0 to -1.0)\xa0% per"
        " minute.".replace("-", quantities.MINUS)
    )


def test_each_its_own():
    gain = np.linspace(0.9, 1.1, 16)[np.random.default_rng(1).permutation(16)]
    text = said("measurement-gain", "measures", 16, "dense", gain=(gain, gain - 0.01, gain + 0.01))
    assert text == (
        "All 16 measuring pairs read anything from 0.900 (90 %: 0.890 to 0.910) to 1.100 (90 %:"
        " 1.090 to 1.110) times the voltage that is there."
    )


@pytest.mark.parametrize("spread", [0.0, 1e-3, 0.3])
def test_values_that_their_intervals_cannot_tell_apart_have_no_range(spread):
    """0.5600 and 0.5602 are 0.56 with an interval of 0.2, and as many values with one of 1e-5."""
    gain = 0.56 + spread * np.linspace(0.0, 0.2, 16)
    wide = np.full(16, 0.01)
    wide[0] = 0.2
    text = said("measurement-gain", "measures", 16, "dense", gain=(gain, gain - wide, gain + wide))
    if spread < 0.1:
        assert "read about 0.56 (90 %: 0.36 to 0.76) times" in text
    else:
        assert "anything from 0.56 (90 %: 0.36 to 0.76) to 0.620 (90 %: 0.610 to 0.630)" in text
    text = said("measurement-gain", "measures", 16, "dense", gain=(gain, gain - 1e-5, gain + 1e-5))
    assert ("anything from 0.5600000 (" in text) == (spread > 0.0)
    assert not re.search(r"from (\S+) \(.*?\) to \1 \(", text)


def test_values_at_a_bound_have_no_digits_of_their_interval():
    made = entry("measurement-gain", "measures", 16, "dense")
    gain = np.linspace(0.2, 3.0, 16)
    bound = ["low", *[None] * 15]
    made["parameters"]["gain"] |= {"value": gain, "low": gain - 0.1, "high": gain + 0.1}
    made["parameters"]["gain"] |= {"at_bound": bound}
    made["parameters"]["gain"]["high"][0] = 100.0
    text = words.effect_sentence(made, EFFECTS["measurement-gain"])
    assert "from 0.200 (the least value tried, without an interval) to 3.00 (90 %: 2.90" in text
    made["parameters"]["gain"] |= {"value": np.full(16, 0.2), "at_bound": ["low"] * 16}
    text = words.effect_sentence(made, EFFECTS["measurement-gain"])
    assert "read about 0.200 (the least value tried, without an interval) times" in text


def test_a_rim_of_another_size_is_no_shape():
    for phase, word in ((0.0, "larger"), (180.0, "smaller")):
        text = said(
            "domain-shape",
            harmonic=(0.0, 0.0, 0.0),
            amplitude=(0.02, 0.01, 0.03),
            phase_deg=(phase, -360.0, 360.0),
            carried=(0.0, 0.0, 0.0),
        )
        assert text == f"The skin is 2.0 (90 %: 1.0 to 3.0)\xa0% {word} than it should be."
    assert "bulges at 3 places" in said("domain-shape", harmonic=(3.0, 3.0, 3.0))


def test_a_pressed_rim_carries_its_electrodes():
    for carried in (0.0, 1.0):
        text = said("domain-shape", harmonic=(2.0, 2.0, 2.0), carried=(carried,) * 3)
        assert text.endswith("as much shorter, its electrodes carried along.") == bool(carried)


def test_degrees_stand_behind_each_number_and_large_numbers_are_written_alike():
    assert quantities.interval(2.0, 1.9, 2.1, "°") == "2.00° (90 %: 1.90° to 2.10°)"
    assert quantities.interval(np.inf, 1.0, np.inf, "°") == "∞° (90 %: 1° to ∞°)"
    assert quantities.number(876506.2) == "8.77·10⁵" and quantities.number(9.09e6) == "9.09·10⁶"
    assert quantities.number(876506.2, 5) == "876506" == quantities.number(876506.0)
    assert quantities.number(12345.6) == "12346"


@pytest.mark.parametrize(("high", "told"), [(60.0, True), (400.0, False)])
def test_a_size_that_might_be_anything_is_said_to_be_untold(high, told):
    body = entry("third-dimension")
    body["parameters"]["depth_mm"] |= {"value": 20.0, "low": 2.0, "high": high}
    text = words.effect_sentence(body, EFFECTS["third-dimension"])
    assert ("through 20 (90 %: " in text) == told
    assert ("These readings do not tell its depth." in text) != told
    assert "mm high" in text


def test_lengths_are_said_to_be_ratios_where_none_is_known():
    assert words.size_sentences({}) == []
    (sentence,) = words.size_sentences({"scale": {"radius_mm": 80.0}})
    assert sentence.startswith("No length that tells the skin's size is stated")
    assert f"80{quantities.NO_BREAK}mm radius" in sentence
