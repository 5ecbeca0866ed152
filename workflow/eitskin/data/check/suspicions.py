"""Suspicions about a recording's units and device: one function for each topic, from a recording
to its findings, which are empty where nothing looks wrong.
"""

from eitskin.data.check import (
    compliance,
    exchange,
    kinds,
    naming,
    plausibility,
    response,
    steps,
    unlabelled,
)
from eitskin.data.check.finding import ERROR, WARNING, Finding
from eitskin.data.recording import Recording
from eitskin.quantities import listed, percent


def units(recording: Recording) -> list[Finding]:
    """Numbers that are implausible in their unit (value: by which factor they seem too large)."""
    findings = []
    for doubt in plausibility.doubts(recording):
        factor_text = "" if doubt.factor is None else f" ({_times(doubt.factor)})"
        sentence = f"{doubt.key}: {doubt.observed}. Looks like {doubt.likely_mistake}{factor_text}."
        findings.append(Finding("units", WARNING, sentence, doubt.factor))
    return findings


def kind_of_values(recording: Recording) -> list[Finding]:
    """Values that are not of the stated kind, so that nothing else can be said of them."""
    if kinds.is_difference(recording):
        sentence = (
            "the untouched skin reads less than touches change: these are differences, not "
            "absolute values. State values: difference."
        )
        return [Finding("values", ERROR, sentence)]
    if kinds.is_normalised(recording):
        sentence = (
            "these differences and their noise do not fall off with distance from the drive as "
            "readings do: they are normalised, divided by the untouched readings. Multiply each "
            "channel by the size of its untouched reading."
        )
        return [Finding("values", ERROR, sentence)]
    return []


def constant_frames(recording: Recording) -> list[Finding]:
    """Readings that are equal in all frames (value: number of frames)."""
    constant_frames = response.constant_frames(recording)
    if constant_frames is None:
        return []
    sentence = f"no reading changes in {constant_frames.frames} frames, not even by noise"
    if constant_frames.severity == ERROR:
        sentence += f", though the skin is touched in {constant_frames.touched} of them"
    sentence += ": the instrument repeats itself, or one frame was copied."
    return [Finding("constant", constant_frames.severity, sentence, float(constant_frames.frames))]


def unseen_touches(recording: Recording) -> list[Finding]:
    """Touches that change no reading (value: the p-value of a difference)."""
    unseen = response.unseen_touches(recording)
    if unseen is None:
        return []
    sentence = (
        f"the {unseen.touched} touched frames differ from the untouched skin no more than the "
        f"{unseen.untouched} untouched ones do (p = {unseen.p_value:.2g}): no touch is seen. "
        "Touches and readings may not belong together, or the probe does not reach the skin."
    )
    return [Finding("unseen", WARNING, sentence, unseen.p_value)]


def unlabelled_touches(recording: Recording) -> list[Finding]:
    """Stretches of frames, labelled untouched, that hold a touch (value: their frames)."""
    findings = []
    for first, last in unlabelled.unlabelled_touches(recording):
        sentence = (
            f"in {unlabelled.stretch_text((first, last))} somebody touched the skin although no"
            " label tells: the readings leave the level of the untouched frames as a touch makes"
            " them, and come back to it. A diagnosis leaves these frames out."
        )
        findings.append(
            Finding("unlabelled", WARNING, sentence, float(last - first + 1), frame=first)
        )
    return findings


def exchanged_channels(recording: Recording) -> list[Finding]:
    """Two exchanged columns (value: the number of exchanges that would restore reciprocity)."""
    exchanges = exchange.exchanged_channels(recording)
    if not exchanges:
        return []
    candidates = " or ".join(f"{channel} and {partner}" for channel, partner in exchanges)
    sentence = (
        f"channels {candidates} seem to stand in each other's place: put back, they keep "
        "reciprocity as all others do. Or two of these are off alike: look at their wiring."
    )
    return [Finding("exchanged", WARNING, sentence, float(len(exchanges)))]


def weak_drives(recording: Recording) -> list[Finding]:
    """Drives whose current is low (value: the lowest share of the median current)."""
    weak_drives = compliance.weak_drives(recording)
    if weak_drives is None:
        return []
    drives = listed(
        [
            f"{a}-{b} (by {percent(1.0 - share, 1)})"
            for (a, b), share in zip(weak_drives.drives, weak_drives.shares, strict=True)
        ]
    )
    plural = "s" if len(weak_drives.drives) > 1 else ""
    sentence = (
        f"drive{plural} {drives}: all readings low together against those with drive and "
        f"measurement exchanged, which explains {percent(weak_drives.explained)} of what breaks "
        "reciprocity. The source may be at its compliance there, or a contact open (or the same "
        "pairs are read too high): look at its voltage range and at these electrodes."
    )
    return [Finding("drives", WARNING, sentence, min(weak_drives.shares))]


def steps_in_time(recording: Recording) -> list[Finding]:
    """Steps of the untouched readings (value: the change over one frame's noise)."""
    findings = []
    cause = "a wire or a contact moved"
    if not recording.frames["touch"].any():
        cause += ", or a touch that the file does not tell"
    for step in steps.steps(recording):
        previous_frame, next_frame = step.between
        sentence = f"the untouched readings change for good from frame {step.frame} on"
        if next_frame - previous_frame > 1:
            sentence += f" (between the untouched frames {previous_frame} and {next_frame})"
        if step.factor is not None:
            sentence += f", all by the factor {step.factor:.4f}: the source or a gain changed"
        elif step.electrodes:
            verb = "takes" if len(step.electrodes) == 1 else "take"
            sentence += f", most where {naming.electrodes(step.electrodes)} {verb} part"
            sentence += f": {cause}"
        else:
            rows = naming.channels(recording, step.channels)
            sentence += f", most in {rows}: the skin or the setup changed, or a cut"
        findings.append(Finding("step", WARNING, f"{sentence}.", step.size, frame=step.frame))
    return findings


def _times(factor: float) -> str:
    times = max(factor, 1.0 / factor)
    shown = f"{times:.3g}" if times < 999.5 else f"{times:,.0f}"
    return f"{shown} times too {'large' if factor > 1 else 'small'}"
