"""What is far off where nobody touches is looked for there first."""

from dataclasses import replace

import pytest

from eitskin.data.averages import averages
from eitskin.data.subset import of_frames
from eitskin.diagnose import diagnosis
from eitskin.diagnose.fitting import families
from eitskin.diagnose.fitting.fit import fit
from eitskin.diagnose.search import staging
from small_skin import small_recording
from witness import owned
from witness.dense import draw

PRESSED = {"harmonic": 2, "amplitude": 0.05, "phase_deg": 20.0, "carried": 1}
OVAL = {"name": "domain-shape", "parameters": PRESSED}
NOISE = 3e-4
GAINS = (  # that hide each other
    {"name": "drive-gain", "drives": [4], "parameters": {"gain": 0.95}},
    {"name": "measurement-gain", "measures": [4], "parameters": {"gain": 0.95}},
)


def first_of(recorded):
    lines: list[str] = []
    _, search, _ = staging.prepared(recorded, 1)
    search = replace(search, report=lines.append)
    return staging._untouched_first(search, recorded, 1), lines


@pytest.mark.long
def test_what_is_far_off_is_explained_without_the_touches():
    """By names that read alike there, whichever they are."""
    recorded = small_recording(OVAL, noise=NOISE)
    start, lines = first_of(recorded)
    assert "nobody touches" in lines[0]
    few = of_frames(recorded, ~recorded.frames["touch"].to_numpy(bool))
    problem = staging.prepared(few, 1)[1].problem
    assert fit(problem, start.effects, start.fit.theta).chi2 < 1.3 * problem.whitening.size


@pytest.mark.long
def test_touches_tell_a_pressed_rim_from_what_reads_like_it_without_them():
    found = diagnosis.diagnose(small_recording(OVAL, noise=NOISE))
    assert [c.name for c in found.explanation.effects] == ["domain-shape"]
    values = found.explanation.fit.settings()[0].values
    assert values["amplitude"] == pytest.approx(0.05, rel=1e-3) and values["carried"] == 1


@pytest.mark.parametrize("item", [None, {"name": "touch-contrast", "parameters": {"ratio": 3.0}}])
def test_what_is_right_without_touches_is_looked_for_with_them(item):
    items = [item] if item else []
    assert first_of(small_recording(*items, noise=NOISE)) == (None, [])


def test_two_gains_that_hide_each_other_stand_out_of_their_families():
    start, lines = first_of(small_recording(*GAINS, noise=NOISE))
    assert start is not None and lines
    values = {s.effect.name: s.values["gain"].tolist() for s in start.fit.settings()}
    assert values == {item["name"]: pytest.approx([0.95], abs=1e-3) for item in GAINS}
    assert {c.sites for c in start.effects} == {(4,)}


@pytest.fixture
def at_most(monkeypatch):
    """Makes families be fitted to so many frames of a small recording at most."""

    def limited(frames):
        _, search, _ = staging.prepared(small_recording(), 1)
        derivatives = families.MOST_TOUCHED_DERIVATIVES
        each = derivatives / families.most_frames(families.members(search.candidates), 40, True)
        monkeypatch.setattr(families, "MOST_TOUCHED_DERIVATIVES", int(each * (frames + 0.5)))

    return limited


def test_families_are_sought_in_an_excerpt_of_too_many_frames(at_most):
    recorded = small_recording(*GAINS, noise=NOISE)
    _, search, _ = staging.prepared(recorded, 1)
    assert staging._takes_families(search, touched=True)
    at_most(29)
    fewer = staging._fewer_frames(search, touched=True)
    assert fewer is not None and fewer.frames in (28, 29) and not fewer.are_averages
    part = diagnosis._excerpt(recorded, fewer.frames, lambda line: None)
    assert 20 <= len(part.frames) <= fewer.frames and not part.frames["touch"].all()
    at_most(12)  # too few for a diagnosis
    assert staging._fewer_frames(search, touched=True) is None
    assert not staging._takes_families(search, touched=True)


def test_many_untouched_frames_with_a_gross_misfit_are_averaged():
    """But for readings in a converter's steps, which averages would hide."""
    frames = draw("dense:8 adjacent", 910_001).recorded
    with pytest.raises(staging.FewerFrames) as fewer:
        staging.searched(frames, staging.prepared(frames, 1)[1], 1)
    assert fewer.value.are_averages and fewer.value.frames == staging.AVERAGES
    part = averages(frames, fewer.value.frames)
    _, search, _ = staging.prepared(part, 1)
    assert search.problem.families and len(search.problem.readings) == staging.AVERAGES
    step = 20.0 * search.problem.whitening.sd.max()
    coarse = replace(frames, voltage=step * (frames.readings / step).round())
    _, search, _ = staging.prepared(coarse, 1)
    assert search.converter_step == pytest.approx(step)
    staging._refuse_many_untouched(search)


@pytest.mark.long
def test_an_excerpt_is_diagnosed_with_its_families(at_most):
    at_most(29)
    diagnosed = diagnosis.diagnose(small_recording(*GAINS, noise=NOISE))
    assert 20 <= len(diagnosed.recording.frames) <= 29
    assert {c.name for c in diagnosed.explanation.effects} == {item["name"] for item in GAINS}


def test_a_recording_of_touches_alone_has_no_frames_to_begin_with():
    recorded = small_recording(OVAL, noise=NOISE)
    touched = recorded.frames["touch"].to_numpy(bool)
    recorded.frames = recorded.frames[touched].reset_index(drop=True)
    recorded.voltage = recorded.voltage[touched]
    assert first_of(recorded)[0] is None


@pytest.mark.long
def test_a_pressed_skin_of_the_witness_is_named_with_its_size():
    one = owned.draw("owner:out-of-round", 3)
    found = diagnosis.diagnose(one.recorded)
    assert [c.name for c in found.explanation.effects] == ["domain-shape"]
    (true, *_) = one.truth.effects
    values = found.explanation.fit.settings()[0].values
    for key in ("harmonic", "amplitude", "phase_deg"):
        assert values[key] == pytest.approx(true["parameters"][key], rel=0.02)
    gain, error = found.prediction.gain(found.prediction_by(found.baseline))
    assert gain > 2.0 * error
