"""The forward model on outlines against finite elements that share nothing with it."""

import pytest

from benchmark import outlines

pytestmark = pytest.mark.long


@pytest.mark.parametrize(
    "name",
    [
        "L",
        "ellipse 2:1",
        "flat disc",
        "blob",
        "square, round corners",
        "L, round corners",
        "square, four inside",
        "ellipse, eight inside",
        "L, all inside",
    ],
)
def test_an_outline_is_that_of_finite_elements(name):
    train, diagnose = outlines.rows(name)
    assert diagnose["witness_error"] < 3e-7 and diagnose["witness_touch_error"] < 3e-6
    assert diagnose["rms_error_of_median_v"] < 1e-6 and diagnose["touch_error"] < 1e-5
    assert train["rms_error_of_median_v"] < 1e-4 and train["touch_error"] < 1e-3
    is_cut = name == "L, all inside"  # a touch across an electrode
    assert isinstance(train["refused"], str) == is_cut
