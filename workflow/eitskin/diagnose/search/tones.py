"""Steady tones in the readings: a periodogram over the moments at which channels are read."""

from dataclasses import replace

import numpy as np

from eitskin.diagnose.fitting.candidates import Candidate, Scales
from eitskin.diagnose.fitting.simulator import RecordingSimulator
from eitskin.diagnose.fitting.tangents import Tangents
from eitskin.diagnose.search import screen
from eitskin.effects.effect import Effect
from eitskin.physics.skin import Skin

OVERSAMPLING = 2.5  # of the periodogram: a tone between two lines loses a tenth of its power
FREE_NUMBERS = 3  # of a tone: its frequency, sine and cosine
LEAST_FRAMES = 2 * FREE_NUMBERS  # channels share one static misfit: samples are the frames
MOST_LINES = 400_000  # of the periodogram: more take over a second


def score(
    tangents: Tangents, effect: Effect, skin: Skin, scales: Scales
) -> tuple[screen.Score, float] | None:
    """The strongest tone (Scargle 1982) of the residual, from a quarter of a period a frame to a
    channel's Nyquist frequency, and the probability that noise as strong as around it has such a
    line somewhere (`line_p_value`); None where nobody knows when channels are read, of one channel,
    whose Nyquist frequency is a frame's, and of fewer than LEAST_FRAMES frames."""
    model = tangents.problem.model
    frame_count = int(tangents.problem.whitening.mask.any(axis=1).sum())
    if not model.frame_s or len(model.channels) < 2 or frame_count < LEAST_FRAMES:
        return None
    frequency, looks, prominence = strongest(
        tangents.problem.whitening.transposed(tangents.residual.reshape(tangents.voltage.shape)),
        model.states["time_s"].to_numpy(),
        model.frame_s,
    )
    start = {"frequency_Hz": frequency}
    candidate = Candidate(effect, None, None, "", start, skin, scales, looks)
    if len(tangents.columns(candidate)) < 2:
        return None
    score_test = screen.score(tangents, candidate)
    if score_test is None:
        return None
    return replace(score_test, choices=looks), line_p_value(prominence, looks)


def line_p_value(prominence: float, looks: int) -> float:
    """Probability that the largest power of noise at so many independent frequencies is at least as
    many medians: powers of a periodogram have an exponential distribution."""
    return float(-np.expm1(looks * np.log1p(-(0.5**prominence))))


def at_frequency(candidate: Candidate, frequency_Hz: float, model: RecordingSimulator) -> Candidate:
    """A tone of a stated frequency: one of as many as `score` looks at."""
    start, looks = {"frequency_Hz": frequency_Hz}, candidate.looks
    if model.frame_s:
        time_s = model.states["time_s"].to_numpy()
        looks = _looks(_duration_s(time_s, model.frame_s), len(model.channels), model.frame_s)
    return replace(candidate, start=start, looks=looks)


def _duration_s(time_s: np.ndarray, frame_s: float) -> float:
    """Seconds from the first frame's beginning to the last one's end."""
    return float(time_s[-1] - time_s[0] + frame_s)


def _coarse(width: int, frame_s: float) -> np.ndarray:
    """Frequencies in Hz, half a period a frame apart, up to a channel's Nyquist frequency."""
    return np.arange(0.5 / frame_s, 0.5 * width / frame_s, 0.5 / frame_s)


def _looks(total: float, width: int, frame_s: float) -> int:
    """How many independent frequencies there are."""
    return int(np.ceil(2 * total * _coarse(width, frame_s)[-1]))


def strongest(weighted: np.ndarray, time_s: np.ndarray, frame_s: float) -> tuple[float, int, float]:
    """Frequency in Hz of the strongest tone in weighted residuals (N, M), how many independent
    frequencies were looked at, and its power over the median of the coarse step around it: noise
    that neighbouring channels share is as strong there.

    Coarse: each frame's spectrum over its channels; fine: the frames' phases together. The
    strongest tone is the one of most power over that median, where it is above the median of all.
    """
    _, width = weighted.shape
    total = _duration_s(time_s, frame_s)
    coarse_step = 0.5 / frame_s
    channel = np.arange(width) * frame_s / width
    coarse = _coarse(width, frame_s)
    fine_step = 1.0 / (OVERSAMPLING * total)
    fine_count = max(2, int(np.ceil(coarse_step / fine_step)))
    if len(coarse) * fine_count > MOST_LINES:
        fine_count = max(2, MOST_LINES // len(coarse))
    fine = (np.arange(fine_count) - 0.5 * fine_count) * coarse_step / fine_count
    spectra = weighted @ np.exp(-2j * np.pi * np.outer(channel, coarse))
    turned = spectra * np.exp(-2j * np.pi * np.outer(time_s, coarse))
    phases = np.exp(-2j * np.pi * np.outer(fine, time_s))
    power = np.abs(phases @ turned) ** 2
    around = np.median(power, axis=0)
    background = np.maximum(around, np.median(around))
    i, j = np.unravel_index(np.argmax(power / background), power.shape)
    prominence = float(power[i, j] / max(background[j], np.finfo(float).tiny))
    return float(coarse[j] + fine[i]), _looks(total, width, frame_s), prominence
