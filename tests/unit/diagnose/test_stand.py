"""An effect stands against other names in its place; two that take turns end it."""

from types import SimpleNamespace

import pytest

from eitskin.diagnose.search.search import Search


def candidate(name):
    """A candidate of a name, of no wiring, for all of the skin."""
    effect = SimpleNamespace(stage="skin", last_resort=False)
    return SimpleNamespace(name=name, key=(name,), scope=None, sites=(), effect=effect)


def state(log_evidence, *names):
    """A set of effects and its log evidence."""
    effects = [candidate(name) for name in names]
    return SimpleNamespace(
        effects=effects,
        key=tuple(c.key for c in effects),
        log_evidence=log_evidence,
        p_values={c.key: 1e-4 for c in effects},
    )


def stood(start, settled):
    """What `_stand` makes of a state, and the names that took a place. A rival's trial is 3 nats
    ahead of the effect that stands; what the set has when its fit has settled is `settled`."""
    taken = []

    def tried(_less, _scores, effect, best):
        return [state(best + 3.0, name) for name in settled if name != effect.name]

    search = SimpleNamespace(
        rival_evidence=-float("inf"),
        spent=False,
        less=lambda _state, _index: state(-100.0),
        scores=lambda _state: [],
        tried=tried,
        predicts=lambda _rival, _less: True,
        step=lambda _action, new, _state, _p=None: taken.append(new and new.name),
        _drop=lambda found: state(settled[found.effects[-1].name], found.effects[-1].name),
        _grow=lambda found: found,
    )
    return Search._stand(search, start), taken


@pytest.mark.parametrize(("a", "b"), [(5.0, 4.0), (4.0, 5.0)])
def test_of_two_that_take_turns_the_likelier_stays(a, b):
    found, taken = stood(state(a, "contrast"), {"contrast": a, "drift": b})
    assert taken[:2] == ["drift", "contrast"]
    assert found.log_evidence == 5.0
    assert found.effects[0].name == ("contrast" if a > b else "drift")
    # The path ends with the set that stays.
    assert taken[2:] == [None] * (found.effects[0].name != "contrast")
