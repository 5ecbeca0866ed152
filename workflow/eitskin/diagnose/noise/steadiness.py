"""How steady the noise of a recording is, once a first fit has told what the skin does.

What simulated readings do over the frames, their courses, and a constant are where physics that is
missing and faults of the instrument mostly show; what residuals have beside these is noise. Its
correlation in time, its drift and its size are those of greatest restricted likelihood (Patterson
& Thompson, Biometrika 58, 1971) in the odd half of reciprocity, which no skin moves. A channel's
own noise is what its residual has beyond what tied channels share.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cholesky, qr, solve_triangular
from scipy.linalg.lapack import dpotri
from scipy.optimize import minimize, minimize_scalar
from scipy.special import expit, logit
from scipy.stats import chi2, f

from eitskin.data.recording import Recording, elapsed
from eitskin.diagnose.noise.estimate import (
    ALPHA,
    FLOOR,
    MOST_LOST,
    ROUNDING,
    Noise,
    converter_step,
    parity,
    rank_above_noise,
)
from eitskin.diagnose.noise.outliers import loud_frames, spiked, spread

WRONG = 0.05  # of a course, by which a reading may be off
SHOWN = 0.5  # of the noise in one course, that so much must be to matter
ROUNDS = 3  # in which uneven channels show how to look past what they share
LEAST_LEFT = 8  # frames beside the courses, or contrasts, fewer of which tell nothing
CORRELATIONS = (0.02, 0.3, 0.6, 0.8, 0.9, 0.95, 0.98, 0.995)
DRIFTS = (0.05, 0.2, 0.5, 1.0, 2.0, 5.0, 20.0, 100.0)
CLOSE = 0.02  # of logit and logarithm, to which the two are found
QUIETEST = 1e-6  # of the law's variance, below which no channel's is told
HOPEFUL = 0.1  # p-value of one at the other's place, above which both are not fitted together
SURE = 3.0  # sd, from which a misfit is taken as it is found
NOTHING = 1e-2  # of the noise: residuals below it hold none
RIDGE = 1e-9  # of a precision's diagonal, for courses that only lost readings showed


@dataclass(frozen=True)
class _Left:
    """Values (N, C) whitened in time beside the courses, their sums of squares (C,), degrees of
    freedom (C,) and what the logarithm of the likelihood's determinants comes to; filled (N, C):
    the values with the lost ones as the others have them."""

    white: np.ndarray
    squares: np.ndarray
    dof: np.ndarray
    determinant: float
    filled: np.ndarray

    @property
    def deviance(self) -> float:
        """-2 log restricted likelihood, each column's scale at its best."""
        size = self.squares / self.dof
        return float(np.sum(self.dof * np.log(np.maximum(size, 1e-300))) + self.determinant)


@dataclass(frozen=True)
class _Time:
    """Frames that are kept: their numbers (N,), share (N,) of the time gone, courses (N, K)."""

    number: np.ndarray
    share: np.ndarray
    courses: np.ndarray

    def left(
        self, steadiness: tuple[float, float], values: np.ndarray, modes: np.ndarray | None = None
    ) -> _Left:
        """Of values (N, C), NaN where lost, under (correlation, drift); modes (C, R): directions
        over the columns that are taken out."""
        rho, drift = steadiness
        cover = drift**2 * np.minimum.outer(self.share, self.share)
        apart = np.abs(np.subtract.outer(self.number, self.number)).astype(float)
        cover += rho**apart
        root = cholesky(cover, lower=True)
        lost = np.isnan(values)
        filled = np.where(lost, 0.0, values)
        basis, upper = qr(solve_triangular(root, self.courses, lower=True), mode="economic")
        white = _beside(basis, solve_triangular(root, filled, lower=True))
        one = 2.0 * (np.log(np.diag(root)).sum() + np.log(np.abs(np.diag(upper))).sum())
        determinant = one * (values.shape[1] - (0 if modes is None else modes.shape[1]))
        dof = np.full(values.shape[1], float(len(values) - self.courses.shape[1]))
        if lost.any():
            inverse = np.tril(dpotri(root, lower=1)[0])
            back = solve_triangular(root, basis, lower=True, trans="T")
            precision = inverse + np.tril(inverse, -1).T - back @ back.T
            pull = solve_triangular(root, white, lower=True, trans="T")
            for k in np.flatnonzero(lost.any(axis=0)):
                gone = np.flatnonzero(lost[:, k])
                own = precision[np.ix_(gone, gone)] * (1.0 + RIDGE * np.eye(len(gone)))
                filled[gone, k] = -np.linalg.solve(own, pull[gone, k])
                determinant += np.linalg.slogdet(own)[1]
                dof[k] -= len(gone)
            white = _beside(basis, solve_triangular(root, filled, lower=True))
        if modes is not None:
            white -= (white @ modes) @ modes.T
            dof *= 1.0 - np.sum(modes**2, axis=1)
        return _Left(white, np.sum(white**2, axis=0), dof, determinant, filled)


@dataclass(frozen=True)
class _Channels:
    """Combinations (M, P), orthonormal, of readings in units of `unit` (M,) that hold noise alone.

    odd, even: the halves of reciprocity; where that ties few channels, `odd` is empty and the
    combinations are beside what simulated readings do over the channels.
    """

    own: np.ndarray
    unit: np.ndarray
    odd: np.ndarray
    even: np.ndarray

    @classmethod
    def of(
        cls, halves: tuple, lost: np.ndarray, sd: np.ndarray, patterns: np.ndarray
    ) -> "_Channels":
        """Of odd and even half, lost readings (N, M), noise sd (M,) and patterns (M, G) over
        channels in units of it."""
        odd, even = halves
        gone = (lost.astype(float) @ (odd != 0.0) > 0.0).mean(axis=0)
        odd = odd[:, gone <= MOST_LOST]
        if odd.shape[1] >= LEAST_LEFT:
            return cls(odd, np.ones(len(sd)), odd, even)
        common = np.column_stack([1.0 / sd, patterns])
        own = np.linalg.qr(common, mode="complete")[0][:, common.shape[1] :]
        return cls(own, sd, np.empty((len(sd), 0)), np.eye(len(sd)))

    @property
    def paired(self) -> bool:
        """Whether reciprocity tells of the noise."""
        return self.odd.shape[1] > 0

    def variance(self, sd: np.ndarray) -> np.ndarray:
        """(P,) of the combinations, of channels' noise sd (M,)."""
        return (self.own**2).T @ (sd / self.unit) ** 2

    def values(self, residual: np.ndarray) -> np.ndarray:
        """(N, P) of residuals (N, M), NaN where lost."""
        lost = np.isnan(residual)
        if self.paired:
            values = np.where(lost, 0.0, residual) @ self.odd
            values[(lost.astype(float) @ (self.odd != 0.0)) > 0.0] = np.nan
            return values
        rows, filled = np.arange(len(residual)), residual / self.unit
        for k in np.flatnonzero(lost.any(axis=0)):
            there = ~lost[:, k]
            filled[:, k] = np.interp(rows, rows[there], filled[there, k])
        return filled @ self.own


def refine(recording: Recording, noise: Noise, simulated: np.ndarray) -> Noise:
    """The noise of a recording, `noise` by the recording alone, with what residuals tell of its
    correlation, its drift, its channels, loud frames and spikes.

    simulated (N, M): noise-free readings of a first fit, NaN in frames that cannot be simulated.
    What is not significant stays as it was; so does all where too few frames or channels are left.
    """
    residual = recording.voltage - simulated
    rows, usable = _kept(~np.isfinite(residual))
    if min(len(rows), len(usable)) < 2 * LEAST_LEFT:
        return noise
    left, law = residual[np.ix_(rows, usable)], noise.sd[usable]
    shown = simulated[np.ix_(rows, usable)]
    halves = parity(recording.channels[usable], recording.metadata["voltage"] == "signed")
    level = np.median(spread((left - np.nanmedian(left, axis=0)) / law))
    if level < NOTHING:
        return noise
    courses, patterns = _modes(shown / (min(level, 1.0) * law))
    channels = _Channels.of(halves, np.isnan(left), law, patterns)
    values = channels.values(left) / np.sqrt(channels.variance(law))
    if np.median(spread(values)) < NOTHING:
        return noise
    loud = loud_frames(values if channels.paired else left, courses)
    quiet, courses = rows[~loud], np.linalg.qr(courses[~loud])[0]
    if len(quiet) - courses.shape[1] < LEAST_LEFT:
        return noise
    struck = spiked(left[~loud], channels.odd, channels.even, courses)
    left = np.where(struck, np.nan, left[~loud])
    number = recording.frames["frame"].to_numpy()[quiet]
    time = _Time(number, elapsed(recording.frames)[quiet], courses)
    found = _Found.of(time, channels, left, law)
    for _ in range(0 if channels.paired else ROUNDS):
        if found.uneven:
            patterns = _modes(shown[~loud] / found.sd)[1]
            channels = _Channels.of(halves, np.isnan(left), found.sd, patterns)
            found = _Found.of(time, channels, left, found.sd)
    strays = bool(loud.any() or struck.any())
    uneven = bool(np.ptp(found.sd / law) > 1e-9 * np.max(found.sd / law))
    if not (strays or any(found.steadiness) or uneven or found.differs(noise.dof)):
        return noise
    sd = noise.sd * np.sqrt(np.mean((found.sd / law) ** 2))
    sd[usable] = found.sd
    sd = np.maximum(sd, FLOOR * np.nanmedian(np.abs(recording.readings)))
    sd = np.maximum(sd, ROUNDING * converter_step(recording.readings))
    lost = np.zeros(residual.shape, bool)
    lost[rows[loud]] = True
    lost[np.ix_(quiet, usable)] = struck
    larger, spikes = float(np.median(sd / noise.sd)), int(struck.sum())
    said = _said(larger, *found.steadiness, uneven, int(loud.sum()), spikes)
    return replace(
        noise,
        sd=sd,
        dof=found.dof,
        source=f"{noise.source}; by the residuals of a first fit {', '.join(said)}",
        correlation=found.steadiness[0],
        drift=found.steadiness[1],
        lost=lost if strays else None,
        loud_frames=tuple(rows[loud].tolist()),
        spikes=spikes,
    )


def _said(
    larger: float, correlation: float, drift: float, uneven: bool, loud: int, spikes: int
) -> list[str]:
    """What residuals tell of the noise, in words; larger: how many times."""
    said = [f"{larger:.3g} times as large"]
    said += [f"correlated from frame to frame, {correlation:.2g}"] * bool(correlation)
    said += [f"drifting by {drift:.2g} of its size to the end"] * bool(drift)
    said += ["uneven over the channels"] * uneven
    return said + [f"{loud} loud frames and {spikes} spikes put aside"] * bool(loud or spikes)


def _kept(lost: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of (N, M) that are not mostly lost."""
    rows = np.flatnonzero(lost.mean(axis=1) <= MOST_LOST)
    if len(rows) == 0:
        return rows, rows
    columns = np.flatnonzero(lost[rows].mean(axis=0) <= MOST_LOST)
    rows = rows[lost[np.ix_(rows, columns)].mean(axis=1) <= MOST_LOST] if len(columns) else columns
    return rows, columns


@dataclass(frozen=True)
class _Found:
    """steadiness: (correlation, drift); level: overall variance over the law's; sd (M,) of the
    channels; uneven: whether they differ from the law; dof of the level."""

    steadiness: tuple[float, float]
    level: float
    sd: np.ndarray
    uneven: bool
    dof: float

    @classmethod
    def of(
        cls, time: _Time, channels: _Channels, residual: np.ndarray, law: np.ndarray
    ) -> "_Found":
        """Of residuals (N, M), NaN where lost, and the channels' noise sd (M,) by the law."""
        values = channels.values(residual) / np.sqrt(channels.variance(law))
        size = spread(values)
        own = (np.isnan(values).mean(axis=0) <= MOST_LOST) & (size > NOTHING * np.median(size))
        channels = replace(channels, own=channels.own[:, own])
        steadiness, left = _steadiness(time, values[:, own])
        size = np.sqrt(left.squares / left.dof)
        modes = _coherent(left.white / size, len(time.number) - time.courses.shape[1])
        if modes.shape[1]:
            steadiness, left = _steadiness(time, left.filled / size, modes)
            left = replace(left, squares=left.squares * size**2)
        level = float(left.squares.sum() / left.dof.sum())
        predicted = channels.variance(law)
        scale = (np.sqrt(predicted) * size)[:, None]
        coherent = (channels.own / scale.T) @ modes @ modes.T @ (scale * channels.own.T)
        sd, uneven = _own(time, channels, residual, steadiness, level, law, coherent)
        ratio = left.squares * predicted / channels.variance(sd)
        sd = sd * np.sqrt(ratio.sum() / left.dof.sum())
        return cls(steadiness, level, sd, uneven, float(left.dof.sum()))

    def differs(self, dof: float) -> bool:
        """Whether the level is another than that of a law with so many degrees of freedom."""
        tails = f.cdf(self.level, self.dof, dof), f.sf(self.level, self.dof, dof)
        return 2.0 * min(tails) < ALPHA


def _steadiness(
    time: _Time, values: np.ndarray, modes: np.ndarray | None = None
) -> tuple[tuple[float, float], _Left]:
    """(correlation, drift) of values (N, C), each 0 unless the likelihood asks for it, and what is
    left by them."""

    def deviance(at: np.ndarray) -> float:
        return time.left((expit(at[0]), np.exp(at[1])), values, modes).deviance

    # What lasts from one of an excerpt's frames to the next, too.
    thinned = np.power(CORRELATIONS, 1.0 / np.median(np.diff(time.number)))
    grids = logit(np.union1d(CORRELATIONS, thinned)), np.log(DRIFTS)

    def along(index: int, at: np.ndarray) -> tuple[float, np.ndarray]:
        def moved(x: float) -> np.ndarray:
            return np.where(np.arange(2) == index, x, at)

        grid = grids[index]
        best = int(np.argmin([deviance(moved(x)) for x in grid]))
        within = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
        found = minimize_scalar(
            lambda x: deviance(moved(x)), bounds=within, method="bounded", options={"xatol": CLOSE}
        )
        return found.fun, moved(found.x)

    none = time.left((0.0, 0.0), values, modes)
    alone = [along(index, np.full(2, -np.inf)) for index in range(2)]
    index = int(np.argmin([least for least, _ in alone]))
    least, at = alone[index]
    if chi2.sf(none.deviance - least, 1) > ALPHA:
        return (0.0, 0.0), none
    both, start = along(1 - index, at)
    if chi2.sf(least - both, 1) < HOPEFUL:
        bounds = [(grid[0], grid[-1]) for grid in grids]
        options = {"xatol": CLOSE, "fatol": 0.1}
        found = minimize(deviance, start, method="Nelder-Mead", bounds=bounds, options=options)
        if chi2.sf(least - found.fun, 1) < ALPHA:
            at = found.x
    steadiness = float(expit(at[0])), float(np.exp(at[1]))
    return steadiness, time.left(steadiness, values, modes)


def _coherent(white: np.ndarray, rows: int) -> np.ndarray:
    """(C, R) directions over the columns of (N, C), of a rank of `rows`, that are no noise."""
    _, sizes, right = np.linalg.svd(white, full_matrices=False)
    return right[: rank_above_noise(sizes, (rows, white.shape[1]))].T


def _own(
    time: _Time,
    channels: _Channels,
    residual: np.ndarray,
    steadiness: tuple[float, float],
    level: float,
    law: np.ndarray,
    coherent: np.ndarray,
) -> tuple[np.ndarray, bool]:
    """Noise sd (M,) of each channel, and whether they differ from the law (M,) at a level.

    coherent (M, M): takes of residuals what is coherent in their combinations. What channels that
    reciprocity ties have in common is misfit: no part of the variance of each, as far as it is
    there at all. Logarithms are drawn together as far as they scatter no more than by chance.
    """
    left = time.left(steadiness, residual / channels.unit)
    variance = level * (law / channels.unit) ** 2
    taken = np.eye(len(law)) - coherent
    if not channels.paired:
        taken = taken @ channels.own @ channels.own.T
    whole = left.white @ taken
    others = channels.even @ channels.even.T
    alike = np.diag(others).copy()
    np.fill_diagonal(others, 0.0)
    total = np.abs(others).sum(axis=0)
    tied = total > 0.0
    others = others / np.where(tied, total, 1.0)
    beside = whole @ others

    def per_dof(one: np.ndarray, other: np.ndarray) -> np.ndarray:
        return np.sum(one * other, axis=0) / left.dof

    square = per_dof(whole, whole) / (variance @ taken**2)
    product = (per_dof(whole, beside) - variance @ (taken * (taken @ others))) / variance
    scatter = (square * per_dof(beside, beside) / variance + product**2) / left.dof
    # Channels of a group say the same of its misfit: together they count once.
    once = np.where(tied, alike, 0.0)
    weight = once / np.where(tied, np.maximum(scatter, QUIETEST), 1.0)
    excess = weight @ product**2
    misfit = np.zeros(len(law))
    if tied.any() and chi2.sf(excess, once.sum()) < ALPHA:
        wide = (excess - once.sum()) / weight.sum()
        misfit = np.where(tied, wide / (wide + scatter), 0.0)
        misfit[product > SURE * np.sqrt(scatter)] = 1.0
    share = np.maximum(square - np.maximum(misfit * product, 0.0), QUIETEST)
    uncertain = 2.0 / left.dof + misfit * scatter / share**2
    shrunk = _shrunk(np.log(share), np.where(share > QUIETEST, uncertain, np.inf))
    return law * np.sqrt(level * np.exp(shrunk)), bool(shrunk.any())


def _shrunk(values: np.ndarray, scatter: np.ndarray) -> np.ndarray:
    """(M,) values of known scatter (variance), drawn to their mean as far as that of the true ones
    asks for (DerSimonian & Laird, Control. Clin. Trials 7, 1986); 0 where chance makes them."""
    weight = 1.0 / scatter
    mean = weight @ values / weight.sum()
    heterogeneity = weight @ (values - mean) ** 2
    if chi2.sf(heterogeneity, len(values) - 1) > ALPHA:
        return np.zeros(len(values))
    room = weight.sum() - np.sum(weight**2) / weight.sum()
    true = max(heterogeneity - len(values) + 1, 0.0) / room
    weight = 1.0 / (scatter + true)
    mean = weight @ values / weight.sum()
    return mean + true * weight * (values - mean)


def _modes(shown: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Courses (N, 1 + K), a constant first, and patterns (M, 1 + K), the mean first, of simulated
    readings (N, M) in units of their noise: those of which a small share would show in it."""
    mean = shown.mean(axis=0)
    left, sizes, right = np.linalg.svd(shown - mean, full_matrices=False)
    count = int(np.sum(WRONG * sizes > SHOWN * np.sqrt(shown.shape[1])))
    count = min(count, len(shown) // 3, shown.shape[1] // 2 - LEAST_LEFT // 2)
    constant = np.full(len(shown), len(shown) ** -0.5)
    return np.column_stack([constant, left[:, :count]]), np.column_stack([mean, right[:count].T])


def _beside(basis: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values (N, C) less what they have in an orthonormal basis (N, K)."""
    return values - basis @ (basis.T @ values)
