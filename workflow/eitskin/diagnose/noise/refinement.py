"""The noise of a recording refined by the residuals of a first fit.

What simulated readings do over the frames, their time modes, and a constant are where physics that
is missing and faults of the instrument mostly show; what residuals have beside these is noise. Its
correlation in time, its drift and its size come from the odd half of reciprocity, which no skin
moves (`temporal_correlation`), and the sd of channels from what tied channels do not share
(`channel_sds`). Loud frames and spikes are rejected before.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import f

from eitskin.data.recording import Recording, elapsed
from eitskin.diagnose.noise.channel_sds import channel_sds
from eitskin.diagnose.noise.coherent_rank import rank_above_noise
from eitskin.diagnose.noise.converter import ROUNDING, converter_step
from eitskin.diagnose.noise.estimate import ALPHA, FLOOR, MOST_LOST
from eitskin.diagnose.noise.noise_combinations import LEAST_COMBINATIONS, NoiseCombinations
from eitskin.diagnose.noise.noise_model import NoiseModel
from eitskin.diagnose.noise.outliers import loud_frames, reading_spikes, robust_sd
from eitskin.diagnose.noise.reciprocity import parity
from eitskin.diagnose.noise.temporal_correlation import (
    FrameSeries,
    TemporalCorrelation,
    temporal_correlation,
)

MODE_ERROR = 0.05  # of a time mode, by which the simulation may be off
MODE_LEVEL = 0.5  # of the noise in one time mode, that such an error must be to matter
UNEVEN_ROUNDS = 3  # in which uneven channels show how to look past what they share
LEAST_FRAMES = LEAST_COMBINATIONS  # beside the time modes, likewise
NEGLIGIBLE = 1e-2  # of the noise: residuals below it hold none
EVEN = 1e-9  # of an sd over the law's, by which channels differ by rounding alone


def refine_noise(recording: Recording, noise: NoiseModel, simulated: np.ndarray) -> NoiseModel:
    """The noise of a recording, `noise` by the recording alone, with what residuals show of its
    correlation, its drift, its channels, loud frames and spikes.

    simulated (N, M): noise-free readings of a first fit, NaN in frames that cannot be simulated.
    What is not significant stays as it was; so does all where too few frames or channels are
    usable.
    """
    residual = recording.voltage - simulated
    rows, usable = _usable(~np.isfinite(residual))
    if min(len(rows), len(usable)) < 2 * LEAST_COMBINATIONS:
        return noise
    residual, law_sd = residual[np.ix_(rows, usable)], noise.sd[usable]
    simulated = simulated[np.ix_(rows, usable)]
    halves = parity(recording.channels[usable], recording.metadata["voltage"] == "signed")
    level = np.median(robust_sd((residual - np.nanmedian(residual, axis=0)) / law_sd))
    if level < NEGLIGIBLE:
        return noise
    time_modes, channel_modes = _modes(simulated / (min(level, 1.0) * law_sd))
    combinations = NoiseCombinations.from_residual(halves, residual, law_sd, channel_modes)
    values = combinations.values(residual) / np.sqrt(combinations.variance(law_sd))
    if np.median(robust_sd(values)) < NEGLIGIBLE:
        return noise
    loud = loud_frames(values if combinations.reciprocal else residual, time_modes)
    quiet, time_modes = rows[~loud], np.linalg.qr(time_modes[~loud])[0]
    if len(quiet) - time_modes.shape[1] < LEAST_FRAMES:
        return noise
    spikes = reading_spikes(residual[~loud], combinations.odd, combinations.even, time_modes)
    residual, simulated = np.where(spikes, np.nan, residual[~loud]), simulated[~loud]
    number = recording.frames["frame"].to_numpy()[quiet]
    series = FrameSeries(number, elapsed(recording.frames)[quiet], time_modes)
    refined = _ResidualNoise.from_residual(series, combinations, residual, law_sd)
    for _ in range(0 if combinations.reciprocal else UNEVEN_ROUNDS):
        if refined.uneven:
            channel_modes = _modes(simulated / refined.sd)[1]
            combinations = NoiseCombinations.from_residual(
                halves, residual, refined.sd, channel_modes
            )
            refined = _ResidualNoise.from_residual(series, combinations, residual, refined.sd)
    ratio = refined.sd / law_sd
    has_outliers = bool(loud.any() or spikes.any())
    uneven = bool(np.ptp(ratio) > EVEN * np.max(ratio))
    if not (has_outliers or any(refined.temporal) or uneven or refined.differs(noise.dof)):
        return noise
    sd = noise.sd * np.sqrt(np.mean(ratio**2))
    sd[usable] = refined.sd
    sd = np.maximum(sd, FLOOR * np.nanmedian(np.abs(recording.readings)))
    sd = np.maximum(sd, ROUNDING * converter_step(recording.readings))
    rejected = np.zeros(recording.readings.shape, bool)
    rejected[rows[loud]] = True
    rejected[np.ix_(quiet, usable)] = spikes
    span = float(np.ptp(series.number))
    wander = refined.temporal.spectrum.wander(span)
    words = [f"{float(np.median(sd / noise.sd)):.3g} times as large"]
    words += refined.temporal_words()
    words += ["uneven over the channels"] * uneven
    if has_outliers:
        words += [f"{loud.sum()} loud frames and {spikes.sum()} spikes put aside"]
    return replace(
        noise,
        sd=sd * np.sqrt(1.0 - sum(wander.shares)),
        dof=refined.dof,
        source=f"{noise.source}; by the residuals of a first fit {', '.join(words)}",
        spectrum=refined.temporal.spectrum.followed(span),
        wander=wander,
        drift=refined.temporal.drift,
        rejected_mask=rejected if has_outliers else None,
        loud_frames=tuple(rows[loud].tolist()),
        spike_count=int(spikes.sum()),
    )


@dataclass(frozen=True)
class _ResidualNoise:
    """The noise that residuals show: spectrum and drift; level: overall variance over that of
    the law; sd (M,) of the channels; uneven: whether they differ from the law; dof of the level."""

    temporal: TemporalCorrelation
    level: float
    sd: np.ndarray
    uneven: bool
    dof: float

    @classmethod
    def from_residual(
        cls,
        series: FrameSeries,
        combinations: NoiseCombinations,
        residual: np.ndarray,
        law_sd: np.ndarray,
    ) -> "_ResidualNoise":
        """Of residuals (N, M), NaN where lost, and the channels' noise sd (M,) by the law."""
        values = combinations.values(residual) / np.sqrt(combinations.variance(law_sd))
        size = robust_sd(values)
        lost_share = np.isnan(values).mean(axis=0)
        used = (lost_share <= MOST_LOST) & (size > NEGLIGIBLE * np.median(size))
        combinations = replace(combinations, basis=combinations.basis[:, used])
        temporal, white = temporal_correlation(series, values[:, used])
        size = np.sqrt(white.squares / white.dof)
        rank = len(series.number) - series.time_modes.shape[1]
        modes = _coherent_modes(white.white / size, rank)
        if modes.shape[1]:
            temporal, white = temporal_correlation(series, white.filled / size, modes)
            white = replace(white, squares=white.squares * size**2)
        level = float(white.squares.sum() / white.dof.sum())
        predicted = combinations.variance(law_sd)
        scale = (np.sqrt(predicted) * size)[:, None]
        coherent = (combinations.basis / scale.T) @ modes @ modes.T @ (scale * combinations.basis.T)
        channels = series.whitened(temporal, residual / combinations.unit)
        sd, uneven = channel_sds(combinations, channels, law_sd, level, coherent)
        ratio = white.squares * predicted / combinations.variance(sd)
        sd = sd * np.sqrt(ratio.sum() / white.dof.sum())
        return cls(temporal, level, sd, uneven, float(white.dof.sum()))

    def differs(self, law_dof: float) -> bool:
        """Whether the level is significantly another than that of a law of some dof."""
        tails = f.cdf(self.level, self.dof, law_dof), f.sf(self.level, self.dof, law_dof)
        return 2.0 * min(tails) < ALPHA

    def temporal_words(self) -> list[str]:
        """Correlation and drift in words, for a reader; none of what is 0."""
        spectrum, drift = self.temporal
        words = [f"correlated from frame to frame, {spectrum.lag_one:.2g}"] * bool(spectrum)
        return words + [f"drifting by {drift:.2g} of its size to the end"] * bool(drift)


def _usable(lost: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of (N, M) that are not mostly lost."""
    rows = np.flatnonzero(lost.mean(axis=1) <= MOST_LOST)
    if len(rows) == 0:
        return rows, rows
    columns = np.flatnonzero(lost[rows].mean(axis=0) <= MOST_LOST)
    rows = rows[lost[np.ix_(rows, columns)].mean(axis=1) <= MOST_LOST] if len(columns) else columns
    return rows, columns


def _coherent_modes(white: np.ndarray, rank: int) -> np.ndarray:
    """(C, R) directions over the columns of (N, C), of some rank, that are no noise."""
    _, singular_values, right_vectors = np.linalg.svd(white, full_matrices=False)
    return right_vectors[: rank_above_noise(singular_values, (rank, white.shape[1]))].T


def _modes(scaled: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Time modes (N, 1 + K), a constant first, and channel modes (M, 1 + K), the mean first, of
    simulated readings (N, M) in units of their noise: those of which an error of MODE_ERROR would
    show in it."""
    mean = scaled.mean(axis=0)
    left_vectors, singular_values, right_vectors = np.linalg.svd(scaled - mean, full_matrices=False)
    count = int(np.sum(MODE_ERROR * singular_values > MODE_LEVEL * np.sqrt(scaled.shape[1])))
    count = min(count, len(scaled) // 3, scaled.shape[1] // 2 - LEAST_COMBINATIONS // 2)
    constant = np.full(len(scaled), len(scaled) ** -0.5)
    return np.column_stack([constant, left_vectors[:, :count]]), np.column_stack(
        [mean, right_vectors[:count].T]
    )
