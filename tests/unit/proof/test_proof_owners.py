"""What an owner keeps to himself, what the check says, and rows of trials that end there."""

import json

import numpy as np
import pytest

from eitskin.data import check, recording
from proof import prediction_score, queries, trial
from witness import owned


def test_channels_kept_out_are_not_given():
    one = queries.of_owner(owned.draw("owner:step", 2))
    given, kept = np.isfinite(one.recorded.voltage), np.isfinite(one.readings)
    recording.validate(one.recorded, "step")
    recording.validate(one.query, "step")
    assert one.query.voltage is None
    assert not (given & kept).any() and (given | kept).all()
    assert not set(one.unit[kept].tolist()) & set(one.unit[given].tolist())
    assert 0.15 < kept.mean() < 0.25


def test_of_presses_the_later_ones_are_asked_for():
    owner = owned.draw("owner:step", 1)
    one = queries.of_owner(owner)
    assert one.query.voltage is None and np.array_equal(one.readings, owner.query.voltage)
    assert one.recorded is owner.recorded
    assert len(np.unique(one.unit)) == one.query.frames["contact"].nunique()


def test_what_the_check_says_is_what_is_counted():
    for kind, seed in (("step", 2), ("clipped", 1)):
        recorded = queries.of_owner(owned.draw(f"owner:{kind}", seed)).recorded
        checked = check.check(recorded)
        said, text = queries.check_findings(recorded, checked), check.text(checked)
        assert all(f"from frame {frame} on" in text for frame in said["steps"])
        assert all(f"stop at {ceiling:.4g}" in text for ceiling in said["ceilings"])
        assert len(said["steps"]) == len(checked.of_topic("step"))
        warned = {topic for topic, _ in said["warnings"]}
        assert bool(said["ceilings"]) == ("clipped" in warned)
        assert {"step": said["steps"], "clipped": said["ceilings"]}[kind]


@pytest.mark.parametrize("kind", ["order", "polarity"])
def test_a_wrong_table_ends_before_the_diagnosis(monkeypatch, kind):
    def never(*_):
        raise AssertionError("diagnosed")

    monkeypatch.setattr(trial.diagnosis, "diagnose", never)
    made = json.loads(json.dumps(trial.row(f"owner:{kind}", 1)))
    assert {topic for topic, _ in made["unusable"]} >= {kind} and "said" not in made
    (scored,) = prediction_score.owners([made]).to_dict("records")
    assert scored["right"] and scored["outcome"] == "unusable"


def test_a_refusal_of_the_diagnosis_is_a_row(monkeypatch):
    def refuse(*_):
        raise trial.InputError("recording", "skin", "nothing", "something")

    monkeypatch.setattr(trial.diagnosis, "diagnose", refuse)
    made = json.loads(json.dumps(trial.row("owner:beliefs", 1)))
    assert "skin" in made["refused"] and made["truth"]["wanted"] == []
    (scored,) = prediction_score.owners([made]).to_dict("records")
    assert not scored["right"] and scored["outcome"] == "refused"
