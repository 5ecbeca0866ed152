"""The complete electrode model by finite elements of high order on unstructured triangles.

-div(s grad u) = 0, z sigma s du/dn = U - u under an electrode, none elsewhere (Somersalo, Cheney,
Isaacson 1992), s a tensor where the conductivity has a direction. Quartics on triangles with curved
sides, small towards electrodes' ends and circles, assembled by scikit-fem. Every place has its own
mesh, with its circles as sides, factored once per contact; a contrast changes the Schur complement
of its inside at its edge, a small dense system.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.polynomial.legendre import leggauss
from scipy.sparse import bmat, coo_matrix, csc_matrix, hstack
from scipy.sparse.linalg import SuperLU, splu
from skfem import (
    Basis,
    BilinearForm,
    ElementH1,
    ElementTriP2,
    ElementTriP3,
    ElementTriP4,
    LinearForm,
    MeshTri,
    MeshTri2,
)
from skfem.helpers import grad
from skfem.refdom import RefTri

from witness.boundary import Disc, Radial
from witness.curves import Shape
from witness.triangles import SLOPE, Curve, Mesh, Sizes, triangulate


class _Lagrange(ElementH1):  # type: ignore[misc]  # skfem has no types
    """Polynomials of an order on a triangle by their values at even nodes: the corners', the
    sides', from the lower corner to the higher, and the inner ones."""

    nodal_dofs = 1
    refdom = RefTri

    def __init__(self, order: int):
        self.maxdeg, self.facet_dofs = order, order - 1
        self.interior_dofs = (order - 1) * (order - 2) // 2
        share = np.arange(1, order) / order
        zero = np.zeros(order - 1)
        i, j = np.array([(i, j) for j in range(1, order) for i in range(1, order - j)]).T / order
        x = np.concatenate([[0.0, 1.0, 0.0], share, 1.0 - share, zero, i])
        y = np.concatenate([[0.0, 0.0, 1.0], zero, share, share, j])
        self.doflocs = np.column_stack([x, y])
        self.dofnames = ["u"] * (1 + self.facet_dofs + self.interior_dofs)
        self._powers = [(a, b) for a in range(order + 1) for b in range(order + 1 - a)]
        self._factors = np.linalg.inv(np.array([x**a * y**b for a, b in self._powers]).T)

    def lbasis(self, X: np.ndarray, i: int) -> tuple[np.ndarray, np.ndarray]:
        """Values and gradient of shape function i at places X (2, ...)."""
        x, y = X
        terms = list(zip(self._factors[:, i], self._powers, strict=True))
        value = sum(f * x**a * y**b for f, (a, b) in terms)
        by_x = sum(f * a * x ** (a - 1) * y**b for f, (a, b) in terms if a)
        by_y = sum(f * b * x**a * y ** (b - 1) for f, (a, b) in terms if b)
        return value, np.array([by_x, by_y])


ELEMENTS = {
    2: ElementTriP2,
    3: ElementTriP3,
    4: ElementTriP4,
    5: lambda: _Lagrange(5),
    6: lambda: _Lagrange(6),
}


@dataclass(frozen=True)
class Fineness:
    """Order of the elements; wanted sides: at an electrode's ends (of its half width), of the rim,
    anywhere and under an electrode (of the skin's radius), on a circle (of its radius), where
    circles cross (of the smaller radius), in a gap (of the gap); how sides grow with the distance
    from fine places."""

    order: int = 4
    end: float = 0.008
    rim: float = 0.12
    max_size: float = 0.2
    arc: float = 1.0
    circle: float = 0.26
    crossing: float = 0.02
    gap: float = 0.7
    slope: float = SLOPE


def _conducted(u: Any, v: Any, w: Any) -> Any:
    (xx, xy, yy), tilt = w.tensor, w.tilt
    s = 1.0 + tilt.real * w.x[0] + tilt.imag * w.x[1]
    du, dv = grad(u), grad(v)
    return s * (xx * du[0] * dv[0] + xy * (du[0] * dv[1] + du[1] * dv[0]) + yy * du[1] * dv[1])


_stiffness = BilinearForm(_conducted)
_mass = BilinearForm(lambda u, v, w: u * v)
_load = LinearForm(lambda v, w: v)


def _trace(order: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gauss places and weights on 0 to 1, and the shape functions (Q, order + 1) of a side: of its
    two ends, then of the nodes between, in order."""
    node, weight = leggauss(order + 6)
    t = 0.5 * (1.0 + node)
    node_places = np.concatenate([[0.0, 1.0], np.arange(1, order) / order])
    values = np.vander(t, order + 1) @ np.linalg.inv(np.vander(node_places, order + 1))
    return t, 0.5 * weight, values


class Domain:
    """A meshed skin with the sides of its curves and the elements' matrices."""

    def __init__(self, mesh: Mesh, curves: list[Curve], shape: Shape, order: int):
        self.mesh, self.curves, self.shape, self.order = mesh, curves, shape, order
        points = np.vstack([mesh.place.real, mesh.place.imag])
        flat = MeshTri(points, mesh.corners.T.copy())
        curved = MeshTri2.from_mesh(flat)
        doflocs = curved.doflocs.copy()
        self.sides = []
        for curve, nodes, phi in zip(curves, mesh.nodes, mesh.angles, strict=True):
            facets = self._facets(flat, nodes)
            middle = curve.place(0.5 * (phi[1:] + phi[:-1]))
            column = curved.dofs.facet_dofs[0, facets]
            doflocs[:, column] = middle.real, middle.imag
            self.sides.append((facets, middle))
        self.fem = replace(curved, doflocs=doflocs)
        self.element = ELEMENTS[order]()
        self.dofs = Basis(self.fem, self.element, intorder=2, elements=np.array([0])).dofs
        self.size = self.dofs.N

    @staticmethod
    def _facets(flat: MeshTri, nodes: np.ndarray) -> np.ndarray:
        count = flat.p.shape[1]
        have = flat.facets[0] * count + flat.facets[1]
        order = np.argsort(have)
        pairs = np.sort(np.column_stack([nodes[:-1], nodes[1:]]), axis=1)
        return order[np.searchsorted(have[order], pairs[:, 0] * count + pairs[:, 1])]

    def matrix(self, form: BilinearForm, triangles: np.ndarray, **values: Any) -> csc_matrix:
        """The matrix of a form over some triangles."""
        basis = Basis(self.fem, self.element, intorder=2 * self.order, elements=triangles)
        return form.assemble(basis, **values).tocsc()

    def stiffness(self, triangles: np.ndarray) -> csc_matrix:
        """The stiffness of the untouched skin over some triangles."""
        ratio, angle = self.shape.anisotropy
        turn = np.exp(2j * np.radians(angle))
        mean, half = 0.5 * (ratio**0.5 + ratio**-0.5), 0.5 * (ratio**0.5 - ratio**-0.5)
        tensor = (mean + half * turn.real, half * turn.imag, mean - half * turn.real)
        return self.matrix(_stiffness, triangles, tensor=tensor, tilt=0.5 * self.shape.tilt)

    def side_dofs(self, curve: int) -> np.ndarray:
        """(K, order + 1): the degrees of freedom of every side of a curve: lower end, higher end,
        between."""
        facets = self.sides[curve][0]
        ends = self.fem.facets[:, facets]
        return np.vstack([self.dofs.nodal_dofs[0, ends], self.dofs.facet_dofs[:, facets]]).T

    def quadrature(self, curve: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Gauss places (K, Q) complex on every side of a curve, weights (K, Q) in length, shape
        functions (Q, order + 1)."""
        facets, middle = self.sides[curve]
        t, weight, values = _trace(self.order)
        starts, stops = (
            self.fem.p[0, e] + 1j * self.fem.p[1, e] for e in self.fem.facets[:, facets]
        )
        corner_places = np.column_stack([starts, stops, middle])
        shape = np.column_stack([(1 - t) * (1 - 2 * t), t * (2 * t - 1), 4 * t * (1 - t)])
        slope = np.column_stack([4 * t - 3, 4 * t - 1, 4 - 8 * t])
        return corner_places @ shape.T, np.abs(corner_places @ slope.T) * weight, values

    def rim_part(self, sides: np.ndarray) -> tuple[csc_matrix, np.ndarray]:
        """Mass matrix and integrals of the shape functions over some sides of the rim."""
        dofs = self.side_dofs(0)[sides]
        _, weight, values = self.quadrature(0)
        local = np.einsum("kq,qi,qj->kij", weight[sides], values, values)
        rows, columns = (np.broadcast_to(d, local.shape) for d in (dofs[:, :, None], dofs[:, None]))
        entries = (local.ravel(), (rows.ravel(), columns.ravel()))
        mass = coo_matrix(entries, shape=(self.size, self.size)).tocsc()
        load = np.zeros(self.size)
        np.add.at(load, dofs, weight[sides] @ values)
        return mass, load

    def area_part(self, triangles: np.ndarray) -> tuple[csc_matrix, np.ndarray]:
        """Mass matrix and integrals of the shape functions over some triangles."""
        basis = Basis(self.fem, self.element, intorder=2 * self.order, elements=triangles)
        return _mass.assemble(basis).tocsc(), _load.assemble(basis)


def factored(matrix: csc_matrix, order: str = "MMD_AT_PLUS_A") -> SuperLU:
    """The factors of a symmetric matrix, definite or bordered; order: `splu`'s of elimination."""
    options = {"SymmetricMode": True}
    return splu(matrix, permc_spec=order, diag_pivot_thresh=0.0, options=options)


def condensed(matrix: csc_matrix, edge: np.ndarray, inner: np.ndarray) -> np.ndarray:
    """(C, C): the Schur complement of a region at its edge's degrees of freedom."""
    edge_matrix = matrix[edge][:, edge].toarray()
    if not len(inner):
        return edge_matrix
    across = matrix[inner][:, edge].toarray()
    return edge_matrix - across.T @ factored(matrix[inner][:, inner].tocsc()).solve(across)


def units(size: int, dofs: np.ndarray) -> csc_matrix:
    """(size, len(dofs)): unit vectors of the degrees of freedom."""
    return csc_matrix((np.ones(len(dofs)), (dofs, np.arange(len(dofs)))), (size, len(dofs)))


def seen_from(matrix: csc_matrix, ends: csc_matrix) -> np.ndarray:
    """(E, E): ends' A^-1 ends of a symmetric definite matrix A (N, N), for independent ends (N, E).

    It is minus the Schur complement of A bordered by its ends, which is several times faster than
    solving for each and stores no fields.
    """
    size = ends.shape[0]
    order = np.argsort(factored(matrix).perm_c)
    bordered = bmat([[matrix[order][:, order], ends[order]], [ends.T[:, order], None]], "csc")
    # The symmetric mode keeps this order, borders last.
    factors = factored(bordered, "NATURAL")
    return -factors.L[size:, size:].toarray() @ factors.U[size:, size:].toarray()


class Body:
    """`boundary.Body` of a sheet: a skin whose contacts are still open."""

    def __init__(
        self,
        shape: Shape,
        deg: np.ndarray,
        width_mm: np.ndarray,
        clearance_mm: float | None = None,
        fineness: Fineness | None = None,
    ):
        self.shape, self.n, self.fineness = shape, len(deg), fineness or Fineness()
        half = np.asarray(width_mm, float) / (2.0 * shape.radius_mm)
        centre = np.radians(deg)
        self.starts, self.stops = centre - half, centre + half
        self.rim, self.sizes = self._drawn_rim(centre, half)
        mesh = triangulate([self.rim], self.sizes)
        self.start = mesh.place[len(mesh.nodes[0]) - 1 :]
        self.empty = mesh

    def _drawn_rim(self, centre: np.ndarray, half: np.ndarray) -> tuple[Curve, Sizes]:
        """The rim, with nodes at the ends of electrodes, centre +- half (n,) in radians, and the
        wanted sides along it."""
        shape, fine = self.shape, self.fineness
        ends = np.concatenate([self.starts, self.stops])
        rim_angles = 2.0 * np.pi * np.arange(256) / 256
        electrode_angles = (centre[:, None] + half[:, None] * np.linspace(-0.9, 0.9, 7)).ravel()
        points = np.concatenate(
            [shape.rim(ends), shape.rim(rim_angles), shape.rim(electrode_angles)]
        )
        # A side is a parabola: a rim of k lobes needs shorter ones.
        rim = fine.rim / max([1.0, *(0.5 * k for k, a in shape.harmonics.items() if a)])
        sides = [
            np.tile(fine.end * half, 2),
            np.full(len(rim_angles), rim),
            np.full(len(electrode_angles), fine.arc),
        ]
        curve = Curve(shape.rim, lambda phi: np.abs(shape.rim(phi, 1)), ends)
        return curve, Sizes(points, np.concatenate(sides), fine.max_size, fine.slope)

    def contact(self, length: np.ndarray) -> np.ndarray:
        """The contacts closed: length (n,) = z sigma, in radii."""
        return np.array(length, float)

    def place(self, discs: Sequence[Disc]) -> "Place":
        """Inclusions at given places, for any contrasts. Raises ValueError where one leaves the
        skin."""
        return Place(self, tuple(discs))

    def electrode_sides(self, angles: np.ndarray) -> list[np.ndarray]:
        """The rim's sides on every electrode, by the rim's angles (K + 1,)."""
        middle = 0.5 * (angles[1:] + angles[:-1])
        centre, half = 0.5 * (self.starts + self.stops), 0.5 * (self.stops - self.starts)
        angle_difference = np.angle(np.exp(1j * (middle[:, None] - centre)))
        return [np.flatnonzero(np.abs(angle_difference[:, i]) < half[i]) for i in range(self.n)]


def circles(body: Body, discs: tuple[Disc, ...]) -> tuple[list[Curve], Sizes]:
    """The discs' edges, and the sizes for them, their gaps and crossings beside the body's.

    Raises ValueError where one leaves the skin.
    """
    fine, r = body.fineness, body.shape.radius_mm
    rim = body.shape.rim(2.0 * np.pi * np.arange(2048) / 2048)
    round_discs = [(complex(d.x_mm, d.y_mm) / r, d.radius_mm / r) for d in discs]
    even = np.exp(2j * np.pi * np.arange(48) / 48)
    curves, point_list, side_list = [], [], []
    for k, (centre, radius) in enumerate(round_discs):
        to_rim = np.abs(centre - rim).min() - radius
        if to_rim <= 0:
            raise ValueError(f"inclusion {k} leaves the skin by {-to_rim * r:g} mm")
        fixed = []
        places = centre + radius * even
        gap = np.abs(places[:, None] - rim).min(axis=1)
        for j, (centre_other, size) in enumerate(round_discs):
            centre_distance = abs(centre_other - centre)
            if j == k:
                continue
            if abs(radius - size) < centre_distance < radius + size:
                turn = np.arccos(
                    (centre_distance**2 + radius**2 - size**2) / (2.0 * centre_distance * radius)
                )
                met = np.angle(centre_other - centre) + np.array([-turn, turn])
                fixed += met.tolist()
                point_list.append(centre + radius * np.exp(1j * met))
                side_list.append(np.full(2, fine.crossing * min(radius, size)))
                # The sizes at the crossing, growing from it, resolve the gap.
            else:
                gap = np.minimum(gap, np.abs(np.abs(places - centre_other) - size))
        point_list.append(places)
        side_list.append(np.minimum(fine.circle * radius, fine.gap * gap))
        curves.append(circle(centre, radius, np.array(fixed or [0.0, np.pi])))
    every_at = np.concatenate([body.sizes.points, *point_list])
    return curves, Sizes(
        every_at, np.concatenate([body.sizes.sides, *side_list]), fine.max_size, fine.slope
    )


def circle(centre: complex, radius: float, fixed: np.ndarray, is_arc: bool = False) -> Curve:
    """A circle, or its arc from the least to the largest fixed angle."""
    return Curve(
        lambda phi: centre + radius * np.exp(1j * phi),
        lambda phi: np.full(np.shape(phi), radius),
        fixed,
        is_arc,
    )


class Place:
    """Inclusions at given places on a body; rim: the angles of the rim's nodes, None as needed."""

    def __init__(self, body: Body, discs: tuple[Disc, ...], rim: np.ndarray | None = None):
        self.body, self.discs = body, discs
        mesh = body.empty
        curves: list[Curve] = []
        if discs:
            curves, sizes = circles(body, discs)
            mesh = triangulate([body.rim, *curves], sizes, body.start, rim)
        self.domain = Domain(mesh, [body.rim, *curves], body.shape, body.fineness.order)
        self._cached: tuple | None = None

    @cached_property
    def inside(self) -> np.ndarray:
        """(T, discs): whether a triangle is inside a disc."""
        centre = self.domain.mesh.place[self.domain.mesh.corners].mean(axis=1)
        r = self.body.shape.radius_mm
        is_inside = [
            np.abs(centre - complex(d.x_mm, d.y_mm) / r) < d.radius_mm / r for d in self.discs
        ]
        return np.array(is_inside, bool).reshape(len(self.discs), len(centre)).T

    @cached_property
    def parts(self) -> tuple[csc_matrix, np.ndarray, list[tuple[np.ndarray, np.ndarray]]]:
        """The stiffness of the untouched skin; the curves' degrees of freedom (C,); for every
        region within discs, a mask of these (discs,) and its Schur complement (C, C)."""
        domain = self.domain
        labels, region = np.unique(self.inside, axis=0, return_inverse=True)
        region = region.ravel()
        drawn, stiffness = [], csc_matrix((domain.size, domain.size))
        curve_dofs = [domain.side_dofs(1 + k).ravel() for k in range(len(self.discs))]
        edge = np.unique(np.concatenate([*curve_dofs, np.zeros(0, int)]))
        for index, label in enumerate(labels):
            triangles = np.flatnonzero(region == index)
            matrix = domain.stiffness(triangles)
            stiffness = stiffness + matrix
            if label.any():
                mine = np.unique(domain.dofs.element_dofs[:, triangles])
                drawn.append((label, condensed(matrix, edge, np.setdiff1d(mine, edge))))
        return stiffness, edge, drawn

    @cached_property
    def electrodes(self) -> list[tuple[csc_matrix, np.ndarray]]:
        """Mass matrix and load of every electrode."""
        sides = self.body.electrode_sides(self.domain.mesh.angles[0])
        return [self.domain.rim_part(mine) for mine in sides]

    def _untouched_system(self, contact: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The untouched admittance (n, n), the potential at the curves for the electrodes' (C, n)
        and for currents into the curves (C, C); cached for the latest contact."""
        if self._cached is None or not np.array_equal(self._cached[0], contact):
            stiffness, edge, _ = self.parts
            loads = np.array([load for _, load in self.electrodes]).T / contact
            masses = (mass / z for (mass, _), z in zip(self.electrodes, contact, strict=True))
            ends = hstack([csc_matrix(loads), units(self.domain.size, edge)], "csc")
            end_response, n = seen_from(sum(masses, stiffness).tocsc(), ends), self.body.n
            admittance = np.diag(loads.sum(axis=0)) - end_response[:n, :n]
            self._cached = contact, admittance, end_response[n:, :n], end_response[n:, n:]
        return self._cached[1:]

    def admittance(
        self, contact: np.ndarray, contrast: Sequence[float], radial: Radial | None = None
    ) -> np.ndarray:
        """(n, n): as `boundary.Place.admittance`. Raises ValueError for a disc that is not sharp,
        where the conductivity has a direction or another disc crosses it."""
        untouched, edge_potential, among = self._untouched_system(contact)
        _, edge, drawn = self.parts
        added = np.zeros((len(edge), len(edge)))
        for label, region_matrix in drawn:
            relative = np.prod(1.0 + np.asarray(contrast)[label])
            if radial is not None and label[0]:
                added -= region_matrix
            else:
                added += (relative - 1.0) * region_matrix
        if radial is not None:
            added += self._radial_matrix(radial, contrast)
        if not added.any():
            return untouched
        change = np.linalg.solve(np.eye(len(edge)) + added @ among, added @ edge_potential)
        return untouched + edge_potential.T @ change

    def _radial_matrix(self, radial: Radial, contrast: Sequence[float]) -> np.ndarray:
        """(C, C): the admittance of the first disc at its edge, from its waves."""
        shape, disc, r = self.body.shape, self.discs[0], self.body.shape.radius_mm
        if shape.anisotropy[0] != 1.0 or shape.tilt:
            raise ValueError("round inclusions need a conductivity without direction or tilt")
        labels = [label for label, _ in self.parts[2] if label[0]]
        if len(labels) > 1:
            raise ValueError("a round inclusion that another one meets")
        around = np.prod(1.0 + np.asarray(contrast)[1:][labels[0][1:]])
        place, weight, values = self.domain.quadrature(1)
        angle = np.angle(place - complex(disc.x_mm, disc.y_mm) / r)
        edge, dofs = self.parts[1], self.domain.side_dofs(1)
        count = min(len(radial.waves), dofs.shape[0] * self.domain.order // 2)
        k = np.arange(count)
        wave = np.exp(1j * k[:, None, None] * angle) * weight
        wave_loads = np.zeros((count, len(edge)), complex)
        load_index = (slice(None), np.searchsorted(edge, dofs))
        np.add.at(wave_loads, load_index, wave @ values)  # type: ignore[arg-type]  # numpy's know no slice here
        radius = disc.radius_mm / r
        share = radial.waves[:count] * r * np.where(k == 0, 0.5, 1.0) / (np.pi * radius)
        return around * ((wave_loads.conj().T * share) @ wave_loads).real
