"""Gains of single channels."""

from eitskin.effects.gain import GainEffect


class ChannelGain(GainEffect):
    """v_i -> g_i v_i. Equation 9's gains are its dense form, mirror-tied, g_i = g_(M-1-i)."""

    name = "channel-gain"
    sites = ("channels",)
    source = "Touch with Insight, equation 9"
    mend = "calibrate channel {site} with a resistor phantom"
    finding = "{site} {reads|read} {gain} times the voltage that is there."
    shown_by = "a recording with absolute values"
    confusable = ("drive-gain", "measurement-gain")
