"""Whether one prediction is worse than another."""

import math

import numpy as np
from scipy.stats import norm, t


def harm(
    prediction: np.ndarray, baseline: np.ndarray, readings: np.ndarray, unit: np.ndarray
) -> dict[str, float]:
    """Errors of a prediction and of a baseline (Q, M) of readings (Q, M), in their unit, and by how
    many standard errors the squared error of the prediction is the larger. Readings that are NaN
    are left out.

    unit (Q, M) int: readings of one label err together, labels independently. The standard error is
    by the scatter over labels. As few labels may agree by chance, Student's t of so many labels is
    given as the normal quantile of the same tail probability. It is infinite where the difference
    is the same in all labels, and NaN where there is one label. Returns rmse_V, rmse_before_V (the
    baseline's), standard_errors, units (the number of labels). Raises ValueError where nothing is
    compared or a prediction is not finite.
    """
    finite = np.isfinite(readings)
    squares = [(predicted[finite] - readings[finite]) ** 2 for predicted in (prediction, baseline)]
    if not finite.any() or not np.isfinite(squares).all():
        raise ValueError("nothing to compare, or a prediction that is not finite")
    label = np.unique(unit[finite], return_inverse=True)[1]
    return {
        "rmse_V": math.sqrt(squares[0].mean()),
        "rmse_before_V": math.sqrt(squares[1].mean()),
        "standard_errors": _normal_score(squares[0] - squares[1], label),
        "units": int(label.max()) + 1,
    }


def _normal_score(difference: np.ndarray, label: np.ndarray) -> float:
    """Standard errors of a normal by which the mean of differences (K,) is above 0; label (K,):
    their independent units, from 0."""
    count, mean = np.bincount(label), float(difference.mean())
    if len(count) < 2:
        return math.nan
    excess = np.bincount(label, difference) - count * mean
    share = len(count) / (len(count) - 1)
    error = math.sqrt(share * float((excess**2).sum())) / len(difference)
    if not error:
        return math.copysign(math.inf, mean) if mean else 0.0
    # By the upper tail alone: the lower one's probability would round to 1.
    quantile = float(norm.isf(t.sf(abs(mean) / error, len(count) - 1)))
    return math.copysign(quantile, mean)
