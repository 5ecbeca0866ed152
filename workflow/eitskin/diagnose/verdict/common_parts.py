"""What all presses share of the errors of touches: of the rig, or an effect that is too small."""

import numpy as np

from eitskin.diagnose.fitting.fit import Fit
from eitskin.diagnose.noise.components import COMPONENTS, TouchComponent
from eitskin.diagnose.noise.noise_model import NORMAL_90
from eitskin.diagnose.noise.rig_errors import RigErrors


def common_parts(fit: Fit, rig: RigErrors) -> dict[str, dict]:
    """{value, low, high} by component: the errors of touches that are alike in all presses, in the
    component's unit, and their 90 % intervals; lists along x and along y for places.

    A touch is where it is reported to be and this part further; by generalised least squares beside
    the coordinates of the fit, in its covariance: the chance mean of P presses, s / sqrt(P), is in
    the interval. Components of walks, which differ from press to press, are left out, and so are
    those whose readings tell nothing beside the fit.
    """
    coordinates = fit.jacobian.reshape(len(fit.theta), -1)
    basis = np.linalg.qr(coordinates.T)[0] if len(coordinates) else coordinates.T
    parts = {}
    for name, columns in rig.columns.items():
        component = COMPONENTS[name]
        if not isinstance(component, TouchComponent) or component.acts_on == "whole":
            continue
        whitened = fit.problem.whitening(columns).reshape(len(columns), -1)
        free = whitened - (whitened @ basis) @ basis.T
        gram = free @ free.T
        if np.linalg.cond(gram) > 1.0 / np.finfo(float).eps:
            continue
        covariance = np.linalg.inv(gram)
        value = covariance @ (free @ fit.residual.ravel())
        half = NORMAL_90 * np.sqrt(np.diag(covariance))
        ends = {"value": value, "low": value - half, "high": value + half}
        single = len(value) == 1
        parts[name] = {k: float(v[0]) if single else v.tolist() for k, v in ends.items()}
    return parts
