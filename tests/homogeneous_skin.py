"""What instruments would read of an even skin, by the forward model: for sample files."""

from functools import cache

import numpy as np

from eitskin.physics.forward import Forward
from eitskin.physics.geometry import Geometry, even_angles

PHASE = np.exp(0.1j)


@cache
def skin(n_electrodes: int) -> Forward:
    """A disc of gel with `n_electrodes` even electrodes."""
    return Forward(
        Geometry(80.0, 3.0, 0.5, even_angles(n_electrodes), 5.0, 2e-3),
        "train",
    )


def readings(channels: np.ndarray, n_electrodes: int) -> np.ndarray:
    """(M,) V per A of channels (M, 4), driven electrodes included."""
    return skin(n_electrodes).voltages(np.asarray(channels))


def potentials(drive: tuple[int, int], n_electrodes: int) -> np.ndarray:
    """(n,) complex V per A of every electrode against electrode 0, with a made-up phase."""
    channels = np.array([[*drive, electrode, 0] for electrode in range(1, n_electrodes)])
    return PHASE * np.concatenate([[0.0], readings(channels, n_electrodes)])
