"""Measuring pairs whose amplifier is not what the board believes."""

from eitskin.effects.gain import PAIR_IDENTITIES, GainEffect


class MeasurementGain(GainEffect):
    """All channels of one measuring pair, times a gain; a pair is named by its plus electrode."""

    name = "measurement-gain"
    sites = ("measures",)
    source = "Hahn, Just, Dittmar, Hellige 2008"
    mend = "calibrate the amplifier with electrode {site} at its plus"
    finding = "{site} {reads|read} {gain} times the voltage that is there."
    shown_by = "a recording with absolute values"
    confusable = ("channel-gain",)
    identities = PAIR_IDENTITIES
