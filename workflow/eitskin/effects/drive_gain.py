"""Drives whose current is not what the board believes."""

from eitskin.effects.gain import PAIR_IDENTITIES, GainEffect


class DriveGain(GainEffect):
    """All channels of one drive, times a gain; a drive is named by its source electrode."""

    name = "drive-gain"
    sites = ("drives",)
    source = "Hahn, Just, Dittmar, Hellige 2008"
    mend = "check the current with electrode {site} as source"
    finding = "{site} {carries|carry} {gain} times the current that the simulation assumes."
    shown_by = "a recording with absolute values"
    confusable = ("channel-gain",)
    identities = PAIR_IDENTITIES
