"""What else could be in the place of a named effect, and how much worse it predicts."""

from dataclasses import dataclass

from eitskin.diagnose.search.explanation import Explanation, added_effect
from eitskin.diagnose.search.prediction import predicted
from eitskin.diagnose.search.proposals import cached_trials
from eitskin.diagnose.search.refits import reduced
from eitskin.diagnose.search.search import Search


@dataclass(frozen=True)
class Rival:
    """An explanation with another name in an effect's place, None: with nothing. gain, error: log
    density of held-out frames by which the explanation with the effect is above it, and its
    standard error, nats."""

    name: str | None
    explanation: Explanation
    gain: float
    error: float


def rivals(search: Search, explanation: Explanation, index: int) -> list[Rival]:
    """Nothing, and the likeliest of every other name that was fitted, in place of effect `index` of
    the explanation that a search ended with."""
    reduced_set = reduced(search, explanation, index)
    trials = cached_trials(search, reduced_set) or []
    best = {added_effect(reduced_set, trial).name: trial for trial in reversed(trials)}
    best.pop(explanation.effects[index].name, None)
    named = [(None, reduced_set), *best.items()]
    held_out = explanation.held_out

    def gain(rival: Explanation) -> tuple[float, float]:
        return held_out.gain(predicted(search, rival, explanation))

    gains = search.problem.model.solved_skins.forked(gain, [rival for _, rival in named])
    return [
        Rival(name, rival, *gain_and_error)
        for (name, rival), gain_and_error in zip(named, gains, strict=True)
    ]
