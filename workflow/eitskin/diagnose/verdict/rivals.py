"""What else could be in a found effect's place, and how much worse it predicts held-out frames."""

from dataclasses import dataclass

from eitskin.diagnose.search.search import Search
from eitskin.diagnose.search.state import State, added


@dataclass(frozen=True)
class Rival:
    """A state with another name in an effect's place, None: with nothing. gain, error: log density
    of held-out frames by which the state found is above it, and its standard error, nats."""

    name: str | None
    state: State
    gain: float
    error: float


def rivals(search: Search, state: State, index: int) -> list[Rival]:
    """Nothing, and the likeliest of every other name that was fitted, in place of effect `index` of
    the state that a search found."""
    less = search.less(state, index)
    trials = search.tried_beside(less) or []
    best = {added(less, trial).name: trial for trial in reversed(trials)}
    best.pop(state.effects[index].name, None)
    named = [(None, less), *best.items()]
    held_out, near = state.held_out, search.problem.model.near

    def gained(rival: State) -> tuple[float, float]:
        return held_out.gain(search.held_out(rival, state))

    found = near.forked(gained, [rival for _, rival in named])
    return [Rival(*own, *gain) for own, gain in zip(named, found, strict=True)]
