"""What gains of channels, of drives and of measuring pairs share; it is no effect by itself."""

import numpy as np

from eitskin.effects.effect import Frames, InstrumentEffect, Parameter, Setting
from eitskin.effects.identity import Identity, NamedEffect, OtherSide, Substitute
from eitskin.quantities import listed, number, quantity

GAINS = ("drive-gain", "measurement-gain")
EVERY_GAIN = (*GAINS, "channel-gain")
SEAT = ("contact-impedance", "electrode-position", "electrode-width")


def scaled_readings(scale: NamedEffect, ratio: float) -> OtherSide:
    """Of an effect that changes readings as a gel that conducts `ratio` times as well with contacts
    as they are: all currents, or all amplifiers, and the conductivity with them, as at unit current
    U = f(z sigma / length) / (sigma h)."""
    drives = np.unique(scale.channels[:, 0])
    gain = Substitute("drive-gain", {"gain": ratio}, drives, "drives")
    stated_S_per_m = scale.skin.conductivity_S_per_m
    assert stated_S_per_m is not None
    sigma_S_per_m = stated_S_per_m * ratio
    sentence = (
        f"Instead all currents, or all readings, may be {number(ratio)} times what is stated, and"
        f" the skin conduct {quantity(sigma_S_per_m, 'S/m')}. Measure the current through a known"
        " resistor."
    )
    return OtherSide(scale.gap(scale.simulated([gain], conductivity_ratio=ratio)), sentence)


def _pairing(gain: NamedEffect) -> tuple[NamedEffect, list[int], float] | None:
    """Of a gain at few sites: the gain of the other kind; the electrodes that all pairs of both
    have, or else all of theirs; and the gap to one gain for each pair in drive and in measurement.
    None where the pairs of the two differ."""
    partners = gain.partners(GAINS)
    if len(partners) != 1 or any(one_gain.scope != "sparse" for one_gain in (gain, *partners)):
        return None
    (partner,) = partners
    pairs, partner_pairs = _electrode_pairs(gain), _electrode_pairs(partner)
    if pairs is None or partner_pairs is None or sorted(pairs) != sorted(partner_pairs):
        return None
    gap = gain.equality_gap(partner, [partner_pairs.index(pair) for pair in pairs])
    common = set.intersection(*map(set, pairs)) or set.union(*map(set, pairs))
    return partner, sorted(common), gap


def _electrode_pairs(gain: NamedEffect) -> list[tuple[int, int]] | None:
    """The two electrodes of every site of a gain; None where a site has several pairs."""
    column = 0 if gain.kind == "drives" else 2
    table = gain.channels[:, column : column + 2]
    pairs = []
    for site in gain.sites:
        rows = {(min(pair), max(pair)) for pair in table[table[:, 0] == site].tolist()}
        if len(rows) != 1:
            return None
        pairs.append(rows.pop())
    return pairs


def shared_wire(gain: NamedEffect) -> OtherSide | None:
    """One transfer of the wires, alike in drive and in measurement, as every passive network
    between skin and board has it (reciprocity: A Z A^T is symmetric as Z is)."""
    pairing = _pairing(gain)
    if pairing is None:
        return None
    _, electrodes, gap = pairing
    place = f"electrode{'s' if len(electrodes) > 1 else ''} {listed(electrodes)}"
    sentence = (
        "Drive and measurement have the same gain there, which no two amplifiers need have: look at"
        f" the wire and the contact of {place} before the board."
    )
    return OtherSide(gap, sentence)


def electrode_seat(gain: NamedEffect) -> OtherSide | None:
    """Of gains alike in drive and in measurement: place, width and contact of their electrodes, in
    place of both; linear."""
    pairing = _pairing(gain)
    if pairing is None or gain.is_distinct(pairing[2]):
        return None
    partner, electrodes, _ = pairing
    return OtherSide(gain.gap_without(partner, SEAT, electrodes), "")


PAIR_IDENTITIES = (
    Identity((), shared_wire, of_pair=True),
    Identity(SEAT, electrode_seat, of_pair=True),
)


class GainEffect(InstrumentEffect):
    """Channels times the gain of their site, `sites` saying what a site is."""

    order = "gain"
    driver = "static"
    common = False  # that is the conductivity's
    parameters = {"gain": Parameter("1", 1.0, 0.0, 10.0, scale=0.05)}

    def change(self, voltage: np.ndarray, setting: Setting, frames: Frames) -> np.ndarray:
        """Readings (N, M) of `voltage` (N, M)."""
        return voltage * setting.at_channels("gain", frames.channels)

    def slope(self, voltage: np.ndarray) -> np.ndarray:
        """(N, M): the reading itself."""
        return voltage
