"""Whether a prediction is worse than another, by what was there."""

import math

import numpy as np


def harm(
    after: np.ndarray, before: np.ndarray, there: np.ndarray, unit: np.ndarray
) -> dict[str, float]:
    """How far two predictions (Q, M) are from what was there (Q, M), both in its unit, and by how
    many standard errors the squared error of the first is the larger; NaN is not compared.

    unit (Q, M) int: readings of one label err together, the units alone; their number gives the
    standard error. Where that is none, a difference is infinite. Returns rmse_V, rmse_before_V,
    standard_errors, units. Raises ValueError where nothing is compared or a prediction is not
    finite.
    """
    known = np.isfinite(there)
    squares = [(predicted[known] - there[known]) ** 2 for predicted in (after, before)]
    if not known.any() or not np.isfinite(squares).all():
        raise ValueError("nothing to compare, or a prediction that is not finite")
    label = np.unique(unit[known], return_inverse=True)[1]
    difference, count = squares[0] - squares[1], np.bincount(label)
    mean = float(difference.mean())
    excess = np.bincount(label, difference) - count * mean
    share = len(count) / max(len(count) - 1, 1)
    error = math.sqrt(share * float((excess**2).sum())) / len(difference)
    apart = math.copysign(math.inf, mean) if mean else 0.0
    return {
        "rmse_V": math.sqrt(squares[0].mean()),
        "rmse_before_V": math.sqrt(squares[1].mean()),
        "standard_errors": mean / error if error else apart,
        "units": len(count),
    }
