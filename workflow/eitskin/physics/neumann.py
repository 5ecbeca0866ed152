"""The Neumann function of the unit disc, sheet conductance 1.

N(x, y) = -(1 / 2 pi) (ln|x - y| + ln|1 - x conj(y)|): the potential at x of a unit current that
enters at y, for sources that sum to zero (constants and the return current's quadratic drop out
then). Points are complex numbers, of NumPy or of PyTorch. On the rim both logarithms agree. A line
element dy with outward normal n obeys d/dn Re g(y) ds = Im(g'(y) dy), counter-clockwise round the
region.
"""

import numpy as np

from eitskin.physics.arrays import library

CACHED_BYTES = 1 << 17  # of a block of rows, so that its intermediate arrays stay in the cache


def rim_potential(angle: np.ndarray) -> np.ndarray:
    """N between two rim points `angle` radians apart (not 0)."""
    xp = library(angle)
    return -xp.log(2.0 * abs(xp.sin(angle / 2.0))) / np.pi


def rim_potential_slope(angle: np.ndarray) -> np.ndarray:
    """d N / d angle between two rim points."""
    return -0.5 / (np.tan(angle / 2.0) * np.pi)


def potential(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """N(x, y) for x != y."""
    product = (x - y) * (1.0 - x * np.conj(y))
    return -np.log(product.real**2 + product.imag**2) / (4.0 * np.pi)


def flux_kernel(x: np.ndarray, y: np.ndarray, dy: np.ndarray) -> np.ndarray:
    """dN(x, y)/dn_y ds_y for y inside or on the rim and x != y."""
    conj = x.conj()
    difference, below = y - x, 1.0 - conj * y
    return ((below - conj * difference) / (difference * below) * (dy / (-2.0 * np.pi))).imag


def flux_kernel_diagonal(y: np.ndarray, dy: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """The limit x -> y of `flux_kernel` along a smooth curve y(t), with dy = y' dt.

    `turn` is Im(y'' / y') dt, the angle by which the tangent turns; half of it is the curve's own
    part.
    """
    image = y.conj() * dy / (1.0 - abs(y) ** 2)
    return -(0.5 * turn - image.imag) / (2.0 * np.pi)


def self_flux_kernel(
    y: np.ndarray, slope: np.ndarray, bend: np.ndarray, weight: np.ndarray, jump: float = 0.0
) -> np.ndarray:
    """(..., N, N): `flux_kernel` between the nodes of one smooth curve.

    y, slope, bend (..., N): nodes, first and second derivatives by the parameter; weight (N,) or
    (..., N); jump: added on the diagonal, -1/2 for the limit from inside a closed curve.
    """
    xp, (*stack, count) = library(y), y.shape
    dy = slope * weight
    kernel = xp.empty((*stack, count, count), dtype=y.real.dtype, device=y.device)
    rows = max(CACHED_BYTES // (16 * y.size), 1) if xp is np else count
    with np.errstate(divide="ignore", invalid="ignore"):  # on the diagonal, which has a limit
        for start in range(0, count, rows):
            block = slice(start, start + rows)
            kernel[..., block, :] = flux_kernel(
                y[..., block, None], y[..., None, :], dy[..., None, :]
            )
    diagonal = flux_kernel_diagonal(y, dy, (bend / slope).imag * weight)
    index = xp.arange(count, device=y.device)
    kernel[..., index, index] = diagonal + jump
    return kernel


def rim_flux_kernel(rim: np.ndarray, y: np.ndarray, dy: np.ndarray) -> np.ndarray:
    """(R, N): `flux_kernel` from a curve's nodes y (N,) to rim points (R,)."""
    xp = library(y)
    kernel = xp.empty((len(rim), len(y)), dtype=y.real.dtype, device=y.device)
    rows = max(CACHED_BYTES // (16 * max(len(y), 1)), 1) if xp is np else max(len(rim), 1)
    line = dy / -np.pi
    for start in range(0, len(rim), rows):
        block = slice(start, start + rows)
        kernel[block] = (line / (y - rim[block, None])).imag
    return kernel
