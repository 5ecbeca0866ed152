"""Rig errors of the witness: their sizes, and names that they must neither take nor lose.

Development seeds. Sizes: 11, where every size is 2.4 times the usual. Effects: one whose gap to
every name out of its class, as the diagnosis has it, or whose SNR beside an overall factor is at
least 8; of a class to which touch-contrast belongs by its gap, the SNR.
"""

import numpy as np
import pytest

from eitskin.data.recording import Recording
from eitskin.diagnose import diagnosis
from eitskin.diagnose.search import refits, staging
from eitskin.diagnose.verdict import conclusion
from witness import cases

OF_MEDIAN = ("common-noise", "channel-drift")  # sizes that the witness tells over the median |v|


def drawn(kind, seed):
    """A case and its recording."""
    case = cases.draw(kind, seed)
    return case, Recording(case.states, case.voltage, None, None, dict(case.metadata))


def size_of(case):
    """(name, size) of the only rig error, in the unit in which it is learned."""
    (error,) = case.rig
    median = float(np.median(np.abs(case.clean[0]))) if error.kind in OF_MEDIAN else 1.0
    return error.kind, error.size * median


@pytest.mark.long
@pytest.mark.parametrize(
    "kind",
    [
        "amplitude-per-frame",
        "common-noise",
        "gain-walk",
        "place-per-frame",
        "place-per-press",
        "force-per-frame",
        "force-per-press",
    ],
)
def test_sizes_of_a_rig_are_found(kind):
    case, recorded = drawn(f"null+rig:{kind}", 11)
    _, search, _ = staging.prepared(recorded, 1)
    name, size = size_of(case)
    least = 2.0 if kind == "gain-walk" else 1.5  # one path of a random walk
    assert 1 / least < refits.calibrated(search)[1].error_sds[name] / size < least


@pytest.mark.long
@pytest.mark.parametrize(
    "kind",
    [
        "force-per-press",
        "place-per-press",
        "gain-walk",
        "channel-drift",
    ],
)
def test_a_rig_error_gets_no_name(kind):
    case, recorded = drawn(f"null+rig:{kind}", 11)
    found = diagnosis.diagnose(recorded)
    said = conclusion.document(found, kind)
    assert said["verdict"] == "consistent" and said["effects"] == []
    name, size = size_of(case)
    assert 1 / 1.5 < found.explanation.error_sds[name] / size < 1.5
    (told,) = (one for one in said["noise"]["components"] if one["name"] == name)
    assert told["sd"] == found.explanation.error_sds[name]
    # Twice as wide as that of 90 %, of which one in ten lies outside.
    assert told["low"] ** 2 < size * told["sd"] < told["high"] ** 2


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "seed", "component"),
    [
        ("touch-contrast", 5, "force-per-press"),  # SNR 24, 1.25 times the contrast
        ("hysteresis", 1, "force-per-press"),  # gap 14
        ("registration", 4, "place-per-press"),  # SNR 42, 0.23 deg
        ("conductivity-drift", 4, "gain-walk"),  # SNR 44
        ("contact-drift", 6, "channel-drift"),  # gap 26
    ],
)
def test_an_effect_is_not_taken_for_a_rig_error(name, seed, component):
    _, recorded = drawn(f"single:{name}", seed)
    found = diagnosis.diagnose(recorded)
    (effect,) = conclusion.document(found, name)["effects"]
    assert name in (effect["name"], *effect["alternatives"])
    assert found.explanation.error_sds[component] < found.search.rig.prior_sds[component] / 3.0


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "seed", "component"),
    [
        ("contact-law", 2, "force-per-press"),  # gap to touch-contrast 8.5
        ("drive-gain", 3, "channel-drift"),  # gap 15
    ],
)
def test_an_effect_and_its_rig_error_are_told_apart(name, seed, component):
    case, recorded = drawn(f"single:{name}+rig:{component}", seed)
    found = diagnosis.diagnose(recorded)
    (effect,) = conclusion.document(found, name)["effects"]
    assert name in (effect["name"], *effect["alternatives"])
    assert 1 / 1.5 < found.explanation.error_sds[component] / size_of(case)[1] < 1.5


@pytest.mark.long
def test_a_class_is_declared_whole_on_a_rig_with_errors():
    case, recorded = drawn("single:contact-law+rig:common-noise", 4)  # SNR 16
    found = diagnosis.diagnose(recorded)
    (effect,) = conclusion.document(found, "contact-law")["effects"]
    (others,) = found.gaps
    near = [other.rival for other in others if other.gap < 3.0]
    assert effect["name"] == "contact-law"
    assert effect["alternatives"] == near and "contact-area-growth" in near
    assert len(near) < len(others)
    name, size = size_of(case)
    assert 1 / 1.5 < found.explanation.error_sds[name] / size < 1.5
    assert (
        found.explanation.error_sds["force-per-press"]
        < found.search.rig.prior_sds["force-per-press"] / 3.0
    )
