"""What every simulated recording of the tests says of itself."""

import numpy as np

from eitskin.physics.skin import Skin


def simulated_metadata(skin: Skin, channels: np.ndarray) -> dict:
    """Metadata of signed, absolute volts of `skin` on channels (M, 4), frames of 0.2 s."""
    return {
        "format": "eit-recording",
        "version": 1,
        "channels": channels.tolist(),
        "voltage": "signed",
        "values": "absolute",
        "unit": "V",
        "frame_s": 0.2,
        "clock": "measured",
        "position_frame": "skin",
        "source_reference": "floating",
        "source": "simulation",
        "skin": skin.metadata(),
    }
