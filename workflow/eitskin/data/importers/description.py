"""The metadata of an imported recording: what its files say, and null for what they do not."""

from collections.abc import Sequence

import numpy as np

from eitskin.data.recording import metadata_of


def describe(
    channels: np.ndarray,
    electrode_deg: np.ndarray | Sequence[float],
    source: str,
    voltage: str,
    position_frame: str = "skin",
    values: str = "absolute",
    unit: str = "arbitrary",
    clock: str = "index",
    skin: dict | None = None,
) -> dict:
    """A recording's metadata; `skin` holds the keys that are known, the others are null."""
    unknown = dict.fromkeys(
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
    known = {"electrode_deg": np.asarray(electrode_deg).tolist()} | (skin or {})
    return metadata_of(
        channels,
        unknown | known,
        source,
        voltage,
        position_frame,
        values=values,
        unit=unit,
        clock=clock,
    )


def swap_measured(channels: np.ndarray) -> np.ndarray:
    """The same channels with plus and minus exchanged: the other polarity of measurement."""
    return channels[:, [0, 1, 3, 2]]
