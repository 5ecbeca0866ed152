"""What is a finding, and what no more than a candidate."""

from dataclasses import replace

import pytest

from diagnosed_skin import SCHEMA
from eitskin.diagnose import diagnosis
from eitskin.diagnose.search.gates import DISTINCT, NOTHING_UNNAMED
from eitskin.diagnose.verdict import conclusion, words
from eitskin.diagnose.verdict.validation import validate
from small_skin import small_recording


@pytest.fixture(scope="module")
def found():
    gain = {"name": "measurement-gain", "measures": [2], "parameters": {"gain": 1.05}}
    return diagnosis.diagnose(small_recording(gain, places=1))


def test_what_does_not_stand_out_from_what_has_no_name_is_a_candidate(found):
    said = conclusion.document(found, "skin")
    (effect,) = said["effects"]
    assert effect["certain"] and said["verdict"] == "explained"
    assert min(gap.snr for gap in found.gaps[0]) > DISTINCT.threshold
    for snr, certain in ((0.99 * DISTINCT.threshold, False), (DISTINCT.threshold, True)):
        faint = [[replace(gap, gap=min(gap.gap, snr), snr=snr) for gap in found.gaps[0]]]
        said = conclusion.document(replace(found, gaps=faint), "skin")
        (effect,) = said["effects"]
        assert effect["certain"] == certain
        assert said["verdict"] == ("explained" if certain else "partly-explained")
        assert effect["sentence"].startswith("Perhaps") != certain
        assert ("candidates" in words.headline(said)) != certain


def test_what_something_without_a_name_might_tell_from_another_is_a_candidate(found):
    """Beside something left that is likely, a name's gap to those outside its class is to be no
    less than that is long."""
    (gaps,) = found.gaps
    nearest = min(gap.gap for gap in gaps if gap.gap >= DISTINCT.threshold)
    alike = [replace(gaps[0], rival="offset", gap=0.5 * DISTINCT.threshold), *gaps]
    for probability, snr, certain in (
        (NOTHING_UNNAMED.threshold, 1.01 * nearest, False),
        (NOTHING_UNNAMED.threshold, nearest, True),
        (0.99 * NOTHING_UNNAMED.threshold, 1.01 * nearest, True),
    ):
        left = replace(found.remainder, probability=probability, snr=snr)
        for gaps_ in (gaps, alike):
            said = conclusion.document(replace(found, remainder=left, gaps=[gaps_]), "skin")
            (effect,) = said["effects"]
            assert effect["certain"] == certain
            assert effect["sentence"].startswith("Perhaps") != certain


def test_a_row_without_evidence_is_no_sentence_on_what_is_left(found):
    evidence_free = "No evidence that drive 0 → 1 differs from the simulation in every frame."
    for sentence, told in ((evidence_free, words.NO_PATTERN), ("Drive 3 differs.",) * 2):
        left = replace(
            found.remainder, probability=0.7, driver="static", law="constant", sentence=sentence
        )
        said = conclusion.document(replace(found, remainder=left), "skin")
        assert said["other"]["sentence"] == told
        assert said["other"]["law"] == (None if told == words.NO_PATTERN else "constant")
        assert f"What has no name: {told}" in words.sentences(said)


def test_a_stretch_without_a_label_stands_in_the_document(found):
    said = conclusion.document(replace(found, unlabelled=((3, 9), (12, 12))), "skin")
    assert said["noise"]["unlabelled"] == [[3, 9], [12, 12]]
    validate(said, SCHEMA, "diagnosis.json")
    assert words.unlabelled_sentences(said)[1].startswith("In frame 12 somebody touched")
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
