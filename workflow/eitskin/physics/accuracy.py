"""The forward model's own numerical error, known channel by channel.

It is the same in every frame of a recording, so it adds up coherently and cannot be treated as
noise; what is returned here is therefore signed, per channel. The limit that errors are measured
against is Richardson's: three expansions, each with twice the electrode modes of the one before,
extrapolated at the order that they show.
"""

from dataclasses import replace

import numpy as np

from eitskin.physics.forward import Accuracy, Forward, channel_values
from eitskin.physics.geometry import Geometry
from eitskin.physics.touch import TouchAccuracy

MODES = (16, 32, 64)  # doubled twice, for Richardson's extrapolation
FINEST = Accuracy(MODES[-1], TouchAccuracy(40, 1e-11, 16, 2e-4), MODES[-1])
CONTRASTS = (0.45, 9.0)  # of touches, a weak and a strong one, at which the error is measured
CACHE_SIZE = 4  # skins whose untouched error is kept

_error_cache: dict[tuple, np.ndarray] = {}


def electrode_limit(geometry: Geometry, channels: np.ndarray) -> tuple[np.ndarray, float]:
    """Untouched voltages (M,) V per A, extrapolated in electrode modes, and the order observed.

    Order q: the error falls as modes^-q. Point electrodes have a closed form,
    order infinite; where the error is at rounding, the order is NaN.
    """
    if geometry.points:
        return Forward(geometry, FINEST).voltages(channels), np.inf
    coarse, middle, fine = (
        channel_values(
            Forward(
                geometry, replace(FINEST, electrode_order=n, most_modes=n)
            ).transfer_impedance(),
            channels,
        )
        for n in MODES
    )
    if np.linalg.norm(fine - middle) < 1e-11 * np.linalg.norm(fine):
        return fine, np.nan
    ratio = np.linalg.norm(middle - coarse) / np.linalg.norm(fine - middle)
    return fine + (fine - middle) / (ratio - 1.0), float(np.log2(ratio))


def untouched_error(
    geometry: Geometry, channels: np.ndarray, accuracy: str | Accuracy
) -> np.ndarray:
    """(M,) V per A, signed: voltages at `accuracy` minus their limit, the same in every frame."""
    key = (geometry.key(), np.asarray(channels).tobytes(), accuracy)
    if key not in _error_cache:
        limit = electrode_limit(geometry, channels)[0]
        while len(_error_cache) >= CACHE_SIZE:
            _error_cache.pop(next(iter(_error_cache)))
        _error_cache[key] = Forward(geometry, accuracy).voltages(channels) - limit
    return _error_cache[key].copy()
