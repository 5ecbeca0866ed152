"""A stretch of a recording: its frames as they were, numbered anew, and a recording of its own."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eitskin.data import recording
from eitskin.data.check import check
from eitskin.data.recording import presses
from eitskin.data.subset import stretch
from eitskin.errors import InputError
from small_skin import small_recording

WHOLE = small_recording(places=4)
COUNT = len(WHOLE.frames)
OWN = ["frame", "contact"]


def test_all_frames_are_the_recording():
    part = stretch(WHOLE, 0, COUNT - 1, "skin")
    assert np.array_equal(part.voltage, WHOLE.voltage)
    assert part.frames.drop(columns="contact").equals(WHOLE.frames)
    assert np.array_equal(presses(part), presses(WHOLE))
    assert part.metadata["source"].endswith(f"; its frames 0 to {COUNT - 1}")


@given(st.integers(5, COUNT - 6))
def test_before_and_after_together_are_the_whole(first):
    parts = [stretch(WHOLE, 0, first - 1, "skin"), stretch(WHOLE, first, COUNT - 1, "skin")]
    assert np.array_equal(np.concatenate([part.voltage for part in parts]), WHOLE.voltage)
    frames = pd.concat([part.frames for part in parts], ignore_index=True)
    assert frames.drop(columns=OWN).equals(WHOLE.frames.drop(columns="frame"))
    for part in parts:
        assert np.array_equal(part.frames["frame"], np.arange(len(part.frames)))
    whole, labels = presses(WHOLE), [presses(part) for part in parts]
    for own, there in zip(labels, np.split(whole, [first]), strict=True):
        assert np.array_equal(own < 0, there < 0)
        assert len({*zip(own, there, strict=True)}) == len({*own}) == len({*there})


def test_a_stretch_can_be_written_and_read(tmp_path):
    part = stretch(WHOLE, 4, 12, "skin")
    recording.write(part, tmp_path / "part.parquet")
    read = recording.read(tmp_path / "part.parquet")
    assert np.array_equal(read.voltage, WHOLE.voltage[4:13])
    assert np.array_equal(read.frames["time_s"], WHOLE.frames["time_s"][4:13])


def test_a_query_has_stretches_too():
    part = stretch(replace(WHOLE, voltage=None), 4, 12, "skin")
    assert part.voltage is None and len(part.frames) == 9 and check(part).ok


@pytest.mark.parametrize("first, last", [(3, 2), (0, COUNT), (-1, 4)])
def test_frames_that_are_not_there_are_refused(first, last):
    expected = f"skin: frames: found {first}:{last}, expected FIRST:LAST, of frames 0 to"
    with pytest.raises(InputError, match=expected):
        stretch(WHOLE, first, last, "skin")


def test_a_stretch_in_which_somebody_always_touches_is_refused():
    touched = int(np.flatnonzero(WHOLE.frames["touch"])[0])
    with pytest.raises(InputError, match="skin: column touch: found true in all 2 rows"):
        stretch(WHOLE, touched, touched + 1, "skin")
