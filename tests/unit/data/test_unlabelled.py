"""Touches that no label tells are found; what else comes and goes is not called a touch."""

from dataclasses import replace

import numpy as np
import pytest

from eitskin.data import check
from eitskin.data.check.steps import steps
from eitskin.data.check.unlabelled import labelled, stretch_text, unlabelled_touches
from eitskin.data.recording import Recording, frames_table, presses
from proof.drawing import draw

STRETCH = slice(20, 32)  # in which something comes and goes


def forgotten(recorded: Recording, *numbers: int) -> tuple[Recording, np.ndarray]:
    """A recording whose presses of these numbers are labelled untouched, and their rows' mask."""
    hidden = np.isin(presses(recorded), numbers)
    frames = recorded.frames.copy()
    frames.loc[hidden, ["x_mm", "y_mm", "probe_mm", "depth_mm"]] = np.nan
    frames.loc[hidden, "force_N"] = 0.0
    frames.loc[hidden, "touch"] = False
    return replace(recorded, frames=frames), hidden


def found(recorded: Recording) -> np.ndarray:
    """(N,) bool: the frames in which a touch without a label is found."""
    mask = np.zeros(len(recorded.frames), bool)
    for first, last in unlabelled_touches(recorded):
        mask[first : last + 1] = True
    return mask


@pytest.mark.parametrize("kind", ["null", "null+rig"])
def test_nothing_is_found_where_every_touch_has_its_label(kind):
    for seed in range(5):
        assert unlabelled_touches(draw(kind, seed).recorded) == []


@pytest.mark.parametrize("numbers", [(3,), (2, 7), (0, 4, 5)])
def test_presses_without_a_label_are_found_frame_by_frame_and_are_no_steps(numbers):
    for seed in (0, 4):
        recorded, hidden = forgotten(draw("null", seed).recorded, *numbers)
        assert (found(recorded) == hidden).all()
        assert steps(recorded) == []
        kept, stretches = labelled(recorded)
        assert kept.frames["frame"].tolist() == np.flatnonzero(~hidden).tolist()
        assert sum(last + 1 - first for first, last in stretches) == hidden.sum()


def test_a_recording_of_forgotten_touches_alone_shows_them():
    case = draw("null", 0)
    recorded, hidden = forgotten(case.recorded, *range(4))
    end = int(np.flatnonzero(presses(case.recorded) == 4)[0])
    part = replace(recorded, frames=recorded.frames[:end], voltage=recorded.voltage[:end])
    assert not part.frames["touch"].any()
    assert (found(part) == hidden[:end]).all()


@pytest.fixture
def untouched():
    """An untouched recording of 60 frames, the size of its change there (60, 1), a generator."""
    case, draws = draw("null", 2), np.random.default_rng(2)
    level = case.clean[~case.states["touch"].to_numpy(bool)][0]
    readings = level + case.noise_V * draws.standard_normal((60, len(level)))
    frames = frames_table(0.8 * np.arange(60), np.zeros(60, bool))
    size = np.zeros((60, 1))
    size[STRETCH] = draws.uniform(0.5, 1.0, (12, 1))
    return Recording(frames, readings, None, None, case.metadata), size, draws


def changes(recorded, size, draws):
    """What comes and goes in readings (N, M), by name."""
    readings, channels = recorded.readings, recorded.channels
    typical, shape = np.abs(readings).mean(), readings.shape
    step = np.abs(np.diff(readings, axis=0)).mean()
    loud = np.zeros(shape)
    loud[25] = 30.0 * step * draws.standard_normal(shape[1])
    of_electrode = (channels == 5).any(axis=1)
    return {
        "gain": 0.05 * size * readings,
        "gain walk": 5e-3 * np.cumsum(draws.standard_normal((60, 1)), axis=0) * readings,
        "drift": 2.0 * step * np.cumsum(draws.standard_normal(shape), axis=0),
        "burst": 10.0 * step * (size > 0.0) * draws.standard_normal(shape),
        "loud frame": loud,
        "electrode's gain": 0.3 * size * readings * of_electrode,
        "open wire": typical * size * of_electrode * draws.standard_normal(shape[1]),
        "drive's gain": 0.3 * size * readings * (channels[:, 0] == 5),
        "offset": 0.3 * typical * size * (channels[:, 2] == 5),
    }


def test_what_else_comes_and_goes_is_no_touch(untouched):
    recorded, size, draws = untouched
    assert unlabelled_touches(recorded) == []
    for name, change in changes(recorded, size, draws).items():
        changed = replace(recorded, voltage=recorded.readings + change)
        assert unlabelled_touches(changed) == [], name


def test_a_broken_wire_that_comes_back_is_no_touch(untouched):
    recorded, size, draws = untouched
    case = draw("single:electrode-open", 1)
    rest = ~case.true_states["touch"].to_numpy(bool)
    states = case.true_states
    level, broken = (case.world.readings(states, laws)[rest][0] for laws in ([], case.effects))
    noise = case.noise_V * draws.standard_normal((60, len(level)))
    readings = np.where(size > 0.0, broken, level) + noise
    assert unlabelled_touches(replace(recorded, voltage=readings, metadata=case.metadata)) == []


def test_a_change_that_stays_is_a_step_and_no_touch():
    recorded = draw("null", 0).recorded
    readings = recorded.readings.copy()
    change = readings[10] - readings[0]
    readings[70:] += change
    changed = replace(recorded, voltage=readings)
    assert unlabelled_touches(changed) == [] and len(steps(changed)) == 1


def test_the_check_warns_of_each_stretch():
    recorded, hidden = forgotten(draw("null", 0).recorded, 3)
    first, last = np.flatnonzero(hidden)[[0, -1]]
    (finding,) = check.check(recorded).of_topic("unlabelled")
    assert finding.severity == check.WARNING and finding.frame == first
    assert finding.sentence.startswith(f"in frames {first} to {last} somebody touched the skin")
    assert not check.check(recorded).of_topic("step")


def test_no_differences_no_query_and_no_other_outline_are_searched():
    recorded, _ = forgotten(draw("null", 0).recorded, 3)
    assert unlabelled_touches(replace(recorded, voltage=None)) == []
    metadata = recorded.metadata | {"values": "difference"}
    assert unlabelled_touches(replace(recorded, metadata=metadata)) == []
    skin = recorded.metadata["skin"] | {"radius_mm": None, "outline": "a glove"}
    metadata = recorded.metadata | {"skin": skin}
    assert unlabelled_touches(replace(recorded, metadata=metadata)) == []


def test_stretches_are_written_by_their_frames():
    assert stretch_text((3, 3)) == "frame 3" and stretch_text([3, 9]) == "frames 3 to 9"
