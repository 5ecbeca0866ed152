"""Whether a prediction is worse than another, by what was there."""

import math

import numpy as np
from scipy.stats import norm, t


def harm(
    after: np.ndarray, before: np.ndarray, there: np.ndarray, unit: np.ndarray
) -> dict[str, float]:
    """How far two predictions (Q, M) are from what was there (Q, M), both in its unit, and by how
    many standard errors the squared error of the first is the larger; NaN is not compared.

    unit (Q, M) int: readings of one label err together, units alone. The standard error is by the
    scatter over units. A few may agree by chance: Student's t of so many units is told as the
    normal quantile that is as improbable. Infinite where all units differ alike; NaN, no verdict,
    where there is one unit. Returns rmse_V, rmse_before_V, standard_errors, units. Raises
    ValueError where nothing is compared or a prediction is not finite.
    """
    known = np.isfinite(there)
    squares = [(predicted[known] - there[known]) ** 2 for predicted in (after, before)]
    if not known.any() or not np.isfinite(squares).all():
        raise ValueError("nothing to compare, or a prediction that is not finite")
    label = np.unique(unit[known], return_inverse=True)[1]
    return {
        "rmse_V": math.sqrt(squares[0].mean()),
        "rmse_before_V": math.sqrt(squares[1].mean()),
        "standard_errors": _apart(squares[0] - squares[1], label),
        "units": int(label.max()) + 1,
    }


def _apart(difference: np.ndarray, label: np.ndarray) -> float:
    """Standard errors of a normal by which the mean of differences (K,) is above 0; label (K,):
    their units, from 0."""
    count, mean = np.bincount(label), float(difference.mean())
    if len(count) < 2:
        return math.nan
    excess = np.bincount(label, difference) - count * mean
    share = len(count) / (len(count) - 1)
    error = math.sqrt(share * float((excess**2).sum())) / len(difference)
    if not error:
        return math.copysign(math.inf, mean) if mean else 0.0
    # By the upper tail alone: the lower one's probability would round to 1.
    far = float(norm.isf(t.sf(abs(mean) / error, len(count) - 1)))
    return math.copysign(far, mean)
