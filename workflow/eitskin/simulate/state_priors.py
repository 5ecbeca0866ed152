"""Priors of contact states: places uniform over a disc, forces from a clipped normal.

Both are functions of standard normal numbers, smooth except where a force is clipped. The generator
draws from them and an inference uses them as its prior, including the weight of clipped forces.
Places within an outline are drawn alone: no inference has them as its prior.
"""

import numpy as np

from eitskin.errors import InputError
from eitskin.physics.rim_curve import RimCurve

LEAST_SHARE = 1e-3  # of a rim's extent in x and y, in which places can be drawn
RIM_POINTS = 2048  # at which a rim's extent is measured
SERIES_SQUARE = 1e-4  # squared length below which a series replaces the closed form


def place_mm(normal: np.ndarray, reach_mm: float) -> np.ndarray:
    """(..., 2) x, y mm of standard normal (..., 2): uniform over a disc of radius `reach_mm`.

    The squared length t of the pair is exponential, so 1 - exp(-t / 2) is uniform: the share of the
    area within.
    """
    square = (normal**2).sum(axis=-1, keepdims=True)
    return reach_mm * normal * _shrink(square)[0]


def place_slope(normal: np.ndarray, reach_mm: float) -> np.ndarray:
    """(2, 2) mm: d place_mm / d normal of one pair (2,), places by row."""
    shrink, slope = _shrink(normal @ normal)
    return reach_mm * (shrink * np.eye(2) + 2.0 * slope * np.outer(normal, normal))


def place_normal(xy_mm: np.ndarray, reach_mm: float) -> np.ndarray:
    """(..., 2): the standard normal pair of places (..., 2) mm within the disc."""
    share = (xy_mm**2).sum(axis=-1, keepdims=True) / reach_mm**2
    return xy_mm / (reach_mm * _shrink(-2.0 * np.log1p(-share))[0])


def _shrink(square: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
    """h = sqrt((1 - exp(-t/2)) / t) and its derivative, of t = `square`; 1 - t/4 + t²/24 at 0."""
    is_small = np.asarray(square) < SERIES_SQUARE
    t = np.where(is_small, 1.0, square)
    ratio = np.where(is_small, 0.5 - square / 8.0 + square**2 / 48.0, -np.expm1(-0.5 * t) / t)
    slope = (0.5 * np.exp(-0.5 * t) + np.expm1(-0.5 * t) / t) / t
    shrink = np.sqrt(ratio)
    return shrink, 0.5 * np.where(is_small, -0.125 + square / 24.0, slope) / shrink


def place_within(
    rng: np.random.Generator, count: int, rim: RimCurve, margin_mm: float
) -> np.ndarray:
    """(count, 2) x, y mm: uniform over what lies farther than `margin_mm` within a rim.

    Raises InputError where nothing does, or less than some LEAST_SHARE of the rim's extent.
    """
    corner = rim.place(2.0 * np.pi * np.arange(RIM_POINTS) / RIM_POINTS)
    corner = np.append(corner, rim.points)
    low = np.array([corner.real.min(), corner.imag.min()])
    high = np.array([corner.real.max(), corner.imag.max()])
    places, drawn, accepted = [np.zeros((0, 2))], 0, 0
    while accepted < count:
        xy = rng.uniform(low, high, (2 * count + 16, 2))
        inner = xy[rim.within(xy @ np.array([1.0, 1.0j]), margin_mm)]
        places.append(inner)
        drawn, accepted = drawn + len(xy), accepted + len(inner)
        if accepted < LEAST_SHARE * drawn and drawn > 10.0 / LEAST_SHARE:
            expected = "a margin within which there is room for touches"
            raise InputError("skin", "outline", f"no place {margin_mm:g} mm within", expected)
    return np.concatenate(places)[:count]


def force_N(normal: np.ndarray, mean_N: float, sd_N: float, max_N: float) -> np.ndarray:
    """N of standard normal numbers: normal, clipped to 0 ... max_N."""
    return np.clip(mean_N + sd_N * np.asarray(normal), 0.0, max_N)
