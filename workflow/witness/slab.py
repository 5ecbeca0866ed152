"""The skin as a body of three dimensions by finite elements: prisms of high order.

Prisms are triangles times intervals, so that their matrices are K x Mz + M x Kz, and the
eigenvectors in depth, cosines up to the elements' error, decompose a body of one conductivity into
sheets lap u = k^2 u. Sheets are coupled by electrodes over part of the height and by dents over
part of the depth. They decay as exp(-k distance): the first few (`far`) reach from dents to
electrodes and are solved together, the others locally around a face or a dent (complete electrode
model: Somersalo, Cheney, Isaacson 1992; in three dimensions: Vauhkonen et al. 1999).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.linalg import block_diag, eigh
from scipy.sparse import block_diag as sparse_blocks
from scipy.sparse import coo_matrix, csc_matrix, hstack
from skfem import Basis, BilinearForm, ElementLinePp, MeshLine
from skfem.helpers import grad

from witness import elements
from witness.boundary import Disc, Radial
from witness.curves import Shape
from witness.elements import Domain, Fineness, condensed, seen_from, units

FADE = 6.0  # sheets reach until they decay on the way there and back by exp(-FADE)
LOCAL_DEPTHS = 2.5  # depths around a face or a dent, in which sheets that do not reach are solved


_mass = BilinearForm(lambda u, v, _: u * v)
_rise = BilinearForm(lambda u, v, _: grad(u)[0] * grad(v)[0])


@dataclass(frozen=True)
class Solid:
    """depth_mm of the body; height_mm of the electrodes and z_mm of their centres above the
    bottom; dent: the share of the depth, from the top, that a touch changes."""

    depth_mm: float
    height_mm: float
    z_mm: float
    dent: float = 1.0

    def face(self) -> tuple[float, float]:
        """Lower and upper end of an electrode, over the depth."""
        low = (self.z_mm - 0.5 * self.height_mm) / self.depth_mm
        high = (self.z_mm + 0.5 * self.height_mm) / self.depth_mm
        return max(low, 0.0), min(high, 1.0)


@dataclass(frozen=True)
class Grain:
    """Order of the elements in depth, and the number of halvings towards an edge in depth."""

    order: int = 4
    halvings: int = 0


class Layers:
    """The depth, 0 to 1: eigenvalues (nz,) of K M^-1 over the depth in radii, squared, and
    matrices of a part of it, in eigenvectors."""

    def __init__(self, solid: Solid, radius_mm: float, grain: Grain):
        cuts = {0.0, 1.0}
        for edge in (*solid.face(), 1.0 - solid.dent):
            if 1e-9 < edge < 1.0 - 1e-9:
                cuts.add(edge)
        edges = sorted(cuts)
        inner = set(edges) - {0.0, 1.0}
        for low, high in pairwise(edges):
            for k in range(1, grain.halvings + 1):
                step = (high - low) * 0.5 * 0.4 ** (k - 1)
                cuts |= {low + step} if low in inner else set()
                cuts |= {high - step} if high in inner else set()
        self.mesh = MeshLine(np.array(sorted(cuts)))
        self.element = ElementLinePp(grain.order)
        self.scale = (radius_mm / solid.depth_mm) ** 2
        mass, rise = self._part(_mass, 0.0, 1.0), self._part(_rise, 0.0, 1.0)
        values, vectors = eigh(rise * self.scale, mass)
        # Without an edge in depth only the mean is excited.
        count = len(values) if inner else 1
        self.eigen, self.vectors = np.maximum(values[:count], 0.0), vectors[:, :count]
        self.eigen[0] = 0.0
        self.vectors[:, 0] /= self._mean(mass)

    def _mean(self, mass: np.ndarray) -> float:
        """The constant value of the first eigenvector, which is normalised to 1."""
        basis = Basis(self.mesh, self.element, intorder=2)
        return float(np.asarray(basis.interpolate(self.vectors[:, 0])).ravel()[0])

    def _part(self, form: BilinearForm, low: float, high: float) -> np.ndarray:
        middle = self.mesh.p[0, self.mesh.t].mean(axis=0)
        mine = np.flatnonzero((middle > low) & (middle < high))
        basis = Basis(self.mesh, self.element, intorder=2 * self.element.maxdeg, elements=mine)
        return form.assemble(basis).toarray()

    def within(self, low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
        """The mass and stiffness (nz, nz) of a part of the depth."""
        mass = self.vectors.T @ self._part(_mass, low, high) @ self.vectors
        return mass, self.scale * (self.vectors.T @ self._part(_rise, low, high) @ self.vectors)


class Body:
    """`boundary.Body` in three dimensions. Raises ValueError for a rim that is not round, or a
    conductivity with direction or tilt."""

    def __init__(
        self,
        shape: Shape,
        deg: np.ndarray,
        width_mm: np.ndarray,
        solid: Solid,
        clearance_mm: float | None = None,
        fineness: Fineness | None = None,
        grain: Grain | None = None,
    ):
        if any(shape.harmonics.values()) or shape.anisotropy[0] != 1.0 or shape.tilt:
            raise ValueError("a slab needs a round rim and a conductivity without direction")
        self.solid, self.n = solid, len(deg)
        self.layers = Layers(solid, shape.radius_mm, grain or Grain())
        self.depth = solid.depth_mm / shape.radius_mm
        fine = fineness or Fineness(rim=0.06)
        count = len(self.layers.eigen)
        if count > 1:
            fine = replace(fine, arc=min(fine.arc, 0.4 * self.depth))
        self.flat = elements.Body(shape, deg, width_mm, None, fine)
        gap = self._between()
        if clearance_mm is not None:
            gap = min(gap, clearance_mm / shape.radius_mm)
        sheet_count = 1 + int(np.ceil(FADE * self.depth / (2.0 * np.pi * gap)))
        self.far = min(sheet_count, count)
        self.face = self.layers.within(*solid.face())[0]
        self._near_potential: dict[tuple, np.ndarray] = {}

    def _between(self) -> float:
        """Half the least distance between electrodes, in radii."""
        starts, stops = self.flat.starts, self.flat.stops
        order = np.argsort(starts % (2.0 * np.pi))
        return 0.5 * ((np.roll(starts[order], -1) - stops[order]) % (2.0 * np.pi)).min()

    @cached_property
    def base(self) -> elements.Place:
        """The body without inclusions."""
        return elements.Place(self.flat, ())

    def near_potential(self, electrode: int) -> np.ndarray:
        """(near, E, E): the potential on an electrode's arc of unit currents there, in each sheet
        that does not reach other electrodes; shared by electrodes of equal width and sides."""
        domain = self.base.domain
        sides = self.flat.electrode_sides(domain.mesh.angles[0])[electrode]
        width = self.flat.stops[electrode] - self.flat.starts[electrode]
        key = (round(float(width), 12), len(sides))
        if key not in self._near_potential:
            middle = 0.5 * (self.flat.starts[electrode] + self.flat.stops[electrode])
            places = domain.mesh.place[domain.mesh.corners].mean(axis=1)
            distance = np.abs(places - np.exp(1j * middle)) - np.sin(0.5 * width)
            triangles = np.flatnonzero(distance < LOCAL_DEPTHS * self.depth)
            dofs = arc_dofs(domain, sides)
            self._near_potential[key] = local_responses(
                domain, triangles, dofs, self.layers.eigen[self.far :]
            )
        return self._near_potential[key]

    def contact(self, length: np.ndarray) -> "Contact":
        """The contacts closed: length (n,) = z sigma, in radii."""
        return Contact(self, np.asarray(length, float))

    def place(self, discs: Sequence[Disc]) -> "Place":
        """One touch, or none. Raises ValueError for more, or where it leaves the skin."""
        return Place(self, tuple(discs))


def arc_dofs(domain: Domain, sides: np.ndarray) -> np.ndarray:
    """Degrees of freedom on adjacent sides of the rim, in the order of the rim."""
    dofs, start_nodes = domain.side_dofs(0)[sides], domain.mesh.nodes[0][sides]
    dof_list = []
    for row, start in zip(dofs, start_nodes, strict=True):
        is_forward = domain.dofs.nodal_dofs[0, start] == row[0]
        inner = row[2:] if is_forward else row[:1:-1]
        dof_list.append(np.concatenate([row[:1] if is_forward else row[1:2], inner]))
    end_dof = dofs[-1][1] if dof_list[-1][0] == dofs[-1][0] else dofs[-1][0]
    return np.append(np.concatenate(dof_list), end_dof)


def local_responses(
    domain: Domain, triangles: np.ndarray, dofs: np.ndarray, eigen: np.ndarray
) -> np.ndarray:
    """(len(eigen), D, D): the potential at dofs of unit currents there in sheets of `eigen`, in an
    insulated part of the mesh."""
    used = np.unique(domain.dofs.element_dofs[:, triangles])
    stiffness = domain.stiffness(triangles)[used][:, used]
    mass = domain.matrix(_mass, triangles)[used][:, used]
    ends = units(len(used), np.searchsorted(used, dofs))
    responses = [seen_from((stiffness + k * mass).tocsc(), ends) for k in eigen]
    return np.array(responses).reshape(len(eigen), len(dofs), len(dofs))


class Contact:
    """The currents on every electrode's arc, by sheet, for the driving potentials there."""

    def __init__(self, body: Body, length: np.ndarray):
        self.body = body
        domain = body.base.domain
        sides = body.flat.electrode_sides(domain.mesh.angles[0])
        solved: dict = {}
        self.responses = []
        for electrode, zeta in enumerate(length.tolist()):
            near_response = body.near_potential(electrode)
            key = (id(near_response), zeta)
            if key not in solved:
                dofs = arc_dofs(domain, sides[electrode])
                mass = domain.rim_part(sides[electrode])[0][dofs][:, dofs].toarray() / zeta
                solved[key] = self._response(mass, near_response)
            self.responses.append(solved[key])

    def _response(self, mass: np.ndarray, near_response: np.ndarray) -> np.ndarray:
        """(far E, far E): the currents for potentials of the electrode above the far sheets, the
        others eliminated."""
        far, size = self.body.far, len(mass)
        robin = np.kron(self.body.face, mass)
        near_matrix = block_diag(np.zeros((far * size, far * size)), *near_response)
        all_sheets = np.linalg.solve(np.eye(len(robin)) + robin @ near_matrix, robin)
        return all_sheets[: far * size, : far * size]


class Place:
    """A touch at a given place on a slab."""

    def __init__(self, body: Body, discs: tuple[Disc, ...]):
        if len(discs) > 1:
            raise ValueError("one touch on a slab")
        self.body, self.discs = body, discs
        self.flat = body.base
        if discs:
            self.flat = elements.Place(body.flat, discs, body.flat.empty.angles[0])
        # A touch through the full depth couples no sheets: only the far ones matter to it.
        self.sheet_count = body.far if body.solid.dent == 1.0 else len(body.layers.eigen)
        self._cached: tuple | None = None

    @cached_property
    def matrices(self) -> tuple[csc_matrix, csc_matrix]:
        """Stiffness and mass of the whole mesh."""
        domain = self.flat.domain
        triangles = np.arange(len(domain.mesh.corners))
        return domain.stiffness(triangles), domain.matrix(_mass, triangles)

    @cached_property
    def inside(self) -> tuple[csc_matrix, csc_matrix, np.ndarray, np.ndarray]:
        """Stiffness and mass of the disc, degrees of freedom of its edge and within."""
        domain = self.flat.domain
        triangles = np.flatnonzero(self.flat.inside[:, 0])
        edge = np.unique(domain.side_dofs(1))
        inner = np.setdiff1d(np.unique(domain.dofs.element_dofs[:, triangles]), edge)
        return domain.stiffness(triangles), domain.matrix(_mass, triangles), edge, inner

    def edge_matrix(self, eigen: float) -> np.ndarray:
        """(C, C): the Schur complement at its edge of the disc with conductivity 1 in a sheet."""
        stiffness, mass, edge, inner = self.inside
        return condensed((stiffness + eigen * mass).tocsc(), edge, inner)

    @cached_property
    def untouched(self) -> list[np.ndarray]:
        """`edge_matrix` in every sheet that a touch couples to."""
        return [self.edge_matrix(eigen) for eigen in self.body.layers.eigen[: self.sheet_count]]

    @cached_property
    def near_response(self) -> np.ndarray:
        """(near, C, C): the potential at the edge of unit currents there, in the sheets that the
        touch couples to but that do not reach the electrodes."""
        domain, disc, body = self.flat.domain, self.discs[0], self.body
        r = body.flat.shape.radius_mm
        places = domain.mesh.place[domain.mesh.corners].mean(axis=1)
        distance = np.abs(places - complex(disc.x_mm, disc.y_mm) / r) - disc.radius_mm / r
        triangles = np.flatnonzero(distance < LOCAL_DEPTHS * body.depth)
        return local_responses(
            domain, triangles, self.inside[2], body.layers.eigen[body.far : self.sheet_count]
        )

    def _untouched_system(self, contact: Contact) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """As `elements.Place._untouched_system`, in all sheets: (n, n), (nz C, n), (nz C, nz C)."""
        if self._cached is None or self._cached[0] is not contact:
            body, domain = self.body, self.flat.domain
            far, n, size = body.far, body.n, domain.size
            stiffness, mass = self.matrices
            system = sparse_blocks([stiffness + k * mass for k in body.layers.eigen[:far]])
            sides = body.flat.electrode_sides(domain.mesh.angles[0])
            loads, total = np.zeros((far * size, n)), np.zeros(n)
            rows, columns, entries = [], [], []
            for i, (electrode_sides, response) in enumerate(
                zip(sides, contact.responses, strict=True)
            ):
                dofs = arc_dofs(domain, electrode_sides)
                index = (dofs + size * np.arange(far)[:, None]).ravel()
                row_sums = response[:, : len(dofs)].sum(axis=1)
                loads[index, i], total[i] = row_sums, row_sums[: len(dofs)].sum()
                rows.append(np.repeat(index, len(index)))
                columns.append(np.tile(index, len(index)))
                entries.append(response.ravel())
            parts = (np.concatenate(part) for part in (entries, rows, columns))
            entry, row, column = parts
            electrodes = coo_matrix((entry, (row, column)), shape=system.shape)
            edge = self.inside[2] if self.discs else np.zeros(0, int)
            edges = units(far * size, (edge + size * np.arange(far)[:, None]).ravel())
            ends = hstack([csc_matrix(loads), edges], "csc")
            end_response = seen_from((system + electrodes).tocsc(), ends)
            admittance = np.diag(total) - end_response[:n, :n]
            near_response = self.near_response if self.discs else np.zeros((0, 0, 0))
            edge_potential = np.vstack(
                [end_response[n:, :n], np.zeros((near_response.shape[0] * len(edge), n))]
            )
            among = block_diag(end_response[n:, n:], *near_response)
            self._cached = contact, admittance, edge_potential, among
        return self._cached[1:]

    def admittance(
        self, contact: Contact, contrast: Sequence[float], radial: Radial | None = None
    ) -> np.ndarray:
        """(n, n): as `boundary.Place.admittance`, in units of the conductance of the whole depth.
        Raises ValueError for a touch that is not sharp."""
        if radial is not None:
            raise ValueError("a slab needs sharp touches")
        untouched, edge_potential, among = self._untouched_system(contact)
        if not any(contrast):
            return untouched
        layers, dent = self.body.layers, self.body.solid.dent
        if dent == 1.0:
            added = contrast[0] * block_diag(*self.untouched)
        else:
            mass, rise = layers.within(1.0 - dent, 1.0)
            mass = np.eye(len(mass)) + contrast[0] * mass
            rise = np.diag(layers.eigen) + contrast[0] * rise
            eigen, vectors = eigh(rise, mass)
            added = block_diag(*(-part for part in self.untouched))
            for share, value in zip(vectors.T @ mass, np.maximum(eigen, 0.0), strict=True):
                added += np.kron(np.outer(share, share), self.edge_matrix(value))
        change = np.linalg.solve(np.eye(len(added)) + added @ among, added @ edge_potential)
        return untouched + edge_potential.T @ change
