"""Single channels' gains and offsets: as many candidates as channels, screened all at once."""

import numpy as np
from scipy.special import chdtrc

from eitskin.diagnose.candidates import Candidate, log_ways
from eitskin.diagnose.search.screen import (
    AMPLITUDES,
    MOST_SITES,
    Score,
    best_amplitude,
    evidence_along,
    sparse,
)
from eitskin.diagnose.tangents import Tangents


def scores(tangents: Tangents, dense: Candidate) -> list[Score]:
    """Score tests of each channel, of the best few together, and of all at once (`dense`).

    A channel's column is taken to stay within the channel, which is exact but for crosstalk and
    memory already found; the fit that follows is exact.
    """
    slope, information = _sums(tangents, dense)
    gain = slope**2 / np.maximum(information, 1e-300)
    evidence = best_amplitude([evidence_along(slope, information, a) for a in AMPLITUDES])
    order = np.argsort(-evidence)
    count = len(slope)
    found = []
    for k in order[:2]:
        found.append(_score(sparse(dense, (int(dense.sites[k]),)), gain[k], 1, evidence[k]))
    best, chosen = -np.inf, []
    for size in range(2, MOST_SITES + 1):
        total = evidence[order[:size]].sum()
        if total - log_ways(count, size) <= best:
            break
        best, chosen = total - log_ways(count, size), order[:size]
    if len(chosen):
        sites = tuple(sorted(int(dense.sites[k]) for k in chosen))
        found.append(_score(sparse(dense, sites), gain[chosen].sum(), len(chosen), best, 0.0))
    together = best_amplitude([evidence_along(slope, information, a).sum() for a in AMPLITUDES])
    found.append(_score(dense, gain.sum(), count, together, 0.0))
    return found


def _score(candidate, gain, dof, evidence, ways: float | None = None) -> Score:
    ways = np.log(candidate.looks) if ways is None else ways
    p = float(chdtrc(dof, gain))
    return Score(candidate, float(gain), int(dof), p, float(evidence - ways))


def _sums(tangents: Tangents, dense: Candidate) -> tuple[np.ndarray, np.ndarray]:
    """Slope (M,) and information (M,) of each channel's own column, the fitted projected out."""
    parameter = next(iter(dense.effect.parameters.values()))
    whitening = tangents.problem.whitening
    shape = tangents.voltage.shape
    column = dense.scales.of(parameter) * dense.effect.slope(tangents.voltage)
    slope = (column * whitening.back(tangents.residual.reshape(shape))).sum(axis=0)
    fitted = whitening.back(tangents.fitted.reshape(-1, *shape))
    shared = np.einsum("pnm,nm->pm", fitted, column)
    information = whitening.channel_lengths(column) - (shared**2).sum(axis=0)
    for block in tangents.blocks:
        information = information - (whitening(column) * block).sum(axis=0) ** 2
    return slope, np.maximum(information, 0.0)
