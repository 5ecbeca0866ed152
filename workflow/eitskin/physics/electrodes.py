"""Electrodes on the rim as the complete electrode model has them, or as points.

The unknown is the current density on each electrode alone, in Legendre modes of the position
across it: P_k(t) / 2 per dt, t = -1 ... 1, so that the mode k = 0 carries the electrode's whole
current. The Galerkin equations of the complete electrode model, U_l - u = (z_l / h) dI/ds
(Somersalo, Cheney, Isaacson 1992), with the unit disc's Neumann function for u. An electrode that
goes round a corner of the rim is one terminal of several pieces (`electrode_pieces`), with modes
of their own.
"""

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from eitskin.physics import neumann
from eitskin.physics.arrays import as_in, library
from eitskin.physics.conformal import DiscMap, MapVelocity
from eitskin.physics.corner_law import CornerLaw
from eitskin.physics.electrode_pieces import combined, grading, pieces
from eitskin.physics.geometry import Geometry, RimMotion
from eitskin.physics.gradient import GradientBulk


class OnRim:
    """What electrodes with nodes on the rim alone have in common."""

    rim: np.ndarray

    def project(self, potential: np.ndarray) -> np.ndarray:
        """Projection on the modes of potentials at the nodes."""
        raise NotImplementedError

    @property
    def nodes(self) -> np.ndarray:
        """(nodes,): the nodes in the unit disc, which are all on its rim."""
        return self.rim

    def flux_kernel(self, y: np.ndarray, dy: np.ndarray) -> np.ndarray:
        """(nodes, N): `neumann.flux_kernel` from a curve's nodes y (N,) to the electrodes'."""
        return neumann.rim_flux_kernel(self.rim, y, dy)

    def coupling(self, touch: Any) -> np.ndarray:
        """(..., size, 2 degree): projection on the modes of the potential that a touch's
        polarisation makes; of a TouchEdge or EvenTouches."""
        return self.project(touch.rim_response(self.rim))

    def covers(self, places: Sequence[Any]) -> np.ndarray:
        """(P,) bool: whether touches at places have electrodes inside the skin within: none."""
        return np.zeros(len(places), bool)

    def clearance(self, circles: Any) -> np.ndarray:
        """(P,): distances of circles from electrodes inside the skin, of which there are none."""
        return np.full(len(circles.radius), np.inf)


class Electrodes(OnRim):
    """Nodes, modes and Galerkin matrix of a skin's n electrodes, which are m pieces: n off the
    rim's corners. `order` modes each (1 for points), fewer of a piece at a corner.

    Matrices are per unit sheet resistance 1 / (sigma h), mode-major within an electrode; `whole`
    (n,): the modes of the electrodes' whole currents, size: of all modes. The singular ln|t - t'|
    of a piece with itself is integrated in closed form; the rest is smooth.
    """

    def __init__(
        self, geometry: Geometry, disc: DiscMap, order: int, bulk: GradientBulk | None = None
    ):
        self.geometry, self.disc, self.bulk = geometry, disc, bulk
        self.n = len(geometry.electrode_deg)
        self.order = 1 if geometry.points else order
        count = 1 if geometry.points else 2 * self.order
        self.t, self.weight = np.polynomial.legendre.leggauss(count)
        self.half_width = geometry.electrode_width_mm / (2.0 * geometry.radius_mm)
        self.pieces = pieces(geometry)
        self._grade()
        self.phi = self.pieces.middle[:, None] + self.pieces.half[:, None] * self.position
        self._angles()
        legendre = np.polynomial.legendre.legvander(self.t, self.order - 1)
        self.modes = 0.5 * legendre.T * self.weight
        self.rim = np.exp(1j * self.theta).ravel()
        self.factor = np.ones_like(self.theta)
        if bulk:
            self.factor = bulk.factor(geometry.rim(self.phi))
            self.spread = self.project(bulk.terms(self.rim))

    def _grade(self) -> None:
        """Set nodes and modes of the pieces by whether they end at corners."""
        kinds, kind = np.unique(self.pieces.graded, axis=0, return_inverse=True)
        gradings = [grading(self.t, self.weight, self.order, *ends) for ends in kinds]
        of_piece = [gradings[k] for k in kind.ravel()]
        self.position, self._crowding, self._from_end = (
            np.array([getattr(piece, name) for piece in of_piece])
            for name in ("position", "slope", "from_end")
        )
        self.size = self.n * self.order
        self.whole = np.arange(self.n) * self.order
        self._combination: np.ndarray | None = None
        if self.pieces.graded.any():
            parts = [piece.coefficients for piece in of_piece]
            self._combination = combined(parts, self.pieces.electrode, self.pieces.half)
            self.size = self._combination.shape[1]
            sizes = np.bincount(self.pieces.electrode, [part.shape[1] for part in parts])
            self.whole = np.append(0, np.cumsum(sizes)[:-1]).astype(int)

    def _combined(self, matrix: np.ndarray) -> np.ndarray:
        """(size, size) of the electrodes' modes, of (m order, m order) of the pieces'."""
        if self._combination is None:
            return matrix
        return self._combination.T @ matrix @ self._combination

    def of_pieces(self, amplitude: np.ndarray) -> np.ndarray:
        """(m, order, k): amplitudes of the pieces' modes, of the electrodes' (size, k)."""
        if self._combination is not None:
            amplitude = self._combination @ amplitude
        return amplitude.reshape(len(self.phi), self.order, -1)

    @cached_property
    def interaction(self) -> np.ndarray:
        """(size, size): `matrix` without the contacts' drop."""
        if self.geometry.points:
            matrix = _between_points(self.theta.ravel(), self.factor.ravel())
        else:
            matrix = interaction(
                self.t, self.modes, self._anchor, self.stretch, self.factor, self._offset
            )
        matrix = self._combined(matrix)
        return matrix + self.spread @ self.bulk.matrix @ self.spread.T if self.bulk else matrix

    @cached_property
    def matrix(self) -> np.ndarray:
        """(size, size): power of the modes' currents."""
        return self.interaction + self._contact_matrix()

    @property
    def phi_slope(self) -> np.ndarray:
        """(m, q): d phi / dt, t from -1 to 1 across a piece."""
        return self._crowding * self.pieces.half[:, None]

    @property
    def stretch(self) -> np.ndarray:
        """(m, q): d theta / dt."""
        return self.theta_slope * self.phi_slope

    @property
    def arc_m(self) -> np.ndarray:
        """(m, q): ds / dt, m."""
        return self.arc_slope * self.phi_slope

    def with_contacts(self, geometry: Geometry) -> "Electrodes":
        """The same electrodes on a geometry of the same outline, with other contacts or
        material."""
        electrodes = copy.copy(self)
        electrodes.geometry = geometry
        electrodes.__dict__.pop("matrix", None)
        return electrodes

    def _angles(self) -> None:
        """Angles on the unit circle and their derivatives by phi; physical arc length by phi, m."""
        g = self.geometry
        z, z_slope, z_bend = (g.unfold(g.rim(self.phi, k)) for k in range(3))
        self.f = self.disc.derivatives(z, 2)
        self.z_slope, self.z_bend = z_slope, z_bend
        self.theta = np.angle(self.f[0])
        spin = self.f[1] * z_slope / self.f[0]
        self.theta_slope = spin.imag
        bend = (self.f[2] * z_slope**2 + self.f[1] * z_bend) / self.f[0] - spin**2
        self.theta_bend = bend.imag
        self.arc_slope = 1e-3 * np.abs(g.rim(self.phi, 1))
        self._anchor = self.theta
        self._offset: np.ndarray | None = None
        self._by_law: list[_NodesByLaw] = []
        if self.pieces.graded.any():
            self._angles_at_corners()

    def _angles_at_corners(self) -> None:
        """Set angles of pieces at corners as those of the corners and offsets, whose differences
        stay exact where they are small, and take them from the law very near."""
        g, split = self.geometry, self.pieces
        assert g.outline is not None
        laws = {
            corner: CornerLaw(g, self.disc, g.outline.corner_phi[corner])
            for corner in np.unique(split.corner[split.graded]).tolist()
        }
        anchor, offset = self.theta.copy(), np.zeros_like(self.theta)
        distance = split.gap[:, :, None] + split.half[:, None, None] * self._from_end
        distance[~split.graded] = np.inf
        for piece, side in np.argwhere(split.graded).tolist():
            law = laws[split.corner[piece, side]]
            away = distance[piece, side]
            nearer = away <= distance[piece, 1 - side]
            wide = self.theta[piece, nearer] - law.theta
            anchor[piece, nearer] = law.theta
            offset[piece, nearer] = (wide + np.pi) % (2.0 * np.pi) - np.pi
            close = nearer & (law.lengths(away, side) < law.reach_mm)
            values = offset, self.theta_slope, self.theta_bend
            for array, close_values in zip(values, law.angles(away[close], side), strict=True):
                array[piece, close] = close_values
            self._by_law.append(_NodesByLaw(law, piece, side, close, away[close]))
        self._anchor, self._offset, self.theta = anchor, offset, anchor + offset

    def _contact_matrix(self) -> np.ndarray:
        """Contact drop of the modes (0 for points)."""
        m, p = len(self.phi), self.order
        blocks = np.zeros((m, p, m, p))
        if not self.geometry.points:
            blocks[range(m), :, range(m), :] = self.contact_blocks()
        return self._combined(blocks.reshape(m * p, m * p))

    def contact_blocks(self) -> np.ndarray:
        """(m, order, order): sigma z_l int P_k P_k' / 4 / (ds/dt) dt, ds in m."""
        return contact_drop(self.modes, self.weight, self._contact_length_m, self.arc_m)

    @property
    def _contact_length_m(self) -> np.ndarray:
        """(m,): z sigma of every piece."""
        return 1e-3 * self.geometry.contact_length_mm[self.pieces.electrode]

    def density(self, amplitude: np.ndarray) -> np.ndarray:
        """(m q, drives): weighted current at the nodes of mode amplitudes (size, drives)."""
        per = self.of_pieces(amplitude)
        return np.einsum("iq,aid->aqd", self.modes, per).reshape(self.phi.size, -1)

    def project(self, potential: np.ndarray) -> np.ndarray:
        """(..., size, k): projection on the modes of potentials at the nodes (..., m q, k); where
        the conductivity rises across the skin, of potentials as at its centre."""
        projected = tested(self.modes, potential * self.factor.reshape(-1, 1), len(self.phi))
        return projected if self._combination is None else self._combination.T @ projected

    def angle_motion(self, electrode: int) -> "ElectrodeMotion":
        """Velocity with electrode_deg of one electrode; a piece's end at a corner stays."""
        return self._along(electrode, np.radians(1.0), np.radians(1.0))

    def width_motion(self, electrode: int) -> "ElectrodeMotion":
        """Velocity with electrode_width_mm of one electrode."""
        growth = 0.5 / self.geometry.radius_mm
        return self._along(electrode, -growth, growth)

    def _along(self, electrode: int, start_dot: float, stop_dot: float) -> "ElectrodeMotion":
        """Motion of one electrode along the rim, with the velocities of phi at its ends."""
        g, selection = self.geometry, self.pieces.of(electrode)
        phi, half = self.phi[selection], self.phi_slope[selection]
        ends_dot = np.where(self.pieces.free[selection], [start_dot, stop_dot], 0.0)
        middle_dot = 0.5 * (ends_dot[:, :1] + ends_dot[:, 1:])
        half_width_dot = 0.5 * (ends_dot[:, 1:] - ends_dot[:, :1])
        phi_dot = middle_dot + half_width_dot * self.position[selection]
        half_width_dot = half_width_dot * self._crowding[selection]
        rim_slope, rim_bend = g.rim(phi, 1), g.rim(phi, 2)
        arc_bend = 1e-6 * (np.conj(rim_slope) * rim_bend).real / self.arc_slope[selection]
        slope = self.theta_slope[selection]
        return ElectrodeMotion(
            selection,
            theta=slope * phi_dot,
            slope=self.theta_bend[selection] * phi_dot * half + slope * half_width_dot,
            arc=arc_bend * phi_dot * half + self.arc_slope[selection] * half_width_dot,
        )

    def skin_motion(self, motion: RimMotion, map_velocity: MapVelocity) -> "ElectrodeMotion":
        """Velocity when the rim or the unfolding moves under electrodes at fixed angles phi."""
        g, half = self.geometry, self.phi_slope
        z_dot = g.unfold(motion.rim(self.phi)) + motion.unfolding(g.rim(self.phi))
        z_slope_dot = g.unfold(motion.rim(self.phi, 1)) + motion.unfolding(g.rim(self.phi, 1))
        z = g.unfold(g.rim(self.phi))
        v = map_velocity.derivatives(z, 1)
        f, z_slope = self.f, self.z_slope
        log_f_dot = (f[1] * z_dot + v[0]) / f[0]
        slope = (f[2] * z_slope * z_dot + f[1] * z_slope_dot + v[1] * z_slope) / f[0]
        slope = slope - log_f_dot * f[1] * z_slope / f[0]
        physical, physical_dot = g.rim(self.phi, 1), motion.rim(self.phi, 1)
        arc = 1e-6 * (np.conj(physical) * physical_dot).real / self.arc_slope
        theta_dot, slope_dot = log_f_dot.imag, slope.imag
        for nodes in self._by_law:
            law_motion = nodes.law.motion(motion, map_velocity)
            theta_dot[nodes.piece, nodes.close], slope_dot[nodes.piece, nodes.close] = (
                law_motion.angles(nodes.distance, nodes.side)
            )
        return ElectrodeMotion(slice(0, len(self.phi)), theta_dot, slope_dot * half, arc * half)

    def field(self, density: np.ndarray) -> np.ndarray:
        """(m q, drives): d potential / d theta at the nodes, of the other nodes' weighted
        currents."""
        angle = _differences(self._anchor.reshape(-1))
        if self._offset is not None:
            angle += _differences(self._offset.reshape(-1))
        np.fill_diagonal(angle, np.pi)
        return neumann.rim_potential_slope(angle) @ density

    def power_slope(
        self, density: np.ndarray, field: np.ndarray, motion: "ElectrodeMotion"
    ) -> np.ndarray:
        """(drives, drives): derivative of the electrodes' power with a motion, contact drop
        included."""
        density, field, moved = density[motion.nodes], field[motion.nodes], motion.pieces
        work = (motion.theta.ravel()[:, None] * density).T @ field
        if self.geometry.points:
            return work + work.T
        stretch = motion.slope / self.stretch[moved]
        length = self._contact_length_m[moved, None]
        drop = -length * motion.arc / self.arc_m[moved] ** 2 / self.weight
        per_node = drop.ravel() - stretch.ravel() / np.pi
        return work + work.T + (density * per_node[:, None]).T @ density


@dataclass(frozen=True)
class ElectrodeMotion:
    """Velocities (k, q) of theta, of d theta / dt and of the arc length ds / dt (m) at the nodes of
    the k pieces that move."""

    pieces: slice
    theta: np.ndarray
    slope: np.ndarray
    arc: np.ndarray

    @property
    def nodes(self) -> slice:
        """The nodes that move, as Electrodes.rim orders them."""
        count = self.theta.shape[1]
        return slice(self.pieces.start * count, self.pieces.stop * count)

    @property
    def rim_velocity(self) -> np.ndarray:
        """Their angular velocities in one row."""
        return self.theta.ravel()


@dataclass(frozen=True)
class _NodesByLaw:
    """Nodes of a piece whose angles are those of a corner's law: a mask (q,), and their distances
    of phi from the corner on a side."""

    law: CornerLaw
    piece: int
    side: int
    close: np.ndarray
    distance: np.ndarray


def _differences(values: np.ndarray) -> np.ndarray:
    """(..., N, N) of values (..., N)."""
    return values[..., :, None] - values[..., None, :]


def interaction(
    t: np.ndarray,
    modes: np.ndarray,
    theta: np.ndarray,
    slope: np.ndarray,
    factor: np.ndarray,
    offset: np.ndarray | None = None,
) -> np.ndarray:
    """(..., n order, n order): power of the modes' currents, without the contacts' drop.

    t (q,), modes (order, q): nodes across an electrode, weighted modes; theta, slope, factor (...,
    n, q): angles on the unit circle, d theta / dt, and sqrt(s) where the conductivity rises;
    offset (n, q): what the angles are more than theta.
    """
    xp, (*stack, n, q) = library(theta), theta.shape
    angle = _differences(theta.reshape(*stack, n * q))
    if offset is not None:
        angle += _differences(offset.reshape(n * q))
    same_electrode = as_in(np.kron(np.eye(n, dtype=bool), np.ones((q, q), dtype=bool)), theta)
    difference = xp.where(same_electrode, 1.0, angle)
    kernel = neumann.rim_potential(difference).reshape(*stack, n, q, n, q)
    diagonal = xp.arange(n, device=theta.device)
    across = xp.moveaxis(angle.reshape(*stack, n, q, n, q)[..., diagonal, :, diagonal, :], 0, -3)
    kernel[..., diagonal, :, diagonal, :] = xp.moveaxis(
        _self_kernel(t, across, slope, factor), -3, 0
    )
    kernel *= factor[..., :, :, None, None] * factor[..., None, None, :, :]
    order = len(modes)
    matrix = modes @ kernel.reshape(*stack, n, q, n * q)
    matrix = matrix.reshape(*stack, n * order, n, q) @ modes.T
    matrix = matrix.reshape(*stack, n, order, n, order)
    singular = xp.mean(factor**2, axis=-1)[..., None, None] * as_in(legendre_log(order), theta)
    matrix[..., diagonal, :, diagonal, :] -= xp.moveaxis(singular, -3, 0) / (4.0 * np.pi)
    return matrix.reshape(*stack, n * order, n * order)


def tested(modes: np.ndarray, potential: np.ndarray, n: int) -> np.ndarray:
    """(..., n order, k): projection of potentials at the nodes (..., n q, k) on modes (order,
    q)."""
    (*stack, _, k), (order, q) = potential.shape, modes.shape
    return (modes @ potential.reshape(*stack, n, q, k)).reshape(*stack, n * order, k)


def _self_kernel(
    t: np.ndarray, angle: np.ndarray, slope: np.ndarray, factor: np.ndarray
) -> np.ndarray:
    """(..., n, q, q): the Neumann function on one electrode, without -ln|t - t'| / pi.

    angle (..., n, q, q): between its nodes.
    """
    xp, diagonal = library(angle), as_in(np.eye(len(t), dtype=bool), angle)
    difference = xp.where(diagonal, 1.0, angle)
    distance = xp.where(diagonal, 1.0, abs(t[:, None] - t))
    share = xp.mean(factor**2, axis=-1)[..., None, None]
    share = share / (factor[..., :, None] * factor[..., None, :])
    kernel = neumann.rim_potential(difference) + share * xp.log(distance) / np.pi
    kernel[..., diagonal] = -xp.log(slope) / np.pi
    return kernel


def _between_points(theta: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """(n, n): power of the currents of point electrodes; NaN on the diagonal."""
    diagonal = np.eye(len(theta), dtype=bool)
    kernel = neumann.rim_potential(np.where(diagonal, 1.0, theta[:, None] - theta))
    return np.where(diagonal, np.nan, factor[:, None] * kernel * factor)


def contact_drop(
    modes: np.ndarray, weight: np.ndarray, length: np.ndarray, arc: np.ndarray
) -> np.ndarray:
    """(..., n, order, order): sigma z_l int P_k P_k' / 4 / (ds/dt) dt, with z sigma (..., n) and
    ds/dt (..., n, q) in m."""
    drop = length[..., None] / arc / weight
    return (modes * drop[..., None, :]) @ modes.T


def legendre_log(order: int) -> np.ndarray:
    """(order, order): double integral of P_m(t) P_n(t') ln|t - t'| over [-1, 1]^2, closed form.

    From int P_n(t') ln|t - t'| dt' = 2 (Q_{n+1}(t) - Q_{n-1}(t)) / (2 n + 1) for n >= 1 and
    int P_m Q_n dt = (1 - (-1)^(m+n)) / ((m - n) (m + n + 1)) (Gradshteyn & Ryzhik 7.113).
    """

    def legendre_pair(m: int, n: int) -> float:
        return 0.0 if (m + n) % 2 == 0 else 2.0 / ((m - n) * (m + n + 1.0))

    matrix = np.zeros((order, order))
    for m in range(order):
        for n in range(max(m, 1), order):
            pair = legendre_pair(m, n + 1) - legendre_pair(m, n - 1)
            matrix[m, n] = matrix[n, m] = 2.0 / (2 * n + 1) * pair
    matrix[0, 0] = 4.0 * np.log(2.0) - 6.0
    return matrix
