"""Which scores are worth a nonlinear fit."""

from eitskin.diagnose.fitting.candidates import Candidate
from eitskin.diagnose.search.screen import Score
from eitskin.effects import EFFECTS

WITHIN = 20.0  # nats of linear evidence below the best, or this share of its gain ...
SHARE = 0.3
MOST_NAMES = 12
FEW = 6  # coordinates; candidates with more are fitted after the others


def shortlist(scores: list[Score]) -> list[Score]:
    """Scores of candidates worth a nonlinear fit: of every name the best of each form, of slow ones
    the best alone, names in order of evidence; those far from the best only while little else
    explains as much."""
    if not scores:
        return []
    top, gain = scores[0].log_evidence, max(s.gain for s in scores)
    names: dict[str, list[Score]] = {}
    for s in scores:
        own = names.setdefault(s.candidate.name, [])
        if not own or (
            _form(s.candidate) not in {_form(o.candidate) for o in own} and not _slow(s.candidate)
        ):
            own.append(s)
    chosen = []
    for name, own in list(names.items())[:MOST_NAMES]:
        for s in own:
            near = s.log_evidence > top - WITHIN or s.gain > SHARE * gain
            # What shows at large readings alone weighs little in a tangent.
            tried = EFFECTS[name].driver == "amplitude" and s.gain > 0
            if near or tried:
                chosen.append(s)
    return sorted(chosen, key=lambda s: s.candidate.size > FEW)


def _slow(candidate: Candidate) -> bool:
    """Whether every frame has a skin of its own to be solved."""
    return candidate.effect.stage == "skin" and candidate.effect.driver != "static"


def _form(candidate: Candidate) -> tuple[str, bool, tuple[str, ...]]:
    few = candidate.scope == "sparse" and len(candidate.own_sites) > 1
    return candidate.scope, few, tuple(candidate.start)
