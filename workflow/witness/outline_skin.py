"""The complete electrode model of a flat skin of any outline, by finite elements.

-div(s h grad u) = 0 with s h du/dn = h (U - u) / z under an electrode of the rim, div(s h grad u) =
(u - U) / z on an electrode inside, no current elsewhere. Triangles are small towards corners, where
u grows as the distance to the power of pi over the angle, electrodes' ends, and where a touch's
circle meets the rim (`elements`, `triangles`). Lengths are in units of the perimeter over 2 pi, so
that the rim's angle is its length.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import brentq
from scipy.sparse import csc_matrix

from witness import elements
from witness.boundary import Disc
from witness.curves import OutlineShape, Shape
from witness.elements import Domain, Fineness, circle, seen_from
from witness.outlines import Outline, to_polygon
from witness.triangles import Curve, Sizes, triangulate, within

FINE = Fineness(6, 1e-4, 0.025, 0.25, 0.25, 0.15, 5e-4, 0.7, 0.85)
USUAL = Fineness(4, 1e-2, 0.1, 0.3, 0.5, 0.3, 2e-2, 0.7, 1.0)  # touches' changes to 2e-5
CORNER = 1e-9  # the wanted side at a corner to twice the field's power, of its side's length
LEAST_SIDE = 4e-7  # below a half of it, the triangulation's rounding shows
SAMPLES = 2048  # of the rim, where distances and crossings are looked for


@dataclass(frozen=True)
class RimElectrode:
    """A stretch of the rim: its middle as a share of the perimeter from the outline's start, its
    width along the rim, its contact impedivity z."""

    share: float
    width_mm: float
    impedivity_ohm_m2: float


@dataclass(frozen=True)
class InnerElectrode(Disc):
    """A disc inside a skin with its contact impedivity z; its current flows in over all of it."""

    impedivity_ohm_m2: float


@dataclass(frozen=True)
class Touch(Disc):
    """A disc in which the conductivity is multiplied by 1 + contrast, as far as it is on the
    skin."""

    contrast: float


class OutlineSkin:
    """A homogeneous skin with electrodes; each set of touches' places has its mesh, the latest of
    which is kept.

    electrodes: E of the rim or inside. Raises ValueError for an electrode that is not on the skin.
    """

    def __init__(
        self,
        outline: Outline,
        electrodes: Sequence[RimElectrode | InnerElectrode],
        conductivity_S_per_m: float,
        thickness_mm: float,
        fineness: Fineness = FINE,
    ):
        self.outline, self.electrodes, self.fineness = outline, list(electrodes), fineness
        self.siemens = conductivity_S_per_m * thickness_mm * 1e-3
        self.conductivity_S_per_m = conductivity_S_per_m
        unit = outline.unit_mm
        self.inner = [e for e in self.electrodes if isinstance(e, InnerElectrode)]
        at_rim = [e for e in self.electrodes if isinstance(e, RimElectrode)]
        middle = 2.0 * np.pi * np.array([e.share for e in at_rim])
        half = np.array([e.width_mm for e in at_rim]) / (2.0 * unit)
        self.spans = np.column_stack([middle - half, middle + half])
        even = 2.0 * np.pi * np.arange(SAMPLES) / SAMPLES
        self.samples = self.rim_place(np.union1d(even, _corner_angles(outline)))
        for number, disc in enumerate(self.inner):
            centre, radius = self.round(disc)
            if not within(np.array([centre]), self.samples)[0] or (
                np.abs(self.samples - centre).min() < radius
            ):
                raise ValueError(f"inner electrode {number} is not within the outline")
        self._meshed: tuple[tuple[Disc, ...], _Meshed] | None = None

    def round(self, disc: Disc) -> tuple[complex, float]:
        """Centre and radius of a disc in units of the mesh."""
        unit = self.outline.unit_mm
        return complex(disc.x_mm, disc.y_mm) / unit, disc.radius_mm / unit

    def rim_place(self, phi: np.ndarray) -> np.ndarray:
        """The rim's places in units of the mesh by its angle."""
        return self.outline.place(phi / (2.0 * np.pi)) / self.outline.unit_mm

    def _place(self, discs: Sequence[Disc]) -> "_Meshed":
        key = tuple(Disc(d.x_mm, d.y_mm, d.radius_mm) for d in discs)
        if self._meshed is None or self._meshed[0] != key:
            self._meshed = key, _Meshed(self, key)
        return self._meshed[1]

    def readings(self, channels: np.ndarray, touches: Sequence[Touch] = ()) -> np.ndarray:
        """(M,) V per A of channels (M, 4) source, sink, plus, minus under all the touches at once.

        Raises ValueError for a touch that is not on the skin.
        """
        return self._place(touches).readings(channels, [t.contrast for t in touches])

    def changes(
        self, channels: np.ndarray, touches: Sequence[Touch]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Untouched readings (M,) and the change (T, M) by each touch alone, V per A, on one mesh.

        Raises ValueError as `readings`.
        """
        meshed = self._place(touches)
        untouched = meshed.readings(channels, [0.0] * len(touches))
        alone = np.diag([t.contrast for t in touches]).tolist()
        changed = np.array([meshed.readings(channels, contrasts) for contrasts in alone])
        return untouched, changed.reshape(len(touches), len(channels)) - untouched

    def finer(self) -> "OutlineSkin":
        """The skin with sides 0.7 times as long, which also grow as much more slowly."""
        names = ("end", "rim", "max_size", "arc", "circle", "crossing", "gap", "slope")
        fineness = replace(self.fineness, **{k: 0.7 * getattr(self.fineness, k) for k in names})
        thickness_mm = 1e3 * self.siemens / self.conductivity_S_per_m
        return OutlineSkin(
            self.outline, self.electrodes, self.conductivity_S_per_m, thickness_mm, fineness
        )

    def numerical_error(
        self, channels: np.ndarray, touches: Sequence[Touch] = ()
    ) -> tuple[float, np.ndarray]:
        """The difference from `finer`: rms over channels of the untouched readings over their
        median magnitude, and of every touch's change over the change's rms (T,).

        Raises ValueError as `readings`.
        """
        return difference(*(skin.changes(channels, touches) for skin in (self, self.finer())))


def difference(
    mine: tuple[np.ndarray, np.ndarray], finer: tuple[np.ndarray, np.ndarray]
) -> tuple[float, np.ndarray]:
    """As `OutlineSkin.numerical_error`, of two results of `OutlineSkin.changes`."""
    error = np.sqrt(((mine[0] - finer[0]) ** 2).mean()) / np.median(np.abs(finer[0]))
    gaps = np.linalg.norm(mine[1] - finer[1], axis=1)
    return float(error), gaps / np.linalg.norm(finer[1], axis=1)


def _crossings(skin: OutlineSkin, centre: complex, radius: float) -> np.ndarray:
    """Ascending angles of the rim, 0 to 2 pi, where a circle meets it."""
    phi = np.sort(
        np.concatenate(
            [2.0 * np.pi * np.arange(SAMPLES + 1) / SAMPLES, _corner_angles(skin.outline)]
        )
    )

    def outside(x: float) -> float:
        return float(np.abs(skin.rim_place(np.array([x]))[0] - centre) - radius)

    beyond = np.abs(skin.rim_place(phi) - centre) > radius
    at = np.flatnonzero(beyond[1:] != beyond[:-1])
    return np.array([brentq(outside, phi[k], phi[k + 1], xtol=1e-15, rtol=1e-15) for k in at])


def _corner_angles(outline: Outline) -> np.ndarray:
    return 2.0 * np.pi * outline.ends[outline.corners]


def _to_next(angles: np.ndarray) -> np.ndarray:
    """(N,): the distance of each of N ascending angles to its nearer neighbour."""
    after = np.diff(np.append(angles, angles[:1] + 2.0 * np.pi))
    return np.maximum(np.minimum(after, np.roll(after, 1)), LEAST_SIDE)


def _rim_sizes(
    outline: Outline,
    rim_place: Callable[[np.ndarray], np.ndarray],
    spans: np.ndarray,
    fine: Fineness,
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Places and wanted sides at them for a rim at `rim_place` of its angle, for its corners and
    its electrodes, of angles spans (E, 2)."""
    phi = 2.0 * np.pi * (np.arange(SAMPLES // 4) + 0.5) / (SAMPLES // 4)
    place = rim_place(phi)
    bend = np.abs(outline.bend(phi / (2.0 * np.pi))) * outline.unit_mm
    # A side is a parabola, whose error grows with the curvature and with its change.
    change = np.abs(np.gradient(bend, phi))
    rim = fine.rim / np.maximum(np.maximum(bend, np.cbrt(change)), 0.2)
    # Where the rim folds back, its other part is nearer than half the length to it.
    distance = np.abs(place[:, None] - place)
    length = np.abs(np.angle(np.exp(1j * (phi[:, None] - phi))))
    folded = np.where(length > 2.0 * distance, distance, np.inf).min(axis=1)
    rim = np.maximum(np.minimum(rim, fine.gap * folded), 0.01)
    corner = _corner_angles(outline)
    power = np.minimum(np.pi / outline.angles[outline.corners], 2.0)
    lengths = np.diff(np.append(corner, corner[:1] + 2.0 * np.pi))
    shortest = np.minimum(lengths, np.roll(lengths, 1))
    coarse = fine.end / FINE.end
    corner_sides = np.maximum(shortest * (CORNER * coarse) ** (0.5 / power), LEAST_SIDE * coarse)
    half = 0.5 * np.diff(spans, axis=1)[:, 0]
    under = (spans.mean(axis=1)[:, None] + half[:, None] * np.linspace(-0.9, 0.9, 7)).ravel()
    return [
        (place, rim),
        (rim_place(corner), corner_sides),
        (rim_place(spans.ravel()), np.repeat(fine.end * half, 2)),
        (rim_place(under), np.repeat(fine.arc * half, 7)),
    ]


class Body(elements.Body):
    """`boundary.Body` of a sheet with an outline, its electrodes all on the rim."""

    shape: OutlineShape

    def __init__(
        self,
        shape: OutlineShape,
        deg: np.ndarray,
        width_mm: np.ndarray,
        clearance_mm: float | None = None,
        fineness: Fineness = USUAL,
    ):
        super().__init__(shape, deg, width_mm, clearance_mm, fineness)

    def _drawn_rim(self, centre: np.ndarray, half: np.ndarray) -> tuple[Curve, Sizes]:
        shape, fine, outline = self.shape, self.fineness, self.shape.outline
        spans = np.column_stack([centre - half, centre + half])
        points, sides = zip(*_rim_sizes(outline, shape.rim, spans, fine), strict=True)
        sizes = Sizes(np.concatenate(points), np.concatenate(sides), fine.max_size, fine.slope)
        fixed = np.concatenate([spans.ravel(), _corner_angles(outline)])
        return Curve(shape.rim, lambda phi: np.ones(np.shape(phi)), fixed), sizes.reduced()


class _Meshed:
    """A skin with circles as sides of its mesh, for any contrasts."""

    def __init__(self, skin: OutlineSkin, discs: tuple[Disc, ...]):
        self.skin, self.touches = skin, [skin.round(d) for d in discs]
        self.pads = [skin.round(d) for d in skin.inner]
        circles = [*self.touches, *self.pads]
        crossings = [_crossings(skin, *c) for c in circles]
        ends = [skin.spans.ravel(), 2.0 * np.pi * skin.outline.ends, *crossings]
        fixed = np.unique(np.concatenate(ends) % (2.0 * np.pi))
        rim = Curve(skin.rim_place, lambda phi: np.ones(np.shape(phi)), fixed)
        along_rim = _rim_sizes(skin.outline, skin.rim_place, skin.spans, skin.fineness)
        sized, curves = [*along_rim, (skin.rim_place(fixed), _to_next(fixed))], [rim]
        for number, met in enumerate(crossings):
            arcs, sizes = self._circle(circles, number, met)
            curves, sized = curves + arcs, [*sized, *sizes]
        fine = skin.fineness
        points, sides = (np.concatenate(parts) for parts in zip(*sized, strict=True))
        mesh = triangulate(curves, Sizes(points, sides, fine.max_size, fine.slope))
        self.domain = Domain(mesh, curves, Shape(1.0), fine.order)
        middle = mesh.place[mesh.corners].mean(axis=1)
        self.inside = np.array([np.abs(middle - c) < r for c, r in circles], bool)
        self.inside = self.inside.reshape(len(circles), len(middle))

    def _circle(
        self, circles: list[tuple[complex, float]], number: int, met: np.ndarray
    ) -> tuple[list[Curve], list[tuple[np.ndarray, np.ndarray]]]:
        """The parts of a circle on the skin, and places with wanted sides for them; met: the rim's
        angles where it meets the circle."""
        skin = self.skin
        centre, radius = circles[number]
        ends = np.sort(np.angle(skin.rim_place(met) - centre) % (2.0 * np.pi))
        fixed = [ends]
        for k, (middle, size) in enumerate(circles):
            distance = abs(middle - centre)
            if k != number and abs(radius - size) < distance < radius + size:
                turn = np.arccos((distance**2 + radius**2 - size**2) / (2.0 * distance * radius))
                fixed.append((np.angle(middle - centre) + np.array([-turn, turn])) % (2.0 * np.pi))
        crossings = np.unique(np.concatenate(fixed))
        sizes = self._circle_sizes(circles, number, crossings)
        if not len(ends):
            if within(np.array([centre + radius]), skin.samples)[0]:
                angles = crossings if len(crossings) else np.array([0.0, np.pi])
                return [circle(centre, radius, angles)], sizes
            if np.abs(skin.samples - centre).min() < radius:
                return [], []
            raise ValueError(f"circle {number} does not meet the skin")
        arcs = []
        for start, stop in zip(ends, np.append(ends[1:], ends[0] + 2.0 * np.pi), strict=True):
            middle = centre + radius * np.exp(0.5j * (start + stop))
            if within(np.array([middle]), skin.samples)[0]:
                after = start + (crossings - start) % (2.0 * np.pi)
                inner = after[(after > start) & (after < stop)]
                arcs.append(circle(centre, radius, np.array([start, *inner, stop]), True))
        return arcs, sizes

    def _circle_sizes(
        self, circles: list[tuple[complex, float]], number: int, crossings: np.ndarray
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """Places with wanted sides for a circle and its ascending angles of crossings."""
        skin, fine = self.skin, self.skin.fineness
        centre, radius = circles[number]
        side, least = fine.circle * radius, fine.crossing * radius
        if number >= len(self.touches):
            pad = skin.inner[number - len(self.touches)]
            layer_m = np.sqrt(pad.impedivity_ohm_m2 * skin.siemens)
            side = min(side, 0.5e3 * float(layer_m) / skin.outline.unit_mm)
        step = 2.0 * np.pi / 96
        towards = step * 0.5 ** np.arange(12)
        angles = (crossings[:, None] + np.append(towards, -towards)).ravel()
        places = centre + radius * np.exp(1j * np.append(step * np.arange(96), angles))
        gap = to_polygon(places, skin.samples)
        for k, (middle, size) in enumerate(circles):
            if k != number:
                gap = np.minimum(gap, np.abs(np.abs(places - middle) - size))
        return [
            (places, np.minimum(side, np.maximum(fine.gap * gap, least))),
            (
                centre + radius * np.exp(1j * crossings),
                np.minimum(radius * _to_next(crossings), least),
            ),
        ]

    @cached_property
    def _regions(self) -> list[tuple[np.ndarray, csc_matrix]]:
        """For every region of the mesh, a mask of the touches (T,) and its stiffness."""
        touched = self.inside[: len(self.touches)].T
        labels, region = np.unique(touched, axis=0, return_inverse=True)
        return [
            (label, self.domain.stiffness(np.flatnonzero(region.ravel() == k)))
            for k, label in enumerate(labels)
        ]

    @cached_property
    def _contacts(self) -> tuple[csc_matrix, np.ndarray, np.ndarray]:
        """The contacts' mass matrix, their loads (N, E) and admittances (E,), in units of the
        sheet's conductance."""
        skin, domain = self.skin, self.domain
        angles = domain.mesh.angles[0]
        middle = 0.5 * (angles[1:] + angles[:-1])
        spans, pads = iter(skin.spans), iter(self.inside[len(self.touches) :])
        mass, loads = csc_matrix((domain.size, domain.size)), []
        unit = 1e-3 * skin.outline.unit_mm
        for electrode in skin.electrodes:
            if isinstance(electrode, RimElectrode):
                start, stop = next(spans)
                sides = (middle - start) % (2.0 * np.pi) < stop - start
                part, load = domain.rim_part(np.flatnonzero(sides))
                density = unit / (electrode.impedivity_ohm_m2 * skin.conductivity_S_per_m)
            else:
                part, load = domain.area_part(np.flatnonzero(next(pads)))
                density = unit**2 / (electrode.impedivity_ohm_m2 * skin.siemens)
            mass = mass + density * part
            loads.append(density * load)
        return mass, np.array(loads).T, np.array([load.sum() for load in loads])

    def readings(self, channels: np.ndarray, contrasts: Sequence[float]) -> np.ndarray:
        """(M,) V per A of channels (M, 4) for the touches' contrasts (T,)."""
        mass, loads, admittances = self._contacts
        matrix = mass
        for label, stiffness in self._regions:
            matrix = matrix + float(np.prod(1.0 + np.asarray(contrasts)[label])) * stiffness
        admittance = np.diag(admittances) - seen_from(matrix.tocsc(), csc_matrix(loads))
        admittance *= self.skin.siemens
        # The level of all potentials is free, and leaves the readings as they are.
        impedance = np.linalg.inv(admittance + np.abs(admittance).max())
        source, sink, plus, minus = np.asarray(channels).T
        driven = impedance[:, source] - impedance[:, sink]
        numbers = np.arange(len(source))
        return driven[plus, numbers] - driven[minus, numbers]
