"""What is a finding, and what no more than a candidate."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from diagnosed_skin import SCHEMA
from eitskin.data.subset import of_frames
from eitskin.diagnose import diagnosis
from eitskin.diagnose.fitting.candidates import Candidate, Scales
from eitskin.diagnose.fitting.held_out import held_out
from eitskin.diagnose.search.gates import (
    ACCEPTABLE,
    DISTINCT,
    NOTHING_UNNAMED,
    REMAINDER,
    SIZE_INTERVAL,
    STANDS_OUT,
    STATED_SIZE,
    SURE_GAIN,
    UNAFFECTED,
)
from eitskin.diagnose.verdict import certainty, conclusion, record, words
from eitskin.diagnose.verdict.atlas import COLUMNS
from eitskin.diagnose.verdict.remainder import NO_PATTERN, remainder
from eitskin.diagnose.verdict.validation import validate
from eitskin.effects import EFFECTS
from small_skin import SKIN, small_recording

GAIN = {"name": "measurement-gain", "measures": [2], "parameters": {"gain": 1.05}}


@pytest.fixture(scope="module")
def found():
    return diagnosis.diagnose(small_recording(GAIN, places=1))


@pytest.fixture(scope="module")
def beside_much():
    """A gain where every channel has a gain of its own, for which there is no name: it becomes a
    discrepancy of the search's covariance."""
    gain = {"name": "measurement-gain", "measures": [4], "parameters": {"gain": 1.5}}
    every = small_recording(gain, noise=1e-4, places=2)
    recorded = of_frames(every, ~every.frames["touch"].to_numpy(bool))
    own = 1.0 + 0.01 * np.random.default_rng(5).normal(size=every.voltage.shape[1])
    recorded.voltage = own * recorded.voltage
    return diagnosis.diagnose(recorded)


def values(found):
    """The judgements on the only effect, by the gate's name."""
    return {j.gate: j for item in certainty.certainty(found, 0) for j in item}


def is_certain(found):
    """Whether the only effect is certain, as all that is written says."""
    said = conclusion.document(found, "skin")
    (effect,) = said["effects"]
    assert effect["certain"] == (said["verdict"] == "explained")
    assert effect["sentence"].startswith("Perhaps") != effect["certain"]
    assert ("nothing is certain" in words.headline(said)) != effect["certain"]
    return effect["certain"]


def test_what_passes_every_gate_is_certain(found):
    assert is_certain(found)
    judged = values(found)
    assert list(judged) == [
        SURE_GAIN,
        STANDS_OUT,
        DISTINCT,
        SIZE_INTERVAL,
        STATED_SIZE,
        ACCEPTABLE,
    ]
    assert all(judgement.passed for judgement in judged.values())
    assert judged[DISTINCT].place == found.gaps[0][0].rival
    decided = record._decisions(found).tail(len(judged))
    assert decided["gate"].tolist() == [gate.name for gate in judged] and decided["admitted"].all()


def test_a_signature_that_calibrations_have_as_well_is_a_candidate(found):
    for snr, certain in ((0.99 * STANDS_OUT.threshold, False), (STANDS_OUT.threshold, True)):
        gaps = [[replace(gap, gap=min(gap.gap, snr), snr=snr) for gap in found.gaps[0]]]
        assert is_certain(replace(found, gaps=gaps)) == certain


def test_a_name_that_another_might_be_is_a_candidate(found):
    nearest, *others = found.gaps[0]
    for gap, certain in ((1.6e-9, False), (2.99, False), (3.0, True)):
        gaps = [[replace(nearest, gap=gap), *others]]
        assert is_certain(replace(found, gaps=gaps)) == certain


@pytest.mark.parametrize(
    ("gain", "error", "certain"), [(-0.35, 0.32, False), (1.9, 1.0, False), (2.1, 1.0, True)]
)
def test_a_gain_within_two_standard_errors_is_a_candidate_s(found, gain, error, certain):
    other = replace(found)
    rivals = [replace(rival, gain=gain + i, error=error) for i, rival in enumerate(found.rivals[0])]
    vars(other)["rivals"] = [rivals]
    assert is_certain(other) == certain


def fitted(name, theta, covariance, **given):
    """A fit of one effect at coordinates theta, with their covariance."""
    keys = {"kind": None, "sites": None, "scope": "", "start": {}, **given}
    candidate = Candidate(EFFECTS[name], skin=SKIN, scales=Scales(1.0, 1.0), **keys)
    assert candidate.size == len(theta)
    return SimpleNamespace(
        effects=[candidate],
        theta=np.array(theta, float),
        covariance=np.array(covariance, float),
        coordinate_slice=lambda index: slice(0, candidate.size),
    )


def test_a_size_that_may_be_none_is_a_candidate_s():
    """One value by its 90 % interval; values of one parameter by one interval in common."""
    for z, left_out in ((1.6, False), (1.7, True), (-1.7, True)):
        one = fitted("multiplexer-memory", [0.3 * z], [[0.09]])
        assert SIZE_INTERVAL.admits(certainty.size_interval(one, 0)) == left_out
    sites = {"kind": "electrodes", "sites": (1, 4), "scope": "sparse"}
    for z, left_out in ((2.1, False), (2.2, True)):
        two = fitted("contact-impedance", [z, 0.0], np.eye(2), **sites)
        assert SIZE_INTERVAL.admits(certainty.size_interval(two, 0)) == left_out
    # A time constant is no size, however well it is known.
    slow = fitted("relaxation", [0.5, 9.0], np.diag([1.0, 0.01]), start={"tau_s": 10.0})
    assert not SIZE_INTERVAL.admits(certainty.size_interval(slow, 0))
    sites["sites"] = (1,)
    broken = fitted("electrode-open", [], np.zeros((0, 0)), **sites)
    assert certainty.size_interval(broken, 0) is None


def test_a_size_that_may_be_none_is_said_with_a_perhaps(found, monkeypatch):
    monkeypatch.setattr(certainty, "size_interval", lambda fit, index: 0.89)
    assert not is_certain(found)


@pytest.mark.parametrize(
    ("accepted", "apart", "certain"),
    [(0.5, 0.0, True), (0.011, 0.0, True), (0.0, 0.5, True), (0.009, 0.009, False)],
)
def test_of_a_fit_that_is_not_accepted_only_what_the_misfit_leaves_alone_is_certain(
    found, monkeypatch, accepted, apart, certain
):
    for module in (certainty, conclusion):
        monkeypatch.setattr(module, "held_out_p", lambda diagnosis: accepted)
    monkeypatch.setattr(certainty, "_unaffected_p", lambda diagnosis, index: apart)
    said = conclusion.document(found, "skin")
    assert said["effects"][0]["certain"] == certain
    # The verdict asks for both.
    explained = accepted > ACCEPTABLE.threshold
    assert said["verdict"] == ("explained" if explained else "partly-explained")
    gates = record._decisions(found)["gate"].tolist()
    assert (UNAFFECTED.name in gates) != explained


def test_a_misfit_touches_what_it_lies_along():
    draw = np.random.default_rng(1)
    channel = np.broadcast_to(np.arange(40), (60, 40))
    press = np.broadcast_to(np.arange(60)[:, None] // 5, (60, 40))
    signature = np.where(channel < 12, draw.normal(size=40), 0.0) * np.ones((60, 1))

    def noise():
        residual = draw.normal(size=signature.shape)
        length = (signature**2).sum()
        return residual - signature * (signature * residual).sum() / length

    parts = [channel, press]
    p = np.array([certainty.misfit_along(signature, noise(), parts) for _ in range(400)])
    assert (p < 0.01).mean() < 0.03 and (p < 0.2).mean() < 0.25 and (p > 0.5).mean() > 0.35
    for rows, columns, touched in (
        (slice(None), slice(12, 40), False),
        (slice(None), slice(0, 12), True),
        (slice(10, 15), slice(0, 12), True),
    ):
        misfit = np.zeros(signature.shape)
        misfit[rows, columns] = draw.normal(size=misfit[rows, columns].shape[1])
        residual = noise() + 5.0 * misfit
        residual -= signature * (signature * residual).sum() / (signature**2).sum()
        assert (certainty.misfit_along(signature, residual, parts) < 0.01) == touched


def test_no_discrepancy_makes_a_fit_acceptable(beside_much):
    """What has no name opens the coordinates in the search's covariance; not when it is judged."""
    explanation = beside_much.explanation
    assert explanation.error_sds["static-discrepancy"] > 0.0
    assert explanation.held_out.p_value(beside_much.noise.dof) > ACCEPTABLE.threshold
    assert certainty.held_out_p(beside_much) < 1e-6
    by_name = held_out(beside_much.named_fit, beside_much.search.folds)
    assert by_name.chi2.sum() > 100.0 * explanation.held_out.chi2.sum()
    assert conclusion.document(beside_much, "skin")["verdict"] == "partly-explained"


def test_a_name_beside_much_that_has_none_is_a_candidate(beside_much):
    said = conclusion.document(beside_much, "skin")
    assert said["effects"][0]["name"] == "measurement-gain"
    assert said["fit"]["held_out"]["chi2_per_dof_after"] > 100.0
    assert said["fit"]["last"]["chi2_per_dof_after"] > 100.0
    assert [effect["certain"] for effect in said["effects"]] == [False] * len(said["effects"])
    assert values(beside_much)[UNAFFECTED].value < 1e-6


def test_what_something_without_a_name_might_tell_from_another_is_a_candidate(found):
    """Beside something left that is likely, a name's gap to others is to be no less than that is
    long."""
    nearest = found.gaps[0][0].gap
    for probability, snr, certain in (
        (NOTHING_UNNAMED.threshold, 1.01 * nearest, False),
        (NOTHING_UNNAMED.threshold, nearest, True),
        (0.99 * NOTHING_UNNAMED.threshold, 1.01 * nearest, True),
    ):
        left = replace(found.remainder, probability=probability, snr=snr)
        said = conclusion.document(replace(found, remainder=left), "skin")
        (effect,) = said["effects"]
        assert effect["certain"] == certain
        judged = values(replace(found, remainder=left))
        assert (REMAINDER in judged) == (probability >= NOTHING_UNNAMED.threshold)


def test_a_name_at_whose_site_something_is_left_is_a_candidate(found):
    effect = found.explanation.effects[0]
    (site,) = effect.site_indices
    for sites, certain in (([int(site)], False), ([int(site) + 1], True), ([], True)):
        left = replace(found.remainder, probability=0.9, snr=0.0, **{effect.kind: sites})
        (entry,) = conclusion.document(replace(found, remainder=left), "skin")["effects"]
        assert entry["certain"] == certain


def test_a_row_without_evidence_is_no_sentence_on_what_is_left(found):
    evidence_free = "No evidence that drive 0 → 1 differs from the simulation in every frame."
    rows = (evidence_free, NO_PATTERN, 0.1), ("Drive 3 differs.", "Drive 3 differs.", 0.01)
    for sentence, told, q in rows:
        row = ("constant: drive", "0 → 1", 90.0, 13, 1e-9, q, 1e-9, sentence)
        left = remainder(pd.DataFrame([row], columns=COLUMNS))
        said = conclusion.document(replace(found, remainder=left), "skin")
        assert said["other"]["sentence"] == told
        assert said["other"]["law"] == (None if told == NO_PATTERN else "constant")
        assert f"What has no name: {told}" in words.sentences(said)


def test_a_stretch_without_a_label_stands_in_the_document(found):
    said = conclusion.document(replace(found, unlabelled=((3, 9), (12, 12))), "skin")
    assert said["noise"]["unlabelled"] == [[3, 9], [12, 12]]
    validate(said, SCHEMA, "diagnosis.json")
    assert words.unlabelled_sentences(said)[1].startswith("In frame 12 there is a touch")
    assert "unlabelled" not in conclusion.document(found, "skin")["noise"]


def test_of_many_names_that_it_cannot_be_told_from_the_nearest_are_said():
    names = ["offset", "crosstalk", "drive-gain", "ground-leak", "common-mode", "memory", "tone"]
    few = words.alternatives_sentence({"alternatives": names[:6]})
    assert all(name in few for name in names[:6]) and "further" not in few
    many = words.alternatives_sentence({"alternatives": names})
    assert many == (
        "This recording cannot tell it from offset, crosstalk, drive-gain and 4 further names."
    )
    assert words.alternatives_sentence({"alternatives": []}) == ""
