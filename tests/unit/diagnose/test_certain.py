"""What is a finding, and what no more than a candidate."""

from dataclasses import replace

from eitskin.diagnose import diagnosis, result, words
from eitskin.diagnose.classes import CONFUSED
from small_skin import small_recording


def test_what_does_not_stand_out_from_what_has_no_name_is_a_candidate():
    gain = {"name": "measurement-gain", "measures": [2], "parameters": {"gain": 1.05}}
    found = diagnosis.diagnose(small_recording(gain, places=1))
    said = result.result(found, "skin")
    (effect,) = said["effects"]
    assert effect["certain"] and said["verdict"] == "explained"
    assert min(gap.snr for gap in found.gaps[0]) > CONFUSED
    for snr, certain in ((0.99 * CONFUSED, False), (CONFUSED, True)):
        faint = [[replace(gap, gap=min(gap.gap, snr), snr=snr) for gap in found.gaps[0]]]
        said = result.result(replace(found, gaps=faint), "skin")
        (effect,) = said["effects"]
        assert effect["certain"] == certain
        assert said["verdict"] == ("explained" if certain else "partly-explained")
        assert effect["sentence"].startswith("Perhaps") != certain
        assert ("candidates" in words.headline(said)) != certain


def test_of_many_names_that_it_cannot_be_told_from_the_nearest_are_said():
    names = ["offset", "crosstalk", "drive-gain", "ground-leak", "common-mode", "memory", "tone"]
    few = words.confused({"alternatives": names[:6]})
    assert all(name in few for name in names[:6]) and "further" not in few
    many = words.confused({"alternatives": names})
    assert many == (
        "This recording cannot tell it from offset, crosstalk, drive-gain and 4 further names."
    )
    assert words.confused({"alternatives": []}) == ""
