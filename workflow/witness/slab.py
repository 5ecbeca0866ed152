"""The skin as a body of three dimensions by finite elements: prisms of high order.

Prisms are triangles times intervals, so that their matrices are K x Mz + M x Kz, and the depth's
own eigenvectors, cosines but for the elements' error, part a body of one conductivity into sheets
lap u = k^2 u. What couples them: an electrode that covers part of the height, where the sheets'
fields stand on its face together, and a dent that is part of the depth deep. Sheets fade as
exp(-k distance): the first few (`far`) reach from dents to electrodes and are solved together,
the others round a face and round a dent alone (complete electrode model: Somersalo, Cheney,
Isaacson 1992; in three dimensions: Vauhkonen et al. 1999).
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

FADE = 6.0  # sheets reach as far as there and back they fade to exp(-FADE)
ALONE = 2.5  # depths round a face or a dent in which what does not reach is solved


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
    """Order of the elements in depth, and how many times what an edge in depth parts is halved
    towards it."""

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
        # Without an edge in depth nothing but the mean is ever met.
        count = len(values) if inner else 1
        self.eigen, self.vectors = np.maximum(values[:count], 0.0), vectors[:, :count]
        self.eigen[0] = 0.0
        self.vectors[:, 0] /= self._mean(mass)

    def _mean(self, mass: np.ndarray) -> float:
        """The first eigenvector's value, constant, where 1 is wanted."""
        basis = Basis(self.mesh, self.element, intorder=2)
        return float(np.asarray(basis.interpolate(self.vectors[:, 0])).ravel()[0])

    def _part(self, form: BilinearForm, low: float, high: float) -> np.ndarray:
        middle = self.mesh.p[0, self.mesh.t].mean(axis=0)
        mine = np.flatnonzero((middle > low) & (middle < high))
        basis = Basis(self.mesh, self.element, intorder=2 * self.element.maxdeg, elements=mine)
        return form.assemble(basis).toarray()

    def within(self, low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
        """(nz, nz): mass and stiffness of a part of the depth."""
        mass = self.vectors.T @ self._part(_mass, low, high) @ self.vectors
        return mass, self.scale * (self.vectors.T @ self._part(_rise, low, high) @ self.vectors)


class Body:
    """As `boundary.Body`, of a body. Raises ValueError for another rim than a circle or a
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
        wanted = 1 + int(np.ceil(FADE * self.depth / (2.0 * np.pi * gap)))
        self.far = min(wanted, count)
        self.face = self.layers.within(*solid.face())[0]
        self._own: dict[tuple, np.ndarray] = {}

    def _between(self) -> float:
        """Half the least distance between electrodes, in radii."""
        first, last = self.flat.first, self.flat.last
        order = np.argsort(first % (2.0 * np.pi))
        return 0.5 * ((np.roll(first[order], -1) - last[order]) % (2.0 * np.pi)).min()

    @cached_property
    def base(self) -> elements.Place:
        """The body without inclusions."""
        return elements.Place(self.flat, ())

    def own(self, electrode: int) -> np.ndarray:
        """(near, E, E): potential on an electrode's arc of unit currents there in each sheet that
        does not reach from it to others; electrodes equal in width and sides share it."""
        domain = self.base.domain
        sides = self.flat.electrode_sides(domain.mesh.angles[0])[electrode]
        width = self.flat.last[electrode] - self.flat.first[electrode]
        key = (round(float(width), 12), len(sides))
        if key not in self._own:
            middle = 0.5 * (self.flat.first[electrode] + self.flat.last[electrode])
            places = domain.mesh.place[domain.mesh.corners].mean(axis=1)
            away = np.abs(places - np.exp(1j * middle)) - np.sin(0.5 * width)
            triangles = np.flatnonzero(away < ALONE * self.depth)
            dofs = arc_dofs(domain, sides)
            self._own[key] = alone(domain, triangles, dofs, self.layers.eigen[self.far :])
        return self._own[key]

    def contact(self, length: np.ndarray) -> "Contact":
        """The contacts closed: length (n,) = z sigma, in radii."""
        return Contact(self, np.asarray(length, float))

    def place(self, discs: Sequence[Disc]) -> "Place":
        """One touch, or none. Raises ValueError for more, or where it leaves the skin."""
        return Place(self, tuple(discs))


def arc_dofs(domain: Domain, sides: np.ndarray) -> np.ndarray:
    """Degrees of freedom on adjacent sides of the rim, in the order of the rim."""
    dofs, first = domain.side_dofs(0)[sides], domain.mesh.nodes[0][sides]
    found = []
    for row, start in zip(dofs, first, strict=True):
        onward = domain.dofs.nodal_dofs[0, start] == row[0]
        inner = row[2:] if onward else row[:1:-1]
        found.append(np.concatenate([row[:1] if onward else row[1:2], inner]))
    last = dofs[-1][1] if found[-1][0] == dofs[-1][0] else dofs[-1][0]
    return np.append(np.concatenate(found), last)


def alone(domain: Domain, triangles: np.ndarray, dofs: np.ndarray, eigen: np.ndarray) -> np.ndarray:
    """(len(eigen), D, D): potential at dofs of unit currents there in sheets of `eigen`, in a part
    of the mesh that nothing leaves."""
    used = np.unique(domain.dofs.element_dofs[:, triangles])
    stiffness = domain.stiffness(triangles)[used][:, used]
    mass = domain.matrix(_mass, triangles)[used][:, used]
    ends = units(len(used), np.searchsorted(used, dofs))
    found = [seen_from((stiffness + k * mass).tocsc(), ends) for k in eigen]
    return np.array(found).reshape(len(eigen), len(dofs), len(dofs))


class Contact:
    """Currents on every electrode's arc, sheet by sheet, for what drives them there."""

    def __init__(self, body: Body, length: np.ndarray):
        self.body = body
        domain = body.base.domain
        sides = body.flat.electrode_sides(domain.mesh.angles[0])
        solved: dict = {}
        self.responses = []
        for electrode, zeta in enumerate(length.tolist()):
            own = body.own(electrode)
            key = (id(own), zeta)
            if key not in solved:
                dofs = arc_dofs(domain, sides[electrode])
                mass = domain.rim_part(sides[electrode])[0][dofs][:, dofs].toarray() / zeta
                solved[key] = self._response(mass, own)
            self.responses.append(solved[key])

    def _response(self, mass: np.ndarray, own: np.ndarray) -> np.ndarray:
        """(far E, far E): currents for potentials of the electrode above the sheets that reach,
        the others eliminated."""
        far, size = self.body.far, len(mass)
        robin = np.kron(self.body.face, mass)
        near = block_diag(np.zeros((far * size, far * size)), *own)
        whole = np.linalg.solve(np.eye(len(robin)) + robin @ near, robin)
        return whole[: far * size, : far * size]


class Place:
    """A touch at a definite place on a slab."""

    def __init__(self, body: Body, discs: tuple[Disc, ...]):
        if len(discs) > 1:
            raise ValueError("one touch on a slab")
        self.body, self.discs = body, discs
        self.flat = body.base
        if discs:
            self.flat = elements.Place(body.flat, discs, body.flat.empty.angles[0][:-1])
        # A touch through all of the depth couples no sheets: it meets those that electrodes make.
        self.met = body.far if body.solid.dent == 1.0 else len(body.layers.eigen)
        self._latest: tuple | None = None

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

    def drawn(self, eigen: float) -> np.ndarray:
        """(C, C): what the disc of conductivity 1 draws at its edge in a sheet."""
        stiffness, mass, edge, inner = self.inside
        return condensed((stiffness + eigen * mass).tocsc(), edge, inner)

    @cached_property
    def untouched(self) -> list[np.ndarray]:
        """`drawn` in every sheet that a touch meets."""
        return [self.drawn(eigen) for eigen in self.body.layers.eigen[: self.met]]

    @cached_property
    def near(self) -> np.ndarray:
        """(near, C, C): potential at the edge of unit currents there in the sheets that the touch
        meets but that do not reach the electrodes."""
        domain, disc, body = self.flat.domain, self.discs[0], self.body
        r = body.flat.shape.radius_mm
        places = domain.mesh.place[domain.mesh.corners].mean(axis=1)
        away = np.abs(places - complex(disc.x_mm, disc.y_mm) / r) - disc.radius_mm / r
        triangles = np.flatnonzero(away < ALONE * body.depth)
        return alone(domain, triangles, self.inside[2], body.layers.eigen[body.far : self.met])

    def _met(self, contact: Contact) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """As `elements.Place._met`, in all sheets: (n, n), (nz C, n), (nz C, nz C)."""
        if self._latest is None or self._latest[0] is not contact:
            body, domain = self.body, self.flat.domain
            far, n, size = body.far, body.n, domain.size
            stiffness, mass = self.matrices
            system = sparse_blocks([stiffness + k * mass for k in body.layers.eigen[:far]])
            sides = body.flat.electrode_sides(domain.mesh.angles[0])
            loads, total = np.zeros((far * size, n)), np.zeros(n)
            rows, columns, entries = [], [], []
            for i, (mine, response) in enumerate(zip(sides, contact.responses, strict=True)):
                dofs = arc_dofs(domain, mine)
                index = (dofs + size * np.arange(far)[:, None]).ravel()
                first = response[:, : len(dofs)].sum(axis=1)
                loads[index, i], total[i] = first, first[: len(dofs)].sum()
                rows.append(np.repeat(index, len(index)))
                columns.append(np.tile(index, len(index)))
                entries.append(response.ravel())
            parts = (np.concatenate(part) for part in (entries, rows, columns))
            entry, row, column = parts
            electrodes = coo_matrix((entry, (row, column)), shape=system.shape)
            edge = self.inside[2] if self.discs else np.zeros(0, int)
            edges = units(far * size, (edge + size * np.arange(far)[:, None]).ravel())
            ends = hstack([csc_matrix(loads), edges], "csc")
            seen = seen_from((system + electrodes).tocsc(), ends)
            admittance = np.diag(total) - seen[:n, :n]
            near = self.near if self.discs else np.zeros((0, 0, 0))
            felt = np.vstack([seen[n:, :n], np.zeros((near.shape[0] * len(edge), n))])
            among = block_diag(seen[n:, n:], *near)
            self._latest = contact, admittance, felt, among
        return self._latest[1:]

    def admittance(
        self, contact: Contact, contrast: Sequence[float], radial: Radial | None = None
    ) -> np.ndarray:
        """(n, n): as `boundary.Place.admittance`, in units of the conductance of the whole depth.
        Raises ValueError for a touch that is not sharp."""
        if radial is not None:
            raise ValueError("a slab needs sharp touches")
        untouched, felt, among = self._met(contact)
        if not any(contrast):
            return untouched
        layers, dent = self.body.layers, self.body.solid.dent
        if dent == 1.0:
            more = contrast[0] * block_diag(*self.untouched)
        else:
            mass, rise = layers.within(1.0 - dent, 1.0)
            mass = np.eye(len(mass)) + contrast[0] * mass
            rise = np.diag(layers.eigen) + contrast[0] * rise
            eigen, vectors = eigh(rise, mass)
            more = block_diag(*(-part for part in self.untouched))
            for share, value in zip(vectors.T @ mass, np.maximum(eigen, 0.0), strict=True):
                more += np.kron(np.outer(share, share), self.drawn(value))
        change = np.linalg.solve(np.eye(len(more)) + more @ among, more @ felt)
        return untouched + felt.T @ change
