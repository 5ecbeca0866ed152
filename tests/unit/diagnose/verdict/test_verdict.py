"""The verdict: the four cases and their borders."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eitskin.diagnose.verdict.verdict import verdict

probabilities = st.floats(0.0, 1.0)


@pytest.mark.parametrize(
    ("effects", "held_out_p", "other", "expected"),
    [
        ([], 0.5, 0.1, "consistent"),
        ([], 0.0, 0.1, "consistent"),
        ([], 0.5, 0.5, "unexplained"),
        ([True], 0.5, 0.1, "explained"),
        ([True], 0.0101, 0.499, "explained"),
        ([True], 0.01, 0.1, "partly-explained"),
        ([True], 0.5, 0.5, "partly-explained"),
        ([True], 0.0, 0.9, "partly-explained"),
        ([True, False], 0.5, 0.1, "partly-explained"),
    ],
)
def test_the_table(effects, held_out_p, other, expected):
    assert verdict(effects, held_out_p, other) == expected


@given(st.integers(0, 3), probabilities, probabilities)
def test_every_case_has_one_verdict(number, held_out_p, other):
    found = verdict([True] * number, held_out_p, other)
    assert (found in ("consistent", "unexplained")) == (number == 0)
    if found in ("consistent", "explained"):
        assert other < 0.5
    if found == "explained":
        assert held_out_p > 0.01


@pytest.mark.parametrize("wrong", [-0.1, 1.1, float("nan")])
def test_what_is_no_probability_is_refused(wrong):
    with pytest.raises(ValueError, match="no probability"):
        verdict([], wrong, 0.1)
    with pytest.raises(ValueError, match="no probability"):
        verdict([], 0.1, wrong)
