"""The verdict of a diagnosis: what follows from its effects, its fit and what is left."""

from collections.abc import Sequence

from eitskin.diagnose.search.gates import ACCEPTABLE, NOTHING_UNNAMED


def verdict(effects: Sequence[bool], held_out_p: float, other_probability: float) -> str:
    """consistent, explained, partly-explained or unexplained.

    effects: of those found, whether each is certain; held_out_p: probability of a held-out chi2 at
    least as large as the one after the fit, if the corrected simulator is right; other_probability:
    that something outside the catalogue is present. Raises ValueError for what is no probability.
    """
    for value in (held_out_p, other_probability):
        if not 0.0 <= value <= 1.0:
            raise ValueError(f"{value} is no probability")
    likely = not NOTHING_UNNAMED.admits(other_probability)
    if not effects:
        return "unexplained" if likely else "consistent"
    if likely or not ACCEPTABLE.admits(held_out_p) or not all(effects):
        return "partly-explained"
    return "explained"
