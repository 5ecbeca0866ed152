"""The rig in words: every component learned and assumed, what was left out, what nobody knows."""

import re

import pytest

from eitskin.diagnose.verdict import rig_words
from eitskin.quantities import MINUS

SP = "\N{NO-BREAK SPACE}"
UNITS = {
    "amplitude-per-frame": "1",
    "gain-walk": "1",
    "gain-flicker": "1",
    "correlated-noise": "1",
    "common-noise": "V",
    "channel-drift": "V",
    "quantisation": "V",
    "quadrature": "1",
    "place-per-frame": "mm",
    "place-per-press": "mm",
    "force-per-frame": "N",
    "channel-wander": "V",
    "force-per-press": "1",
    "force-zero-per-press": "N",
    "force-zero-walk": "N",
    "place-walk": "mm",
    "force-walk": "1",
    "place-creep": "mm",
    "force-zero-creep": "N",
}


def component(name, sd=0.41, low=0.3, high=0.5, unit=None, learned=True):
    unit = unit or UNITS[name]
    return {"name": name, "unit": unit, "sd": sd, "low": low, "high": high, "learned": learned}


def sentence_of(entry):
    """The only sentence on a component."""
    (text,) = rig_words.component_sentences(entry)
    return text


def test_every_component_that_is_known_is_said():
    assert set(rig_words.SENTENCES) == set(UNITS)


@pytest.mark.parametrize("name", UNITS)
@pytest.mark.parametrize("learned", [True, False])
def test_every_sentence_is_whole(name, learned):
    text = sentence_of(component(name, learned=learned))
    assert not re.search(r"[{}]|None|nan|  ", text)
    assert text[0].isupper() and text.endswith(".") and text.count(".") >= 1
    assert ("90 %" in text) == learned
    assert text.endswith(rig_words.ASSUMED) == (not learned)


def test_sizes_with_units_and_intervals():
    said = sentence_of
    assert said(component("place-per-press")) == (
        f"The robot's places are good to 0.41 (90 %: 0.30 to 0.50){SP}mm, press by press."
    )
    assert said(component("place-per-press", learned=False)) == (
        f"The robot's places are good to 0.410{SP}mm, press by press; this is assumed, for the"
        " recording has nothing that shows it."
    )
    walk = component("gain-walk", 2e-3, 1.6e-3, 2.5e-3)
    assert said(walk).endswith(f"by 0.200 (90 %: 0.160 to 0.250){SP}%.")
    assert "correlation of 0.41 (90 %: 0.30 to 0.50)." in said(component("correlated-noise"))
    step = component("quantisation", 2.148e-3, 2.148e-3, 2.148e-3)
    expected = (
        f"The converter's rounding leaves errors of typically 2.15{SP}mV that do not scatter."
    )
    assert said(step) == expected
    in_ohm = component("common-noise", 0.02, 0.01, 0.03, "ohm")
    assert said(in_ohm).endswith(f"noise of 20 (90 %: 10 to 30){SP}mΩ.")


def test_what_all_presses_share_is_said_where_it_is_something():
    place = component("place-per-press", sd=0.0, low=0.0)
    place["common"] = {"value": [0.1, 0.02], "low": [0.05, -0.01], "high": [0.15, 0.05]}
    assert rig_words.component_sentences(place) == [
        f"All touches are 0.100 (90 %: 0.050 to 0.150){SP}mm along x and"
        f" 0.020 (90 %: {MINUS}0.010 to 0.050){SP}mm along y from their reported places."
    ]
    place["common"]["low"][0] = -0.05
    assert rig_words.component_sentences(place) == []
    delay = component("place-delay", sd=0.1, unit="s", learned=False)
    assert rig_words.component_sentences(delay) == []
    delay["common"] = {"value": 0.25, "low": 0.24, "high": 0.26}
    assert sentence_of(delay) == f"All poses are 0.250 (90 %: 0.240 to 0.260){SP}s late."
    share = component("force-per-press", sd=0.0)
    share["common"] = {"value": -0.02, "low": -0.03, "high": -0.01}
    assert sentence_of(share).endswith(f"{SP}% larger than reported.")


def test_a_name_that_nobody_knows_is_said_with_its_size():
    text = sentence_of(component("stage-backlash", unit="mm"))
    assert text == (
        f"The rig has an error called stage-backlash, of 0.41 (90 %: 0.30 to 0.50){SP}mm."
    )
    share = sentence_of(component("supply-ripple", unit="1"))
    assert share.endswith("of 0.41 (90 %: 0.30 to 0.50).")


def test_what_was_left_out():
    def said(**noise):
        return rig_words.noise_sentences({"components": []} | noise)

    assert said() == said(loud_frames=[], jumps=[], spikes={"readings": 0, "share": 0.0}) == []
    assert said(loud_frames=[17, 90]) == [
        "Frames 17 and 90 are louder than the others and were left out."
    ]
    assert said(loud_frames=[17]) == ["Frame 17 is louder than the others and was left out."]
    assert said(loud_frames=list(range(30))) == [
        "Frames 0, 1, 2, 3, 4, 5 and 24 more are louder than the others and were left out."
    ]
    assert said(spikes={"readings": 12, "share": 5e-4}) == [
        f"12 readings (0.050{SP}%) stand out alone and were left out."
    ]
    assert said(spikes={"readings": 1, "share": 1e-3}) == [
        f"1 reading (0.10{SP}%) stands out alone and was left out."
    ]
    assert said(jumps=[491]) == ["At frame 491 the readings jump: the rig did not stay the same."]


def test_components_come_first_in_their_order():
    noise = {"components": [component("gain-walk"), component("place-per-press")], "jumps": [3]}
    texts = rig_words.noise_sentences(noise)
    assert texts[:2] == [sentence_of(each) for each in noise["components"]]
    assert len(texts) == 3
