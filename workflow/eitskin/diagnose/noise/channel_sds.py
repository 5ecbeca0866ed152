"""The noise of single channels: what a channel's residual has beyond what tied channels share."""

import numpy as np
from scipy.stats import chi2

from eitskin.diagnose.noise.estimate import ALPHA
from eitskin.diagnose.noise.noise_combinations import NoiseCombinations
from eitskin.diagnose.noise.temporal_correlation import WhitenedSeries

LEAST_SHARE = 1e-6  # of the law's variance: no channel is that much quieter, but for rounding
CERTAIN = 3.0  # sd, from which a misfit is taken out as it is found, not drawn towards the others'


def channel_sds(
    combinations: NoiseCombinations,
    series: WhitenedSeries,
    law_sd: np.ndarray,
    level: float,
    coherent: np.ndarray,
) -> tuple[np.ndarray, bool]:
    """Sd (M,) of each channel's noise, and whether they differ from those of a law.

    series: residuals (N, M) in the combinations' unit, whitened in time; law_sd (M,): by the law;
    level: variance of the combinations over the law's. coherent (M, M): takes out of residuals what
    is coherent in their combinations. What channels that reciprocity ties have in common is misfit:
    no part of the variance of each, as far as it is there at all. Logarithms are drawn together as
    far as they scatter no more than by chance.
    """
    variance = level * (law_sd / combinations.unit) ** 2
    projection = np.eye(len(law_sd)) - coherent
    if not combinations.reciprocal:
        projection = projection @ combinations.basis @ combinations.basis.T
    residual = series.white @ projection
    partners = combinations.even @ combinations.even.T
    even_share = np.diag(partners).copy()
    np.fill_diagonal(partners, 0.0)
    total = np.abs(partners).sum(axis=0)
    tied = total > 0.0
    partners = partners / np.where(tied, total, 1.0)
    partner_residual = residual @ partners

    def per_dof(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.sum(a * b, axis=0) / series.dof

    square = per_dof(residual, residual) / (variance @ projection**2)
    expected = variance @ (projection * (projection @ partners))
    product = (per_dof(residual, partner_residual) - expected) / variance
    partner_square = per_dof(partner_residual, partner_residual)
    scatter = (square * partner_square / variance + product**2) / series.dof
    # Channels of a group show the same misfit: together they count once.
    count = np.where(tied, even_share, 0.0)
    weight = count / np.where(tied, np.maximum(scatter, LEAST_SHARE), 1.0)
    excess = weight @ product**2
    misfit = np.zeros(len(law_sd))
    if tied.any() and chi2.sf(excess, count.sum()) < ALPHA:
        misfit_variance = (excess - count.sum()) / weight.sum()
        misfit = np.where(tied, misfit_variance / (misfit_variance + scatter), 0.0)
        misfit[product > CERTAIN * np.sqrt(scatter)] = 1.0
    share = np.maximum(square - np.maximum(misfit * product, 0.0), LEAST_SHARE)
    uncertainty = 2.0 / series.dof + misfit * scatter / share**2
    uncertainty = np.where(share > LEAST_SHARE, uncertainty, np.inf)
    log_ratio = _shrunk(np.log(share), uncertainty)
    return law_sd * np.sqrt(level * np.exp(log_ratio)), bool(log_ratio.any())


def _shrunk(values: np.ndarray, scatter: np.ndarray) -> np.ndarray:
    """(M,) values of known scatter (variance), drawn to their mean as far as that of the true ones
    asks for (DerSimonian & Laird, Control. Clin. Trials 7, 1986); 0 where chance makes them."""
    weight = 1.0 / scatter
    mean = weight @ values / weight.sum()
    heterogeneity = weight @ (values - mean) ** 2
    if chi2.sf(heterogeneity, len(values) - 1) > ALPHA:
        return np.zeros(len(values))
    effective = weight.sum() - np.sum(weight**2) / weight.sum()
    between = max(heterogeneity - len(values) + 1, 0.0) / effective
    weight = 1.0 / (scatter + between)
    mean = weight @ values / weight.sum()
    return mean + between * weight * (values - mean)
