"""The verdict of a diagnosis: what follows from its effects, its fit and its remainder."""

from collections.abc import Sequence

from eitskin.diagnose.search.gates import ACCEPTABLE, NOTHING_UNNAMED


def verdict(certainties: Sequence[bool], held_out_p: float, remainder_probability: float) -> str:
    """consistent, explained, partly-explained or unexplained.

    certainties: of the named effects, whether each is certain; held_out_p: probability of a
    held-out chi2 at least as large as that of the fit, if the corrected simulator is right;
    remainder_probability: that something outside the catalogue is present. Raises ValueError for
    what is no probability.
    """
    for value in (held_out_p, remainder_probability):
        if not 0.0 <= value <= 1.0:
            raise ValueError(f"{value} is no probability")
    likely = not NOTHING_UNNAMED.admits(remainder_probability)
    if not certainties:
        return "unexplained" if likely else "consistent"
    if likely or not ACCEPTABLE.admits(held_out_p) or not all(certainties):
        return "partly-explained"
    return "explained"
