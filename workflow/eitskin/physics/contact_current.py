"""A touch as one more terminal of the skin: current that enters evenly over the touch's disc.

In unfolded coordinates the disc is an ellipse (a circle where the conductivity has no direction),
of half axes a and b. The mean of a harmonic function over an ellipse is one over the segment
between its foci, so the Neumann function's smooth part needs few points; its -ln|x - y| / 2 pi has
the mean -(ln((a + b) / 2) - 1 / 4) / 2 pi over both. Inside the touch the current also drives the
potential psi that vanishes on its edge, -div grad psi = 1 / area: it couples to nothing else, and
takes the power 1 / (4 pi) a b / (a^2 + b^2) over the conductivity, 1 / (8 pi) for a circle.
"""

import numpy as np

from eitskin.errors import InputError
from eitskin.physics import neumann
from eitskin.physics.touch import TouchEdge

FOCAL_POINTS = 16  # of the segment between the foci; the smooth part of N needs few


class EvenCurrent:
    """A unit current that enters evenly over a touch; sheet conductance 1.

    zeta, weight (points,): nodes and weights of the mean of a harmonic function over the touch;
    power: mean over the touch of its own potential in a uniform skin; inner_power: power of psi.
    Raises InputError for a touch that the rim clips.
    """

    def __init__(self, edge: TouchEdge):
        if edge.clipped:
            place_text = f"({edge.touch.x_mm:g}, {edge.touch.y_mm:g}) mm, clipped by the rim"
            raise InputError("touch", "leak at the touch", place_text, "a touch inside the skin")
        g = edge.geometry
        squeeze = g.anisotropy_ratio**-0.25
        a, b = edge.radius * squeeze, edge.radius / squeeze
        axis = np.exp(1j * np.radians(g.anisotropy_deg)) * (1.0 if a > b else 1j)
        count = FOCAL_POINTS if a != b else 1
        angle = np.pi * np.arange(1, count + 1) / (count + 1)
        self.weight = 2.0 * np.sin(angle) ** 2 / (count + 1)
        place = g.unfold(np.array([edge.centre]))
        place = place + axis * np.sqrt(abs(a**2 - b**2)) * np.cos(angle)
        self.zeta, slope = edge.disc.derivatives(place, 1)
        diagonal = np.eye(count, dtype=bool)
        distance = np.abs(place[:, None] - place) + diagonal
        smooth = neumann.potential(self.zeta[:, None] + 2.0 * diagonal, self.zeta)
        smooth += np.log(distance) / (2.0 * np.pi)
        image = np.log(np.abs(slope)) + np.log(1.0 - np.abs(self.zeta) ** 2)
        smooth[diagonal] = -image / (2.0 * np.pi)
        direct = -(np.log(0.5 * (a + b)) - 0.25) / (2.0 * np.pi)
        self.power = float(direct + self.weight @ smooth @ self.weight)
        self.inner_power = a * b / (4.0 * np.pi * (a**2 + b**2))

    def potential(self, zeta: np.ndarray) -> np.ndarray:
        """(points,): its potential at points zeta outside the touch, in a uniform skin."""
        return neumann.potential(zeta[:, None], self.zeta) @ self.weight

    def flux(self, zeta: np.ndarray, line: np.ndarray) -> np.ndarray:
        """(points,): flux of the potential's gradient through line elements `line` at zeta."""
        return self.weight @ neumann.flux_kernel(self.zeta[:, None], zeta, line)

    def mean_response(self, edge: TouchEdge) -> np.ndarray:
        """(2 degree,): mean over the touch of the potential of its multipoles' polarisation."""
        dzeta = edge.tangent * edge.weight
        kernel = neumann.flux_kernel(self.zeta[:, None], edge.zeta, dzeta)
        return self.weight @ (kernel @ edge.values + edge.harmonics.values(self.zeta))
