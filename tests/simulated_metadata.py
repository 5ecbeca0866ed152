"""What every simulated recording of the tests says of itself."""

import numpy as np

from eitskin.data.recording import metadata_of
from eitskin.physics.skin import Skin


def simulated_metadata(skin: Skin, channels: np.ndarray) -> dict:
    """Metadata of signed, absolute volts of `skin` on channels (M, 4), frames of 0.2 s."""
    return metadata_of(channels, skin.metadata(), "simulation", frame_s=0.2)
