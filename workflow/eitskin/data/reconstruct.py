"""Images of the conductivity from what a touch changes: one Gauss-Newton step from the homogeneous
disc, with a NOSER prior (Cheney et al. 1990).

The unit disc is the complex plane; conductivities are relative to the untouched skin's.
"""

import numpy as np

from eitskin import skin_layout
from eitskin.data import alignment
from eitskin.physics.skin import Skin

STRENGTHS = 10.0 ** np.linspace(-6.0, 4.0, 201)  # of the prior: candidates, 12 % apart


def pixels(across: int, reach: float = 1.0) -> np.ndarray:
    """(G,) complex: centres, within `reach` of the disc's, of the cells of a square grid with
    `across` cells over the disc."""
    centre = (np.arange(across) + 0.5) * 2.0 / across - 1.0
    grid = (centre[None, :] + 1j * centre[:, None]).ravel()
    return grid[np.abs(grid) < reach]


def skin_pixels(skin: Skin, across: int) -> np.ndarray:
    """(G,) complex, mm: centres, on a skin whose size is stated, of the cells of a square grid with
    `across` cells over its extent."""
    if skin.rim is None:
        assert skin.radius_mm is not None
        return skin.radius_mm * pixels(across)
    extent = skin_layout.stated_layout(skin)
    centre = extent.centre + extent.half_extent_mm * pixels(across, np.inf)
    return centre[~skin_layout.is_beyond(skin, centre)]


def jacobian(
    channels: np.ndarray, electrode_deg: np.ndarray, places: np.ndarray, across: int
) -> np.ndarray:
    """(M, G): change of each reading, as `alignment.homogeneous_readings`, per relative rise of the
    conductivity in each of `pixels(across)`."""
    return alignment.sensitivity(channels, electrode_deg, places).T * (2.0 / across) ** 2


def noser(jacobian: np.ndarray, strength: float) -> np.ndarray:
    """(G, M): the matrix that turns a change of the readings into an image.

    (J'J + k R)⁻¹ J' with R = diag(J'J), as R⁻¹J' (J R⁻¹ J' + k)⁻¹: M equations for G.
    """
    weighted = jacobian / (jacobian**2).sum(axis=0)
    system = weighted @ jacobian.T + strength * np.eye(len(jacobian))
    return np.linalg.solve(system, weighted).T


def strength(jacobian: np.ndarray, change: np.ndarray) -> float:
    """The strength of the prior by generalised cross-validation (Golub, Heath & Wahba 1979) over
    changes (N, M): what predicts a reading best from all the others.
    """
    eigenvalues, eigenvectors = np.linalg.eigh(jacobian / (jacobian**2).sum(axis=0) @ jacobian.T)
    power = ((change @ eigenvectors) ** 2).mean(axis=0)
    residual_filter = STRENGTHS[:, None] / (np.maximum(eigenvalues, 0.0) + STRENGTHS[:, None])
    scores = (residual_filter**2 * power).mean(axis=1) / residual_filter.mean(axis=1) ** 2
    return float(STRENGTHS[np.argmin(scores)])
