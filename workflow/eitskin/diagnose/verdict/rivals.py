"""What else could be in a found effect's place, and how much worse it predicts held-out frames."""

from dataclasses import dataclass

from eitskin.diagnose.search.explanation import Explanation, added_effect
from eitskin.diagnose.search.prediction import predicted
from eitskin.diagnose.search.proposals import cached_trials
from eitskin.diagnose.search.refits import reduced
from eitskin.diagnose.search.search import Search


@dataclass(frozen=True)
class Rival:
    """A state with another name in an effect's place, None: with nothing. gain, error: log density
    of held-out frames by which the state found is above it, and its standard error, nats."""

    name: str | None
    state: Explanation
    gain: float
    error: float


def rivals(search: Search, state: Explanation, index: int) -> list[Rival]:
    """Nothing, and the likeliest of every other name that was fitted, in place of effect `index` of
    the state that a search found."""
    less = reduced(search, state, index)
    trials = cached_trials(search, less) or []
    best = {added_effect(less, trial).name: trial for trial in reversed(trials)}
    best.pop(state.effects[index].name, None)
    named = [(None, less), *best.items()]
    held_out, near = state.held_out, search.problem.model.solved_skins

    def gained(rival: Explanation) -> tuple[float, float]:
        return held_out.gain(predicted(search, rival, state))

    found = near.forked(gained, [rival for _, rival in named])
    return [Rival(*own, *gain) for own, gain in zip(named, found, strict=True)]
