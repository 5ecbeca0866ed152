"""What a black box makes of a recording: regressions of the misfit on the touch's state."""

import warnings

import numpy as np
import pandas as pd
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
from sklearn.neural_network import MLPRegressor

MOST_COMPONENTS = 8
NETS = 3
DECAY = 30.0  # of the weights, at a misfit of the noise's size


def features(states: pd.DataFrame) -> np.ndarray:
    """(N, 6): x, y (mm; 0 untouched), force (N), probe (mm; 0 untouched), time (s), and whether the
    force has passed its press' peak.
    """
    peak = states.groupby("contact")["force_N"].transform("cummax")
    unloading = (states["force_N"] < peak).fillna(False).astype(float)
    columns = ("x_mm", "y_mm", "force_N", "probe_mm", "time_s")
    return np.column_stack([*(states[c].fillna(0.0).astype(float) for c in columns), unloading])


def predictions(
    states: np.ndarray, residual: np.ndarray, query: np.ndarray, seed: int
) -> dict[str, np.ndarray]:
    """The misfit (Q, M) at features `asked` (Q, P), learned from `residual` (N, M), in units of the
    noise, at features `known` (N, P), by "gp", a Gaussian process, and "mlp", a small network.

    Both learn the residual's principal components over the channels, those above the noise's
    largest expected eigenvalue (Marchenko and Pastur 1967), one at least: the Gaussian process with
    a length a feature and noise, by marginal likelihood, each alone; the network all at once, the
    mean of NETS started differently. Where the residual is constant both give its mean.
    """
    mean, scale = states.mean(axis=0), states.std(axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    states, query = (states - mean) / scale, (query - mean) / scale
    centre = residual.mean(axis=0)
    left_singular, singular_values, components = np.linalg.svd(
        residual - centre, full_matrices=False
    )
    edge = np.sqrt(len(residual)) + np.sqrt(residual.shape[1])
    count = int(np.clip((singular_values > edge).sum(), 1, MOST_COMPONENTS))
    scores = left_singular[:, :count] * singular_values[:count]
    score_predictions = {
        "gp": _gaussian_process(states, scores, query),
        "mlp": _networks(states, scores, query, seed),
    }
    return {name: centre + s @ components[:count] for name, s in score_predictions.items()}


def corrections(
    states: pd.DataFrame, misfit: np.ndarray, sd: np.ndarray, query: pd.DataFrame, seed: int
) -> dict[str, np.ndarray]:
    """What each black box adds to a simulation of `query` (Q, M), having seen the `misfit` (N, M)
    of that of `states`, both in the unit of the noise sd (M,); lost readings of it are NaN."""
    scaled = np.nan_to_num(misfit / sd)
    predicted = predictions(features(states), scaled, features(query), seed)
    return {name: values * sd for name, values in predicted.items()}


def _gaussian_process(states: np.ndarray, scores: np.ndarray, query: np.ndarray) -> np.ndarray:
    kernel = ConstantKernel(1.0, (1e-3, 1e3)) * RBF(
        np.full(states.shape[1], 2.0), (0.1, 1e3)
    ) + WhiteKernel(0.1, (1e-6, 1e1))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # lengths that reach their bounds
        processes = [
            GaussianProcessRegressor(kernel, normalize_y=True).fit(states, column)
            for column in scores.T
        ]
    return np.column_stack([process.predict(query) for process in processes])


def _networks(states: np.ndarray, scores: np.ndarray, query: np.ndarray, seed: int) -> np.ndarray:
    scale = max(scores.std(), 1.0)
    target = (scores if scores.shape[1] > 1 else scores[:, 0]) / scale
    total = np.zeros((len(query), scores.shape[1]))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        for number in range(NETS):
            network = MLPRegressor(
                hidden_layer_sizes=(32, 32),
                activation="tanh",
                solver="lbfgs",
                alpha=DECAY / scale**2,
                max_iter=200,
                random_state=seed * NETS + number,
            ).fit(states, target)
            total += network.predict(query).reshape(total.shape)
    return scale * total / NETS
