"""The complete electrode model of a round sheet, in closed form except for the currents.

The rim's potential for a current density q is the disc's Fourier series, -log|2 sin| / pi. A round
inclusion is made concentric by a Moebius map and adds to the series

    sum 2 b_m / ((1 - b_m) m pi) cos m (phi - phi'),    b_m = -c / (c + 2) rho^2m,

phi the mapped rim's angle, rho the mapped inclusion's radius, c its contrast. Under an electrode
zeta q + u = U is solved on nodes graded towards its ends, where q has logarithms; the logarithm of
the kernel is integrated exactly (Kress 1990; Somersalo, Cheney, Isaacson 1992).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import lu_factor, lu_solve

from witness.boundary import Disc, Radial
from witness.curves import Shape

FADED = 39.0  # the series ends where rho^2m < exp(-FADED)


@dataclass(frozen=True)
class Nodes:
    """The number of an electrode's nodes, and the power of their grading towards its ends."""

    count: int = 48
    power: int = 4

    def grade(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Parameters (count,) in 0 to pi, w at them, rising from 0 to pi, and its derivative."""
        s = np.pi * (np.arange(self.count) + 0.5) / self.count
        x = 1.0 - s / np.pi
        p = self.power
        v = (1.0 / p - 0.5) * (2.0 * x - 1.0) ** 3 + (1.0 / p) * (1.0 - 2.0 * x) + 0.5
        slope = (3.0 * (1.0 / p - 0.5) * (2.0 * x - 1.0) ** 2 * 2.0 - 2.0 / p) * (-1.0 / np.pi)
        u = 1.0 - v
        total = v**p + u**p
        rising = p * (v ** (p - 1) * u ** (p - 1)) * slope / total**2
        return s, np.pi * v**p / total, np.pi * rising

    def logarithm(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """t = cos w at the nodes, weights |dt|, and the quadrature (count, count) of
        -log|t - t'| f(t')."""
        s, w, rise = self.grade()
        n = self.count
        # Even about 0: nodes -s carry the same values, and both are summed.
        mirrored_s, mirrored_w = np.append(s, -s), np.append(w, -w)
        steep = np.append(rise, rise)
        m = np.arange(1, n)
        lag = s[:, None] - mirrored_s
        exact = -(2.0 * np.pi / n) * (np.cos(lag[..., None] * m) / m).sum(axis=-1)
        exact -= np.pi / n**2 * np.cos(n * lag)
        chord = np.sin(0.5 * lag)
        coincident = np.abs(chord) < 1e-14
        ratio = np.sin(0.5 * (w[:, None] - mirrored_w)) / np.where(coincident, 1.0, chord)
        ratio = np.where(coincident, steep, np.abs(ratio))
        kernel = 0.5 * exact + (np.pi / n) * np.log(ratio)
        kernel = kernel[:, :n] + kernel[:, n:] - (np.pi / n) * np.log(2.0)
        return np.cos(w), np.sin(w) * rise * np.pi / n, -kernel * np.sin(w) * rise


class Body:
    """`boundary.Body` of a round sheet. Raises ValueError for another rim or a conductivity with
    direction or tilt."""

    def __init__(
        self, shape: Shape, deg: np.ndarray, width_mm: np.ndarray, nodes: Nodes | None = None
    ):
        if any(shape.harmonics.values()) or shape.anisotropy[0] != 1.0 or shape.tilt:
            raise ValueError("the series needs a round rim and a conductivity without direction")
        self.radius_mm, self.n = shape.radius_mm, len(deg)
        t, weight, segment_log = (nodes or Nodes()).logarithm()
        half = np.asarray(width_mm, float) / (2.0 * shape.radius_mm)
        theta = np.radians(deg)[:, None] + half[:, None] * t
        self.angle, self.weight = theta.ravel(), (half[:, None] * weight).ravel()
        size = len(t)
        lag = theta.ravel()[:, None] - theta.ravel()
        chord = np.abs(2.0 * np.sin(0.5 * lag))
        np.fill_diagonal(chord, 1.0)
        self.mutual = -np.log(chord) * self.weight / np.pi
        for i in range(self.n):
            columns = slice(i * size, (i + 1) * size)
            half_distance = 0.5 * half[i] * (t[:, None] - t)
            curved_log = (
                -np.log(2.0 * half[i] * 0.5 * np.sinc(half_distance / np.pi)) * self.weight[columns]
            )
            self.mutual[columns, columns] = (half[i] * segment_log + curved_log) / np.pi
        self.membership = np.repeat(np.eye(self.n), size, axis=0)

    def contact(self, length: np.ndarray) -> "Contact":
        """The contacts closed: length (n,) = z sigma, in radii."""
        return Contact(self, np.asarray(length, float))

    def place(self, discs: Sequence[Disc]) -> "Place":
        """One inclusion, or none. Raises ValueError for more, or where it leaves the skin."""
        return Place(self, tuple(discs))


class Contact:
    """The factored equations of the electrodes, and the current densities for their potentials."""

    def __init__(self, body: Body, length: np.ndarray):
        matrix = body.mutual.copy()
        matrix[np.diag_indices(len(matrix))] += body.membership @ length
        self.factored = lu_factor(matrix)
        self.density = lu_solve(self.factored, body.membership)


class Place:
    """An inclusion at a given place."""

    def __init__(self, body: Body, discs: tuple[Disc, ...]):
        if len(discs) > 1:
            raise ValueError("the series knows one inclusion")
        self.body = body
        self.order, self.rho, self.waves = np.zeros(0), 0.0, np.zeros((len(body.angle), 0))
        for disc in discs:
            centre = complex(disc.x_mm, disc.y_mm) / body.radius_mm
            radius = disc.radius_mm / body.radius_mm
            excess = abs(centre) + radius - 1.0
            if excess >= 0:
                raise ValueError(f"inclusion 0 leaves the skin by {excess * body.radius_mm:g} mm")
            pole, self.rho = concentric(abs(centre), radius)
            z = np.exp(1j * (body.angle - np.angle(centre)))
            phi = np.angle((z - pole) / (1.0 - pole * z))
            m = np.arange(1, 1 + int(np.ceil(FADED / (-2.0 * np.log(self.rho)))))
            self.order = np.tile(m, 2)
            self.waves = np.hstack([np.cos(np.outer(phi, m)), np.sin(np.outer(phi, m))])
        self._cached: tuple | None = None

    def _untouched_system(self, contact: Contact) -> tuple[np.ndarray, ...]:
        if self._cached is None or self._cached[0] is not contact:
            electrode_weights = self.body.membership.T * self.body.weight
            weight = self.body.weight[:, None]
            densities = lu_solve(contact.factored, self.waves)
            wave_weights = (self.waves * weight).T
            parts = (
                electrode_weights @ contact.density,
                electrode_weights @ densities,
                wave_weights @ contact.density,
                wave_weights @ densities,
            )
            self._cached = contact, *parts
        return self._cached[1:]

    def admittance(
        self, contact: Contact, contrast: Sequence[float], radial: Radial | None = None
    ) -> np.ndarray:
        """(n, n): as `boundary.Place.admittance`. Raises ValueError for a touch that is not
        sharp."""
        if radial is not None:
            raise ValueError("the series needs sharp touches")
        current, currents_from_waves, waves_from_currents, among = self._untouched_system(contact)
        if any(contrast):
            b = -contrast[0] / (contrast[0] + 2.0) * self.rho ** (2.0 * self.order)
            strength = 2.0 * b / ((1.0 - b) * self.order * np.pi)
            system = np.eye(len(strength)) + strength[:, None] * among
            current = current - currents_from_waves @ np.linalg.solve(
                system, strength[:, None] * waves_from_currents
            )
        # All electrodes' potentials stand above a level at which their currents sum to zero.
        return current - np.outer(current.sum(axis=1), current.sum(axis=0)) / current.sum()


def concentric(centre: float, radius: float) -> tuple[float, float]:
    """The pole a of (z - a) / (1 - a z), which maps a disc about `centre` >= 0 in the unit disc to
    one about 0, and the radius of the latter."""
    low, high = centre - radius, centre + radius
    total, product = low + high, 1.0 + low * high
    pole = total / (product + np.sqrt(product**2 - total**2))
    return pole, (high - pole) / (1.0 - pole * high)
