"""What a recording holds, how good it is, and what it cannot tell; in plain words.

Each finding is a small function of the recording. Errors are what makes a recording useless as it
stands: a wrong channel order, readings that no passive skin gives.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from eitskin.atomic import atomic_path
from eitskin.data import alignment, dataset
from eitskin.data.channel_order import Misfit, known_orders, misfit, relative_change, reordered
from eitskin.data.recording import Recording, presses
from eitskin.errors import InputError
from eitskin.physics.protocol import reciprocal_channels

FACT, WARNING, ERROR, UNOBSERVABLE = "fact", "warning", "error", "unobservable"
NORMAL = 1.4826  # standard deviation of a normal variable over its median distance from its median
BROKEN = 0.25  # rms misfit of the identities: 0.01-0.06 on tanks, mostly 0.8-1.1 in a wrong order
DOUBTFUL = 0.1  # from here on an order that fits FAR_BETTER is taken for the true one
FAR_BETTER = 3.0
ALIKE = 1.5
MOST_FRAMES = 500
HOLD_S = 5.0
HOLD_SPREAD = 0.02
UNLOADED = 0.1
CLIPPED_FRAMES = 3
NUMBERED_WITHIN_RADII = 0.25
LEAST_TOUCHES = 20
MOST_REPEATED = 0.5
UNKNOWNS = 3  # x, y and F of a touch


@dataclass(frozen=True)
class Finding:
    """One statement: its topic, how grave it is, a sentence, a number where there is one (relative
    unless the topic's function says otherwise), and for what cannot be told the frames to add.
    """

    topic: str
    severity: str
    sentence: str
    value: float | None = None
    remedy: str | None = None


@dataclass(frozen=True)
class Check:
    """All findings about one recording."""

    findings: tuple[Finding, ...]

    @property
    def ok(self) -> bool:
        """Whether no finding is an error."""
        return not any(finding.severity == ERROR for finding in self.findings)

    def about(self, topic: str) -> list[Finding]:
        """The findings of one topic."""
        return [finding for finding in self.findings if finding.topic == topic]


def check(recording: Recording) -> Check:
    """Every finding about a recording or query (`recording.validate`d)."""
    findings = contents(recording) + repeated(recording)
    if recording.voltage is not None:
        nothing = dead(recording)
        if nothing:
            return Check((*findings, *nothing))
        for examine in (
            lost,
            clipped,
            noise,
            drift,
            reciprocity,
            channel_order,
            polarity,
            numbering,
        ):
            findings += examine(recording)
        findings += unobservable(recording)
    return Check(tuple(findings))


def text(result: Check) -> str:
    """The check as plain words, a sentence a line, ending with a verdict."""
    sections = {
        FACT: "What it holds",
        WARNING: "What to look at",
        ERROR: "What makes it unusable as it stands",
        UNOBSERVABLE: "What it cannot tell, and what to add so that it could",
    }
    lines = []
    for severity, title in sections.items():
        found = [finding for finding in result.findings if finding.severity == severity]
        if found:
            lines.append(f"{title}:")
        for finding in found:
            remedy = f" Add: {finding.remedy}." if finding.remedy else ""
            lines.append(f"  {finding.topic}: {finding.sentence}{remedy}")
    lines.append("Usable." if result.ok else "Not usable as it stands.")
    return "\n".join(lines) + "\n"


def write(result: Check, path: str | Path, file: str | Path) -> None:
    """Write the check of the recording `file` as plain words.

    Raises InputError naming the first error, with those words as its note, where the recording is
    unusable; then nothing is written, so that nothing can be learned from it.
    """
    for finding in result.findings:
        if finding.severity == ERROR:
            expected = "a usable recording"
            refusal = InputError(file, f"check, {finding.topic}", finding.sentence[:-1], expected)
            refusal.add_note(text(result))
            raise refusal
    with atomic_path(path) as temporary:
        temporary.write_text(text(result), encoding="utf-8")


def contents(recording: Recording) -> list[Finding]:
    """Frames, touches, channels and where they come from."""
    frames, metadata = recording.frames, recording.metadata
    touch = frames["touch"].to_numpy(dtype=bool)
    kind = "query" if recording.voltage is None else "recording"
    sentence = (
        f"a {kind} of {len(frames)} frames: {(~touch).sum()} untouched, {touch.sum()} touched"
    )
    if touch.any():
        places = len(frames.loc[touch, ["x_mm", "y_mm"]].drop_duplicates())
        sentence += f" in {presses(recording).max() + 1} presses at {places} places"
    if metadata["clock"] == "measured" and len(frames) > 1:
        sentence += f"; {np.ptp(frames['time_s']):.3g} s long"
    found = [_fact("frames", f"{sentence}. Source: {metadata['source']}.")]
    drive, measure = _pattern(recording, 0), _pattern(recording, 2)
    found.append(
        _fact(
            "channels",
            f"{len(recording.channels)} of {recording.n_electrodes} electrodes, {drive} drive, "
            f"{measure} measurement; {metadata['values']} values, {metadata['voltage']}, "
            f"unit {metadata['unit']}; places in the {metadata['position_frame']}'s frame.",
        )
    )
    for name, unit in (("force_N", "N"), ("depth_mm", "mm"), ("probe_mm", "mm")):
        values = frames.loc[touch, name].dropna()
        if len(values):
            levels = values.nunique()
            span = f"{values.min():.3g} to {values.max():.3g} {unit}, {levels} different"
            found.append(_fact(name.rsplit("_", 1)[0], f"{span}."))
    return found


def repeated(recording: Recording) -> list[Finding]:
    """Channels that stand in the table more than once (value: the share of rows that repeat an
    earlier one): most of them make a table that no skin was read by.
    """
    _, first = np.unique(recording.channels, axis=0, return_index=True)
    again = np.setdiff1d(np.arange(len(recording.channels)), first)
    if not len(again):
        return []
    share = len(again) / len(recording.channels)
    sentence = f"a channel appears twice: {_channels(recording, again)} stood in the table before."
    return [Finding("repeated", ERROR if share > MOST_REPEATED else WARNING, sentence, share)]


def dead(recording: Recording) -> list[Finding]:
    """Whether too few channels ever read a number other than 0, both untouched and touched, to
    tell where and how hard a skin is touched (value: how many do). Then nothing can be examined.
    """
    touch = recording.frames["touch"].to_numpy(dtype=bool)
    reads = np.nan_to_num(recording.voltage) != 0
    difference = recording.metadata["values"] == "difference"
    states = [touch] if difference and touch.any() else [~touch, touch]
    live = np.logical_and.reduce([reads[state].any(axis=0) for state in states if state.any()])
    needed = min(UNKNOWNS, len(live))
    if live.sum() >= needed:
        return []
    in_both = ", untouched as well as touched" if len(states) > 1 and touch.any() else ""
    sentence = f"{live.sum()} of {len(live)} channels have a reading other than 0{in_both}"
    return [Finding("dead", ERROR, f"{sentence}; {needed} at least are needed.", float(live.sum()))]


def lost(recording: Recording) -> list[Finding]:
    """Channels with lost readings (value: the share lost) and channels that never change."""
    missing = np.isnan(recording.voltage)
    found = []
    gone = np.flatnonzero(missing.all(axis=0))
    partly = np.flatnonzero(missing.any(axis=0) & ~missing.all(axis=0))
    if len(gone):
        sentence = f"{_channels(recording, gone)} lost in every frame."
        found.append(Finding("lost", WARNING, sentence, len(gone) / missing.shape[1]))
    if len(partly):
        share = missing[:, partly].mean()
        sentence = f"{_channels(recording, partly)} lost in some frames ({share:.1%} of them)."
        found.append(Finding("lost", WARNING, sentence, float(missing.mean())))
    if not found:
        found.append(_fact("lost", "no reading is lost.", 0.0))
    if len(missing) > 2:
        values = recording.voltage
        still = ~missing.any(axis=0) & (values == values[:1]).all(axis=0)
        if still.any() and not still.all():
            sentence = f"{_channels(recording, np.flatnonzero(still))} never change: stuck or dead."
            found.append(Finding("stuck", WARNING, sentence, float(still.mean())))
    return found


def clipped(recording: Recording) -> list[Finding]:
    """Channels at a ceiling: the largest |reading| comes back exactly, in several different frames,
    and more than twice as often as any other large reading. Value: the share of channels.
    """
    if recording.metadata["values"] == "difference":
        return []
    size = np.unique(np.abs(recording.voltage), axis=0)
    if not np.isfinite(size).any():
        return []
    ceiling = np.nanmax(size)
    at_ceiling = size == ceiling
    channels = np.flatnonzero(at_ceiling.any(axis=0))
    near = size[:, channels]
    others, counts = np.unique(near[(near < ceiling) & (near > 0.9 * ceiling)], return_counts=True)
    commonest = counts.max() if len(others) else 0
    varies = (near < ceiling).any() or len(channels) > 1
    enough = at_ceiling.any(axis=1).sum() >= CLIPPED_FRAMES
    if enough and varies and at_ceiling.sum() > 2 * commonest:
        sentence = (
            f"{_channels(recording, channels)} stop at {ceiling:.4g}: the range is too small."
        )
        return [Finding("clipped", WARNING, sentence, len(channels) / size.shape[1])]
    return [_fact("clipped", "no channel stops at a ceiling.", 0.0)]


def noise(recording: Recording) -> list[Finding]:
    """Noise of the median channel, in the recording's unit, from one untouched frame to the next:
    the median absolute successive difference / sqrt 2, scaled to a standard deviation; drift hardly
    enters it.

    Without repeats the odd half of reciprocity bounds it from above.
    """
    if recording.metadata["values"] == "difference":
        return []
    touch = recording.frames["touch"].to_numpy(dtype=bool)
    rows = np.flatnonzero(~touch)
    level = _level(recording)
    follow = np.diff(rows) == 1
    between_presses = not follow.any()
    steps = np.diff(recording.voltage[rows], axis=0)
    if not between_presses:
        steps = steps[follow]
    unit = _unit(recording)
    if np.isfinite(steps).any():
        spread = NORMAL * _columns(np.nanmedian, np.abs(steps)) / np.sqrt(2.0)
        sigma = float(np.nanmedian(spread))
        sentence = (
            f"{sigma:.3g} {unit} in the median channel{_share(sigma, level)}, "
            f"from {len(steps) + 1} untouched frames"
        )
        if between_presses:
            sentence += " with presses between them, so recovery after a press is in it"
        return [_fact("noise", sentence + ".", sigma)]
    pairs, signs = reciprocal_channels(recording.channels)
    values, signs = _identity_readings(recording, signs)
    odd = np.abs(values[:, pairs[:, 1]] - signs * values[:, pairs[:, 0]])
    if not np.isfinite(odd).any():
        return []
    bound = float(NORMAL * np.nanmedian(odd) / np.sqrt(2.0))
    sentence = (
        f"no untouched repeats; at most {bound:.3g} {unit}{_share(bound, level)}, else drive and "
        "measurement could not be exchanged so well."
    )
    return [_fact("noise", sentence, bound)]


def drift(recording: Recording) -> list[Finding]:
    """Median relative change of the untouched readings from their first tenth to their last
    (value).
    """
    if recording.metadata["values"] == "difference":
        return []
    untouched = recording.voltage[~recording.frames["touch"].to_numpy(dtype=bool)]
    if len(untouched) < 2:
        return []
    tenth = max(1, len(untouched) // 10)
    first = _columns(np.nanmean, untouched[:tenth])
    last = _columns(np.nanmean, untouched[-tenth:])
    kept = np.isfinite(first) & np.isfinite(last) & (first != 0)
    first, last = first[kept], last[kept]
    if not len(first):
        return []
    change = float(np.median(np.abs(last - first) / np.abs(first)))
    sentence = f"the untouched readings change by {change:.2%} (median channel) from first to last"
    if np.any(last != first):
        factor = first @ last / (first @ first)
        rest = np.linalg.norm(last - factor * first) / np.linalg.norm(last - first)
        sentence += f"; {rest:.0%} of it is left when one common factor is taken out"
    return [_fact("drift", sentence + ".", change)]


def reciprocity(recording: Recording) -> list[Finding]:
    """Median over reciprocal pairs of their relative difference (value), of the untouched readings,
    or of the modulus where there is a quadrature.
    """
    pairs, signs = reciprocal_channels(recording.channels)
    if not len(pairs):
        return []
    values, signs = _identity_readings(recording, signs)
    first, second = signs * values[:, pairs[:, 0]], values[:, pairs[:, 1]]
    size = (np.abs(first) + np.abs(second)) / 2.0
    kept = np.isfinite(size) & (size > 0)
    if not kept.any():
        return []
    error = float(np.median(np.abs(first - second)[kept] / size[kept]))
    rms = relative_change(values, pairs, signs)
    sentence = (
        f"exchanging drive and measurement changes a reading by {error:.2%} (median of "
        f"{len(pairs)} pairs; rms {rms:.2%})."
    )
    return [_fact("reciprocity", sentence, error)]


def channel_order(recording: Recording) -> list[Finding]:
    """Whether the readings stand in the table's order (value: the rms misfit of its identities), or
    far better in another known one; by the untouched readings and by what strong touches change.
    """
    signed = recording.metadata["voltage"] == "signed"
    values, _ = _identity_readings(recording, np.ones(1))
    own, best, names = _orders(recording, values, signed and recording.quadrature is None)
    if own.overall is None:
        sentence = "the channels repeat nothing, so their order cannot be checked."
        return [Finding("order", UNOBSERVABLE, sentence, remedy="reciprocal or reversed channels")]
    judged = [(own, best, names)]
    changes = _strong_changes(recording)
    if changes is not None:
        judged.append(_orders(recording, changes, signed))
    for misfit_, best_, names_ in judged:
        overall = misfit_.overall or 0.0
        if overall > DOUBTFUL and best_ < overall / FAR_BETTER:
            others = f" ({len(names_) - 1} more orders fit alike)" if len(names_) > 1 else ""
            sentence = (
                f"wrong channel order: {_in_words(misfit_)}; read as '{names_[0]}' the misfit is "
                f"{best_:.2g} instead of {overall:.2f}{others}."
            )
            return [Finding("order", ERROR, sentence, overall)]
    if own.overall <= BROKEN:
        return [_fact("order", f"as the table says: {_in_words(own)}.", own.overall)]
    if own.reciprocity is not None:
        sentence = (
            f"{_in_words(own)}, {_worst_electrodes(recording, values)}; no known channel order "
            f"repairs it (the best leaves {best:.0%}). No passive, linear skin reads so: look at "
            "the wiring and the contacts, or at a channel table of another pattern."
        )
        return [Finding("order", ERROR, sentence, own.overall)]
    sentence = (
        f"{_in_words(own)}; no known channel order is far better (the best: {best:.2f} overall "
        f"instead of {own.overall:.2f}), so it is the skin or the instrument that breaks it, not "
        "the order."
    )
    return [Finding("order", WARNING, sentence, own.overall)]


def _orders(
    recording: Recording, values: np.ndarray, signed: bool
) -> tuple[Misfit, float, list[str]]:
    """Misfit of the table's order, the least misfit of other known orders, and which have it."""
    channels, n = recording.channels, recording.n_electrodes
    own = misfit(values, channels, n, signed)
    others = {
        name: misfit(reordered(values, permutation), channels, n, signed).overall
        for name, permutation in known_orders(channels, n).items()
    }
    if own.overall is None or not others:
        return own, np.inf, []
    best = min(others.values())
    return own, best, [name for name, value in others.items() if value <= ALIKE * best]


def _strong_changes(recording: Recording) -> np.ndarray | None:
    """(K, M): what the strongest touches of absolute readings change; None where there are few."""
    touched = recording.frames["touch"].any()
    if recording.metadata["values"] == "difference" or not touched:
        return None
    try:
        rows = alignment.strongest_touches(recording)
        changes = dataset.changes(recording, "recording")[rows]
    except InputError:  # a session without an untouched frame
        return None
    return changes if np.isfinite(changes).any() and len(rows) >= LEAST_TOUCHES else None


def _in_words(misfit_: Misfit) -> str:
    if misfit_.reciprocity is not None:
        return f"exchanging drive and measurement changes readings by {misfit_.reciprocity:.0%} rms"
    parts = []
    if misfit_.reversal is not None:
        parts.append(
            f"exchanging source and sink changes the size of readings by {misfit_.reversal:.2f}"
        )
    if misfit_.rotation is not None:
        parts.append(f"going round by one electrode changes them by {misfit_.rotation:.2f}")
    return " and ".join(parts) + " of their size"


def polarity(recording: Recording) -> list[Finding]:
    """Whether signed readings have the sign that the table gives them (value: their correlation
    with a homogeneous disc's).
    """
    angles = recording.skin.electrode_deg
    metadata = recording.metadata
    if metadata["voltage"] != "signed" or metadata["values"] != "absolute" or angles is None:
        return []
    model = alignment.homogeneous_readings(recording.channels, np.array(angles))
    reading = _untouched(recording.voltage, recording)[0]
    kept = np.isfinite(model) & np.isfinite(reading)
    if kept.sum() < 3 or np.ptp(model[kept]) == 0 or np.ptp(reading[kept]) == 0:
        return []
    alike = float(np.corrcoef(model[kept], reading[kept])[0, 1])
    if alike < -0.5:
        sentence = (
            f"wrong channel table: the readings correlate by {alike:.2f} with a homogeneous "
            "disc's; plus and minus (or source and sink) are exchanged."
        )
        return [Finding("polarity", ERROR, sentence, alike)]
    return []


def numbering(recording: Recording) -> list[Finding]:
    """Whether touches light up where the file says that they are (value: how far round they do,
    degrees).

    Only for places in the skin's frame; a mirror or a turn by an electrode or more is wrong
    numbering.
    """
    skin = recording.skin
    touched = int(recording.frames["touch"].sum())
    in_skin = recording.metadata["position_frame"] == "skin"
    if not in_skin or skin.electrode_deg is None or touched < LEAST_TOUCHES:
        return []
    try:
        similarity = alignment.fit(recording)
    except InputError:  # too few strong touches, or all at one place
        return []
    radius = skin.radius_mm or 1.0
    turn = similarity.rotation_deg
    sentence = (
        f"the {similarity.touches} strongest touches light up {turn:+.0f} degrees "
        "(counter-clockwise) from where the file puts them, and after that turn within "
        f"{similarity.residual / radius:.2f} of the radius (median)"
    )
    clear = (
        similarity.residual < NUMBERED_WITHIN_RADII * radius
        and similarity.rival_residual > FAR_BETTER * similarity.residual
    )
    pitch = 360.0 / recording.n_electrodes
    if clear and similarity.mirrored:
        sentence = (
            "wrong electrode numbering: touches light up mirrored; numbers run the other way round."
        )
        return [Finding("numbering", ERROR, sentence, turn)]
    if clear and abs(turn) > 0.75 * pitch:
        sentence = f"wrong electrode numbering, off by {turn / pitch:+.1f} electrodes: {sentence}."
        return [Finding("numbering", ERROR, sentence, turn)]
    if abs(turn) > 0.25 * pitch or not clear:
        return [Finding("numbering", WARNING, sentence + ".", turn)]
    return [_fact("numbering", sentence + ".", turn)]


def unobservable(recording: Recording) -> list[Finding]:
    """What these frames cannot tell, each with the frames to add."""
    found = []

    def cannot(topic: str, applies: bool, sentence: str, remedy: str) -> None:
        if applies:
            found.append(Finding(topic, UNOBSERVABLE, sentence, remedy=remedy))

    frames, metadata = recording.frames, recording.metadata
    touch = frames["touch"].to_numpy(dtype=bool)
    rows = np.flatnonzero(~touch)
    difference = metadata["values"] == "difference"
    index = metadata["clock"] == "index"
    cannot(
        "absolute",
        difference,
        "only differences: nothing of contacts, widths, shape or offsets that the untouched skin "
        "shows, nor of noise and drift.",
        "the untouched frames themselves",
    )
    cannot(
        "noise",
        not difference and not (np.diff(rows) == 1).any(),
        "no two untouched frames in a row: noise cannot be told from recovery and drift.",
        "20 untouched frames in a row",
    )
    late = len(rows) > 1 and rows[-1] >= 0.8 * (len(frames) - 1)
    cannot(
        "drift",
        not difference and not late,
        "no untouched frame late in the recording: drift cannot be told from touch.",
        "untouched frames between the presses, to the end",
    )
    cannot(
        "rates",
        index,
        "only the order of frames is known: nothing of rates, relaxation or drift a minute.",
        "the time of each frame",
    )
    cannot(
        "scan",
        metadata["frame_s"] is None,
        "how long a frame takes is unknown: changes during a frame cannot be told from pattern.",
        "frame_s",
    )
    cannot(
        "sign",
        metadata["voltage"] == "magnitude",
        "magnitudes only: polarity and readings that cross zero are not seen.",
        "in-phase readings",
    )
    cannot(
        "conductivity",
        metadata["unit"] == "arbitrary" or recording.skin.current_A is None,
        "no absolute scale: the conductivity is known up to a factor.",
        "readings in volts and the drive current",
    )
    cannot(
        "reciprocity",
        not len(reciprocal_channels(recording.channels)[0]),
        "no channel has its reciprocal: faults of drive and of measurement are hard to tell apart.",
        "some frames with adjacent drive and measurement",
    )
    if not touch.any():
        cannot(
            "touch", True, "nobody touches: nothing of touch.", "presses at known places and forces"
        )
        return found
    touched = frames[touch]
    cannot(
        "force",
        touched["force_N"].isna().all(),
        "no force was measured: contrast a newton and its law are unknown.",
        "a load cell's readings",
    )
    levels = touched["force_N"].dropna()
    cannot(
        "force",
        len(levels) > 0 and levels.max() < 2.0 * levels.min(),
        "all forces are within a factor 2: the law from force to contrast is unknown.",
        "presses from light to full force",
    )
    probes = touched["probe_mm"].nunique()
    cannot(
        "probe",
        probes < 2,
        "one probe, or an unknown one: a touch's radius cannot be told from its contrast.",
        "presses with a second probe diameter, both known",
    )
    held, unloaded, again = _press_facts(recording)
    cannot(
        "relaxation",
        index or held < HOLD_S,
        f"no press is held for {HOLD_S:.0f} s at a constant force: relaxation cannot be seen.",
        "one press held for a minute",
    )
    cannot(
        "hysteresis",
        not unloaded,
        "no press is let go step by step: loading and unloading cannot be compared.",
        "frames while unloading",
    )
    cannot(
        "repeatability",
        not again,
        "no place is pressed twice: wear and misplacement cannot be told from place.",
        "some places pressed again late",
    )
    cannot(
        "placement",
        metadata["position_frame"] == "robot",
        "the robot's frame is not the skin's: a turn or shift of the skin cannot be told from it.",
        "a touch at two marks on the skin",
    )
    return found


def _press_facts(recording: Recording) -> tuple[float, bool, bool]:
    """Longest hold in s, whether any press is unloaded, whether any place is pressed twice."""
    frames = recording.frames.assign(press=presses(recording))
    longest, unloaded = 0.0, False
    for _, press in frames[frames["press"] >= 0].groupby("press"):
        load = press["force_N"] if press["force_N"].notna().all() else press["depth_mm"]
        load = load.to_numpy(dtype=float)
        if len(load) < 2 or np.isnan(load).any():
            continue
        unloaded |= bool((np.maximum.accumulate(load) - load).max() > UNLOADED * load.max())
        longest = max(longest, _longest_hold(load, press["time_s"].to_numpy()))
    firsts = frames[frames["press"] >= 0].drop_duplicates("press")
    return longest, unloaded, bool(firsts.duplicated(["x_mm", "y_mm"]).any())


def _longest_hold(load: np.ndarray, time_s: np.ndarray) -> float:
    start, longest = 0, 0.0
    for stop in range(len(load)):
        while np.ptp(load[start : stop + 1]) > HOLD_SPREAD * load.max():
            start += 1
        longest = max(longest, float(time_s[stop] - time_s[start]))
    return longest


def _identity_readings(recording: Recording, signs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Readings (K, M) on which a channel table's identities should hold, and the signs to use: the
    mean untouched frame, or some frames of differences; the modulus where there is a quadrature.
    """
    values = recording.voltage
    if recording.quadrature is not None:
        values = np.hypot(values, recording.quadrature)
    if recording.metadata["voltage"] == "magnitude" or recording.quadrature is not None:
        signs = np.ones_like(signs)
    return _untouched(values, recording), signs


def _untouched(values: np.ndarray, recording: Recording) -> np.ndarray:
    """(K, M): the mean over untouched frames, or some frames of a recording of differences."""
    if recording.metadata["values"] == "difference":
        rows = np.linspace(0, len(values) - 1, min(len(values), MOST_FRAMES)).astype(int)
        return values[rows]
    untouched = ~recording.frames["touch"].to_numpy(dtype=bool)
    return _columns(np.nanmean, values[untouched])[None]


def _columns(statistic: Callable, values: np.ndarray) -> np.ndarray:
    """A statistic of each column (M,); NaN for a column without any reading."""
    result = np.full(values.shape[1], np.nan)
    some = np.isfinite(values).any(axis=0)
    result[some] = statistic(values[:, some], axis=0)
    return result


def _worst_electrodes(recording: Recording, values: np.ndarray) -> str:
    """The electrodes that the broken reciprocal pairs have in common."""
    pairs, _ = reciprocal_channels(recording.channels)
    break_ = np.nansum((values[:, pairs[:, 1]] - values[:, pairs[:, 0]]) ** 2, axis=0)
    share = np.array(
        [
            break_[(recording.channels[pairs[:, 0]] == electrode).any(axis=1)].sum()
            for electrode in range(recording.n_electrodes)
        ]
    )
    worst = np.argsort(-share, kind="stable")[:2]
    return f"most where electrodes {worst[0]} and {worst[1]} take part"


def _level(recording: Recording) -> float:
    untouched = recording.voltage[~recording.frames["touch"].to_numpy(dtype=bool)]
    return float(np.nanmedian(np.abs(untouched)))


def _share(value: float, level: float) -> str:
    """`, 0.25% of the median reading`; nothing where that reading is 0."""
    return f", {value / level:.2%} of the median reading" if level > 0 else ""


def _unit(recording: Recording) -> str:
    unit = recording.metadata["unit"]
    return "arbitrary units" if unit == "arbitrary" else unit


def _pattern(recording: Recording, first: int) -> str:
    """The pattern of the drives (first = 0) or measurements (2), as `protocol` names it."""
    n = recording.n_electrodes
    pair = recording.channels[:, first : first + 2]
    steps = {min(step, n - step) for step in ((pair[:, 1] - pair[:, 0]) % n).tolist()}
    if len(steps) > 1:
        return "mixed"
    step = steps.pop()
    names = {1: "adjacent", n // 2: "opposite"}
    return names.get(step, f"skip-{step - 1}")


def _channels(recording: Recording, rows: np.ndarray) -> str:
    """`3 channels (0: 0-1 -> 2-3, ...)`, at most three named."""
    shown = ", ".join(
        "{}: drive {}-{}, measured {}-{}".format(row, *recording.channels[row]) for row in rows[:3]
    )
    more = ", ..." if len(rows) > 3 else ""
    plural = "" if len(rows) == 1 else "s"
    return f"{len(rows)} channel{plural} ({shown}{more})"


def _fact(topic: str, sentence: str, value: float | None = None) -> Finding:
    return Finding(topic, FACT, sentence, value)
