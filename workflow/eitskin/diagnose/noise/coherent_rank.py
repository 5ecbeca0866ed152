"""How many modes of a matrix stand above noise."""

from functools import lru_cache

import numpy as np

TRACY_WIDOM = 2.0234  # 99 % quantile of the largest singular value squared, standardised
LEAST_ROWS = 4  # fewer independent rows show no modes


def rank_above_noise(singular_values: np.ndarray, shape: tuple[int, int]) -> int:
    """How many singular values, in descending order, stand above those of white noise (rows,
    columns).

    The noise's variance is that at which the median of the remaining ones is the Marchenko-Pastur
    median (1967); the largest of noise alone is distributed as Johnstone gives it (Ann. Statist.
    29, 2001).
    """
    rows, columns = shape
    singular_values = singular_values[: min(shape)]
    count = len(singular_values)
    rank = 0
    while count - rank >= LEAST_ROWS and rank < count // 2 + 1:
        low, high = sorted((rows - rank, columns - rank))
        median = np.median(singular_values[rank:])
        variance = median**2 / (high * _marchenko_pastur_median(low / high))
        root = np.sqrt(low - 0.5) + np.sqrt(high - 0.5)
        spread = root * (1.0 / np.sqrt(low - 0.5) + 1.0 / np.sqrt(high - 0.5)) ** (1.0 / 3.0)
        if singular_values[rank] ** 2 <= variance * (root**2 + TRACY_WIDOM * spread):
            break
        rank += 1
    return rank


@lru_cache(maxsize=4096)
def _marchenko_pastur_median(ratio: float) -> float:
    """Median eigenvalue of X X^T / n, X (p, n) of unit variance, ratio = p / n in (0, 1]."""
    angle = np.linspace(0.0, np.pi, 4001)
    value = 1.0 + ratio + 2.0 * np.sqrt(ratio) * np.cos(angle[::-1])
    density = np.sin(angle) ** 2 / np.maximum(value, 1e-12)
    mass = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
    return float(np.interp(0.5 * mass[-1], mass, value))
