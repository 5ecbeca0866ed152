"""The rig in words: what a recording shows of its noise, its robot and its load cell."""

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
}
UNKNOWN = "The rig has an error called {name}, of {size}."
ASSUMED = "; this is assumed, for the recording has nothing that shows it."


def component_sentence(component: dict) -> str:
    """A component of `noise` in diagnosis.json in a sentence: its size with its 90 % interval, or
    that its size is assumed."""
    text = SENTENCES.get(component["name"], UNKNOWN.replace("{name}", component["name"]))
    size = size_text(component)
    text = text.replace(PER_CENT, size).replace(PLAIN, size)
    return text if component["learned"] else f"{text.removesuffix('.')}{ASSUMED}"


def noise_sentences(noise: dict) -> list[str]:
    """`noise` of diagnosis.json, a sentence each: components, loud frames, spikes, jumps, and what
    changes with time or in one press without a name."""
    sentences = [component_sentence(component) for component in noise["components"]]
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
