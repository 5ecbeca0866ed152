"""Cramér-Rao bounds of place and force over the skin.

The variance of an unbiased estimate is at least the inverse of Fisher's information. With skin and
gains unknown, their distributions add information, evaluated at their means (the hybrid bound:
Rockah and Schultheiss 1987; Van Trees 1968, § 2.4); the state has no prior.
"""

import numpy as np
import pandas as pd

from eitskin.limit.observation import Covariance, Experiment, SessionModel

FORCES_N = (1.0, 2.5, 5.0, 7.5, 10.0)  # over the range of the paper's forces
RIM_MARGIN = 1e-3  # of the way to the rim, where slopes are differences
BOUNDS = {"x": "mm", "y": "mm", "F": "N"}


def bound(model: SessionModel, state: np.ndarray) -> np.ndarray:
    """(3,): lower bound of the sd of x mm, y mm and F N at a state, sqrt(diag(I⁻¹))."""
    mean = np.zeros(model.skin_spread.shape[1])
    e, noise = model.change(state, mean)
    information = Covariance(model, e, noise).information(*model.slopes(state, mean))
    information[3:, 3:] += np.eye(len(mean))
    return np.sqrt(np.diag(np.linalg.inv(information))[:3])


def table(experiment: Experiment, grid: pd.DataFrame) -> pd.DataFrame:
    """One row for each place of the touch grid (place, x_mm, y_mm) and force of FORCES_N: the
    bounds `x_mm_known` ... `F_N_known` with skin and gains known, at their means, and `_unknown`.

    Places whose touch meets the rim are left out: the readings have no slope there.
    """
    prior_session = experiment.prior_session()
    models = {"known": prior_session.at_mean(), "unknown": prior_session}
    rows = []
    assert experiment.skin.radius_mm is not None
    reach = experiment.skin.radius_mm - 0.5 * experiment.probe_mm
    for place in grid[
        np.hypot(grid["x_mm"], grid["y_mm"]) < (1.0 - RIM_MARGIN) * reach
    ].itertuples():
        for force in FORCES_N:
            row = {"place": place.place, "x_mm": place.x_mm, "y_mm": place.y_mm, "force_N": force}
            for name, model in models.items():
                sd = bound(model, np.array([place.x_mm, place.y_mm, force]))
                row |= {
                    f"{target}_{unit}_{name}": bound_sd
                    for (target, unit), bound_sd in zip(BOUNDS.items(), sd, strict=True)
                }
            rows.append(row)
    return pd.DataFrame(rows)
