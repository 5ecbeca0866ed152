"""Channel tables and the patterns that make none."""

import numpy as np
import pytest

from eitskin.errors import InputError
from eitskin.physics.protocol import channel_table, tied_channels


def test_adjacent_of_sixteen_is_the_papers_table():
    channels = channel_table(16)
    assert channels.shape == (208, 4)
    assert channels[:2].tolist() == [[0, 1, 2, 3], [0, 1, 3, 4]]
    assert channels[-1].tolist() == [15, 0, 13, 14]


@pytest.mark.parametrize(("drive", "measure"), [("adjacent", "skip-2"), ("opposite", "skip-14")])
def test_no_channel_touches_its_drive_and_none_stands_twice(drive, measure):
    channels = channel_table(16, drive, measure)
    assert all(len(set(channel)) == 4 for channel in channels.tolist())
    assert len(np.unique(channels, axis=0)) == len(channels)


@pytest.mark.parametrize(
    ("n", "pattern"),
    [(16, "skip-15"), (16, "skip-20"), (16, "skip-31"), (15, "opposite"), (16, "skip--1")],
)
def test_a_pattern_that_pairs_no_two_electrodes_is_refused(n, pattern):
    with pytest.raises(InputError, match=f"protocol: pattern: found '{pattern}'"):
        channel_table(n, pattern)


@pytest.mark.parametrize(
    ("n", "drive", "measure"), [(4, "adjacent", "opposite"), (4, "opposite", "adjacent"), (3,) * 3]
)
def test_a_table_without_channels_is_refused(n, drive, measure):
    patterns = (drive, measure) if n == 4 else ()
    with pytest.raises(InputError, match="no channel is left"):
        channel_table(n, *patterns)


def test_channels_are_tied_through_others():
    """The second is the first turned round in both pairs, the third exchanged with either."""
    label, sign = tied_channels(np.array([[0, 1, 2, 3], [1, 0, 3, 2], [2, 3, 0, 1], [0, 2, 1, 3]]))
    assert label[0] == label[1] == label[2] != label[3]
    assert sign[0] == sign[1] == sign[2]
    label, sign = tied_channels(np.array([[0, 1, 2, 3], [3, 2, 0, 1]]))
    assert label[0] == label[1] and sign[0] == -sign[1]
