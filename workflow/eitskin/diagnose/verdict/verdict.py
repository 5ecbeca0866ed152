"""The verdict of a diagnosis: what follows from its effects, its fit and what is left."""

from collections.abc import Sequence

ACCEPTABLE_P = 0.01  # of the held-out chi2, above which the fit is accepted
LIKELY = 0.5  # probability of something outside the catalogue, from which on it counts


def acceptable(held_out_p: float) -> bool:
    """Whether a fit is, by the probability of a held-out chi2 at least as large as its own."""
    return held_out_p > ACCEPTABLE_P


def verdict(effects: Sequence[bool], held_out_p: float, other_probability: float) -> str:
    """consistent, explained, partly-explained or unexplained.

    effects: of those found, whether each is certain; held_out_p: probability of a held-out chi2 at
    least as large as the one after the fit, if the corrected simulator is right; other_probability:
    that something outside the catalogue is present. Raises ValueError for what is no probability.
    """
    for value in (held_out_p, other_probability):
        if not 0.0 <= value <= 1.0:
            raise ValueError(f"{value} is no probability")
    likely = other_probability >= LIKELY
    if not effects:
        return "unexplained" if likely else "consistent"
    if likely or not acceptable(held_out_p) or not all(effects):
        return "partly-explained"
    return "explained"
