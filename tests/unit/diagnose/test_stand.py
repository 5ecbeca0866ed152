"""An effect stands against other names in its place; two that take turns end it."""

from types import SimpleNamespace

import pytest

from eitskin.diagnose.search import growth
from eitskin.diagnose.search.journal import Journal


def candidate(name):
    """A candidate of a name, of no wiring, for all of the skin."""
    effect = SimpleNamespace(stage="skin", last_resort=False)
    kind = SimpleNamespace(kind=None, name=name, key=(name,), scope=None, sites=(), effect=effect)
    return kind


def state(log_evidence, *names):
    """A set of effects and its log evidence."""
    effects = [candidate(name) for name in names]
    return SimpleNamespace(
        effects=effects,
        key=tuple(c.key for c in effects),
        log_evidence=log_evidence,
        p_values={c.key: 1e-4 for c in effects},
        fit=SimpleNamespace(chi2=0.0),
        with_p_values=lambda _p_values: state(log_evidence, *names),
    )


def stood(monkeypatch, start, settled, fitted_on=0.0):
    """What `_stand` makes of a state, and the names that took a place. A rival's trial is 3 nats
    ahead of the effect that stands; what the set has when its fit has settled is `settled`;
    fitted_on: what a set gains that is fitted on."""

    def trials(_search, _less, _ranked, effect, best):
        return [state(best + 3.0, name) for name in settled if name != effect.name]

    for name, function in {
        "reduced": lambda _search, _explanation, _index: state(-100.0),
        "scores": lambda _search, _explanation: [],
        "trials": trials,
        "_predicts": lambda *_: True,
        "_fitted_on": lambda _search, set_: state(
            set_.log_evidence + fitted_on, *(e.name for e in set_.effects)
        ),
        "_drop": lambda _search, set_: state(settled[set_.effects[-1].name], set_.effects[-1].name),
        "_grow": lambda _search, explanation: explanation,
    }.items():
        monkeypatch.setattr(growth, name, function)
    search = SimpleNamespace(rival_evidence=-float("inf"), spent=False, journal=Journal())
    after = growth._stand(search, start)
    return after, [step["effect"] or None for step in search.journal.steps]


@pytest.mark.parametrize(("a", "b"), [(5.0, 4.0), (4.0, 5.0)])
def test_of_two_that_take_turns_the_likelier_stays(monkeypatch, a, b):
    found, taken = stood(monkeypatch, state(a, "contrast"), {"contrast": a, "drift": b})
    assert taken[:2] == ["drift", "contrast"]
    assert found.log_evidence == 5.0
    assert found.effects[0].name == ("contrast" if a > b else "drift")
    # The path ends with the set that stays.
    assert taken[2:] == [None] * (found.effects[0].name != "contrast")


def test_a_body_takes_no_place_among_the_effects_of_a_set():
    search = SimpleNamespace(is_body=lambda effect: effect.name == "body")
    assert growth._effect_count(search, state(0.0, "body", "one", "another")) == 2


def test_an_effect_that_reaches_its_rival_when_fitted_on_stays(monkeypatch):
    found, taken = stood(monkeypatch, state(5.0, "contrast"), {"contrast": 5.0, "drift": 9.0}, 2.5)
    assert (found.key, found.log_evidence, taken) == ((("contrast",),), 7.5, [])
    _, taken = stood(monkeypatch, state(5.0, "contrast"), {"contrast": 5.0, "drift": 9.0}, 0.2)
    assert taken[:1] == ["drift"]


@pytest.mark.parametrize(
    ("single", "together", "needed", "expected"),
    [
        (1.0, 40.0, True, ("body", "one", "another")),
        (1.0, 40.0, False, None),
        (-8.0, -4.0, True, None),
        (1.0, None, True, None),
        (None, 40.0, True, None),
    ],
    ids=[
        "each beside the other",
        "the second is enough",
        "together less than none",
        "nothing beside it",
        "nothing to try",
    ],
)
def test_two_that_hide_each_other_come_together(monkeypatch, single, together, needed, expected):
    begin = state(0.0, "body")
    pair = None if together is None else state(together, "body", "one", "another")
    for name, function in {
        "scores": lambda *_: [],
        "trials": lambda *_: [] if single is None else [state(single, "body", "one")],
        "_warranted": lambda _search, first: pair if first.key == (("body",), ("one",)) else None,
        "without": lambda _search, whole, index: state(
            3.0, *(e.name for i, e in enumerate(whole.effects) if i != index)
        ),
        "_ratio_p": lambda *_: 1e-5,
        "_is_borne_out": lambda _search, _whole, effect, reduced_set, _p: (
            needed and effect.name not in {e.name for e in reduced_set.effects}
        ),
        "_drop": lambda _search, explanation: explanation,
        "_grow": lambda _search, explanation: explanation,
        "added_effect": lambda _before, trial: trial.effects[-1],
    }.items():
        monkeypatch.setattr(growth, name, function)
    search = SimpleNamespace(
        spent=False, journal=Journal(), is_body=lambda effect: effect.name == "body"
    )
    grown_set = growth._with_two_more(search, begin)
    assert (None if grown_set is None else tuple(e.name for e in grown_set.effects)) == expected
    steps = [(step["effect"], step["log_evidence"]) for step in search.journal.steps]
    assert steps == ([("one", single), ("another", together)] if expected else [])
