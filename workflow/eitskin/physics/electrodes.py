"""Electrodes on the rim as the complete electrode model has them, or as points.

The unknown is the current density on each electrode alone, in Legendre modes of the position
across it: P_k(t) / 2 per dt, t = -1 ... 1, so that the mode k = 0 carries the electrode's whole
current. The Galerkin equations of the complete electrode model, U_l - u = (z_l / h) dI/ds
(Somersalo, Cheney, Isaacson 1992), with the unit disc's Neumann function for u.
"""

import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from eitskin.physics import neumann
from eitskin.physics.arrays import as_in, library
from eitskin.physics.conformal import DiscMap, MapVelocity
from eitskin.physics.geometry import Geometry, RimMotion
from eitskin.physics.gradient import GradientBulk


class Electrodes:
    """Nodes, modes and Galerkin matrix of a skin's electrodes; `order` modes each (1 for points).

    Matrices are per unit sheet resistance 1 / (sigma h), mode-major within an electrode. The
    singular ln|t - t'| of an electrode with itself is integrated in closed form; the rest is
    smooth.
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
        self.phi = np.radians(geometry.electrode_deg)[:, None] + self.half_width[:, None] * self.t
        self._angles()
        legendre = np.polynomial.legendre.legvander(self.t, self.order - 1)
        self.modes = 0.5 * legendre.T * self.weight
        self.rim = np.exp(1j * self.theta).ravel()
        self.factor = np.ones_like(self.theta)
        if bulk:
            self.factor = bulk.factor(geometry.rim(self.phi))
            self.spread = self.project(bulk.terms(self.rim))

    @cached_property
    def interaction(self) -> np.ndarray:
        """(n order, n order): `matrix` without the contacts' drop."""
        if self.geometry.points:
            matrix = _between_points(self.theta.ravel(), self.factor.ravel())
        else:
            matrix = interaction(self.t, self.modes, self.theta, self.stretch, self.factor)
        return matrix + self.spread @ self.bulk.matrix @ self.spread.T if self.bulk else matrix

    @cached_property
    def matrix(self) -> np.ndarray:
        """(n order, n order): power of the modes' currents."""
        return self.interaction + self._contact_matrix()

    @property
    def stretch(self) -> np.ndarray:
        """(n, q): d theta / dt, t from -1 to 1 across an electrode."""
        return self.theta_slope * self.half_width[:, None]

    @property
    def arc_m(self) -> np.ndarray:
        """(n, q): ds / dt, m."""
        return self.arc_slope * self.half_width[:, None]

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

    def _contact_matrix(self) -> np.ndarray:
        """Contact drop of the modes, block diagonal (0 for points)."""
        n, p = self.n, self.order
        blocks = np.zeros((n, p, n, p))
        if not self.geometry.points:
            blocks[range(n), :, range(n), :] = self.contact_blocks()
        return blocks.reshape(n * p, n * p)

    def contact_blocks(self) -> np.ndarray:
        """(n, order, order): sigma z_l int P_k P_k' / 4 / (ds/dt) dt, ds in m."""
        length = 1e-3 * self.geometry.contact_length_mm
        return contact_drop(self.modes, self.weight, length, self.arc_m)

    def density(self, amplitude: np.ndarray) -> np.ndarray:
        """(n q, drives): weighted current at the nodes of mode amplitudes (n order, drives)."""
        per = amplitude.reshape(self.n, self.order, -1)
        return np.einsum("iq,aid->aqd", self.modes, per).reshape(self.n * len(self.t), -1)

    def project(self, potential: np.ndarray) -> np.ndarray:
        """(..., n order, k): projection on the modes of potentials at the nodes (..., n q, k);
        where the conductivity rises across the skin, of potentials as at its centre."""
        return tested(self.modes, potential * self.factor.reshape(-1, 1), self.n)

    def angle_motion(self, electrode: int) -> "ElectrodeMotion":
        """Velocity with electrode_deg of one electrode."""
        return self._along(electrode, np.full((1, len(self.t)), np.radians(1.0)), 0.0)

    def width_motion(self, electrode: int) -> "ElectrodeMotion":
        """Velocity with electrode_width_mm of one electrode."""
        growth = 0.5 / self.geometry.radius_mm
        return self._along(electrode, growth * self.t[None], growth)

    def _along(
        self, electrode: int, phi_dot: np.ndarray, half_width_dot: float
    ) -> "ElectrodeMotion":
        """Motion of one electrode along the rim; phi_dot (1, q): velocity of the angles of its
        nodes."""
        g, selection = self.geometry, slice(electrode, electrode + 1)
        phi, half = self.phi[selection], self.half_width[selection, None]
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
        g, half = self.geometry, self.half_width[:, None]
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
        return ElectrodeMotion(slice(0, self.n), log_f_dot.imag, slope.imag * half, arc * half)

    def field(self, density: np.ndarray) -> np.ndarray:
        """(n q, drives): d potential / d theta at the nodes, of the other nodes' weighted
        currents."""
        theta = self.theta.ravel()
        angle = theta[:, None] - theta
        np.fill_diagonal(angle, np.pi)
        return neumann.rim_potential_slope(angle) @ density

    def power_slope(
        self, density: np.ndarray, field: np.ndarray, motion: "ElectrodeMotion"
    ) -> np.ndarray:
        """(drives, drives): derivative of the electrodes' power with a motion, contact drop
        included."""
        density, field, electrodes = density[motion.nodes], field[motion.nodes], motion.electrodes
        work = (motion.theta.ravel()[:, None] * density).T @ field
        if self.geometry.points:
            return work + work.T
        stretch = motion.slope / self.stretch[electrodes]
        length = 1e-3 * self.geometry.contact_length_mm
        drop = -length[electrodes, None] * motion.arc / self.arc_m[electrodes] ** 2 / self.weight
        per_node = drop.ravel() - stretch.ravel() / np.pi
        return work + work.T + (density * per_node[:, None]).T @ density


@dataclass(frozen=True)
class ElectrodeMotion:
    """Velocities (m, q) of theta, of d theta / dt and of the arc length ds / dt (m) at the nodes of
    the electrodes that move."""

    electrodes: slice
    theta: np.ndarray
    slope: np.ndarray
    arc: np.ndarray

    @property
    def nodes(self) -> slice:
        """The nodes that move, as Electrodes.rim orders them."""
        count = self.theta.shape[1]
        return slice(self.electrodes.start * count, self.electrodes.stop * count)

    @property
    def rim_velocity(self) -> np.ndarray:
        """Their angular velocities in one row."""
        return self.theta.ravel()


def interaction(
    t: np.ndarray, modes: np.ndarray, theta: np.ndarray, slope: np.ndarray, factor: np.ndarray
) -> np.ndarray:
    """(..., n order, n order): power of the modes' currents, without the contacts' drop.

    t (q,), modes (order, q): nodes across an electrode, weighted modes; theta, slope, factor (...,
    n, q): angles on the unit circle, d theta / dt, and sqrt(s) where the conductivity rises.
    """
    xp, (*stack, n, q) = library(theta), theta.shape
    angle = theta.reshape(*stack, n * q)
    same_electrode = as_in(np.kron(np.eye(n, dtype=bool), np.ones((q, q), dtype=bool)), theta)
    difference = xp.where(same_electrode, 1.0, angle[..., :, None] - angle[..., None, :])
    kernel = neumann.rim_potential(difference).reshape(*stack, n, q, n, q)
    diagonal = xp.arange(n, device=theta.device)
    kernel[..., diagonal, :, diagonal, :] = xp.moveaxis(
        _self_kernel(t, theta, slope, factor), -3, 0
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
    t: np.ndarray, theta: np.ndarray, slope: np.ndarray, factor: np.ndarray
) -> np.ndarray:
    """(..., n, q, q): the Neumann function on one electrode, without -ln|t - t'| / pi."""
    xp, diagonal = library(theta), as_in(np.eye(len(t), dtype=bool), theta)
    difference = xp.where(diagonal, 1.0, theta[..., :, None] - theta[..., None, :])
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
