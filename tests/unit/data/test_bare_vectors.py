"""Frames as bare vectors: channel tables by count, pairs and order, against the physics."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eitskin.data.channel_order import ORDERS, in_order, misfit
from eitskin.data.importers import bare_vectors
from eitskin.data.importers.bare_vectors import channel_layout, pattern_layout
from eitskin.errors import InputError
from eitskin.physics.protocol import (
    channel_table,
    every_channel,
    reciprocal_channels,
    undriven,
)
from homogeneous_skin import readings

PATTERNS = ["adjacent", "opposite", "skip-1", "skip-2"]
sizes = st.sampled_from([8, 12, 16])
patterns = st.sampled_from(PATTERNS)


@given(sizes, patterns, patterns, st.booleans())
def test_the_count_tells_the_electrodes_and_the_table_is_the_protocols(
    n, drive, measure, with_driven
):
    table = channel_table(n, drive, measure)
    layout = pattern_layout("file", n * n if with_driven else len(table), drive, measure)
    assert layout.n_electrodes == n
    np.testing.assert_array_equal(layout.channels, table)
    assert len(layout.columns) == len(table) and layout.width == (
        n * n if with_driven else len(table)
    )
    if with_driven:
        all_channels = every_channel(n, drive, measure)
        np.testing.assert_array_equal(all_channels[layout.columns], table)
    turned = pattern_layout("file", layout.width, drive, f"{measure}-reversed")
    np.testing.assert_array_equal(turned.channels, table[:, [0, 1, 3, 2]])


@settings(deadline=None)
@given(sizes, patterns, patterns, st.sampled_from([None, *ORDERS]), st.booleans())
def test_what_a_skin_reads_in_an_order_keeps_the_tables_values(
    n, drive, measure, order, with_driven
):
    """Numbers written in any order come back as the channels' own, without those at the drive."""
    channels = every_channel(n, drive, measure)
    channels = channels if with_driven else channels[undriven(channels)]
    written = channels if order is None else in_order("file", order, channels, n)
    frame = readings(written, n)
    layout = pattern_layout("file", len(frame), drive, measure, order)
    np.testing.assert_array_equal(frame[layout.columns], readings(layout.channels, n))
    assert undriven(layout.channels).all()
    order_misfit = misfit(frame[None, layout.columns], layout.channels, n, True).overall
    assert order_misfit is None or order_misfit < (1e-6 if drive == measure else 0.3)


@given(sizes, st.sampled_from(["adjacent", "skip-1"]), st.booleans())
def test_numbers_that_reciprocity_makes_alike_may_stand_once(n, pattern, is_ring_stated):
    """104 of 16 electrodes: EIDORS's no_redundant, the channels whose drive comes first."""
    table = channel_table(n, pattern, pattern)
    half_table = table[table[:, 0] < table[:, 2]]
    layout = pattern_layout(
        "file",
        len(half_table),
        pattern,
        pattern,
        None,
        None if n == 16 and not is_ring_stated else n,
    )
    np.testing.assert_array_equal(layout.channels, half_table)
    assert len(layout.columns) == len(half_table) == layout.width
    assert not len(reciprocal_channels(half_table)[0])


@given(sizes, patterns, patterns)
def test_a_list_of_channels_is_the_table_that_it_lists(n, drive, measure):
    all_channels = every_channel(n, drive, measure)
    layout = channel_layout("file", n * n, all_channels.tolist())
    np.testing.assert_array_equal(layout.channels, channel_table(n, drive, measure))
    np.testing.assert_array_equal(layout.columns, np.flatnonzero(undriven(all_channels)))


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ((207, "adjacent", "adjacent"), "found 207, expected .*104 or 208 or 256 of 16 elec"),
        ((3, "adjacent", "adjacent"), "found 3, expected 40 or 64 of 8 electrodes, 54 or"),
        ((208, "sideways", "adjacent"), "'sideways'.*adjacent, opposite or skip-<n>"),
        ((208, "adjacent", "reversed-adjacent"), "expected .*-reversed"),
        (
            (28, "adjacent", "adjacent", None, 8),
            "found 28, expected 20 or 40 or 64 of 8",
        ),
        (
            (208, "adjacent", "adjacent", "backwards"),
            "order: found 'backwards', expected one of",
        ),
    ],
)
def test_what_fits_nothing_is_refused_in_one_line(arguments, match):
    with pytest.raises(InputError, match=match) as caught:
        pattern_layout("file", *arguments)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("channels", "match"),
    [
        ([[0, 1, 2, 3]], "1 channels, expected 2, one a number"),
        ([[0, 1, 2, 3], [0, 1, 2]], "row 1"),
        ([[0, 1, 2, 3], [0, 1, 2, 2.0]], "row 1"),
        ([[0, 1, 2, 3], [0, 1, 2, 9]], "row 1: .*0 to 7"),
        ([[0, 1, 2, 3], [4, 4, 2, 3]], "row 1: .*two electrodes a pair"),
        ([[0, 1, 0, 1], [2, 3, 2, 4]], "every measured pair at a driven electrode"),
    ],
)
def test_a_list_that_is_none_of_channels_is_refused(channels, match):
    with pytest.raises(InputError, match=match):
        channel_layout("file", 2, channels, None, 8)


@pytest.mark.parametrize("order", ["drive-plus-ascending-own", "drive-plus-descending"])
@pytest.mark.parametrize("signed", [True, False])
def test_a_full_matrix_in_another_order_is_refused_and_the_order_named(order, signed):
    """Its numbers at driven electrodes would be taken for readings."""
    channels = every_channel(16, "adjacent", "adjacent")
    frames = readings(in_order("file", order, channels, 16), 16)[None]
    frames = frames if signed else np.abs(frames)
    layout = pattern_layout("file", 256, "adjacent", "adjacent")
    with pytest.raises(InputError, match=r"--order (\S+) ") as caught:
        bare_vectors.refuse_other_order("file", frames, "adjacent", "adjacent", layout)
    named = str(caught.value).split("--order ")[1].split()[0]
    layout = pattern_layout("file", 256, "adjacent", "adjacent", named)
    np.testing.assert_array_equal(
        np.abs(frames[0, layout.columns]), np.abs(readings(layout.channels, 16))
    )


def test_a_full_matrix_in_its_own_order_and_garbage_are_not_refused():
    layout = pattern_layout("file", 256, "adjacent", "adjacent")
    frame_in_order = readings(every_channel(16, "adjacent", "adjacent"), 16)[None]
    garbage = np.random.default_rng(0).normal(size=(3, 256))
    for frames in (frame_in_order, garbage, np.full((2, 256), np.nan), np.zeros((1, 256))):
        bare_vectors.refuse_other_order("file", frames, "adjacent", "adjacent", layout)
