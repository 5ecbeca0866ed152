"""What is said of each measure of a recording: one function a topic, from a recording to its
findings.
"""

import numpy as np

from eitskin.data.channel_order import ORDERS, Misfit
from eitskin.data.check import clipping, measures, named, wiring
from eitskin.data.check.finding import ERROR, FACT, UNOBSERVABLE, WARNING, Finding
from eitskin.data.check.missing import HOLD_S, missing
from eitskin.data.recording import Recording
from eitskin.physics.outline import EXPECTED, no_disc
from eitskin.physics.skin import OPTIONAL
from eitskin.quantities import percent, quantity

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
MISSING = {  # what cannot be told: its topic, the sentence, the frames to add
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
        "frame_s",
    ),
    "sign": (
        "sign",
        "magnitudes only: polarity and readings that cross zero are not seen.",
        "in-phase readings",
    ),
    "conductivity": (
        "conductivity",
        "no absolute scale: the conductivity is known up to a factor.",
        "readings in volts and the drive current",
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

CEILING_SIGNS = {
    "noise": "they are equal, and their noise is squashed",
    "touch": "they are equal, and touches that should raise them do not",
}


def contents(recording: Recording) -> list[Finding]:
    """Frames, touches, channels and where they come from."""
    held, metadata = measures.contents(recording), recording.metadata
    kind = "query" if recording.voltage is None else "recording"
    sentence = (
        f"a {kind} of {held.frames} frames: {held.untouched} untouched, {held.touched} touched"
    )
    if held.touched:
        sentence += f" in {_counted(held.presses, 'press', 'presses')}"
        sentence += f" at {_counted(held.places, 'place', 'places')}"
    if held.seconds is not None:
        sentence += f"; {held.seconds:.3g} s long"
    found = [_fact("frames", f"{sentence}. Source: {metadata['source']}.")]
    drive, measure = measures.pattern(recording, 0), measures.pattern(recording, 2)
    found.append(
        _fact(
            "channels",
            f"{len(recording.channels)} of {recording.n_electrodes} electrodes, {drive} drive, "
            f"{measure} measurement; {metadata['values']} values, {metadata['voltage']}, "
            f"unit {metadata['unit']}; places in the {metadata['position_frame']}'s frame.",
        )
    )
    for name, unit in (("force_N", "N"), ("depth_mm", "mm"), ("probe_mm", "mm")):
        levels = measures.levels(recording, name)
        if levels is not None:
            least, largest, different = levels
            span = f"{least:.3g} {unit} always"
            if different > 1:
                span = f"{least:.3g} to {largest:.3g} {unit}, {different} different"
            found.append(_fact(name.rsplit("_", 1)[0], f"{span}."))
    return found


def _counted(count: int | None, one: str, several: str) -> str:
    return f"{count} {one if count == 1 else several}"


def skin(recording: Recording) -> list[Finding]:
    """What is believed of the skin and its wiring, and what is not known."""
    believed = recording.skin
    known, unknown = [], []
    for key, (name, unit) in SKIN.items():
        value = getattr(believed, key)
        if value is not None:
            known.append(f"{name} {quantity(value, unit)}")
        elif key not in OPTIONAL:
            unknown.append(name)
    if believed.electrode_deg is None:
        unknown.append("the electrodes' angles")
    else:
        known.append(f"{len(believed.electrode_deg)} electrodes {_angles(believed.electrode_deg)}")
    ends = []
    if known:
        ends.append(f"believed: {', '.join(known)}")
    if unknown:
        ends.append(f"not known, so calibrated: {', '.join(unknown)}")
    source = recording.metadata["source_reference"]
    ends.append(f"the current source is taken as {source}")
    return [_fact("skin", f"{'; '.join(ends)}.")]


def outline(recording: Recording) -> list[Finding]:
    """A skin that is no disc with electrodes on its rim, which nothing here simulates."""
    other = no_disc(recording.skin)
    if other is None:
        return []
    place, found = other
    sentence = f"{place} says: {found}. It is no skin to be diagnosed; that takes {EXPECTED}."
    return [Finding("outline", WARNING, sentence)]


def _angles(degrees: tuple[float, ...]) -> str:
    """Where electrodes lie: in even steps from the first, or from the first to the last."""
    pitch = 360.0 / len(degrees)
    steps = np.diff(degrees) % 360.0
    for step, way in ((pitch, "counter-clockwise"), (360.0 - pitch, "clockwise")):
        if np.allclose(steps, step):
            return f"in even steps {way} from {degrees[0] % 360.0:g}°"
    return f"at {', '.join(f'{angle:g}°' for angle in degrees)}"


def repeated(recording: Recording) -> list[Finding]:
    """Channels that stand in the table more than once (value: the share of rows that repeat an
    earlier one).
    """
    again = measures.repeated(recording)
    if again is None:
        return []
    rows = named.channels(recording, again.rows)
    sentence = f"a channel appears twice: {rows} stood in the table before."
    return [Finding("repeated", again.severity, sentence, again.share)]


def dead(recording: Recording) -> list[Finding]:
    """Whether too few channels read anything (value: how many do); then nothing can be examined."""
    few = measures.dead(recording)
    if few is None:
        return []
    in_both = ", untouched as well as touched" if few.both_states else ""
    sentence = (
        f"{few.live} of {few.channels} channels have a reading other than 0{in_both}; "
        f"{few.needed} at least are needed."
    )
    return [Finding("dead", ERROR, sentence, float(few.live))]


def lost(recording: Recording) -> list[Finding]:
    """Channels with lost readings (value: the share lost) and channels that never change."""
    gone = measures.lost(recording)
    found = []
    if len(gone.always):
        sentence = f"{named.channels(recording, gone.always)} lost in every frame."
        found.append(Finding("lost", WARNING, sentence, len(gone.always) / gone.channels))
    if len(gone.sometimes):
        rows, share = named.channels(recording, gone.sometimes), gone.share_of_sometimes
        sentence = f"{rows} lost in some frames ({percent(share, 1)} of them)."
        found.append(Finding("lost", WARNING, sentence, gone.share))
    if not found:
        found.append(_fact("lost", "no reading is lost.", 0.0))
    if len(gone.stuck):
        sentence = f"{named.channels(recording, gone.stuck)} never change: stuck or dead."
        found.append(Finding("stuck", WARNING, sentence, len(gone.stuck) / gone.channels))
    return found


def clipped(recording: Recording) -> list[Finding]:
    """Channels that stop at a ceiling (value: their share)."""
    stop = measures.clipped(recording)
    if stop is None:
        return []
    if len(stop.channels):
        rows = named.channels(recording, stop.channels)
        sentence = f"{rows} stop at {stop.ceiling:.4g}: the range is too small."
        return [Finding("clipped", WARNING, sentence, stop.share)]
    found = []
    for one in clipping.ceilings(recording):
        rows, at = named.channels(recording, one.channels), named.frames(one.frames)
        sentence = (
            f"{rows} seem to stop at {one.ceiling:.4g}: {CEILING_SIGNS[one.sign]}. They are there "
            f"in {at}; the range may be too small."
        )
        share = len(one.channels) / len(recording.channels)
        found.append(Finding("clipped", WARNING, sentence, share))
    return found or [_fact("clipped", "no channel stops at a ceiling.", 0.0)]


def noise(recording: Recording) -> list[Finding]:
    """Noise of the median channel, in the recording's unit (value), or without repeats what
    reciprocity bounds it by.
    """
    if recording.metadata["values"] == "difference":
        return []
    unit = recording.metadata["unit"]
    unit = "arbitrary units" if unit == "arbitrary" else unit
    level = measures.median_reading(recording)
    measured = measures.noise(recording)
    if measured is not None:
        sentence = (
            f"{measured.sigma:.3g} {unit} in the median channel{_share(measured.sigma, level)}, "
            f"from {measured.frames} untouched frames"
        )
        if measured.between_presses:
            sentence += " with presses between them, so recovery after a press is in it"
        return [_fact("noise", sentence + ".", measured.sigma)]
    bound = measures.noise_bound(recording)
    if bound is None:
        return []
    sentence = (
        f"no untouched repeats; at most {bound:.3g} {unit}{_share(bound, level)}, else drive and "
        "measurement could not be exchanged so well."
    )
    return [_fact("noise", sentence, bound)]


def drift(recording: Recording) -> list[Finding]:
    """Median relative change of the untouched readings from first to last (value)."""
    if recording.metadata["values"] == "difference":
        return []
    measured = measures.drift(recording)
    if measured is None:
        return []
    change, rest = measured.change, measured.uncommon
    changed = f"{percent(change, 2)} (median channel)"
    sentence = f"the untouched readings change by {changed} from first to last"
    if rest is not None:
        sentence += f"; {percent(rest)} of it is left when one common factor is taken out"
    return [_fact("drift", sentence + ".", change)]


def reciprocity(recording: Recording) -> list[Finding]:
    """Median over reciprocal pairs of their relative difference (value)."""
    measured = measures.reciprocity(recording)
    if measured is None:
        return []
    sentence = (
        f"exchanging drive and measurement changes a reading by {percent(measured.median, 2)} "
        f"(median of {measured.pairs} pairs; rms {percent(measured.rms, 2)})."
    )
    return [_fact("reciprocity", sentence, measured.median)]


def channel_order(recording: Recording) -> list[Finding]:
    """Whether the readings stand in the table's order (value: the rms misfit of its identities), or
    far better in another known one.
    """
    order = wiring.order(recording)
    overall, best, names = order.own.overall, order.best, order.names
    if overall is None:
        sentence = "the channels repeat nothing, so their order cannot be checked."
        return [Finding("order", UNOBSERVABLE, sentence, remedy="reciprocal or reversed channels")]
    if order.is_wrong:
        others = f" ({len(names) - 1} more orders fit alike)" if len(names) > 1 else ""
        sentence = (
            f"wrong channel order: {_in_words(order.own)}; read as '{ORDERS[names[0]].sentence}' "
            f"the misfit is {best:.2g} instead of {overall:.2f}{others}. To read it so: --order "
            f"{names[0]} (in config.yaml order: {names[0]})."
        )
    elif order.severity == FACT:
        sentence = f"as the table says: {_in_words(order.own)}."
    elif order.worst is not None:
        sentence = (
            f"{_in_words(order.own)}, most where electrodes {order.worst[0]} and {order.worst[1]} "
            f"take part; no known channel order repairs it (the best leaves {percent(best)}). No "
            "passive, linear skin reads so: look at the wiring and the contacts, or at a channel "
            "table of another pattern."
        )
    else:
        sentence = (
            f"{_in_words(order.own)}; no known channel order is far better (the best: {best:.2f} "
            f"overall instead of {overall:.2f}), so it is the skin or the instrument that breaks "
            "it, not the order."
        )
    return [Finding("order", order.severity, sentence, overall)]


def _in_words(misfit: Misfit) -> str:
    if misfit.reciprocity is not None:
        changed = percent(misfit.reciprocity)
        return f"exchanging drive and measurement changes readings by {changed} rms"
    parts = []
    if misfit.reversal is not None:
        parts.append(
            f"exchanging source and sink changes the size of readings by {misfit.reversal:.2f}"
        )
    if misfit.rotation is not None:
        parts.append(f"going round by one electrode changes them by {misfit.rotation:.2f}")
    return " and ".join(parts) + " of their size"


def polarity(recording: Recording) -> list[Finding]:
    """Whether signed readings have the sign that the table gives them (value: their correlation
    with a homogeneous disc's).
    """
    alike = wiring.polarity(recording)
    if alike is None or alike >= wiring.EXCHANGED:
        return []
    sentence = (
        f"wrong channel table: the readings correlate by {alike:.2f} with a homogeneous "
        "disc's; plus and minus (or source and sink) are exchanged."
    )
    turned = measures.turned_pairs(recording)
    if turned is not None:
        sentence += f" Where the format leaves the measured pairs open: --measure {turned}."
    return [Finding("polarity", ERROR, sentence, alike)]


def numbering(recording: Recording) -> list[Finding]:
    """Whether touches light up where the file says that they are (value: how far round they do,
    degrees).
    """
    lit = wiring.numbering(recording)
    if lit is None:
        return []
    sentence = (
        f"the {lit.touches} strongest touches light up {lit.turn:+.0f} degrees "
        "(counter-clockwise) from where the file puts them, and after that turn within "
        f"{lit.residual_radii:.2f} of the radius (median)."
    )
    if lit.severity == ERROR and lit.mirrored:
        sentence = (
            "wrong electrode numbering: touches light up mirrored; numbers run the other way round."
            " State skin.electrode_deg clockwise, or mirror the labelled places."
        )
    elif lit.severity == ERROR:
        off = f"{lit.turn / lit.pitch:+.1f} electrodes"
        sentence = (
            f"wrong electrode numbering, off by {off}: {sentence} State skin.electrode_deg with "
            f"about {abs(lit.turn):.0f} degrees {'less' if lit.turn > 0 else 'more'} each, or turn "
            "the labelled places."
        )
    return [Finding("numbering", lit.severity, sentence, lit.turn)]


def unobservable(recording: Recording) -> list[Finding]:
    """What these frames cannot tell, each with the frames to add."""
    return [
        Finding(topic, UNOBSERVABLE, sentence, remedy=remedy)
        for topic, sentence, remedy in map(MISSING.__getitem__, missing(recording))
    ]


def _share(value: float, level: float) -> str:
    """`, 0.25 % of the median reading`; nothing where that reading is 0."""
    return f", {percent(value / level, 2)} of the median reading" if level > 0 else ""


def _fact(topic: str, sentence: str, value: float | None = None) -> Finding:
    return Finding(topic, FACT, sentence, value)
