"""Closed curves in the plane: the rim of a skin and the edges of inclusions.

Complex places in units of the skin's radius, unfolded: in coordinates, equal in area, in which an
anisotropic conductivity is the same in all directions.
"""

from dataclasses import dataclass, field
from itertools import pairwise
from typing import TypeVar

import numpy as np

from witness.arc import panel_nodes
from witness.medium import Medium, Plane
from witness.outlines import Outline

PANEL_MODES = 40  # waves that panels resolve
PANEL_NODES = 8  # Gauss nodes of a panel
SHORTEST = 1e-3  # panel towards a crossing, in radians: shorter ones change nothing visible
Places = TypeVar("Places", np.ndarray, complex)


@dataclass(frozen=True)
class Shape:
    """The shape of a skin: harmonics of its rim {k: complex amplitude exp(i phase)}, the
    conductivity's anisotropy (ratio, deg) and its complex tilt."""

    radius_mm: float
    harmonics: dict[int, complex] = field(default_factory=dict)
    anisotropy: tuple[float, float] = (1.0, 0.0)
    tilt: complex = 0.0

    def rim(self, phi: np.ndarray, derivative: int = 0) -> np.ndarray:
        """The physical rim over the radius, or its derivative (1 or 2) by phi."""
        r = [np.ones(phi.shape), np.zeros(phi.shape), np.zeros(phi.shape)]
        for k, amplitude in self.harmonics.items():
            wave = np.conj(amplitude) * np.exp(1j * k * phi)
            r = [part + ((1j * k) ** d * wave).real for d, part in enumerate(r)]
        turn = np.exp(1j * phi)
        if derivative == 0:
            return r[0] * turn
        if derivative == 1:
            return (r[1] + 1j * r[0]) * turn
        return (r[2] + 2j * r[1] - r[0]) * turn

    def unfold(self, z: Places) -> Places:
        """Places, or directions, in coordinates in which the conductivity is isotropic."""
        ratio, angle = self.anisotropy
        if ratio == 1.0:
            return z
        turn = np.exp(1j * np.radians(angle))
        local = z / turn
        return turn * (local.real * ratio**-0.25 + 1j * local.imag * ratio**0.25)

    def slope(self) -> complex:
        """The gradient of the relative conductivity in unfolded coordinates."""
        ratio, angle = self.anisotropy
        return complex(Shape(1.0, anisotropy=(1.0 / ratio, angle)).unfold(0.5 * self.tilt))


@dataclass(frozen=True)
class OutlineShape(Shape):
    """The shape of a skin with an outline: angles are shares of its length, radius_mm is that over
    2 pi. Harmonics move the rim along its normal, by sqrt(area / pi) where they are 1; none are of
    a rim with corners."""

    outline: Outline = field(kw_only=True)

    def rim(self, phi: np.ndarray, derivative: int = 0) -> np.ndarray:
        """The physical rim over the radius. Raises ValueError for a derivative, and for harmonics
        of a rim with corners."""
        share = np.asarray(phi) / (2.0 * np.pi)
        place = self.outline.place(share)
        if derivative or (self.harmonics and len(self.outline.corners)):
            raise ValueError("derivatives of an outline, or harmonics of one with corners")
        waves = (np.conj(a) * np.exp(1j * k * phi) for k, a in self.harmonics.items())
        if self.harmonics:
            size = np.sqrt(self.outline.area_mm2 / np.pi)
            place = place + size * sum(wave.real for wave in waves) * self.outline.normal(share)
        return place / self.radius_mm


@dataclass(frozen=True)
class Edge:
    """Nodes of a closed curve: places, outward normals, weights (arc length), angles, curvature.

    span: the nodes' weights in angle, weight over speed.
    """

    place: np.ndarray
    normal: np.ndarray
    weight: np.ndarray
    angle: np.ndarray
    curvature: np.ndarray
    span: np.ndarray

    @property
    def even(self) -> bool:
        """Whether the nodes are equidistant in angle."""
        return bool(np.ptp(self.span) < 1e-12)

    @property
    def modes(self) -> int:
        """The number of waves round the curve that the nodes resolve."""
        return len(self.place) // 2 - 1 if self.even else PANEL_MODES

    @classmethod
    def from_curve(
        cls,
        shape: Shape,
        z: np.ndarray,
        dz: np.ndarray,
        ddz: np.ndarray,
        angle: np.ndarray,
        span: np.ndarray,
    ) -> "Edge":
        """The edge of a physical curve, from its two derivatives by the angle."""
        z, dz, ddz = (shape.unfold(part) for part in (z, dz, ddz))
        speed = np.abs(dz)
        curvature = (np.conj(dz) * ddz).imag / speed**3
        return cls(z, -1j * dz / speed, speed * span, angle, curvature, span)


def rim_edge(shape: Shape, count: int) -> Edge:
    """`count` even nodes of the rim."""
    phi = 2.0 * np.pi * np.arange(count) / count
    z, dz, ddz = (shape.rim(phi, derivative) for derivative in range(3))
    return Edge.from_curve(shape, z, dz, ddz, phi, np.full(count, 2.0 * np.pi / count))


def disc_edge(
    shape: Shape, centre: complex, radius: float, angle: np.ndarray, span: np.ndarray
) -> Edge:
    """Nodes at `angle` of a physical circle."""
    turn = np.exp(1j * angle)
    return Edge.from_curve(
        shape, centre + radius * turn, 1j * radius * turn, -radius * turn, angle, span
    )


def close_angles(
    centre: complex, radius: float, circles: list[tuple[complex, float]], to_rim: float
) -> tuple[np.ndarray, np.ndarray]:
    """Angles and their weights on a circle that other circles (centre, radius) cross or approach.

    Gauss panels between crossings, halved until none is longer than its distance from the other
    circles and from the rim; at a crossing down to SHORTEST.
    """
    ends = [*np.linspace(0.0, 2.0 * np.pi, 9)]
    for circle_centre, size in circles:
        centre_distance = abs(circle_centre - centre)
        if abs(radius - size) < centre_distance < radius + size:
            half = np.arccos(
                (centre_distance**2 + radius**2 - size**2) / (2.0 * centre_distance * radius)
            )
            ends += [(np.angle(circle_centre - centre) + s * half) % (2.0 * np.pi) for s in (-1, 1)]
    pending = list(pairwise(sorted(set(ends))))
    panels = []
    while pending:
        a, b = pending.pop()
        points = centre + radius * np.exp(1j * np.linspace(a, b, 5))
        circle_distance = min(
            np.abs(np.abs(points - circle_centre) - size).min() for circle_centre, size in circles
        )
        if b - a > SHORTEST and radius * (b - a) > min(circle_distance, 2.0 * to_rim):
            pending += [(a, 0.5 * (a + b)), (0.5 * (a + b), b)]
        else:
            panels.append((a, b))
    panels.sort()
    angle, span = panel_nodes(np.array([panels[0][0], *[b for _, b in panels]]), PANEL_NODES)
    return angle.ravel(), span.ravel()


def wave_log(a: np.ndarray, b: np.ndarray, modes: int) -> np.ndarray:
    """-log(4 sin^2((a - b) / 2)) / 2 up to `modes`: sum of cos k (a - b) / k."""
    k = np.arange(1, modes + 1)
    phase_a, phase_b = np.outer(a, k), np.outer(b, k)
    return (np.cos(phase_a) / k) @ np.cos(phase_b).T + (np.sin(phase_a) / k) @ np.sin(phase_b).T


def same_curve_log(
    x: np.ndarray, angle: np.ndarray, speed: np.ndarray, edge: Edge, modes: int
) -> np.ndarray:
    """-log|x - y| / 2 pi for x on the curve of `edge` at angles `at`, exact against smooth
    densities at its nodes."""
    chord = np.abs(2.0 * np.sin(0.5 * (angle[:, None] - edge.angle)))
    distance = np.abs(x[:, None] - edge.place)
    coincident = chord < 1e-7
    ratio = np.where(coincident, speed[:, None], distance / np.where(coincident, 1.0, chord))
    return (wave_log(angle, edge.angle, modes) - np.log(ratio)) / (2.0 * np.pi)


def same_curve_normal(edge: Edge) -> np.ndarray:
    """Normal derivative at the nodes of the log kernel from the nodes; on it, -curvature / 4 pi."""
    difference = edge.place[:, None] - edge.place
    np.fill_diagonal(difference, 1.0)
    value = -(edge.normal[:, None] / difference).real / (2.0 * np.pi)
    np.fill_diagonal(value, -edge.curvature / (4.0 * np.pi))
    return value


def own_flux(medium: Medium, edge: Edge) -> np.ndarray:
    """dg/dn - b g among the nodes of one curve, without weights."""
    value = same_curve_normal(edge)
    if isinstance(medium, Plane):
        return value
    speed = edge.weight / edge.span
    self_potential = same_curve_log(edge.place, edge.angle, speed, edge, edge.modes)
    self_potential = self_potential + medium.smooth(edge.place, edge.place)
    bend = medium.bend(edge.place, edge.normal)[:, None]
    return value + medium.normal_smooth(edge.place, edge.normal, edge.place) - bend * self_potential
