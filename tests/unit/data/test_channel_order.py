import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eitskin.data.alignment import homogeneous_readings, sensitivity
from eitskin.data.channel_order import Misfit, known_orders, misfit, reordered
from eitskin.data.check.finding import ERROR, FACT, WARNING
from eitskin.data.check.wiring import Order
from eitskin.physics.geometry import even_angles
from eitskin.physics.protocol import channel_table

RNG = np.random.default_rng(1)


def skin_readings(channels, n):
    """An uneven skin's signed readings (1, M): a disc with two patches."""
    angles = even_angles(n)
    patches = sensitivity(channels, angles, np.array([0.5 + 0.3j, -0.4j]))
    return (homogeneous_readings(channels, angles) + 0.05 * patches.sum(axis=0))[None]


@given(st.sampled_from([8, 16]), st.sampled_from(["adjacent", "skip-2"]), st.booleans())
def test_a_skin_keeps_its_identities_and_a_shuffled_one_does_not(n, pattern, signed):
    channels = channel_table(n, pattern, pattern)
    readings = skin_readings(channels, n)
    values = readings if signed else np.abs(readings)
    assert misfit(values, channels, n, signed).reciprocity < 1e-12
    shuffled = values[:, RNG.permutation(len(channels))]
    assert misfit(shuffled, channels, n, signed).reciprocity > 0.3


@pytest.mark.parametrize("polarity", [[0, 1, 2, 3], [0, 1, 3, 2]])
@pytest.mark.parametrize("signed", [True, False])
def test_opposite_drive_turns_its_sign_when_reversed(polarity, signed):
    channels = channel_table(16, "opposite")[:, polarity]
    readings = skin_readings(channels, 16)
    order_misfit = misfit(readings if signed else np.abs(readings), channels, 16, signed)
    assert order_misfit.reciprocity is None
    assert order_misfit.reversal < 1e-12
    assert 0 < order_misfit.rotation < 0.2
    assert order_misfit.overall == pytest.approx(order_misfit.rotation / np.sqrt(2))


def test_lost_readings_are_left_out():
    channels = channel_table(16)
    readings = skin_readings(channels, 16)
    readings[0, ::7] = np.nan
    order_misfit = misfit(readings, channels, 16, True)
    assert order_misfit.reciprocity < 1e-12 and np.isfinite(order_misfit.rotation)


def test_a_table_without_identities_has_no_misfit():
    channels = np.array([[0, 1, 2, 3], [0, 4, 6, 9]])
    assert misfit(np.ones((1, 2)), channels, 16, True).overall is None


@pytest.mark.parametrize("drive", ["adjacent", "opposite", "skip-3"])
def test_known_orders_are_other_orders_of_the_same_channels(drive):
    channels = channel_table(16, drive)
    orders = known_orders(channels, 16)
    assert len(orders) > 10
    assert len({tuple(order) for order in orders.values()}) == len(orders)
    for order in orders.values():
        assert sorted(order) == list(range(len(channels)))
        assert (order != np.arange(len(channels))).any()


def test_the_order_relative_to_the_drive_is_among_them():
    """pyEIT's fmmu and EIDORS's rotate_meas: each drive's pairs from its own electrodes onwards."""
    channels = channel_table(16)
    relative = [
        [k, (k + 1) % 16, (k + 2 + i) % 16, (k + 3 + i) % 16] for k in range(16) for i in range(13)
    ]
    name = "drive-plus-ascending-own"
    assert channels[known_orders(channels, 16)[name]].tolist() == relative


def test_readings_are_put_back_into_the_tables_order():
    channels = channel_table(16)
    readings = skin_readings(channels, 16)
    for permutation in known_orders(channels, 16).values():
        np.testing.assert_array_equal(reordered(readings[:, permutation], permutation), readings)


@pytest.mark.parametrize(
    ("reciprocity", "best", "severity"),
    [
        (0.06, 0.02, FACT),
        (0.25, 0.2, FACT),
        (0.26, 0.2, ERROR),
        (0.9, 0.8, ERROR),
        (0.12, 0.039, ERROR),
        (0.12, 0.041, FACT),
        (0.09, 0.001, FACT),
    ],
)
def test_readings_that_are_not_in_their_tables_order_are_refused(reciprocity, best, severity):
    """By what they break, or by another order that fits three times better."""
    order = Order(Misfit(reciprocity, None, None), best, ["some"])
    assert order.severity == severity
    assert order.is_wrong == (severity == ERROR and best < reciprocity / 3)


def test_weaker_identities_that_are_broken_are_a_warning():
    assert Order(Misfit(None, 0.3, 0.3), 0.25, ["some"]).severity == WARNING
    assert Order(Misfit(None, 0.3, 0.3), 0.05, ["some"]).severity == ERROR
