"""Which scores are worth a nonlinear fit."""

from collections.abc import Collection

from eitskin.diagnose.fitting.candidates import Candidate
from eitskin.diagnose.search.explanation import Explanation
from eitskin.diagnose.search.gates import AMPLITUDE, GAIN_SHARE, NAMES, NEAR_BEST
from eitskin.diagnose.search.journal import Journal
from eitskin.diagnose.search.screen import Score

LIGHT_SIZE = 6  # coordinates; candidates with more are fitted after the others


def shortlist(
    journal: Journal, explanation: Explanation, ranked: list[Score], names: Collection[str]
) -> list[Score]:
    """Of scores, the best evidence first, those that are worth a nonlinear fit beside an
    explanation: of each of some names the best of each form, of slow ones the best alone, names in
    order of evidence; those far from the best only while little else explains as much."""
    if not names:
        return []
    top, gain = ranked[0].log_evidence, max(s.gain for s in ranked)
    by_name: dict[str, list[Score]] = {}
    for score in ranked:
        forms = by_name.setdefault(score.candidate.name, [])
        is_new = _form(score.candidate) not in {_form(s.candidate) for s in forms}
        if not forms or (is_new and not _is_slow(score.candidate)):
            forms.append(score)
    listed = []
    for rank, (name, forms) in enumerate(by_name.items(), start=1):
        if name not in names or not journal.judge(NAMES, rank, forms[0].candidate, explanation):
            continue
        for score in forms:
            values = [(NEAR_BEST, score.log_evidence - top), (GAIN_SHARE, _ratio(score.gain, gain))]
            if score.candidate.effect.driver == "amplitude":
                values.append((AMPLITUDE, score.gain))
            if journal.judge_any(values, score.candidate, explanation):
                listed.append(score)
    return sorted(listed, key=lambda s: s.candidate.size > LIGHT_SIZE)


def _ratio(gain: float, largest: float) -> float:
    """A gain over the largest one, 0 where there is none."""
    return gain / largest if largest > 0.0 else 0.0


def _is_slow(candidate: Candidate) -> bool:
    """Whether every frame has a skin to be solved."""
    return candidate.effect.stage == "skin" and candidate.effect.driver != "static"


def _form(candidate: Candidate) -> tuple[str, bool, tuple[str, ...]]:
    several = candidate.scope == "sparse" and len(candidate.site_indices) > 1
    return candidate.scope, several, tuple(candidate.start)
