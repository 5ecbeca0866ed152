"""The difference of two recordings in words."""

from collections.abc import Sequence

import numpy as np

from eitskin.diagnose.compare.difference import MARGIN_NATS, Difference, Finding
from eitskin.diagnose.compare.discs import Disc
from eitskin.diagnose.compare.evidence import Explanation
from eitskin.diagnose.compare.objects import LEAST_EXPLAINED, NAME, objects_of
from eitskin.diagnose.verdict.words import sites_text
from eitskin.effects.effect import SITES
from eitskin.quantities import MINUS, listed, number, percent

MOST_LISTED = 8  # channels that are listed one by one
SHOWN = 3  # electrodes at which most changed
LEAST_COMMON = 0.002  # ratio of all readings together, below which it is not mentioned
PASSIVE = 0.2  # odd share of a change, below which it may be the passive skin's
SIGNIFICANT = 0.01  # p-value from which on the scatter within a recording explains a change
DEAD = 0.05  # of its reading, that a dead channel has at most

DESCRIPTIONS = {
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


def placed(explanation: Explanation) -> dict:
    """The name of a fault and its sites of each kind."""
    kind, numbers = explanation.place
    site_lists = {name: [int(s) for s in numbers] if name == kind else [] for name in SITES}
    return {"name": explanation.name, **site_lists}


def sentences(difference: Difference) -> list[str]:
    """What changed, strongest first; what did not, where nothing was found."""
    control, later = difference.pair.names
    texts = []
    if difference.lost_channels:
        channels = _channels(difference.lost_channels, difference)
        texts.append(f"{later} has no readings of {channels}, which {control} has.")
    texts += [sentence(finding, difference) for finding in difference.findings]
    if not texts:
        texts.append(_no_fault(difference))
    elif any(not finding.named for finding in difference.findings):
        texts.append(f"Most changed {_most_changed(difference)}.")
    for finding in difference.findings:
        change = finding.change if finding.named else difference.wander.change
        odd_share = difference.odd_share(change)
        if finding.object_fit is not None:
            texts.append(_fit_of_objects(finding))
        elif finding.explanation.place[0] is None:
            continue  # What all readings share has no place near which a contact may be.
        elif odd_share is not None and odd_share < PASSIVE and finding.name != "electrode-swap":
            texts.append(
                f"As much as {percent(1.0 - odd_share)} of this is the same with drive and"
                " measurement exchanged: so it may be the passive skin, or a contact, near by,"
                " rather than the instrument."
            )
    if abs(difference.common_ratio) >= LEAST_COMMON:
        texts.append(
            f"All readings together moved by {_signed_percent(difference.common_ratio)}: the skin's"
            " or the current's, and counted as no fault."
        )
    return texts


def _no_fault(difference: Difference) -> str:
    """The sentence where no fault was found."""
    control, later = difference.pair.names
    rms, p_value = difference.change_test
    text = f"No fault shows between {control} and {later}: "
    if p_value >= SIGNIFICANT:
        return f"{text}what differs is no more than the readings scatter within a recording."
    return (
        f"{text}the readings differ by {number(rms, 2)} times what they scatter within a"
        " recording, but at no one site. A skin may do so by itself from one session to the next;"
        " or its gel, its contacts or what lies on it changed."
    )


def sentence(finding: Finding, difference: Difference) -> str:
    """A finding in a sentence: what, where, since when, and its evidence."""
    later = difference.pair.names[1]
    start = f"From frame {finding.onset_row} of {later} on" if finding.onset_row else f"In {later}"
    nats, rival = f"{finding.explanation.evidence:.0f} nats", finding.rival
    if not finding.named:
        reason = "it sits at more sites than one fault has"
        fit = finding.object_fit
        if fit is not None and fit.explained_share < LEAST_EXPLAINED:
            unexplained = percent(1.0 - fit.explained_share)
            reason = f"it leaves {unexplained} of the change's square unexplained"
        if rival is not None and finding.margin < MARGIN_NATS:
            degree = "better" if finding.margin < 0.0 else "as well"
            reason = f"{_short(rival)} explains it {degree} ({rival.evidence:.0f} nats)"
        return (
            f"{start} something changed, and what it is cannot be told:"
            f" {_short(finding.explanation)} explains much of it ({nats}), but {reason}."
        )
    text = f"{start}, {_description(finding, difference)} ({nats}"
    if rival is not None:
        text += f"; next, {_short(rival)}: {number(max(rival.evidence, 0.0), 2)}"
    if finding.alternatives:
        text += f"; as well it may be {' or '.join(finding.alternatives)}"
    return f"{text})."


def _description(finding: Finding, difference: Difference) -> str:
    """A named fault as a clause."""
    name, where = finding.name, _where(finding.explanation, difference)
    signatures = finding.explanation.signatures
    if name == "offset":
        volt = float(np.median(finding.change[finding.change != 0]))
        place = f"what is measured with its plus at {where}" if where else "every reading"
        return f"{number(volt)} is added to {place}"
    if name == "adc-nonlinearity":
        return _converter(finding, difference)
    if finding.object_fit is not None:
        discs = objects_of(finding.explanation).discs
        objects = listed([_object(disc, difference) for disc in discs])
        subject = "something lies" if len(discs) == 1 else f"{len(discs)} things lie"
        return f"{subject} in the skin: {objects}"
    if name == "channel-gain" and len(signatures) == 1:
        m = signatures[0].sites[0]
        mean = difference.wander.mean[m]
        if np.abs(mean + finding.change[m]) < DEAD * np.abs(mean):
            return f"{where} reads next to nothing: it is dead"
    several = len(signatures) > 1 and name == "channel-gain"
    direction = "more" if finding.ratio > 0 else "less"
    return DESCRIPTIONS[name].format(
        where=where,
        reads="read" if several else "reads",
        ratio=f"{percent(abs(finding.ratio), 2)} {direction}",
    )


def _object(disc: Disc, difference: Difference) -> str:
    """An object: which way it conducts, and its place."""
    noun = "a conducting one" if disc.conducting else "an insulating one"
    angle = f"at {disc.angle_deg:.0f}°"
    radius = difference.pair.radius_mm
    if radius is None:
        share = number(np.hypot(disc.x, disc.y), 2)
        return f"{noun} {angle}, {share} of the radius from the centre"
    return f"{noun} {angle}, at x = {radius * disc.x:.0f} mm, y = {radius * disc.y:.0f} mm"


def _fit_of_objects(finding: Finding) -> str:
    """How well objects explain the change, and the limits of their simulation."""
    assert finding.object_fit is not None
    held_out = finding.object_fit.held_out
    ratio = number(held_out["rms_after"] / held_out["rms_before"], 2)
    return (
        "Simulated on an even disc, this conductivity-patch explains"
        f" {percent(finding.object_fit.explained_share)} of the change's square; on reciprocal"
        f" pairs held out the misfit falls to {ratio} of what it is without. In a deep tank the"
        " disc is only the nearest: trust the place more than the size."
    )


def _converter(finding: Finding, difference: Difference) -> str:
    """A converter's limit, or its nonlinearity, as a clause."""
    channels = np.flatnonzero(finding.explanation.signatures[0].basis.any(axis=1))
    if len(channels) < difference.wander.usable.sum():
        limit = np.nanmax(np.abs(difference.pair.later))
        return (
            f"no reading goes beyond {number(limit)}: reached by {_channels(channels, difference)}"
        )
    return "readings change as their cube does: the converter is not linear"


def _where(explanation: Explanation, difference: Difference) -> str:
    """The sites of a fault; "" without any."""
    kind, numbers = explanation.place
    if kind == "channels":
        return _channels(numbers, difference)
    if kind is None:
        return ""
    return f"electrode{'s' if len(numbers) > 1 else ''} {listed([int(s) for s in numbers])}"


def _channels(numbers: np.ndarray | Sequence[int], difference: Difference) -> str:
    """Channels with their electrodes, or how many they are."""
    if len(numbers) > MOST_LISTED:
        return f"{len(numbers)} channels"
    rows = difference.pair.channels
    texts = [
        f"{m} ({rows[m][0]}–{rows[m][1]}, {rows[m][2]}–{rows[m][3]})"  # noqa: RUF001
        for m in numbers
    ]
    return f"channel{'s' if len(texts) > 1 else ''} {listed(texts)}"


def _short(explanation: Explanation) -> str:
    """The name of a fault and its sites."""
    if explanation.name == NAME:
        signs = [
            "conducting" if disc.conducting else "insulating"
            for disc in objects_of(explanation).discs
        ]
        return f"{NAME} ({listed(signs)})"
    return " at ".join(filter(None, [explanation.name, sites_text(placed(explanation))]))


def _signed_percent(share: float) -> str:
    return f"{'+' if share > 0 else MINUS}{percent(abs(share), 1)}"


def _most_changed(difference: Difference) -> str:
    """The electrodes whose channels changed most, in units of the wander."""
    squares = difference.wander.whitened(difference.wander.change) ** 2
    usable = difference.wander.usable
    mean = squares[usable].mean()
    ratios = []
    for electrode in range(difference.pair.n):
        mask = (difference.pair.channels == electrode).any(axis=1) & usable
        ratios.append(squares[mask].mean() / mean if mask.any() else 0.0)
    texts = [
        f"electrode {e} ({number(ratios[e], 2)} times the mean square)"
        for e in np.argsort(ratios)[::-1][:SHOWN]
    ]
    return f"the channels that use {listed(texts)}"
