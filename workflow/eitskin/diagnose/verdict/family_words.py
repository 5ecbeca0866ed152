"""Families in words: what is a little wrong everywhere, by how much, and how much it explains."""

from eitskin.diagnose.verdict.words import UNITS
from eitskin.quantities import interval, listed, number

TOLD_SHARE = 0.01  # of the held-out misfit: less is not worth a sentence
SENTENCES = {  # on a family; its sd as {sd}, in the unit of a reader
    "drive-gain": "The current differs from drive to drive by {sd}.",
    "measurement-gain": "The gain differs from measuring pair to measuring pair by {sd}.",
    "offset": "Each measuring pair has an offset, of {sd}.",
    "electrode-position": "Each electrode is a little off its place, by {sd}.",
    "electrode-width": "The electrodes' widths scatter by {sd}.",
    "contact-impedance": "The electrodes' contact impedances scatter by {sd}.",
    "ground-leak": "Each electrode leaks a little to ground, through {sd}.",
    "rim-modes": "The rim is a little out of round, by {sd} of its radius a harmonic.",
}
NAMES = {
    "drive-gain": "the drives' currents",
    "measurement-gain": "the measuring pairs' gains",
    "offset": "the offsets",
    "electrode-position": "the electrodes' places",
    "electrode-width": "the electrodes' widths",
    "contact-impedance": "the contacts",
    "ground-leak": "the leaks",
    "rim-modes": "the rim",
}


def family_sentence(family: dict) -> str:
    """A family of diagnosis.json in a sentence: its sd with the 90 % interval, its share, and what
    it cannot be told from."""
    sd = family["sd"]
    factor, unit = (100.0, "%") if sd["unit"] == "1" else (1.0, UNITS.get(sd["unit"], sd["unit"]))
    value, low, high = (factor * sd[key] for key in ("value", "low", "high"))
    size = interval(value, low, high, unit)
    text = SENTENCES[family["name"]].replace("{sd}", size)
    if family["share"] >= TOLD_SHARE:
        share = f"{number(100.0 * family['share'])} %"
        text += f" Without it {share} of the misfit of what was held out comes back."
    if family["confused_with"]:
        others = listed([NAMES[name] for name in family["confused_with"]])
        text += f" It cannot be told from {others}."
    return text
