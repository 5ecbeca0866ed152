"""The metadata of an imported recording: its files' statements, and null for all others."""

from collections.abc import Sequence

import numpy as np

from eitskin.data.recording import metadata_of


def describe(
    channels: np.ndarray,
    electrode_deg: np.ndarray | Sequence[float],
    source: str,
    voltage: str,
    skin: dict | None = None,
    **settings: str,
) -> dict:
    """The metadata of an imported recording of channels (M, 4).

    `skin` holds the known keys of the skin, the others are null; `settings` as of `metadata_of`,
    by default an arbitrary unit and frames in order without times.
    """
    unknown_skin = dict.fromkeys(
        (
            "radius_mm",
            "thickness_mm",
            "conductivity_S_per_m",
            "electrode_width_mm",
            "contact_impedivity_ohm_m2",
            "current_A",
            "contrast_per_N",
        )
    )
    stated_skin = {"electrode_deg": np.asarray(electrode_deg).tolist()} | (skin or {})
    return metadata_of(
        channels,
        unknown_skin | stated_skin,
        source,
        voltage,
        **{"unit": "arbitrary", "clock": "index"} | settings,
    )


def swap_measured(channels: np.ndarray) -> np.ndarray:
    """The same channels with plus and minus exchanged: the other polarity of measurement."""
    return channels[:, [0, 1, 3, 2]]
