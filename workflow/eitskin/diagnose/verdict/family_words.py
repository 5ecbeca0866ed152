"""Families in words: what is a little wrong everywhere, by how much, and how much it explains."""

from eitskin.diagnose.verdict.words import UNITS
from eitskin.quantities import interval, listed, number

TOLD_SHARE = 0.01  # of the held-out misfit: less is not worth a sentence
SENTENCES = {  # on a family; its sd as {sd}, in the unit of a reader
    "drive-gain": "All drives carry their current to {sd}.",
    "measurement-gain": "All measuring pairs read true to {sd}.",
    "offset": "All measuring pairs have their zero to {sd}.",
    "electrode-position": "All electrodes are in their places to {sd}.",
    "electrode-width": "All electrodes have their width to {sd}.",
    "contact-impedance": "All contacts are alike to {sd}.",
    "ground-leak": "All electrodes leak a little to ground, through about {sd}.",
    "rim-modes": "The rim is round to {sd} of its radius.",
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
        text += f" It accounts for {share} of the misfit."
    if family["confused_with"]:
        others = listed([NAMES[name] for name in family["confused_with"]])
        text += f" This recording cannot tell it from {others}."
    return text
