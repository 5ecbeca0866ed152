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
    known: np.ndarray, residual: np.ndarray, asked: np.ndarray, seed: int
) -> dict[str, np.ndarray]:
    """The misfit (Q, M) at features `asked` (Q, P), learned from `residual` (N, M), in units of the
    noise, at features `known` (N, P), by "gp", a Gaussian process, and "mlp", a small network.

    Both learn the residual's principal components over the channels, those above the noise's
    largest expected eigenvalue (Marchenko and Pastur 1967), one at least: the Gaussian process with
    a length a feature and noise, by marginal likelihood, each alone; the network all at once, the
    mean of NETS started differently. Where the residual is constant both give its mean.
    """
    mean, spread = known.mean(axis=0), known.std(axis=0)
    spread = np.where(spread > 0, spread, 1.0)
    known, asked = (known - mean) / spread, (asked - mean) / spread
    centre = residual.mean(axis=0)
    left, size, components = np.linalg.svd(residual - centre, full_matrices=False)
    edge = np.sqrt(len(residual)) + np.sqrt(residual.shape[1])
    count = int(np.clip((size > edge).sum(), 1, MOST_COMPONENTS))
    scores = left[:, :count] * size[:count]
    learned = {
        "gp": _gaussian_process(known, scores, asked),
        "mlp": _networks(known, scores, asked, seed),
    }
    return {name: centre + s @ components[:count] for name, s in learned.items()}


def corrections(
    states: pd.DataFrame, misfit: np.ndarray, sd: np.ndarray, query: pd.DataFrame, seed: int
) -> dict[str, np.ndarray]:
    """What each black box adds to a simulation of `query` (Q, M), having seen the `misfit` (N, M)
    of that of `states`, both in the unit of the noise sd (M,); lost readings of it are NaN."""
    scaled = np.nan_to_num(misfit / sd)
    learned = predictions(features(states), scaled, features(query), seed)
    return {name: values * sd for name, values in learned.items()}


def _gaussian_process(known: np.ndarray, scores: np.ndarray, asked: np.ndarray) -> np.ndarray:
    kernel = ConstantKernel(1.0, (1e-3, 1e3)) * RBF(
        np.full(known.shape[1], 2.0), (0.1, 1e3)
    ) + WhiteKernel(0.1, (1e-6, 1e1))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # lengths that reach their bounds
        fits = [
            GaussianProcessRegressor(kernel, normalize_y=True).fit(known, column)
            for column in scores.T
        ]
    return np.column_stack([one.predict(asked) for one in fits])


def _networks(known: np.ndarray, scores: np.ndarray, asked: np.ndarray, seed: int) -> np.ndarray:
    scale = max(scores.std(), 1.0)
    target = (scores if scores.shape[1] > 1 else scores[:, 0]) / scale
    total = np.zeros((len(asked), scores.shape[1]))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        for net in range(NETS):
            fit = MLPRegressor(
                hidden_layer_sizes=(32, 32),
                activation="tanh",
                solver="lbfgs",
                alpha=DECAY / scale**2,
                max_iter=200,
                random_state=seed * NETS + net,
            ).fit(known, target)
            total += fit.predict(asked).reshape(total.shape)
    return scale * total / NETS
