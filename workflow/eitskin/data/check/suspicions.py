"""What a careful lab mate says of a recording's units and device: one function a topic, from a
recording to its findings. Where nothing looks wrong, nothing is said.
"""

from eitskin.data.check import compliance, exchanged, named, plausibility, response, steps
from eitskin.data.check.finding import ERROR, WARNING, Finding
from eitskin.data.recording import Recording
from eitskin.quantities import listed, percent


def units(recording: Recording) -> list[Finding]:
    """Numbers that are hardly in their unit (value: how many times too large they seem)."""
    found = []
    for doubt in plausibility.doubts(recording):
        times = "" if doubt.factor is None else f" ({_times(doubt.factor)})"
        sentence = f"{doubt.key}: {doubt.found}. Looks like {doubt.looks_like}{times}."
        found.append(Finding("units", WARNING, sentence, doubt.factor))
    return found


def constant(recording: Recording) -> list[Finding]:
    """Readings that are the same in every frame (value: how many frames)."""
    still = response.constant(recording)
    if still is None:
        return []
    sentence = f"no reading changes in {still.frames} frames, not even by noise"
    if still.severity == ERROR:
        sentence += f", though the skin is touched in {still.touched} of them"
    sentence += ": the instrument repeats itself, or one frame was copied."
    return [Finding("constant", still.severity, sentence, float(still.frames))]


def unseen(recording: Recording) -> list[Finding]:
    """Touches that no reading shows (value: the p-value of a difference)."""
    lack = response.unseen(recording)
    if lack is None:
        return []
    sentence = (
        f"the {lack.touched} touched frames differ from the untouched skin no more than the "
        f"{lack.untouched} untouched ones do (p = {lack.p_value:.2g}): no touch is seen. Touches "
        "and readings may not belong together, or the probe does not reach the skin."
    )
    return [Finding("unseen", WARNING, sentence, lack.p_value)]


def exchanged_channels(recording: Recording) -> list[Finding]:
    """Two columns in each other's place (value: how many exchanges would mend it)."""
    found = exchanged.exchanged(recording)
    if not found:
        return []
    which = " or ".join(f"{one} and {other}" for one, other in found)
    sentence = (
        f"channels {which} seem to stand in each other's place: put back, they keep reciprocity as "
        "all others do. Or two of these are off alike: look at their wiring."
    )
    return [Finding("exchanged", WARNING, sentence, float(len(found)))]


def weak_drives(recording: Recording) -> list[Finding]:
    """Drives whose current is low (value: the lowest share of the usual one)."""
    found = compliance.weak(recording)
    if found is None:
        return []
    drives = listed(
        [
            f"{a}-{b} (by {percent(1.0 - share, 1)})"
            for (a, b), share in zip(found.drives, found.shares, strict=True)
        ]
    )
    plural = "s" if len(found.drives) > 1 else ""
    sentence = (
        f"drive{plural} {drives}: all readings low together against those with drive and "
        f"measurement exchanged, which explains {percent(found.explained)} of what breaks "
        "reciprocity. The source may be at its compliance there, or a contact open (or the same "
        "pairs are read too high): look at its voltage range and at these electrodes."
    )
    return [Finding("drives", WARNING, sentence, min(found.shares))]


def steps_in_time(recording: Recording) -> list[Finding]:
    """Steps of the untouched readings (value: the change over one frame's noise)."""
    found = []
    moved = "a wire or a contact moved"
    if not recording.frames["touch"].any():
        moved += ", or a touch that the file does not tell"
    for step in steps.steps(recording):
        before, after = step.between
        sentence = f"the untouched readings change for good from frame {step.frame} on"
        if after - before > 1:
            sentence += f" (between the untouched frames {before} and {after})"
        if step.factor is not None:
            sentence += f", all by the factor {step.factor:.4f}: the source or a gain changed"
        elif step.electrodes:
            take = "takes" if len(step.electrodes) == 1 else "take"
            sentence += f", most where {named.electrodes(step.electrodes)} {take} part"
            sentence += f": {moved}"
        else:
            rows = named.channels(recording, step.channels)
            sentence += f", most in {rows}: the skin or the setup changed, or a cut"
        found.append(Finding("step", WARNING, f"{sentence}.", step.size, frame=step.frame))
    return found


def _times(factor: float) -> str:
    times = max(factor, 1.0 / factor)
    shown = f"{times:.3g}" if times < 999.5 else f"{times:,.0f}"
    return f"{shown} times too {'large' if factor > 1 else 'small'}"
