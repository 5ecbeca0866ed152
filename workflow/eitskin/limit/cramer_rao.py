"""Cramér-Rao bounds of place and force over the skin.

No unbiased estimate has a smaller variance than the inverse of Fisher's information. With skin and
gains unknown their distributions count as information of their own (the hybrid bound: Rockah and
Schultheiss 1987; Van Trees 1968, § 2.4), at their means; the state has no prior.
"""

import numpy as np
import pandas as pd

from eitskin.limit.observation import Covariance, Experiment, SessionModel

FORCES_N = (1.0, 2.5, 5.0, 7.5, 10.0)
CLEAR = 1e-3  # of the way to the rim
BOUNDS = {"x": "mm", "y": "mm", "F": "N"}


def bound(model: SessionModel, state: np.ndarray) -> np.ndarray:
    """(3,): least sd of x mm, y mm and F N at a state, the model's unknowns about their means."""
    mean = np.zeros(model.skin_spread.shape[1])
    e, noise = model.change(state, mean)
    information = Covariance(model, e, noise).information(*model.slopes(state, mean))
    information[3:, 3:] += np.eye(len(mean))
    return np.sqrt(np.diag(np.linalg.inv(information))[:3])


def table(experiment: Experiment, grid: pd.DataFrame) -> pd.DataFrame:
    """A row a place of the touch grid (place, x_mm, y_mm) and force of FORCES_N, with the bounds
    `x_mm_known` ... `F_N_known`, skin and gains at their means and known, and `_unknown`.

    Without places whose touch meets the rim: there the readings have no slope.
    """
    unknown = experiment.unknown()
    models = {"known": unknown.at_mean(), "unknown": unknown}
    rows = []
    assert experiment.skin.radius_mm is not None
    reach = experiment.skin.radius_mm - 0.5 * experiment.probe_mm
    for place in grid[np.hypot(grid["x_mm"], grid["y_mm"]) < (1.0 - CLEAR) * reach].itertuples():
        for force in FORCES_N:
            row = {"place": place.place, "x_mm": place.x_mm, "y_mm": place.y_mm, "force_N": force}
            for name, model in models.items():
                sd = bound(model, np.array([place.x_mm, place.y_mm, force]))
                row |= {f"{k}_{u}_{name}": s for (k, u), s in zip(BOUNDS.items(), sd, strict=True)}
            rows.append(row)
    return pd.DataFrame(rows)
