"""Recordings whose channels all read one level a frame."""

import numpy as np

from eitskin.data.recording import Recording, frames_table
from eitskin.physics.protocol import channel_table

CHANNELS = channel_table(8)  # 40


def recording(touch, voltage, session=None, x=None, force=None, depth=None, **metadata):
    """A recording of these frames; touches at (x, 0), by default one further place a frame."""
    n = len(touch)
    frames = frames_table(
        np.arange(n) * 0.1,
        touch,
        x_mm=np.arange(n, dtype=float) if x is None else x,
        y_mm=np.zeros(n),
        force_N=force,
        depth_mm=depth,
    )
    if session is not None:
        frames["session"] = session
    given = {"values": "absolute", "unit": "V", "voltage": "signed", "position_frame": "skin"}
    metadata = {**given, "source": "a citation", "channels": CHANNELS.tolist(), **metadata}
    return Recording(frames, voltage, None, None, metadata)


def level(*levels):
    """Frames whose channels all read their level."""
    return np.repeat(np.array(levels, dtype=float)[:, None], len(CHANNELS), axis=1)
