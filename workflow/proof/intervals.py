"""Shares and statistics over recordings, with 95 % intervals.

A measured value is {value, low, high, hits, n}: hits are None of a statistic that is no share.
"""

from collections.abc import Callable

import numpy as np

from eitskin.diagnose.noise.noise_model import NORMAL_90

Z = 1.959964  # quantile of the normal distribution at 0.975
RESAMPLES = 2000  # twice what Efron and Tibshirani 1993 ask for a percentile interval

Bounds = tuple[float, float]  # lowest and highest value


def rms(values: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt((values**2).mean()))


def band_numbers(error: np.ndarray, sd: np.ndarray, noise_V: np.ndarray) -> dict[str, float]:
    """Of a prediction's errors (Q, M) V on noise-free readings, with its sd (Q, M) V: χ² per
    reading that has noise noise_V (M,) V besides, and the share within the bands of 90 %."""
    return {
        "chi2_per_dof": float(1.0 + ((error / noise_V) ** 2).mean()),
        "within_90": float((np.abs(error) <= NORMAL_90 * sd).mean()),
    }


def wilson(hits: int, n: int) -> Bounds:
    """Interval of a share (Wilson 1927); NaN where nothing was counted."""
    if n == 0:
        return float("nan"), float("nan")
    fraction, room = hits / n, Z**2 / n
    centre = fraction + room / 2
    half = Z * np.sqrt((fraction * (1 - fraction) + room / 4) / n)
    low, high = (centre - half) / (1 + room), (centre + half) / (1 + room)
    return (0.0 if hits == 0 else float(low)), (1.0 if hits == n else float(high))


def bootstrap(n: int, statistic: Callable[[np.ndarray], float]) -> Bounds:
    """Percentile interval (Efron 1979) of statistic(indices (n,)) over `n` recordings, seeded.

    Draws for which the statistic is NaN do not count. NaN for fewer than two recordings.
    """
    if n < 2:
        return float("nan"), float("nan")
    rng = np.random.default_rng(n)
    draws = np.array([statistic(rng.integers(0, n, n)) for _ in range(RESAMPLES)])
    if np.isnan(draws).all():
        return float("nan"), float("nan")
    low, high = np.nanpercentile(draws, [2.5, 97.5])
    return float(low), float(high)


def share(hits: int, n: int) -> dict:
    """A share as a measured value, with Wilson's interval."""
    low, high = wilson(int(hits), int(n))
    value = hits / n if n else float("nan")
    return {**point(value, n), "low": low, "high": high, "hits": int(hits)}


def resampled(n: int, statistic: Callable[[np.ndarray], float]) -> dict:
    """statistic(indices (n,)) over n recordings as a measured value, with a bootstrap interval."""
    low, high = bootstrap(n, statistic)
    value = statistic(np.arange(n)) if n else float("nan")
    return {**point(value, n), "low": low, "high": high}


def point(value: float, n: int) -> dict:
    """A measured value without an interval."""
    return {"value": float(value), "low": np.nan, "high": np.nan, "hits": None, "n": int(n)}


def median(values: np.ndarray) -> dict:
    """Median (n,) of the values that are known, as a measured value."""
    finite = values[~np.isnan(values)]
    return resampled(len(finite), lambda index: float(np.median(finite[index])))


def mean(values: np.ndarray) -> dict:
    """Mean (n,), as a measured value."""
    return resampled(len(values), lambda index: float(values[index].mean()))


def interval_of(key: str, measured: dict) -> dict[str, float]:
    """{key, key_low, key_high} of a measured value: columns of a table."""
    return {key: measured["value"], f"{key}_low": measured["low"], f"{key}_high": measured["high"]}
