"""The rig in words: what a recording shows of its noise, its robot and its load cell."""

import numpy as np

from eitskin.diagnose.verdict.words import UNITS
from eitskin.quantities import interval, listed, quantity

MOST_LISTED = 6  # frames; more are counted
PER_CENT, PLAIN = "{size:%}", "{size}"
SENTENCES = {  # on a component; its size as {size}, or as {size:%} of the whole
    "amplitude-per-frame": "All readings of a frame scatter together by {size:%} from frame to"
    " frame.",
    "gain-walk": "The gain of all channels wanders over the recording, typically by {size:%}.",
    "gain-flicker": "The gain of all channels flickers, with power in proportion to 1/f, by"
    " {size:%}.",
    "correlated-noise": "Noise lasts from one frame to the next, with a correlation of {size}.",
    "common-noise": "All channels of a frame share noise of {size}.",
    "channel-drift": "Each channel drifts by itself over the recording, typically by {size}.",
    "channel-wander": "Each channel wanders by itself about its level, by {size}.",
    "quantisation": "The converter's rounding leaves errors of typically {size} that do not"
    " scatter.",
    "quadrature": "The board reads magnitudes: quadrature of typically {size:%} of a reading is in"
    " them.",
    "place-per-frame": "The robot's places scatter by {size} from frame to frame.",
    "place-per-press": "The robot's places are good to {size}, press by press.",
    "force-per-frame": "The load cell scatters by {size} from frame to frame.",
    "force-per-press": "The load cell's forces are good to {size:%}, press by press.",
    "force-zero-per-press": "The load cell's zero is good to {size}, press by press.",
    "force-zero-walk": "The load cell's zero wanders over the recording, typically by {size}.",
    "place-walk": "The robot's place wanders over the recording, typically by {size}.",
    "force-walk": "The load cell's factor wanders over the recording, typically by {size:%}.",
    "place-creep": "The probe creeps away by {size} in a press.",
    "force-zero-creep": "The load cell creeps by {size} in a press.",
}
COMMON_SENTENCES = {  # on what all presses share, with its interval; of places by axis
    "place-per-press": "All touches are {x} along x and {y} along y from their reported places.",
    "force-per-press": "All forces are {size:%} larger than reported.",
    "force-zero-per-press": "All forces are {size} larger than reported.",
    "place-delay": "All poses are {size} late.",
    "force-delay": "All forces are {size} late.",
}
UNKNOWN = "The rig has an error called {name}, of {size}."
ASSUMED = "; this is assumed, for the recording has nothing that shows it."


def component_sentences(component: dict) -> list[str]:
    """A component of `noise` in diagnosis.json in sentences: its size with its 90 % interval, or
    that its size is assumed; what all presses share of it, where that is not nothing."""
    sentences = []
    if component["sd"] > 0.0 and component["unit"] != "s":
        text = SENTENCES.get(component["name"], UNKNOWN.replace("{name}", component["name"]))
        size = size_text(component)
        text = text.replace(PER_CENT, size).replace(PLAIN, size)
        sentences.append(text if component["learned"] else f"{text.removesuffix('.')}{ASSUMED}")
    common = component.get("common")
    if common and component["name"] in COMMON_SENTENCES and _is_something(common):
        sentences.append(_common_sentence(component))
    return sentences


def _is_something(common: dict) -> bool:
    """Whether an interval, or that along one axis, is without 0."""
    low, high = np.ravel(common["low"]), np.ravel(common["high"])
    return bool(((low > 0.0) | (high < 0.0)).any())


def _common_sentence(component: dict) -> str:
    """What all presses share of a component, with its 90 % interval."""
    text = COMMON_SENTENCES[component["name"]]
    factor, unit = (100.0, "%") if PER_CENT in text else (1.0, component["unit"])
    ends = [factor * np.ravel(component["common"][key]) for key in ("value", "low", "high")]
    sizes = [
        interval(float(value), float(low), float(high), unit)
        for value, low, high in zip(*ends, strict=True)
    ]
    if len(sizes) == 1:
        return text.replace(PER_CENT, sizes[0]).replace(PLAIN, sizes[0])
    return text.format(x=sizes[0], y=sizes[1])


def noise_sentences(noise: dict) -> list[str]:
    """`noise` of diagnosis.json, a sentence each: components, loud frames, spikes, jumps, and what
    changes with time or in one press without a name."""
    sentences = [s for component in noise["components"] for s in component_sentences(component)]
    loud, spikes, jumps = (noise.get(key) for key in ("loud_frames", "spikes", "jumps"))
    if loud:
        are, were = ("is", "was") if len(loud) == 1 else ("are", "were")
        sentences.append(f"{_frames_text(loud)} {are} louder than the others and {were} left out.")
    if spikes and spikes["readings"]:
        count, share = spikes["readings"], quantity(100.0 * spikes["share"], "%", 2)
        plural = "readings", "stand out alone and were"
        noun, verb = ("reading", "stands out alone and was") if count == 1 else plural
        sentences.append(f"{count} {noun} ({share}) {verb} left out.")
    if jumps:
        place = _frames_text(jumps).lower()
        sentences.append(f"At {place} the readings jump: the rig did not stay the same.")
    for sentence in noise.get("changes", ()):
        sentences.append(f"{sentence} A rig's ordinary errors do so, too.")
    return sentences


def size_text(component: dict) -> str:
    """The size of a component in its unit, with its 90 % interval where it was learned."""
    factor, unit = _scale(component)
    value, low, high = (factor * component[key] for key in ("sd", "low", "high"))
    if low == high or not component["learned"]:
        return quantity(value, unit)
    return interval(value, low, high, unit)


def _scale(component: dict) -> tuple[float, str]:
    """The factor and the unit in which the size of a component is written."""
    unit = component["unit"]
    if unit == "1" and PER_CENT in SENTENCES.get(component["name"], ""):
        return 100.0, "%"
    return 1.0, UNITS.get(unit, unit)


def _frames_text(frames: list[int]) -> str:
    """`Frame 3`, `Frames 3 and 5`; of many the first, and how many more."""
    if len(frames) == 1:
        return f"Frame {frames[0]}"
    surplus = len(frames) - MOST_LISTED
    shown = [*frames[:MOST_LISTED], f"{surplus} more"] if surplus > 0 else frames
    return f"Frames {listed(shown)}"
