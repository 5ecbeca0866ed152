"""Findings in words: one function for each topic, from a recording to its findings."""

import numpy as np

from eitskin.data.channel_order import ORDERS, Misfit
from eitskin.data.check import clipping, measures, naming, wiring
from eitskin.data.check.finding import ERROR, FACT, UNOBSERVABLE, WARNING, Finding
from eitskin.data.check.missing import HOLD_S, missing_information
from eitskin.data.recording import Recording, has_lengths
from eitskin.physics.outline import EXPECTED, inside_mm, not_simulated
from eitskin.physics.skin import OPTIONAL, Skin
from eitskin.quantities import counted, decimal, listed, percent, quantity

SKIN = {  # key: its name, its unit
    "radius_mm": ("radius", "mm"),
    "thickness_mm": ("thickness", "mm"),
    "conductivity_S_per_m": ("conductivity", "S/m"),
    "electrode_width_mm": ("width of electrodes", "mm"),
    "electrode_height_mm": ("height of electrodes", "mm"),
    "electrode_z_mm": ("electrodes above the bottom", "mm"),
    "contact_impedivity_ohm_m2": ("contact impedivity", "Ω·m²"),
    "current_A": ("current", "A"),
    "contrast_per_N": ("contrast", "1/N"),
}
MAX_NOISE = 0.5  # of the median reading
MISSING = {  # key of `missing_information`: topic, sentence, frames to add
    "absolute": (
        "absolute",
        "only differences: nothing of contacts, widths, shape or offsets that the untouched skin "
        "shows, nor of noise and drift.",
        "the untouched frames themselves",
    ),
    "noise": (
        "noise",
        "no two untouched frames in a row: noise cannot be told from recovery and drift.",
        "20 untouched frames in a row",
    ),
    "drift": (
        "drift",
        "no untouched frame late in the recording: drift cannot be told from touch.",
        "untouched frames between the presses, to the end",
    ),
    "rates": (
        "rates",
        "only the order of frames is known: nothing of rates, relaxation or drift a minute.",
        "the time of each frame",
    ),
    "scan": (
        "scan",
        "how long a frame takes is unknown: changes during a frame cannot be told from pattern.",
        "the seconds a frame takes, as frame_s",
    ),
    "sign": (
        "sign",
        "magnitudes only: polarity and readings that cross zero are not seen.",
        "in-phase readings",
    ),
    "conductivity": (
        "conductivity",
        "no absolute scale: the conductivity is known up to a factor.",
        "the unit of the readings (unit: V, mV, ohm) and the drive current (current_A)",
    ),
    "reciprocity": (
        "reciprocity",
        "no channel has its reciprocal: faults of drive and of measurement are hard to tell apart.",
        "some frames with adjacent drive and measurement",
    ),
    "touch": (
        "touch",
        "nobody touches: nothing of touch.",
        "presses at known places and forces",
    ),
    "force": (
        "force",
        "no force was measured: contrast a newton and its law are unknown.",
        "a load cell's readings",
    ),
    "forces": (
        "force",
        "all forces are within a factor 2: the law from force to contrast is unknown.",
        "presses from light to full force",
    ),
    "probe": (
        "probe",
        "one probe, or an unknown one: a touch's radius cannot be told from its contrast.",
        "presses with a second probe diameter, both known",
    ),
    "relaxation": (
        "relaxation",
        f"no press is held for {HOLD_S:.0f} s at a constant force: relaxation slower than a press"
        " cannot be seen.",
        "one press held for a minute",
    ),
    "hysteresis": (
        "hysteresis",
        "no press is let go step by step: loading and unloading cannot be compared.",
        "frames while unloading",
    ),
    "repeatability": (
        "repeatability",
        "no place is pressed twice: wear and misplacement cannot be told from place.",
        "some places pressed again late",
    ),
    "placement": (
        "placement",
        "the robot's frame is not the skin's: a turn or shift of the skin cannot be told from it.",
        "a touch at two marks on the skin",
    ),
}

MOSTLY_COMMON = 0.1  # of a drift, left beside one factor: less, and that is what it is

CEILING_SIGNS = {
    "noise": "they are equal, and their noise is squashed",
    "touch": "they are equal, and touches that should raise them do not",
}


def contents(recording: Recording) -> list[Finding]:
    """Numbers of frames, touches and channels, and their source."""
    counts, metadata = measures.contents(recording), recording.metadata
    kind = "query" if recording.voltage is None else "recording"
    sentence = f"a {kind} of {counted(counts.frames, 'frame')}: {counts.untouched} untouched"
    sentence += f", {counts.touched} touched"
    if counts.presses is not None and counts.places is not None:
        sentence += f" in {counted(counts.presses, 'press')} at {counted(counts.places, 'place')}"
    if counts.seconds is not None:
        sentence += f"; {counts.seconds:.3g} s long"
    findings = [_fact("frames", f"{sentence}. Source: {metadata['source']}.")]
    drive, measure = measures.pattern(recording, 0), measures.pattern(recording, 2)
    findings.append(
        _fact(
            "channels",
            f"{len(recording.channels)} of {recording.n_electrodes} electrodes, {drive} drive, "
            f"{measure} measurement; {metadata['values']} values, {_phase_text(recording)}, "
            f"unit {metadata['unit']}; places in the {metadata['position_frame']}'s frame.",
        )
    )
    for name, unit in (("force_N", "N"), ("depth_mm", "mm"), ("probe_mm", "mm")):
        levels = measures.levels(recording, name)
        if levels is not None:
            smallest, largest, n_values = levels
            span = f"{smallest:.3g} {unit} always"
            if n_values > 1:
                span = f"{smallest:.3g} to {largest:.3g} {unit}, {n_values} different"
            findings.append(_fact(name.rsplit("_", 1)[0], f"{span}."))
    return findings


def _phase_text(recording: Recording) -> str:
    has_quadrature = recording.quadrature is not None
    return f"{recording.metadata['voltage']}{', in-phase and quadrature' * has_quadrature}"


def _inside_text(skin: Skin) -> str:
    """How many electrodes are inside the skin, in words; "" for none."""
    inner = inside_mm(skin)
    return "" if inner is None else f", {int((~np.isnan(inner)).sum())} of them inside"


def skin(recording: Recording) -> list[Finding]:
    """The stated and the unknown properties of the skin and its wiring."""
    stated_skin = recording.skin
    rim, scaleless = stated_skin.rim, not has_lengths(recording)
    stated_parts, unknown_parts = [], []
    for key, (name, unit) in SKIN.items():
        value = getattr(stated_skin, key)
        if value is not None:
            stated_parts.append(f"{name} {quantity(value, unit)}")
        elif key not in OPTIONAL and not (key == "radius_mm" and (rim or scaleless)):
            unknown_parts.append(name)
    if rim:
        stated_parts.append(f"a rim of {quantity(rim.perimeter_mm, 'mm')} in length")
        stated_parts.append(f"{recording.n_electrodes} electrodes{_inside_text(stated_skin)}")
    elif inside_mm(stated_skin) is not None:
        stated_parts.append(f"{recording.n_electrodes} electrodes{_inside_text(stated_skin)}")
    elif stated_skin.electrode_deg is None:
        unknown_parts.append("the electrodes' angles")
    else:
        stated_parts.append(
            f"{len(stated_skin.electrode_deg)} electrodes {_angles(stated_skin.electrode_deg)}"
        )
    clauses = []
    if stated_parts:
        clauses.append(f"believed: {', '.join(stated_parts)}")
    if unknown_parts:
        clauses.append(f"not known, so calibrated: {', '.join(unknown_parts)}")
    if scaleless:
        clauses.append("no length is stated that would tell its size, so lengths are ratios")
    source = recording.metadata["source_reference"]
    clauses.append(f"the current source is taken as {source}")
    return [_fact("skin", f"{'; '.join(clauses)}.")]


def outline(recording: Recording) -> list[Finding]:
    """A skin that is no disc with electrodes on its rim, which cannot be simulated."""
    shape_fault = not_simulated(recording.skin)
    if shape_fault is None:
        return []
    place, description = shape_fault
    sentence = f"{place} says: {description}. It is no skin to be diagnosed; that takes {EXPECTED}."
    return [Finding("outline", WARNING, sentence)]


def _angles(degrees: tuple[float, ...]) -> str:
    """The electrodes' angles in words: even steps from the first electrode, or a list."""
    pitch = 360.0 / len(degrees)
    steps = np.diff(degrees) % 360.0
    for step, way in ((pitch, "counter-clockwise"), (360.0 - pitch, "clockwise")):
        if np.allclose(steps, step):
            return f"in even steps {way} from {degrees[0] % 360.0:g}°"
    return f"at {', '.join(f'{angle:g}°' for angle in degrees)}"


def repeated_channels(recording: Recording) -> list[Finding]:
    """Channels repeated in the table (value: the share of rows that repeat an earlier one)."""
    repeats = measures.repeated_channels(recording)
    if repeats is None:
        return []
    rows = naming.channels(recording, repeats.rows)
    sentence = f"a channel appears twice: {rows} stood in the table before."
    return [Finding("repeated", repeats.severity, sentence, repeats.share)]


def dead_channels(recording: Recording) -> list[Finding]:
    """Too few channels with readings for any further check (value: their number)."""
    dead = measures.dead_channels(recording)
    if dead is None:
        return []
    states_text = ", untouched as well as touched" if dead.has_both_states else ""
    sentence = (
        f"{dead.n_live} of {dead.channels} channels have a reading other than 0{states_text}; "
        f"{dead.n_needed} at least are needed."
    )
    return [Finding("dead", ERROR, sentence, float(dead.n_live))]


def lost_readings(recording: Recording) -> list[Finding]:
    """Channels with lost readings (value: the share lost) and channels that never change."""
    losses = measures.lost_readings(recording)
    findings = []
    if len(losses.always_lost):
        lost_text = naming.channels(recording, losses.always_lost)
        sentence = f"{lost_text} lost in every frame{_common_lead(recording, losses.always_lost)}."
        findings.append(
            Finding("lost", WARNING, sentence, len(losses.always_lost) / losses.channels)
        )
    if len(losses.partly_lost):
        rows, share = naming.channels(recording, losses.partly_lost), losses.share_of_partly_lost
        sentence = f"{rows} lost in some frames ({percent(share, 1)} of them)."
        findings.append(Finding("lost", WARNING, sentence, losses.share))
    if not findings:
        findings.append(_fact("lost", "no reading is lost.", 0.0))
    if len(losses.stuck):
        verb = "changes" if len(losses.stuck) == 1 else "change"
        sentence = f"{naming.channels(recording, losses.stuck)} never {verb}: stuck or dead."
        findings.append(Finding("stuck", WARNING, sentence, len(losses.stuck) / losses.channels))
    return findings


def _common_lead(recording: Recording, rows: np.ndarray) -> str:
    """`: all that electrode 3 measures`, where channels are just those of one electrode."""
    for verb, pair in (("drives", [0, 1]), ("measures", [2, 3])):
        electrodes = recording.channels[:, pair]
        for electrode in np.unique(electrodes[rows]):
            if np.array_equal(np.flatnonzero((electrodes == electrode).any(axis=1)), rows):
                return f": all that electrode {electrode} {verb}; look at its lead"
    return ""


def clipped_channels(recording: Recording) -> list[Finding]:
    """Channels that stop at a ceiling (value: their share)."""
    clipping_limit = measures.clipped_channels(recording)
    if clipping_limit is None:
        return []
    if len(clipping_limit.channels):
        rows = naming.channels(recording, clipping_limit.channels)
        sentence = f"{rows} stop at {clipping_limit.ceiling:.4g}: the range is too small."
        return [Finding("clipped", WARNING, sentence, clipping_limit.share)]
    findings = []
    for channel_ceiling in clipping.ceilings(recording):
        rows, frames_text = (
            naming.channels(recording, channel_ceiling.channels),
            naming.frames(channel_ceiling.frames),
        )
        sentence = (
            f"{rows} seem to stop at {channel_ceiling.ceiling:.4g}: "
            f"{CEILING_SIGNS[channel_ceiling.sign]}. They are there in {frames_text}; the range "
            "may be too small."
        )
        share = len(channel_ceiling.channels) / len(recording.channels)
        findings.append(Finding("clipped", WARNING, sentence, share))
    return findings or [_fact("clipped", "no channel stops at a ceiling.", 0.0)]


def noise(recording: Recording) -> list[Finding]:
    """Noise of the median channel in the recording's unit (value); without repeated frames its
    upper bound by reciprocity."""
    if recording.metadata["values"] == "difference":
        return []
    level = measures.median_reading(recording)
    estimate = measures.noise(recording)
    if estimate is not None:
        sentence = (
            f"{_reading_text(recording, estimate.sigma)} in the median channel"
            f"{_share(estimate.sigma, level)}"
        )
        if estimate.sigma == 0.0:
            step = measures.resolution(recording)
            sentence = "none: the median channel repeats itself"
            if step is not None:
                sentence = (
                    f"less than {_reading_text(recording, step)} in the median channel, the step"
                    " between two readings: their digits are too few to show it"
                )
        sentence += f", from {counted(estimate.frames, 'untouched frame')}"
        if estimate.between_presses:
            sentence += " with presses between them, so recovery after a press is in it"
        if estimate.sigma > MAX_NOISE * level:
            sentence += "; of so noisy readings little can be told"
            return [Finding("noise", WARNING, sentence + ".", estimate.sigma)]
        return [_fact("noise", sentence + ".", estimate.sigma)]
    bound = measures.noise_bound(recording)
    if bound is None:
        return []
    sentence = (
        f"no untouched repeats; at most {_reading_text(recording, bound)}{_share(bound, level)}, "
        "else drive and measurement could not be exchanged so well."
    )
    return [_fact("noise", sentence, bound)]


def drift(recording: Recording) -> list[Finding]:
    """Median relative change of the untouched readings from first to last (value)."""
    if recording.metadata["values"] == "difference":
        return []
    untouched_drift = measures.drift(recording)
    if untouched_drift is None:
        return []
    change, residual_share = untouched_drift.change, untouched_drift.residual_share
    change_text = f"{percent(change, 2)} (median channel)"
    sentence = f"the untouched readings change by {change_text} from first to last"
    if residual_share is not None:
        if untouched_drift.is_noise:
            sentence += ", no more than by their noise"
        elif residual_share < MOSTLY_COMMON:
            sentence += ", nearly all of it by one factor in all channels"
        else:
            sentence += ", each channel in its own way"
    return [_fact("drift", sentence + ".", change)]


def reciprocity(recording: Recording) -> list[Finding]:
    """Median over reciprocal pairs of their relative difference (value)."""
    pair_error = measures.reciprocity(recording)
    if pair_error is None:
        return []
    noise_text = "; noise included" if recording.metadata["values"] == "difference" else ""
    sentence = (
        f"exchanging drive and measurement changes a reading by {percent(pair_error.median, 2)} "
        f"(median of {counted(pair_error.pairs, 'pair')}; "
        f"rms {percent(pair_error.rms, 2)}{noise_text})."
    )
    return [_fact("reciprocity", sentence, pair_error.median)]


def sampled_frames(recording: Recording, sampled: Recording) -> list[Finding]:
    """Of a long recording, that most is told from a sample (value: its frames)."""
    if sampled is recording:
        return []
    sentence = (
        f"{len(sampled.frames)} of the {len(recording.frames)} frames, evenly from all of it, tell "
        "what follows, but for lost readings, steps and touches without a label, which all tell."
    )
    return [_fact("sample", sentence, len(sampled.frames))]


def channel_order(recording: Recording) -> list[Finding]:
    """Whether the readings are in the table's order (value: the rms misfit of its identities), or
    fit another known order far better."""
    order = wiring.order(recording)
    overall, best, names = (
        order.misfit.overall,
        order.best_misfit,
        order.best_names,
    )
    if overall is None:
        sentence, remedy = "the channels repeat nothing", "reciprocal or reversed channels"
        if measures.reciprocity(recording) is not None:
            sentence, remedy = "most of the readings is noise", "stronger touches"
        sentence += ", so their order cannot be checked."
        return [Finding("order", UNOBSERVABLE, sentence, remedy=remedy)]
    if order.is_wrong:
        ties = f" ({len(names) - 1} more orders fit alike)" if len(names) > 1 else ""
        sentence = (
            f"wrong channel order: {_in_words(order.misfit)}; read as "
            f"'{ORDERS[names[0]].sentence}' the misfit is {best:.2g} instead of "
            f"{overall:.2f}{ties}. To read it so: --order {names[0]} (in config.yaml order: "
            f"{names[0]})."
        )
    elif order.severity == FACT:
        sentence = f"as the table says: {_in_words(order.misfit)}."
    elif order.faults:
        sites = listed([naming.electrodes(site) for site in order.faults])
        sentence = (
            f"{_in_words(order.misfit)}, and hardly any without {sites}: a broken wire,"
            " a bad contact, a wrong gain or offset there. A diagnosis may name it."
        )
    elif order.worst_electrodes is not None:
        sentence = (
            f"{_in_words(order.misfit)}, most where electrodes "
            f"{' and '.join(map(str, order.worst_electrodes))} take part; no known channel order "
            f"repairs it (the best leaves {percent(best)}). No passive, linear skin reads so: look "
            "at the wiring and the contacts, or at a channel table of another pattern."
        )
    else:
        sentence = (
            f"{_in_words(order.misfit)}; no known channel order is far better (the best: "
            f"{best:.2f} overall instead of {overall:.2f}), so it is the skin or the instrument "
            "that breaks it, not the order."
        )
    return [Finding("order", order.severity, sentence, overall, sites=order.faults)]


def _in_words(misfit: Misfit) -> str:
    if misfit.reciprocity is not None:
        change_text = f"{percent(misfit.reciprocity)} rms beyond noise"
        if misfit.reciprocity == 0.0:
            change_text = "no more than noise does"
        return f"exchanging drive and measurement changes readings by {change_text}"
    clauses = []
    if misfit.reversal is not None:
        clauses.append(
            f"exchanging source and sink changes the size of readings by {misfit.reversal:.2f}"
        )
    if misfit.rotation is not None:
        clauses.append(f"going round by one electrode changes them by {misfit.rotation:.2f}")
    return " and ".join(clauses) + " of their size"


def polarity(recording: Recording) -> list[Finding]:
    """Whether signed readings have the table's sign (value: their correlation with a homogeneous
    disc's)."""
    correlation = wiring.polarity(recording)
    if correlation is None or correlation >= wiring.EXCHANGED_CORRELATION:
        return []
    sentence = (
        f"wrong channel table: the readings correlate by {decimal(correlation, 2)} with a "
        "homogeneous disc's; plus and minus (or source and sink) are exchanged."
    )
    measure_name = measures.measure_setting(recording)
    if measure_name is not None:
        sentence += f" Where the format leaves the measured pairs open: --measure {measure_name}."
    return [Finding("polarity", ERROR, sentence, correlation)]


def numbering(recording: Recording) -> list[Finding]:
    """Whether hotspots of touches are at their stated places (value: the turn between them in
    degrees)."""
    fit = wiring.numbering(recording)
    if fit is None:
        return []
    distance_text = f"within {fit.residual_radii:.2f} of the radius (median)"
    sentence = f"the {fit.touches} strongest touches light up where the file puts them"
    if decimal(fit.turn_deg, 0) == "0":
        sentence += f", {distance_text}."
    else:
        turn_text = decimal(fit.turn_deg, 0, sign=True)
        sentence += f" turned by {turn_text} degrees (counter-clockwise), and after that turn"
        sentence += f" {distance_text}."
    if fit.is_lost:
        sentence += " No turn brings them there: places and readings may not belong together."
    if fit.centre_mm is not None:
        place_text = ", ".join(quantity(value, "mm") for value in fit.centre_mm)
        sentence = (
            "places are not counted from the skin's centre: touches light up as if that were at"
            f" ({place_text}), in the file's coordinates. Subtract it, or state"
            " position_frame: robot."
        )
    elif fit.severity == ERROR and fit.is_mirrored:
        sentence = (
            "wrong electrode numbering: touches light up mirrored; numbers run the other way round."
            " State skin.electrode_deg clockwise, or mirror the labelled places."
        )
    elif fit.severity == ERROR:
        offset_text = f"{decimal(fit.turn_deg / fit.pitch_deg, 1, sign=True)} electrodes"
        sentence = (
            f"wrong electrode numbering, off by {offset_text}: {sentence} State skin.electrode_deg "
            f"with about {abs(fit.turn_deg):.0f} degrees {'less' if fit.turn_deg > 0 else 'more'} "
            "each, or turn the labelled places."
        )
    return [Finding("numbering", fit.severity, sentence, fit.turn_deg)]


def places(recording: Recording) -> list[Finding]:
    """Presses that light up at each other's places (value: their share of all presses)."""
    moved = wiring.misplaced(recording)
    if moved is None:
        return []
    distance_text = (
        f"{len(moved.presses)} of {moved.number} presses light up {moved.stated_radii:.2f} of the"
        f" radius (median) from where the file puts them, but within {moved.assigned_radii:.2f} of"
        " another press' place"
    )
    if moved.severity == ERROR:
        sentence = (
            f"places and readings do not belong together: {distance_text}. The places' order is not"
            " that of the presses: look at how labels were joined to frames."
        )
    else:
        named = listed(list(moved.presses[:8])) + (" ..." if len(moved.presses) > 8 else "")
        sentence = f"places of presses {named} seem to be exchanged: {distance_text}."
    share = len(moved.presses) / moved.number
    return [Finding("places", moved.severity, sentence, share)]


def unobservable(recording: Recording) -> list[Finding]:
    """What cannot be observed in these frames, each with the frames to add."""
    return [
        Finding(topic, UNOBSERVABLE, sentence, remedy=remedy)
        for topic, sentence, remedy in map(MISSING.__getitem__, missing_information(recording))
    ]


def _reading_text(recording: Recording, value: float) -> str:
    """A size of readings in their unit, by thousands where it takes a prefix."""
    unit = {"V": "V", "ohm": "Ω", "arbitrary": "arbitrary units"}[recording.metadata["unit"]]
    return quantity(value, unit)


def _share(value: float, level: float) -> str:
    """`, 0.25 % of the median reading`; nothing where that reading is 0."""
    return f", {percent(value / level, 2)} of the median reading" if level > 0 else ""


def _fact(topic: str, sentence: str, value: float | None = None) -> Finding:
    return Finding(topic, FACT, sentence, value)
