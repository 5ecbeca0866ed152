"""Root mean squares; 95 % intervals of shares and of statistics over recordings."""

from collections.abc import Callable

import numpy as np

Z = 1.959964  # of a normal distribution, 95 %
RESAMPLES = 2000


def rms(values: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt((values**2).mean()))


def wilson(hits: int, n: int) -> tuple[float, float]:
    """Interval of a share (Wilson 1927); NaN where nothing was counted."""
    if n == 0:
        return float("nan"), float("nan")
    share, room = hits / n, Z**2 / n
    centre = share + room / 2
    half = Z * np.sqrt((share * (1 - share) + room / 4) / n)
    low, high = (centre - half) / (1 + room), (centre + half) / (1 + room)
    return (0.0 if hits == 0 else float(low)), (1.0 if hits == n else float(high))


def bootstrap(n: int, statistic: Callable[[np.ndarray], float]) -> tuple[float, float]:
    """Percentile interval (Efron 1979) of statistic(indices (n,)) over `n` recordings, seeded.

    Draws for which the statistic is NaN do not count. NaN for fewer than two recordings.
    """
    if n < 2:
        return float("nan"), float("nan")
    rng = np.random.default_rng(n)
    drawn = np.array([statistic(rng.integers(0, n, n)) for _ in range(RESAMPLES)])
    if np.isnan(drawn).all():
        return float("nan"), float("nan")
    low, high = np.nanpercentile(drawn, [2.5, 97.5])
    return float(low), float(high)
