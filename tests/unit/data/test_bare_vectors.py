"""Frames as bare vectors: channel tables by count, pairs and order, against the physics."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eitskin.data.channel_order import ORDERS, in_order, misfit
from eitskin.data.importers import bare_vectors
from eitskin.data.importers.bare_vectors import listed, stepped
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
def test_the_count_tells_the_electrodes_and_the_table_is_the_protocols(n, drive, measure, whole):
    table = channel_table(n, drive, measure)
    laid = stepped("file", n * n if whole else len(table), drive, measure)
    assert laid.n_electrodes == n
    np.testing.assert_array_equal(laid.channels, table)
    assert len(laid.columns) == len(table) and laid.width == (n * n if whole else len(table))
    if whole:
        every = every_channel(n, drive, measure)
        np.testing.assert_array_equal(every[laid.columns], table)
    turned = stepped("file", laid.width, drive, f"{measure}-reversed")
    np.testing.assert_array_equal(turned.channels, table[:, [0, 1, 3, 2]])


@settings(deadline=None)
@given(sizes, patterns, patterns, st.sampled_from([None, *ORDERS]), st.booleans())
def test_what_a_skin_reads_in_an_order_keeps_the_tables_values(n, drive, measure, order, whole):
    """Numbers written in any order come back as the channels' own, without those at the drive."""
    channels = every_channel(n, drive, measure)
    channels = channels if whole else channels[undriven(channels)]
    written = channels if order is None else in_order("file", order, channels, n)
    frame = readings(written, n)
    laid = stepped("file", len(frame), drive, measure, order)
    np.testing.assert_array_equal(frame[laid.columns], readings(laid.channels, n))
    assert undriven(laid.channels).all()
    found = misfit(frame[None, laid.columns], laid.channels, n, True).overall
    assert found is None or found < (1e-6 if drive == measure else 0.3)


@given(sizes, st.sampled_from(["adjacent", "skip-1"]), st.booleans())
def test_numbers_that_reciprocity_makes_alike_may_stand_once(n, pattern, known):
    """104 of 16 electrodes: EIDORS's no_redundant, the channels whose drive comes first."""
    table = channel_table(n, pattern, pattern)
    once = table[table[:, 0] < table[:, 2]]
    laid = stepped("file", len(once), pattern, pattern, None, None if n == 16 and not known else n)
    np.testing.assert_array_equal(laid.channels, once)
    assert len(laid.columns) == len(once) == laid.width
    assert not len(reciprocal_channels(once)[0])


@given(sizes, patterns, patterns)
def test_a_list_of_channels_is_the_table_that_it_lists(n, drive, measure):
    every = every_channel(n, drive, measure)
    laid = listed("file", n * n, every.tolist())
    np.testing.assert_array_equal(laid.channels, channel_table(n, drive, measure))
    np.testing.assert_array_equal(laid.columns, np.flatnonzero(undriven(every)))


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
        stepped("file", *arguments)
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
        listed("file", 2, channels, None, 8)


@pytest.mark.parametrize("order", ["drive-plus-ascending-own", "drive-plus-descending"])
@pytest.mark.parametrize("signed", [True, False])
def test_a_full_matrix_in_another_order_is_refused_and_the_order_named(order, signed):
    """Its numbers at driven electrodes would be taken for readings."""
    channels = every_channel(16, "adjacent", "adjacent")
    frames = readings(in_order("file", order, channels, 16), 16)[None]
    frames = frames if signed else np.abs(frames)
    laid = stepped("file", 256, "adjacent", "adjacent")
    with pytest.raises(InputError, match=r"--order (\S+) ") as caught:
        bare_vectors.refuse_other_order("file", frames, "adjacent", "adjacent", laid)
    named = str(caught.value).split("--order ")[1].split()[0]
    laid = stepped("file", 256, "adjacent", "adjacent", named)
    np.testing.assert_array_equal(
        np.abs(frames[0, laid.columns]), np.abs(readings(laid.channels, 16))
    )


def test_a_full_matrix_in_its_own_order_and_garbage_are_not_refused():
    laid = stepped("file", 256, "adjacent", "adjacent")
    own = readings(every_channel(16, "adjacent", "adjacent"), 16)[None]
    garbage = np.random.default_rng(0).normal(size=(3, 256))
    for frames in (own, garbage, np.full((2, 256), np.nan), np.zeros((1, 256))):
        bare_vectors.refuse_other_order("file", frames, "adjacent", "adjacent", laid)
