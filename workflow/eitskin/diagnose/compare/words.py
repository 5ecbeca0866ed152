"""What a difference of two recordings says, in words, and as an entry of comparison.json."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from eitskin.diagnose.compare.difference import (
    DEAD,
    MARGIN,
    THRESHOLD,
    Difference,
    Found,
)
from eitskin.diagnose.compare.evidence import Explained
from eitskin.diagnose.compare.objects import EXPLAINS, NAME, Disc, ends, objects_of
from eitskin.diagnose.verdict.words import sites
from eitskin.effects.effect import SITES
from eitskin.physics.protocol import reciprocal_channels
from eitskin.quantities import MINUS, listed, number, percent

FEW = 8  # channels that are named one by one
SHOWN = 3  # electrodes at which most changed
MOVED = 0.002  # of all readings together, below which nothing is said of it
PASSIVE = 0.2  # share of a change that exchanging drive and measurement turns round, of a skin's
FEWEST_PAIRS = 10
SIGNIFICANT = 0.01  # below which chance does not move readings so far

WHAT = {
    "channel-gain": "{where} {reads} {ratio}: a gain of the channel's own, or an offset",
    "drive-gain": "what is driven from {where} {reads} {ratio}",
    "measurement-gain": "what is measured with its plus at {where} {reads} {ratio}",
    "electrode-gain": "what one wire sees or drives, {where}, {reads} {ratio}",
    "electrode": "the pairs that use {where} changed, each by its own share: a contact, or a wire",
    "drive-pair": "what is driven from {where} changed, by no one share",
    "measuring-pair": "what is measured with its plus at {where} changed, by no one share",
    "electrode-swap": "the wires of {where} are exchanged",
    "multiplexer-memory": "every reading holds a share of the reading before it",
    "crosstalk": "every reading holds a share of its neighbours in order of reading",
    "mains-interference": "the readings hold the mains",
}


def entries(found: Difference) -> dict:
    """The key `difference` of comparison.json."""
    return {
        "found": [_entry(one, found) for one in found.found],
        "lost_channels": list(found.lost),
        "common_ratio": found.common,
        "odd_share": odd_share(found, found.wander.change),
        "moved": dict(zip(("times_scatter", "p_value"), found.moved, strict=True)),
        "untouched_frames": [len(found.pair.control), len(found.pair.later)],
        "threshold_nats": THRESHOLD,
        "margin_nats": MARGIN,
    }


def _entry(one: Found, found: Difference) -> dict:
    rival = one.rival
    return {
        **_placed(one.explained),
        "named": one.named,
        "alternatives": list(one.alternatives),
        "ratio": one.ratio if np.isfinite(one.ratio) else None,
        "objects": _objects(one, found),
        "explained": one.inside and one.inside.explained,
        "held_out": one.inside and one.inside.held_out,
        "since_frame": one.since,
        "evidence_nats": one.explained.evidence,
        "odd_share": odd_share(found, one.change),
        "rival": None if rival is None else {**_placed(rival), "evidence_nats": rival.evidence},
        "sentence": _sentence(one, found),
    }


def _objects(one: Found, found: Difference) -> list[dict]:
    """Objects, one an entry: which way they conduct, and where, in mm too where the skin's radius
    is known; 90 % intervals, an end that nothing holds null."""
    if one.inside is None:
        return []
    entries = []
    part = objects_of(one.explained)
    for disc, known in zip(part.discs, ends(part.at, one.inside.spread), strict=True):
        entry: dict[str, Any] = {"conducting": disc.conducts, "angle_deg": _angle(disc)}
        for key, numbers in known.items():
            name = "contrast" if key == "ratio" else f"{key}_of_radius"
            entry[name] = _estimate(numbers, "1")
            if key != "ratio":
                radius = found.pair.radius_mm
                scaled = [radius * value for value in numbers] if radius else None
                entry[f"{key}_mm"] = _estimate(scaled, "mm") if scaled else None
        entries.append(entry)
    return entries


def _estimate(numbers: Sequence[float], unit: str) -> dict:
    """Value, low and high; an infinite end, and the 0 of a ratio at its bound, are null."""
    value, low, high = (float(each) for each in numbers)
    held = {"low": low if low != 0 else None, "high": high if np.isfinite(high) else None}
    return {"value": value, **held, "unit": unit}


def _angle(disc: Disc) -> float:
    """Degrees, as electrodes' angles are counted."""
    return float(np.degrees(np.arctan2(disc.y, disc.x)) % 360.0)


def _placed(explained: Explained) -> dict:
    kind, where = explained.place
    there = {each: [int(s) for s in where] if each == kind else [] for each in SITES}
    return {"name": explained.name, **there}


def sentences(found: Difference) -> list[str]:
    """What changed, strongest first; what did not, where nothing was found."""
    control, later = found.pair.names
    said = []
    if found.lost:
        whose = _channels(found.lost, found)
        said.append(f"{later} has no readings of {whose}, which {control} has.")
    said += [_sentence(one, found) for one in found.found]
    if not said:
        said.append(_nothing(found))
    elif any(not one.named for one in found.found):
        said.append(f"Most changed {_most(found)}.")
    for one in found.found:
        share = odd_share(found, one.change if one.named else found.wander.change)
        if one.inside is not None:
            said.append(_of_objects(one, found))
        elif one.explained.place[0] is None:
            continue  # What all readings share has no place near which a contact may be.
        elif share is not None and share < PASSIVE and one.name != "electrode-swap":
            said.append(
                f"As much as {percent(1.0 - share)} of this is the same with drive and measurement"
                " exchanged: so it may be the passive skin, or a contact, near by, rather than the"
                " instrument."
            )
    if abs(found.common) >= MOVED:
        said.append(
            f"All readings together moved by {_percent(found.common)}: the skin's or the current's,"
            " and counted as no fault."
        )
    return said


def _nothing(found: Difference) -> str:
    """What is said where no fault was found."""
    control, later = found.pair.names
    times, p = found.moved
    said = f"No fault shows between {control} and {later}: "
    if p >= SIGNIFICANT:
        return f"{said}what differs is no more than the readings scatter within a recording."
    return (
        f"{said}the readings differ by {number(times, 2)} times what they scatter within a"
        " recording, but at no one site. A skin may do so by itself from one session to the next;"
        " or its gel, its contacts or what lies on it changed."
    )


def _sentence(one: Found, found: Difference) -> str:
    later = found.pair.names[1]
    when = f"From frame {one.since} of {later} on" if one.since else f"In {later}"
    nats = f"{one.explained.evidence:.0f} nats"
    if not one.named:
        why = "it sits at more sites than one fault has"
        if one.inside is not None and one.inside.explained < EXPLAINS:
            left = percent(1.0 - one.inside.explained)
            why = f"it leaves {left} of the change's square unexplained"
        if one.rival is not None and one.margin < MARGIN:
            how = "better" if one.margin < 0.0 else "as well"
            why = f"{_short(one.rival)} explains it {how} ({one.rival.evidence:.0f} nats)"
        return (
            f"{when} something changed, and what it is cannot be told: {_short(one.explained)}"
            f" explains much of it ({nats}), but {why}."
        )
    text = f"{when}, {_what(one, found)} ({nats}"
    if one.rival is not None:
        text += f"; next, {_short(one.rival)}: {number(max(one.rival.evidence, 0.0), 2)}"
    if one.alternatives:
        text += f"; as well it may be {' or '.join(one.alternatives)}"
    return f"{text})."


def _what(one: Found, found: Difference) -> str:
    name, where = one.name, _where(one.explained, found)
    if name == "offset":
        volt = float(np.median(one.change[one.change != 0]))
        place = f"what is measured with its plus at {where}" if where else "every reading"
        return f"{number(volt)} is added to {place}"
    if name == "adc-nonlinearity":
        return _converter(one, found)
    if one.inside is not None:
        discs = objects_of(one.explained).discs
        told = listed([_object(disc, found) for disc in discs])
        some = "something lies" if len(discs) == 1 else f"{len(discs)} things lie"
        return f"{some} in the skin: {told}"
    if name == "channel-gain" and len(one.explained.parts) == 1:
        m = one.explained.parts[0].sites[0]
        left = np.abs(found.wander.mean[m] + one.change[m])
        if left < DEAD * np.abs(found.wander.mean[m]):
            return f"{where} reads next to nothing: it is dead"
    several = len(one.explained.parts) > 1 and name == "channel-gain"
    more = "more" if one.ratio > 0 else "less"
    return WHAT[name].format(
        where=where,
        reads="read" if several else "reads",
        ratio=f"{percent(abs(one.ratio), 2)} {more}",
    )


def _object(disc: Disc, found: Difference) -> str:
    """One object: which way it conducts and where."""
    which = "a conducting one" if disc.conducts else "an insulating one"
    at = f"at {_angle(disc):.0f}°"
    radius = found.pair.radius_mm
    if radius is None:
        return f"{which} {at}, {number(np.hypot(disc.x, disc.y), 2)} of the radius from the centre"
    return f"{which} {at}, at x = {radius * disc.x:.0f} mm, y = {radius * disc.y:.0f} mm"


def _of_objects(one: Found, found: Difference) -> str:
    """How well objects explain, and what their simulation is."""
    assert one.inside is not None
    held = one.inside.held_out
    left = number(held["rms_after"] / held["rms_before"], 2)
    return (
        "Simulated on an even disc, this conductivity-patch explains"
        f" {percent(one.inside.explained)} of the change's square; on reciprocal pairs"
        f" held out the misfit falls to {left} of what it is without. In a deep tank the disc is"
        " only the nearest: trust the place more than the size."
    )


def _converter(one: Found, found: Difference) -> str:
    at = np.flatnonzero(one.explained.parts[0].basis.any(axis=1))
    if len(at) < found.wander.usable.sum():
        limit = np.nanmax(np.abs(found.pair.later))
        return f"no reading goes beyond {number(limit)}: reached by {_channels(at, found)}"
    return "readings change as their cube does: the converter is not linear"


def _where(explained: Explained, found: Difference) -> str:
    kind, there = explained.place
    if kind == "channels":
        return _channels(there, found)
    if kind is None:
        return ""
    return f"electrode{'s' if len(there) > 1 else ''} {listed([int(s) for s in there])}"


def _channels(which: np.ndarray | Sequence[int], found: Difference) -> str:
    if len(which) > FEW:
        return f"{len(which)} channels"
    rows = found.pair.channels
    named = [f"{m} ({rows[m][0]}–{rows[m][1]}, {rows[m][2]}–{rows[m][3]})" for m in which]  # noqa: RUF001
    return f"channel{'s' if len(named) > 1 else ''} {listed(named)}"


def _short(explained: Explained) -> str:
    placed = _placed(explained)
    if explained.name == NAME:
        signs = [
            "conducting" if disc.conducts else "insulating" for disc in objects_of(explained).discs
        ]
        return f"{NAME} ({listed(signs)})"
    return " at ".join(filter(None, [explained.name, sites(placed)]))


def _percent(share: float) -> str:
    return f"{'+' if share > 0 else MINUS}{percent(abs(share), 1)}"


def _most(found: Difference) -> str:
    """The electrodes whose channels changed most, against what they would without a fault."""
    white = found.wander.across(found.wander.change) ** 2
    usable = found.wander.usable
    mean = white[usable].mean()
    size = []
    for electrode in range(found.pair.n):
        uses = (found.pair.channels == electrode).any(axis=1) & usable
        size.append(white[uses].mean() / mean if uses.any() else 0.0)
    first = np.argsort(size)[::-1][:SHOWN]
    told = [f"electrode {e} ({number(size[e], 2)} times the mean square)" for e in first]
    return f"the channels that use {listed(told)}"


def odd_share(found: Difference, change: np.ndarray) -> float | None:
    """How much of the square of a change (M,), V, turns round when drive and measurement are
    exchanged: none of a passive skin's, half of what changes each channel by itself. None where the
    recording has too few such pairs, or nothing changed in them."""
    pairs, signs = reciprocal_channels(found.pair.channels)
    scale = found.wander.scale
    there = np.isfinite(scale[pairs]).all(axis=1)
    if there.sum() < FEWEST_PAIRS:
        return None
    first, second = pairs[there].T
    turned = signs[there] if found.pair.signed else np.ones(len(first))
    weight = np.hypot(scale[first], scale[second])
    odd = ((change[first] - turned * change[second]) / weight) ** 2
    even = ((change[first] + turned * change[second]) / weight) ** 2
    whole = float((odd + even).sum())
    return float(odd.sum() / whole) if whole > 0 else None
