"""Electrodes inside a skin that a touch covers.

Within a touch of factor 1 + c the current of an electrode also drives the potential that vanishes
on the touch's edge, G j with the Dirichlet function G of the touch's disc: a power of <j, G j> / (1
+ c), on a skin without the touch <j, G j>. So the touch takes c / (1 + c) <j, G j>, as a
polarisation of pole 1. The density then follows another law than I_m(r / lambda): it may change by
densities without a moment, differences of I_m(r / lambda_k) of the same moment, which act on
nothing outside the electrode, so that they relax by themselves, and lower the poles.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag
from scipy.special import ive

from eitskin.physics.bessel_ratios import inner_steps
from eitskin.physics.inner_electrodes import InnerElectrodes

LENGTHS = (1.0, 0.4, 1.5, 3.0)  # lambda_k over lambda, the first that of the untouched skin
LEAST_POWER = 1e-12  # of the largest; below it a density, or a polarisation, is rounding
RADIAL_NODES = 64


@dataclass(frozen=True)
class CoveredElectrodes:
    """Polarisations of unit mass: response (K, K) to themselves and coupling (size, K) to the modes
    of the electrodes inside."""

    response: np.ndarray
    coupling: np.ndarray


def covered_electrodes(
    inner: InnerElectrodes,
    layer_mm: np.ndarray,
    is_covered: np.ndarray,
    centre: complex,
    radius: float,
) -> CoveredElectrodes:
    """The polarisations in a touch, centre and radius in mm, that covers the electrodes of the
    mask `is_covered` (count,); layer_mm (count,): lambda of every electrode."""
    numbers = np.flatnonzero(is_covered)
    scaled = (inner.place[numbers].ravel() - centre) / radius
    if inner.geometry.points:
        return _covered_points(inner, numbers, scaled)
    blocks = [_radial(inner.radius[i], layer_mm[i], inner.orders, radius) for i in numbers]
    free, extra, drive, relaxed = (block_diag(*part) for part in zip(*blocks, strict=True))
    kernel = _dirichlet(scaled, inner.place.shape[1])
    modes = block_diag(*[inner.modes] * len(numbers))
    power = np.block([[free + modes @ kernel @ modes.T, drive], [drive.T, extra]])
    weight, vectors = np.linalg.eigh(0.5 * (power + power.T))
    is_power = weight > LEAST_POWER * weight[-1]
    factor = vectors[:, is_power] * np.sqrt(weight[is_power])
    on_modes, on_extra = factor[: len(free)], factor[len(free) :]
    response = np.eye(factor.shape[1])
    strength, turn = np.linalg.eigh(0.5 * (relaxed + relaxed.T))
    is_density = strength > LEAST_POWER * strength[-1]
    lowered = (turn[:, is_density] / np.sqrt(strength[is_density])).T @ on_extra
    response -= lowered.T @ lowered
    coupling = np.zeros((inner.count, len(inner.modes), factor.shape[1]))
    coupling[numbers] = on_modes.reshape(len(numbers), len(inner.modes), -1)
    return CoveredElectrodes(response, coupling.reshape(inner.size, -1))


def _dirichlet(scaled: np.ndarray, nodes: int) -> np.ndarray:
    """(N, N): the Dirichlet function of the unit disc between places on it, of `nodes` nodes an
    electrode; without its logarithm within one."""
    count = len(scaled) // nodes
    same_electrode = np.kron(np.eye(count, dtype=bool), np.ones((nodes, nodes), bool))
    apart = np.where(same_electrode, 1.0, np.abs(scaled[:, None] - scaled))
    mirrored = np.log(np.abs(1.0 - scaled[:, None] * scaled.conj()))
    return (mirrored - np.log(apart)) / (2.0 * np.pi)


def _covered_points(
    inner: InnerElectrodes, numbers: np.ndarray, scaled: np.ndarray
) -> CoveredElectrodes:
    """Of points, whose own power is infinite: any will do that is large enough, as their own
    potential is never read."""
    power = _dirichlet(scaled, 1)
    np.fill_diagonal(power, 1.0 + np.abs(power).sum(axis=1))
    coupling = np.zeros((inner.size, len(numbers)))
    coupling[numbers] = np.linalg.cholesky(power)
    return CoveredElectrodes(np.eye(len(numbers)), coupling)


def _radial(
    rho: float, layer: float, orders: int, radius: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of one electrode, by modes and by densities without a moment: <j, phi_j>, <e, phi_e>, <j,
    phi_e>, and <e, phi_e + lambda^2 e>; phi the potential of a density by -ln(r / radius) / 2 pi.
    """
    lengths = layer * np.array(LENGTHS)
    order = np.arange(orders + 1)[:, None]
    step = inner_steps(orders, rho / lengths)
    power = (0.5 / np.maximum(order, 1) + 1.0 / step) / np.pi
    power[0] = (np.log(radius / rho) + 1.0 / step[0]) / (2.0 * np.pi)
    overlap = _overlap(rho, lengths, orders)
    mutual = power[:, None, :] - lengths**2 * overlap
    mutual = 0.5 * (mutual + mutual.mT)

    def without_moment(matrix: np.ndarray) -> np.ndarray:
        across = matrix[:, 1:, 1:] - matrix[:, :1, 1:] - matrix[:, 1:, :1]
        return across + matrix[:, :1, :1]

    extra, spread = without_moment(mutual), without_moment(overlap)
    drive = mutual[:, :1, 1:] - mutual[:, :1, :1]
    parts = mutual[:, :1, :1], extra, drive, extra + layer**2 * spread
    both = np.append(np.arange(orders + 1), np.arange(1, orders + 1))
    free, extra, drive, relaxed = (block_diag(*part[both]) for part in parts)
    return free, extra, drive, relaxed


def _overlap(rho: float, lengths: np.ndarray, orders: int) -> np.ndarray:
    """(orders + 1, L, L): int f_i f_k dA of densities I_m(r / lengths) cos m theta of unit
    moment."""
    node, weight = np.polynomial.legendre.leggauss(RADIAL_NODES)
    node, weight = 0.5 * (1.0 + node), 0.5 * weight
    # Crowded towards the edge, where the current of a good contact is.
    share, weight = 1.0 - (1.0 - node) ** 2, 2.0 * (1.0 - node) * weight
    order = np.arange(orders + 1)[:, None, None]
    x = rho / lengths[:, None]
    profile = ive(order, x * share) * np.exp(x * (share - 1.0)) / ive(order + 1, x)
    angular = np.where(order, np.pi, 2.0 * np.pi)
    profile = profile * x / (angular * rho**2)
    return angular * np.einsum("miq,mkq,q->mik", profile, profile, rho**2 * share * weight)
