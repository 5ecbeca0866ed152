"""Correlation in time and drift of noise, by restricted likelihood.

The noise of each column has the covariance s^2 (correlation^|n - m| + drift^2 min(t_n, t_m)) over
frames of numbers n and elapsed shares t of time: an autoregressive process and a random walk. Of
residuals beside time modes, both are those of the greatest restricted likelihood (Patterson &
Thompson, Biometrika 58, 1971), each 0 unless a likelihood ratio asks for it.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, qr, solve_triangular
from scipy.linalg.lapack import dpotri
from scipy.optimize import minimize, minimize_scalar
from scipy.special import expit, logit
from scipy.stats import chi2

from eitskin.diagnose.noise.estimate import ALPHA

# Starts of a search: dense enough that the likelihood has one maximum between neighbours.
CORRELATIONS = (0.02, 0.3, 0.6, 0.8, 0.9, 0.95, 0.98, 0.995)
DRIFTS = (0.05, 0.2, 0.5, 1.0, 2.0, 5.0, 20.0, 100.0)
TOLERANCE = 0.02  # of logit and logarithm: a tenth of their standard errors, or less
DEVIANCE_TOLERANCE = 0.1  # where correlation and drift are found together
BOTH_ALPHA = 0.1  # p-value of one at the other's estimate, above which they are not fitted together
RIDGE = 1e-9  # of a precision's diagonal, for time modes that only lost readings showed
LEAST_VARIANCE = 1e-300  # keeps a logarithm finite


class TemporalCorrelation(NamedTuple):
    """Of noise: correlation from frame to frame; drift: sd of a random walk at the end, in units of
    the noise."""

    correlation: float
    drift: float


@dataclass(frozen=True)
class WhitenedSeries:
    """Values (N, C), whitened in time beside the time modes (white), their sums of squares (C,) and
    degrees of freedom (C,), the logarithm of the likelihood's determinants, and the values (N, C)
    with lost ones predicted from the others (filled)."""

    white: np.ndarray
    squares: np.ndarray
    dof: np.ndarray
    log_determinant: float
    filled: np.ndarray

    @property
    def deviance(self) -> float:
        """-2 log restricted likelihood, each column's scale at its best."""
        variance = np.maximum(self.squares / self.dof, LEAST_VARIANCE)
        return float(np.sum(self.dof * np.log(variance)) + self.log_determinant)


@dataclass(frozen=True)
class FrameSeries:
    """Frames: their numbers (N,), the elapsed share (N,) of the time, and time modes (N, K)."""

    number: np.ndarray
    elapsed: np.ndarray
    time_modes: np.ndarray

    def whitened(
        self,
        temporal: TemporalCorrelation,
        values: np.ndarray,
        channel_modes: np.ndarray | None = None,
    ) -> WhitenedSeries:
        """Values (N, C), NaN where lost, whitened under a correlation and a drift; channel_modes
        (C, R): directions over the columns that are taken out."""
        covariance = temporal.drift**2 * np.minimum.outer(self.elapsed, self.elapsed)
        gap = np.abs(np.subtract.outer(self.number, self.number)).astype(float)
        covariance += temporal.correlation**gap
        root = cholesky(covariance, lower=True)
        lost = np.isnan(values)
        filled = np.where(lost, 0.0, values)
        basis, upper = qr(solve_triangular(root, self.time_modes, lower=True), mode="economic")
        white = _residual(basis, solve_triangular(root, filled, lower=True))
        column_log_determinant = 2.0 * (
            np.log(np.diag(root)).sum() + np.log(np.abs(np.diag(upper))).sum()
        )
        removed = 0 if channel_modes is None else channel_modes.shape[1]
        log_determinant = column_log_determinant * (values.shape[1] - removed)
        dof = np.full(values.shape[1], float(len(values) - self.time_modes.shape[1]))
        if lost.any():
            inverse = np.tril(dpotri(root, lower=1)[0])
            back = solve_triangular(root, basis, lower=True, trans="T")
            precision = inverse + np.tril(inverse, -1).T - back @ back.T
            weighted = solve_triangular(root, white, lower=True, trans="T")
            for k in np.flatnonzero(lost.any(axis=0)):
                rows = np.flatnonzero(lost[:, k])
                block = precision[np.ix_(rows, rows)] * (1.0 + RIDGE * np.eye(len(rows)))
                filled[rows, k] = -np.linalg.solve(block, weighted[rows, k])
                log_determinant += np.linalg.slogdet(block)[1]
                dof[k] -= len(rows)
            white = _residual(basis, solve_triangular(root, filled, lower=True))
        if channel_modes is not None:
            white -= (white @ channel_modes) @ channel_modes.T
            dof *= 1.0 - np.sum(channel_modes**2, axis=1)
        return WhitenedSeries(white, np.sum(white**2, axis=0), dof, log_determinant, filled)


def temporal_correlation(
    series: FrameSeries, values: np.ndarray, channel_modes: np.ndarray | None = None
) -> tuple[TemporalCorrelation, WhitenedSeries]:
    """Correlation and drift of values (N, C), NaN where lost, each 0 unless the likelihood asks for
    it, and the values whitened by them; channel_modes (C, R): as in `FrameSeries.whitened`."""

    def temporal_at(coordinates: np.ndarray) -> TemporalCorrelation:
        return TemporalCorrelation(expit(coordinates[0]), np.exp(coordinates[1]))

    def deviance(coordinates: np.ndarray) -> float:
        return series.whitened(temporal_at(coordinates), values, channel_modes).deviance

    # What lasts from one of an excerpt's frames to the next, too.
    thinned = np.power(CORRELATIONS, 1.0 / np.median(np.diff(series.number)))
    grids = logit(np.union1d(CORRELATIONS, thinned)), np.log(DRIFTS)

    def minimum_along(index: int, coordinates: np.ndarray) -> tuple[float, np.ndarray]:
        """The least deviance by one coordinate, the other being fixed, and where it is."""

        def point(x: float) -> np.ndarray:
            return np.where(np.arange(2) == index, x, coordinates)

        grid = grids[index]
        nearest = int(np.argmin([deviance(point(x)) for x in grid]))
        minimum = minimize_scalar(
            lambda x: deviance(point(x)),
            bounds=(grid[max(nearest - 1, 0)], grid[min(nearest + 1, len(grid) - 1)]),
            method="bounded",
            options={"xatol": TOLERANCE},
        )
        return minimum.fun, point(minimum.x)

    uncorrelated = TemporalCorrelation(0.0, 0.0)
    white = series.whitened(uncorrelated, values, channel_modes)
    minima = [minimum_along(index, np.full(2, -np.inf)) for index in range(2)]
    index = int(np.argmin([minimum_deviance for minimum_deviance, _ in minima]))
    single_deviance, coordinates = minima[index]
    if chi2.sf(white.deviance - single_deviance, 1) > ALPHA:
        return uncorrelated, white
    joint_deviance, start = minimum_along(1 - index, coordinates)
    if chi2.sf(single_deviance - joint_deviance, 1) < BOTH_ALPHA:
        minimum = minimize(
            deviance,
            start,
            method="Nelder-Mead",
            bounds=[(grid[0], grid[-1]) for grid in grids],
            options={"xatol": TOLERANCE, "fatol": DEVIANCE_TOLERANCE},
        )
        if chi2.sf(single_deviance - minimum.fun, 1) < ALPHA:
            coordinates = minimum.x
    temporal = TemporalCorrelation(*map(float, temporal_at(coordinates)))
    return temporal, series.whitened(temporal, values, channel_modes)


def _residual(basis: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values (N, C) less their projection on an orthonormal basis (N, K)."""
    return values - basis @ (basis.T @ values)
