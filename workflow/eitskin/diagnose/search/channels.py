"""Single channels' gains and offsets: as many candidates as channels, screened all at once."""

import numpy as np

from eitskin.diagnose.fitting.candidates import Candidate, log_subset_count
from eitskin.diagnose.fitting.jacobian import in_groups
from eitskin.diagnose.fitting.tangents import RESIDUAL_SHARE, Tangents
from eitskin.diagnose.search.screen import (
    AMPLITUDES,
    MOST_SITES,
    Score,
    best_amplitude,
    evidence_along,
    sparse,
    subset_choices,
)
from eitskin.effects.effect import InstrumentEffect

# Share of a channel's squared length beside what is fitted, below which single precision does not
# tell it.
LEAST_SHARE = 0.1


def scores(tangents: Tangents, dense: Candidate) -> list[Score]:
    """Score tests of each channel, of the best few together, and of all at once (`dense`).

    A channel's column is taken to stay within the channel, which is exact but for crosstalk and
    memory in the set; the fit that follows is exact.
    """
    slope, information = _sums(tangents, dense)
    free = information > 0
    gain = np.divide(slope**2, information, out=np.zeros_like(slope), where=free)
    evidence = best_amplitude([evidence_along(slope, information, a) for a in AMPLITUDES])
    order = np.argsort(-evidence)
    count = len(slope)
    scored = []
    for k in order[:2]:
        single = sparse(dense, (int(dense.site_indices[k]),))
        scored.append(Score(single, float(gain[k]), 1, float(evidence[k] - np.log(single.looks))))
    best, subset = -np.inf, order[:0]
    for size in range(2, min(MOST_SITES, count) + 1):
        total = evidence[order[:size]].sum()
        if total - log_subset_count(count, size) <= best:
            break
        best, subset = total - log_subset_count(count, size), order[:size]
    if len(subset):
        best_subset = sparse(dense, tuple(sorted(int(dense.site_indices[k]) for k in subset)))
        total = float(gain[subset].sum())
        scored.append(
            Score(best_subset, total, len(subset), float(best), subset_choices(best_subset))
        )
    dense_evidence = best_amplitude(
        [evidence_along(slope, information, a).sum() for a in AMPLITUDES]
    )
    scored.append(Score(dense, float(gain.sum()), max(1, int(free.sum())), float(dense_evidence)))
    return scored


def looks(dense: Candidate) -> int:
    """How many independent looks `scores` takes at most: each channel, the best few, all."""
    return len(dense.site_indices) + 2


def _sums(tangents: Tangents, dense: Candidate) -> tuple[np.ndarray, np.ndarray]:
    """Slope (M,) and information (M,) of each channel's own column, the fitted projected out; 0
    where the channel's is a fitted one."""
    parameter = next(iter(dense.effect.parameters.values()))
    assert isinstance(dense.effect, InstrumentEffect)
    whitening = tangents.problem.whitening
    shape = tangents.voltage.shape
    column = dense.scales.typical_change(parameter) * dense.effect.slope(tangents.voltage)
    residual = tangents.marginal(tangents.residual.reshape(shape))
    slope = (column * whitening.transposed(residual)).sum(axis=0)
    shared = in_groups(
        lambda fitted: np.einsum(
            "pnm,nm->pm", whitening.transposed(tangents.marginal(fitted)), column
        ),
        tangents.fitted_directions.reshape(-1, *shape),
    )
    fitted_length = (shared**2).sum(axis=0)
    for block in tangents.channel_directions:
        fitted_length = fitted_length + (whitening(column) * block).sum(axis=0) ** 2
    indices = np.arange(len(slope))
    length = tangents.single_precision.channel_lengths(column.astype(np.float32), indices)
    close = np.flatnonzero(length - fitted_length < LEAST_SHARE * length)
    length[close] = whitening.channel_lengths(column, close)
    information = length - fitted_length
    identifiable = information > RESIDUAL_SHARE * length
    return np.where(identifiable, slope, 0.0), np.where(identifiable, information, 0.0)
