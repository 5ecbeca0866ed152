"""What all presses share of the errors of touches: of the rig, or an effect that is too small."""

from collections.abc import Iterable, Mapping

import numpy as np
from scipy.stats import t

from eitskin.diagnose.fitting.fit import Fit
from eitskin.diagnose.noise.component_sds import greatest_sds
from eitskin.diagnose.noise.components import COMPONENTS
from eitskin.diagnose.noise.rig_errors import RigErrors

# An effect of the fit does what a component does where it leaves less of the component's energy.
LEAST_FREE_SHARE = 0.01
UPPER = 0.95  # of Student's t: an interval of 90 %


def with_common_parts(
    components: Iterable[dict], fit: Fit, rig: RigErrors, error_sds: Mapping[str, float]
) -> list[dict]:
    """`noise.components` of diagnosis.json with the common part of every error of touches that has
    one; errors of presses that have no sd are added for it, with the largest sd that they may
    have."""
    entries = {component["name"]: component for component in components}
    parts = common_parts(fit, rig, error_sds)
    absent = [name for name in parts if name not in entries]
    for name, largest_sd in greatest_sds(rig, error_sds, absent).items():
        entries[name] = {
            "name": name,
            "unit": COMPONENTS[name].unit,
            "sd": 0.0,
            "low": 0.0,
            "high": largest_sd,
            "learned": name not in rig.assumed,
        }
    for name, part in parts.items():
        entries[name] = {**entries[name], "common": part}
    return list(entries.values())


def common_parts(fit: Fit, rig: RigErrors, error_sds: Mapping[str, float]) -> dict[str, dict]:
    """{value, low, high} by component: the errors of touches that are alike in all presses, in the
    component's unit, and their 90 % intervals; lists along x and along y for places.

    A touch is where it is reported to be and this part further; by generalised least squares, all
    parts together and beside the coordinates of the fit, in its covariance: the chance mean of P
    presses, s / sqrt(P), is in the interval, by Student's t of P - 1 degrees of freedom, over the
    presses that the fit has. Of an error that is one number by itself (a delay) its own variance is
    left out. Components that effects of the fit, or other parts, do as well have none
    (LEAST_FREE_SHARE).
    """
    coordinates = fit.jacobian.reshape(len(fit.theta), -1)
    basis = np.linalg.qr(coordinates.T)[0] if len(coordinates) else coordinates.T
    whitened = {
        name: fit.problem.whitening(columns).reshape(len(columns), -1)
        for name, columns in rig.columns.items()
        if COMPONENTS[name].has_common_part
    }
    least_energy = {
        name: LEAST_FREE_SHARE * (rows**2).sum(axis=1) for name, rows in whitened.items()
    }
    free = {name: rows - (rows @ basis) @ basis.T for name, rows in whitened.items()}
    free = {n: rows for n, rows in free.items() if ((rows**2).sum(axis=1) > least_energy[n]).all()}
    free = {
        n: rows for n, rows in free.items() if (_beyond_others(free, n) > least_energy[n]).all()
    }
    if not free:
        return {}
    stacked = np.concatenate(list(free.values()))
    covariance = np.linalg.inv(stacked @ stacked.T)
    value, variance = covariance @ (stacked @ fit.residual.ravel()), np.diag(covariance)
    is_fitted = fit.problem.whitening.mask.any(axis=1) & (rig.press >= 0)
    presses = len(np.unique(rig.press[is_fitted]))
    half_width = float(t.ppf(UPPER, max(presses - 1, 1)))
    parts, start = {}, 0
    for name, rows in free.items():
        place = slice(start, start := start + len(rows))
        part_variance = variance[place]
        if COMPONENTS[name].acts_on == "whole":
            part_variance = np.maximum(part_variance - error_sds.get(name, 0.0) ** 2, 0.0)
        half = half_width * np.sqrt(part_variance)
        ends = {"value": value[place], "low": value[place] - half, "high": value[place] + half}
        parts[name] = {k: v.tolist() if len(rows) > 1 else float(v[0]) for k, v in ends.items()}
    return parts


def _beyond_others(rows: Mapping[str, np.ndarray], name: str) -> np.ndarray:
    """(K,): squared length of each of the K rows of a name beyond all rows of the other names."""
    other_rows = np.concatenate(
        [np.zeros((0, rows[name].shape[1])), *(r for n, r in rows.items() if n != name)]
    )
    products = other_rows @ rows[name].T
    explained = (
        products * (np.linalg.pinv(other_rows @ other_rows.T, hermitian=True) @ products)
    ).sum(axis=0)
    return np.asarray((rows[name] ** 2).sum(axis=1) - explained)
