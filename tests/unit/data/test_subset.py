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

RECORDING = small_recording(places=4)
COUNT = len(RECORDING.frames)
RENUMBERED = ["frame", "contact"]


def test_all_frames_are_the_recording():
    part = stretch(RECORDING, 0, COUNT - 1, "skin")
    assert np.array_equal(part.voltage, RECORDING.voltage)
    assert part.frames.drop(columns="contact").equals(RECORDING.frames)
    assert np.array_equal(presses(part), presses(RECORDING))
    assert part.metadata["source"].endswith(f"; its frames 0 to {COUNT - 1}")


@given(st.integers(5, COUNT - 6))
def test_before_and_after_together_are_the_whole(first_frame):
    parts = [
        stretch(RECORDING, 0, first_frame - 1, "skin"),
        stretch(RECORDING, first_frame, COUNT - 1, "skin"),
    ]
    assert np.array_equal(np.concatenate([part.voltage for part in parts]), RECORDING.voltage)
    frames = pd.concat([part.frames for part in parts], ignore_index=True)
    assert frames.drop(columns=RENUMBERED).equals(RECORDING.frames.drop(columns="frame"))
    for part in parts:
        assert np.array_equal(part.frames["frame"], np.arange(len(part.frames)))
    all_presses, labels = presses(RECORDING), [presses(part) for part in parts]
    for part_presses, expected_presses in zip(
        labels, np.split(all_presses, [first_frame]), strict=True
    ):
        assert np.array_equal(part_presses < 0, expected_presses < 0)
        assert (
            len({*zip(part_presses, expected_presses, strict=True)})
            == len({*part_presses})
            == len({*expected_presses})
        )


def test_a_stretch_can_be_written_and_read(tmp_path):
    part = stretch(RECORDING, 4, 12, "skin")
    recording.write(part, tmp_path / "part.parquet")
    read = recording.read(tmp_path / "part.parquet")
    assert np.array_equal(read.voltage, RECORDING.voltage[4:13])
    assert np.array_equal(read.frames["time_s"], RECORDING.frames["time_s"][4:13])


def test_a_query_has_stretches_too():
    part = stretch(replace(RECORDING, voltage=None), 4, 12, "skin")
    assert part.voltage is None and len(part.frames) == 9 and check(part).ok


@pytest.mark.parametrize("first_frame, last_frame", [(3, 2), (0, COUNT), (-1, 4)])
def test_frames_that_are_not_there_are_refused(first_frame, last_frame):
    expected = (
        f"skin: frames: found {first_frame}:{last_frame}, expected FIRST:LAST, of frames 0 to"
    )
    with pytest.raises(InputError, match=expected):
        stretch(RECORDING, first_frame, last_frame, "skin")


def test_a_stretch_in_which_somebody_always_touches_is_refused():
    touched = int(np.flatnonzero(RECORDING.frames["touch"])[0])
    with pytest.raises(InputError, match="skin: column touch: found true in all 2 rows"):
        stretch(RECORDING, touched, touched + 1, "skin")
