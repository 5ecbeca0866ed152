"""What all presses share of the errors of touches: of the rig, or an effect that is too small."""

from collections.abc import Iterable, Mapping

import numpy as np
from scipy.stats import t

from eitskin.diagnose.fitting.fit import Fit
from eitskin.diagnose.noise.component_sds import greatest_sd
from eitskin.diagnose.noise.components import COMPONENTS, TouchComponent
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
    for name, part in common_parts(fit, rig, error_sds).items():
        if name not in entries:
            entries[name] = {
                "name": name,
                "unit": COMPONENTS[name].unit,
                "sd": 0.0,
                "low": 0.0,
                "high": greatest_sd(rig, error_sds, name),
                "learned": name not in rig.assumed,
            }
        entries[name] = {**entries[name], "common": part}
    return list(entries.values())


def common_parts(fit: Fit, rig: RigErrors, error_sds: Mapping[str, float]) -> dict[str, dict]:
    """{value, low, high} by component: the errors of touches that are alike in all presses, in the
    component's unit, and their 90 % intervals; lists along x and along y for places.

    A touch is where it is reported to be and this part further; by generalised least squares, all
    parts together and beside the coordinates of the fit, in its covariance: the chance mean of P
    presses, s / sqrt(P), is in the interval, by Student's t of P - 1 degrees of freedom. Of an
    error that is one number by itself (a delay) its own variance is left out. Components that
    effects of the fit do as well (LEAST_FREE_SHARE) have none.
    """
    coordinates = fit.jacobian.reshape(len(fit.theta), -1)
    basis = np.linalg.qr(coordinates.T)[0] if len(coordinates) else coordinates.T
    free = {}
    for name, columns in rig.columns.items():
        component = COMPONENTS[name]
        if isinstance(component, TouchComponent) and component.has_common_part:
            whitened = fit.problem.whitening(columns).reshape(len(columns), -1)
            rest = whitened - (whitened @ basis) @ basis.T
            if ((rest**2).sum(axis=1) > LEAST_FREE_SHARE * (whitened**2).sum(axis=1)).all():
                free[name] = rest
    if not free:
        return {}
    stacked = np.concatenate(list(free.values()))
    covariance = np.linalg.pinv(stacked @ stacked.T, hermitian=True)
    value, variance = covariance @ (stacked @ fit.residual.ravel()), np.diag(covariance)
    half_width = float(t.ppf(UPPER, max(rig.press_count - 1, 1)))
    parts, start = {}, 0
    for name, rest in free.items():
        place = slice(start, start := start + len(rest))
        part = variance[place]
        if COMPONENTS[name].acts_on == "whole":
            part = np.maximum(part - error_sds.get(name, 0.0) ** 2, 0.0)
        half = half_width * np.sqrt(part)
        ends = {"value": value[place], "low": value[place] - half, "high": value[place] + half}
        parts[name] = {k: v.tolist() if len(rest) > 1 else float(v[0]) for k, v in ends.items()}
    return parts
