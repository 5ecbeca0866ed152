"""Spectrum and drift of noise, by restricted likelihood.

The noise of each column has the covariance s^2 (R + drift^2 min(t_n, t_m)) over frames n, m with
elapsed shares t of time: noise of a spectrum R (`spectrum`) and a random walk. Of residuals beside
time modes, they are those of the greatest restricted likelihood (Patterson & Thompson, Biometrika
58, 1971): processes and drift enter one by one, each if a likelihood ratio asks for it.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, qr, solve_triangular
from scipy.linalg.lapack import dpotri
from scipy.optimize import minimize
from scipy.special import expit, logit
from scipy.stats import chi2

from eitskin.diagnose.noise.estimate import ALPHA
from eitskin.diagnose.noise.spectrum import WHITE, Spectrum

# Starts of a search: of a process its correlation from frame to frame and its share of the noise
# beside the drift. Between neighbours the likelihood has one maximum.
CORRELATIONS = (0.1, 0.4, 0.7, 0.85, 0.93, 0.97, 0.99)
SHARES = (0.05, 0.3, 0.8)
DRIFTS = (0.1, 0.3, 1.0, 3.0, 10.0, 50.0)
LARGEST_LOGIT = 14.0  # of a share or a correlation: beyond it is 1, or 0
DRIFT_BOUNDS = (-5.0, 6.0)  # of a drift's logarithm
MOST_PROCESSES = 2  # that last: with the white noise and the drift four timescales
LONGEST = 0.35  # of the recording, that a process lasts: what is slower is a drift
TOLERANCE = 0.02  # of logit and logarithm: a tenth of their standard errors, or less
DEVIANCE_TOLERANCE = 0.05
RIDGE = 1e-9  # of a precision's diagonal, for time modes that only lost readings showed
LEAST_VARIANCE = 1e-300  # keeps a logarithm finite


class TemporalCorrelation(NamedTuple):
    """Of noise: its spectrum, and the sd of a random walk at the end, in units of the noise."""

    spectrum: Spectrum = WHITE
    drift: float = 0.0


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
        covariance += temporal.spectrum.covariance(self.number)
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
    """Spectrum and drift of values (N, C), NaN where lost, as far as the likelihood asks for them,
    and the values whitened by them; channel_modes (C, R): as in `FrameSeries.whitened`."""
    search = _SpectrumSearch(series, values, channel_modes)
    best = _Point((), None)
    deviance = search.deviance(best)
    while True:
        grown, grown_deviance = search.grown(best)
        added = len(grown.coordinates) - len(best.coordinates)
        if added == 0 or chi2.sf(deviance - grown_deviance, added) > ALPHA:
            break
        best, deviance = grown, grown_deviance
    temporal = best.temporal
    return temporal, series.whitened(temporal, values, channel_modes)


class _Point(NamedTuple):
    """Coordinates of a spectrum and a drift: of each process the logits of its correlation and of
    its share of what earlier processes leave; the logarithm of the drift, None for none."""

    processes: tuple[tuple[float, float], ...]
    log_drift: float | None

    @property
    def coordinates(self) -> np.ndarray:
        """(P,): all of them."""
        last = () if self.log_drift is None else (self.log_drift,)
        return np.array([*(c for process in self.processes for c in process), *last])

    def moved(self, coordinates: np.ndarray) -> "_Point":
        """The point of the same kind at coordinates (P,)."""
        count = 2 * len(self.processes)
        pairs = tuple((float(a), float(b)) for a, b in coordinates[:count].reshape(-1, 2))
        return _Point(pairs, None if self.log_drift is None else float(coordinates[count]))

    @property
    def temporal(self) -> TemporalCorrelation:
        """The spectrum and the drift."""
        rest, shares = 1.0, []
        for _, share in self.processes:
            shares.append(rest * float(expit(share)))
            rest -= shares[-1]
        correlations = tuple(float(expit(process[0])) for process in self.processes)
        drift = 0.0 if self.log_drift is None else float(np.exp(self.log_drift))
        return TemporalCorrelation(Spectrum(correlations, tuple(shares)), drift)


@dataclass(frozen=True)
class _SpectrumSearch:
    """The restricted likelihood of series of values (N, C) beside channel modes (C, R)."""

    series: FrameSeries
    values: np.ndarray
    channel_modes: np.ndarray | None

    def deviance(self, point: _Point) -> float:
        """-2 log restricted likelihood."""
        return self.series.whitened(point.temporal, self.values, self.channel_modes).deviance

    @property
    def correlation_logits(self) -> np.ndarray:
        """(G,): of CORRELATIONS from one frame of the series to the next, and of what lasts so from
        one frame's number to the next, none that lasts more than LONGEST of all."""
        gap = float(np.median(np.diff(self.series.number)))
        correlations = np.power(CORRELATIONS, 1.0 / gap)
        if gap > 1.0:
            correlations = np.union1d(correlations, CORRELATIONS)
        return logit(correlations[correlations <= self.longest_correlation])

    @property
    def longest_correlation(self) -> float:
        """From one frame's number to the next, of a process that lasts LONGEST of all."""
        return float(np.exp(-1.0 / max(LONGEST * np.ptp(self.series.number), 1.0)))

    def grown(self, point: _Point) -> tuple[_Point, float]:
        """The best point with one process more, or with a drift, and its deviance; the point itself
        where there may be no more."""
        starts = []
        if len(point.processes) < MOST_PROCESSES:
            starts += [
                _Point((*point.processes, (c, float(logit(share)))), point.log_drift)
                for c in self.correlation_logits
                for share in SHARES
            ]
        if point.log_drift is None:
            starts += [_Point(point.processes, float(np.log(drift))) for drift in DRIFTS]
        if not starts:
            return point, self.deviance(point)
        deviances = [self.deviance(start) for start in starts]
        kinds = [start.log_drift is None for start in starts]
        ends = []
        for kind in set(kinds):
            of_kind = [i for i, k in enumerate(kinds) if k == kind]
            best = min(of_kind, key=lambda i: deviances[i])
            ends.append(self._optimum(starts[best]))
        return min(ends, key=lambda end: end[1])

    def _optimum(self, start: _Point) -> tuple[_Point, float]:
        """The point of least deviance near a start, and its deviance."""
        longest = float(logit(self.longest_correlation))
        process = [(-LARGEST_LOGIT, longest), (-LARGEST_LOGIT, LARGEST_LOGIT)]
        bounds = process * len(start.processes)
        bounds += [DRIFT_BOUNDS] * (start.log_drift is not None)
        minimum = minimize(
            lambda coordinates: self.deviance(start.moved(coordinates)),
            start.coordinates,
            method="Nelder-Mead",
            bounds=bounds,
            options={"xatol": TOLERANCE, "fatol": DEVIANCE_TOLERANCE},
        )
        return start.moved(minimum.x), float(minimum.fun)


def _residual(basis: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values (N, C) less their projection on an orthonormal basis (N, K)."""
    return values - basis @ (basis.T @ values)
