"""Suspicions about a recording's units and device: one function for each topic, from a recording
to its findings, which are empty where nothing looks wrong.
"""

import numpy as np

from eitskin.data.check import (
    compliance,
    copies,
    exchange,
    kinds,
    loads,
    naming,
    placeholders,
    plausibility,
    response,
    second_touches,
    steps,
    unlabelled,
)
from eitskin.data.check.finding import ERROR, WARNING, Finding
from eitskin.data.recording import Recording
from eitskin.quantities import counted, decimal, listed, percent

MAX_TOLD = 5  # steps or touches, one by one: more are no mishap of a recording


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


def stand_ins(recording: Recording) -> list[Finding]:
    """Numbers in the place of readings (value: their share of all readings)."""
    findings = []
    for placeholder in placeholders.placeholders(recording):
        frames = np.flatnonzero(placeholder.mask.any(axis=1))
        count = int(placeholder.mask.sum())
        verb = "is" if count == 1 else "are"
        sentence = (
            f"{counted(count, 'reading')} {verb} {placeholder.value:.6g} (in"
            f" {naming.frames(frames)}), far from all others of the same channels: the instrument's"
            " sign that it read nothing. Left out here and in a diagnosis."
        )
        share = float(placeholder.mask.mean())
        findings.append(Finding("placeholder", WARNING, sentence, share, frame=int(frames[0])))
    return findings


def unplugged(recording: Recording) -> list[Finding]:
    """Electrodes that no channel reads (value: the share of channels that they take part in)."""
    electrodes = placeholders.unplugged(recording)
    if not electrodes:
        return []
    channels = np.unique(np.concatenate([item.channels for item in electrodes]))
    readings = {item.reading for item in electrodes}
    reading = readings.pop() if len(readings) == 1 else None
    state = "read nothing" if reading is None else f"are {reading:.6g}"
    state = "are lost in every frame" if reading is not None and np.isnan(reading) else state
    numbers = sorted(item.electrode for item in electrodes)
    verb, pronoun = ("takes", "is") if len(numbers) == 1 else ("take", "are")
    sentence = (
        f"all {counted(len(channels), 'reading')} in which {naming.electrodes(numbers)} {verb} part"
        f" {state}: "
        f"{naming.electrodes(numbers)} {pronoun} not connected. They are left out here and in a"
        " diagnosis."
    )
    return [Finding("unplugged", WARNING, sentence, len(channels) / len(recording.channels))]


def copied_frames(recording: Recording) -> list[Finding]:
    """Frames that copy earlier ones (value: their share of all frames)."""
    rows = copies.copies(recording)
    if not len(rows):
        return []
    verb = "is a copy" if len(rows) == 1 else "are copies"
    sentence = (
        f"{naming.frames(rows)} {verb}, to the last digit of every channel, of an earlier frame:"
        " the instrument, its driver or the file repeats itself, and what these frames say of"
        " force, time and noise is not measured. A diagnosis leaves them out; ask the driver for"
        " new frames only."
    )
    share = len(rows) / len(recording.frames)
    return [Finding("copies", WARNING, sentence, share, frame=int(rows[0]))]


def lost_forces(recording: Recording) -> list[Finding]:
    """Forces that fall away in a press (value: the lowest of them in N)."""
    rows = loads.lost_forces(recording)
    if not len(rows):
        return []
    lowest = float(recording.frames["force_N"].to_numpy()[rows].min())
    sentence = (
        f"force_N falls to {lowest:.3g} N in {naming.frames(rows)}, within a press, though the"
        " readings show that the probe presses on: look at the load cell, its cable and its"
        " amplifier. A diagnosis leaves these frames out."
    )
    return [Finding("lost force", WARNING, sentence, lowest, frame=int(rows[0]))]


def load_cell_zero(recording: Recording) -> list[Finding]:
    """A force where nobody touches (value: its median in N)."""
    zero = loads.load_cell_zero(recording)
    if zero is None:
        return []
    values = zero.median_N, zero.least_N, zero.largest_N
    median_text, low_text, high_text = (decimal(v, 2) for v in values)
    spread = "" if low_text == high_text else f" ({low_text} to {high_text} N)"
    frames = "1 untouched frame reports" if zero.frames == 1 else "untouched frames report"
    fault, remedy = "is off", "Subtract it, or tare the load cell before each session"
    if zero.wanders:
        fault, remedy = "wanders", "Subtract that of the untouched frames beside each touch"
    sentence = (
        f"{frames} {median_text} N{spread}: the load cell's zero {fault}, and the forces of"
        f" touches probably as much. {remedy}."
    )
    return [Finding("zero", WARNING, sentence, zero.median_N)]


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
    verb = "differs" if unseen.touched == 1 else "differ"
    sentence = (
        f"the {counted(unseen.touched, 'touched frame')} {verb} from the untouched skin no more"
        f" than the {unseen.untouched} untouched ones do (p = {unseen.p_value:.2g}): no touch is"
        " seen. Touches and readings may not belong together, or the probe does not reach the skin."
    )
    return [Finding("unseen", WARNING, sentence, unseen.p_value)]


def unlabelled_touches(recording: Recording) -> list[Finding]:
    """Stretches of frames, labelled untouched, that hold a touch (value: their frames)."""
    stretches = unlabelled.unlabelled_touches(recording)
    if len(stretches) > MAX_TOLD:
        frames = np.concatenate([np.arange(first, last + 1) for first, last in stretches])
        places = [(f"{len(stretches)} times, in {naming.frames(frames)},", frames[0], len(frames))]
    else:
        places = [
            (f"in {unlabelled.stretch_text((first, last))}", first, last - first + 1)
            for first, last in stretches
        ]
    return [
        Finding(
            "unlabelled",
            WARNING,
            f"{place} somebody touched the skin although no label tells: the readings leave the"
            " level of the untouched frames as a touch makes them, and come back to it. A diagnosis"
            " leaves these frames out.",
            float(count),
            frame=int(first_row),
        )
        for place, first_row, count in places
    ]


def second_touch(recording: Recording) -> list[Finding]:
    """Presses with a second touch that no label tells (value: their frames)."""
    rows = second_touches.second_touches(recording)
    if not rows:
        return []
    frames = np.sort(np.concatenate(rows))
    sentence = (
        f"in {counted(len(rows), 'press')}, {naming.frames(frames)}, the readings show a second"
        " touch, at another place than the labelled one, that no label tells. A diagnosis leaves"
        " these frames out; a column `touches` would tell it both."
    )
    return [Finding("second", WARNING, sentence, float(len(frames)), frame=int(frames[0]))]


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
    all_steps = steps.steps(recording)
    if len(all_steps) > MAX_TOLD:
        largest = max(all_steps, key=lambda step: step.size)
        first, last = _steady_part(recording, [step.frame for step in all_steps])
        sentence = (
            f"{len(all_steps)} steps, the largest from frame {largest.frame} on: an object or a"
            " touch that the file does not tell, or a wire that moved, again and again. The longest"
            f" part without one: {unlabelled.stretch_text((first, last))}."
        )
        count = float(len(all_steps))
        return [Finding("steps", WARNING, sentence, count, stretch=(first, last))]
    for step in all_steps:
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


def _steady_part(recording: Recording, first_rows: list[int]) -> tuple[int, int]:
    """First and last row of the part between steps that has most frames in which nobody touched
    without a label; it begins and ends with such frames."""
    labelled_rows = np.arange(len(recording.frames))
    for first, last in unlabelled.unlabelled_touches(recording):
        labelled_rows = labelled_rows[(labelled_rows < first) | (labelled_rows > last)]
    parts = np.split(labelled_rows, np.searchsorted(labelled_rows, first_rows))
    longest = max(parts, key=len)
    return int(longest[0]), int(longest[-1])


def _times(factor: float) -> str:
    times = max(factor, 1.0 / factor)
    shown = f"{times:.3g}" if times < 999.5 else f"{times:,.0f}"
    return f"{shown} times too {'large' if factor > 1 else 'small'}"
