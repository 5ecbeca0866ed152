"""Finite elements on triangles, with a sheet conductance for each element.

For cases without a formula (images, any mesh, any outline) and as an independent check of the exact
forward model. Assembly by scikit-fem, factorisation by SciPy.
"""

from functools import cached_property

import numpy as np
from scipy.linalg import eigh
from scipy.sparse import bmat, csc_matrix, diags
from scipy.sparse.linalg import SuperLU, splu
from skfem import (
    Basis,
    BilinearForm,
    ElementTriP1,
    ElementTriP2,
    FacetBasis,
    LinearForm,
    MappingIsoparametric,
    MeshTri,
    MeshTri2,
)
from skfem.helpers import dot, grad

from eitskin.errors import InputError
from eitskin.physics.forward import TouchModes, channel_values

ELEMENT_TYPES = {1: ElementTriP1, 2: ElementTriP2}
LARGEST_RESIDUAL = 1e-9  # of a unit current: far above rounding on sound meshes

_laplace = BilinearForm(lambda u, v, _: dot(grad(u), grad(v)))
_mass = BilinearForm(lambda u, v, _: u * v)
_flux = LinearForm(lambda v, _: 1.0 * v)


class _RimMapping(MappingIsoparametric):  # type: ignore[misc]  # skfem has no types
    """Isoparametric mapping whose inverse tolerates the rounding of small graded elements.

    scikit-fem demands 1e-12 of the element, which coordinates near 1 cannot reach for elements
    below 1e-3; Newton's last step is quadratic, so that only rounding remains.
    """

    def invF(self, x: np.ndarray, tind: np.ndarray | None = None) -> np.ndarray:
        return super().invF(x, tind, newton_tol=1e-7)


class FiniteElements:
    """Transfer impedances of a triangulated sheet.

    mesh: skfem MeshTri (straight) or MeshTri2 (quadratic, curved rim); any unit of length, here m.
    electrodes: node numbers (n,) for points; a list of n arrays of facet numbers for complete
    electrodes. contact: None for points, else z/h in ohm m, one number or (n,). order: 1 or 2.
    Raises InputError where these do not fit together.

    Complete electrodes (Somersalo, Cheney and Isaacson 1992): current density (U_l - u) h/z on
    electrode l, none elsewhere.
    """

    def __init__(
        self,
        mesh: MeshTri | MeshTri2,
        electrodes: np.ndarray | list[np.ndarray],
        contact: float | np.ndarray | None = None,
        order: int = 1,
    ):
        if order not in ELEMENT_TYPES:
            raise InputError("finite elements", "order", order, f"one of {list(ELEMENT_TYPES)}")
        self.mesh = mesh
        self.n_electrodes = len(electrodes)
        self.basis = Basis(mesh, ELEMENT_TYPES[order](), intorder=2 * order)
        self._local = _laplace.coo_data(self.basis)
        if contact is None:
            self._point_electrodes(np.asarray(electrodes))
        else:
            self._complete_electrodes(electrodes, contact)

    def _point_electrodes(self, nodes: np.ndarray) -> None:
        if nodes.ndim != 1 or len(np.unique(nodes)) < len(nodes) or len(nodes) < 2:
            raise InputError("finite elements", "electrodes", nodes.shape, "two nodes or more")
        self._size = self.basis.N
        self._terminals = self.basis.nodal_dofs[0, nodes]
        self._contact_matrix = csc_matrix((self._size, self._size))

    def _complete_electrodes(
        self, electrodes: np.ndarray | list[np.ndarray], contact: float | np.ndarray
    ) -> None:
        n = self.n_electrodes
        impedance = np.asarray(contact, dtype=float)
        if impedance.ndim > 1 or impedance.size not in (1, n) or not np.all(impedance > 0):
            raise InputError("finite elements", "contact", contact, f"above 0, one or {n}")
        impedance = np.broadcast_to(impedance, n)
        boundary = set(self.mesh.boundary_facets().tolist())
        robin = csc_matrix((self.basis.N, self.basis.N))
        mapping = None
        if isinstance(self.mesh, MeshTri2):
            mapping = _RimMapping(self.mesh, self.mesh.elem(), self.mesh.bndelem)
        couplings, lengths = [], []
        for number, (facets, z) in enumerate(zip(electrodes, impedance, strict=True)):
            if len(facets) == 0 or not boundary.issuperset(np.asarray(facets).tolist()):
                raise InputError(
                    "finite elements", f"electrodes[{number}]", facets, "facets on the boundary"
                )
            rim = FacetBasis(
                self.mesh,
                self.basis.elem,
                mapping=mapping,
                facets=facets,
                intorder=2 * self.basis.elem.maxdeg + 2,
            )
            flux = _flux.assemble(rim) / z
            robin = robin + _mass.assemble(rim) / z
            couplings.append(-flux)
            lengths.append(flux.sum())
        coupling = csc_matrix(np.array(couplings).T)
        self._size = self.basis.N + n
        self._terminals = self.basis.N + np.arange(n)
        self._contact_matrix = bmat([[robin, coupling], [coupling.T, diags(lengths)]], "csc")

    def stiffness(self, conductance: np.ndarray) -> csc_matrix:
        """System matrix in S for `conductance` (elements,) in S, contacts included, ungrounded."""
        conductance = np.asarray(conductance, dtype=float)
        expected = (self.mesh.nelements,)
        if conductance.shape != expected or not np.all(np.isfinite(conductance)):
            raise InputError(
                "finite elements", "conductance", conductance.shape, f"finite numbers {expected}"
            )
        if conductance.min() <= 0:
            raise InputError("finite elements", "conductance", conductance.min(), "more than 0")
        repeats = len(self._local.data) // self.mesh.nelements
        data = self._local.data * np.tile(conductance, repeats)
        body = csc_matrix((data, self._local.indices), shape=(self._size, self._size))
        return body + self._contact_matrix

    def factored(self, conductance: np.ndarray) -> "FactoredElements":
        """The factored system; `conductance` as in `stiffness`."""
        return FactoredElements(self, np.asarray(conductance, dtype=float))

    def transfer_impedance(self, conductance: np.ndarray) -> np.ndarray:
        """Transfer impedance (n, n) in ohm; rows and columns sum to 0 (sum of U is 0).

        [i, j]: potential of electrode i for a unit current into j, drawn evenly from all.
        """
        return self.factored(conductance).transfer_impedance

    def voltages(self, conductance: np.ndarray, channels: np.ndarray, current: float) -> np.ndarray:
        """Voltages (M,) in V of channels (M, 4) source, sink, plus, minus at `current` in A."""
        return current * channel_values(self.transfer_impedance(conductance), np.asarray(channels))


class FactoredElements:
    """A sheet of known conductance (elements,) in S, factored: solves, impedance and touches.

    Solving raises InputError where elements are so thin that rounding spoils the fields.
    """

    def __init__(self, elements: FiniteElements, conductance: np.ndarray):
        self.elements = elements
        self.conductance = conductance
        self._ground = elements._terminals[-1]
        self._free_nodes = np.delete(np.arange(elements._size), self._ground)
        self._matrix = elements.stiffness(conductance)[self._free_nodes][
            :, self._free_nodes
        ].tocsc()
        self._factors: SuperLU = splu(
            self._matrix,
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )

    def solve(self, currents: np.ndarray) -> np.ndarray:
        """Potentials (unknowns, P) in V for `currents` (unknowns, P) in A, last electrode at 0."""
        potentials = np.zeros_like(currents)
        potentials[self._free_nodes] = self._factors.solve(currents[self._free_nodes])
        return potentials

    @cached_property
    def fields(self) -> np.ndarray:
        """Potentials (unknowns, n) in ohm: unit current into each electrode, out of the last."""
        terminals = self.elements._terminals
        currents = np.zeros((self.elements._size, len(terminals)))
        currents[terminals, np.arange(len(terminals))] = 1.0
        fields = self.solve(currents)
        residual = np.max(abs(self._matrix @ fields[self._free_nodes] - currents[self._free_nodes]))
        if not residual < LARGEST_RESIDUAL:
            raise InputError(
                "finite elements", "mesh", f"{residual:.1e} of a current lost", "no slivers"
            )
        return fields

    @cached_property
    def transfer_impedance(self) -> np.ndarray:
        """Transfer impedance (n, n) in ohm, as `FiniteElements.transfer_impedance`."""
        grounded = self.fields[self.elements._terminals]
        centred = grounded - grounded.mean(axis=0)
        return centred - centred.mean(axis=1, keepdims=True)

    def touch_modes(self, touched: np.ndarray) -> TouchModes:
        """Modes of a touch on the elements `touched` (numbers), all multiplied by 1 + c.

        The stiffness changes by c L L^T on the touched elements' nodes alone, so by Woodbury's
        identity R(c) = R(0) - c F^T L (1 + c L^T A^-1 L)^-1 L^T F, with the electrodes' fields F;
        the eigenvectors of L^T A^-1 L separate it.
        """
        touched = np.asarray(touched)
        if touched.size == 0:
            return TouchModes(np.zeros((self.elements.n_electrodes, 0)), np.zeros(0))
        dofs = self.elements.basis.element_dofs[:, touched]
        nodes, position = np.unique(dofs, return_inverse=True)
        position = position.reshape(dofs.shape)
        local = self.elements._local.tolocal()[touched] * self.conductance[touched, None, None]
        change = np.zeros((len(nodes), len(nodes)))
        np.add.at(change, (position.T[:, :, None], position.T[:, None, :]), local)
        values, vectors = eigh(change)
        has_stiffness = values > values[-1] * len(nodes) * np.finfo(float).eps
        root = vectors[:, has_stiffness] * np.sqrt(values[has_stiffness])

        currents = np.zeros((self.elements._size, root.shape[1]))
        currents[nodes] = root
        potentials = self.solve(currents)[nodes]
        eigenvalues, rotation = eigh(root.T @ potentials)
        fields = self.fields[nodes] - self.fields[nodes].mean(axis=1, keepdims=True)
        gains = fields.T @ root @ rotation
        has_gain = (gains**2).sum(axis=0) > np.finfo(float).eps * (gains**2).sum()
        return TouchModes(gains[:, has_gain], eigenvalues[has_gain])


def straight_mesh(nodes: np.ndarray, elements: np.ndarray) -> MeshTri:
    """Mesh of straight triangles: nodes (P, 2) in m, elements (E, 3) node numbers, order kept."""
    return MeshTri(
        np.ascontiguousarray(np.asarray(nodes, dtype=float)[:, :2].T),
        np.ascontiguousarray(np.asarray(elements, dtype=np.int64).T),
    )
