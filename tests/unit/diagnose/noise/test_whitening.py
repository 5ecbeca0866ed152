"""Whitening against the covariance written out, and against its limit of a free constant."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eitskin.diagnose.noise.low_rank import BATCH_COLUMNS
from eitskin.diagnose.noise.spectrum import WHITE, Spectrum
from eitskin.diagnose.noise.whitening import MOST_LINKED_IN_SINGLE, ErrorColumns, Whitening

LEAK = "in lasting noise a press's error reaches the frame after it, of another press or of none"
HUGE = 1e4  # sd of a constant that is as good as free
SEEDS = st.integers(0, 10**6)
FRAMES, CHANNELS = st.integers(2, 7), st.integers(2, 5)
CORRELATIONS = st.sampled_from([0.0, 0.3, 0.9])


def drawn(seed, frames, channels):
    draw = np.random.default_rng(seed)
    voltage = draw.normal(size=(frames, channels))
    voltage[draw.random((frames, channels)) < 0.2] = np.nan
    return voltage, draw.uniform(0.5, 2.0, channels), draw.uniform(0.0, 3.0, channels), draw


def explicit(whitening, a, b, error_sd):
    """a^T C^-1 b, channel by channel, over the frames that are there."""
    total = 0.0
    for m, (sd, error) in enumerate(zip(whitening.sd, error_sd, strict=True)):
        rows = whitening.mask[:, m]
        covariance = sd**2 * np.eye(rows.sum()) + error**2
        total += a[rows, m] @ np.linalg.solve(covariance, b[rows, m])
    return total


def test_a_free_constant_takes_a_reading_of_channels_that_have_some():
    mask = np.ones((5, 4), bool)
    mask[:, 2:] = False
    whitening = Whitening(mask, np.ones(4), np.full(4, np.inf))
    assert whitening.size == 2 * 5 - 2


@given(st.integers(0, 10**6), st.integers(1, 9), st.integers(1, 4))
def test_products_are_those_of_the_inverse_covariance(seed, frames, channels):
    voltage, sd, error, draw = drawn(seed, frames, channels)
    whitening = Whitening.from_readings(voltage, sd, False, error)
    a, b = draw.normal(size=(2, frames, channels))
    found = (whitening(a) * whitening(b)).sum()
    assert np.isclose(found, explicit(whitening, a, b, error), rtol=1e-9, atol=1e-9)
    assert whitening.size == np.isfinite(voltage).sum()
    assert not whitening(a)[~whitening.mask].any()


@given(st.integers(0, 10**6), st.integers(2, 9), st.integers(1, 4))
def test_differences_have_a_free_constant_a_channel(seed, frames, channels):
    voltage, sd, error, draw = drawn(seed, frames, channels)
    whitening = Whitening.from_readings(voltage, sd, True, error)
    a, b = draw.normal(size=(2, frames, channels))
    huge = explicit(whitening, a, b, np.full(channels, 1e4))
    assert np.isclose((whitening(a) * whitening(b)).sum(), huge, rtol=1e-5, atol=1e-5)
    assert np.abs(whitening(np.ones((frames, channels)))).max() < 1e-12
    there = np.isfinite(voltage)
    assert whitening.size == there.sum() - there.any(axis=0).sum()


def test_values_of_several_axes_are_whitened_alike():
    voltage, sd, error, draw = drawn(3, 6, 3)
    whitening = Whitening.from_readings(voltage, sd, False, error)
    many = draw.normal(size=(4, 6, 3))
    assert np.allclose(whitening(many), [whitening(one) for one in many])


def spectrum_of(correlation):
    """White noise at 0, one process below a half, and else two beside white noise."""
    if not correlation:
        return WHITE
    if correlation < 0.5:
        return Spectrum((correlation,), (1.0,))
    return Spectrum((correlation, 0.4), (0.5, 0.2))


def rigged(seed, frames, channels, counts, correlation=0.0, rho=0.0):
    """With columns of every channel, of every frame, of the whole, of every press and linked ones,
    as many as counts says; rho: None where the constant is free. Up to three presses, of unequal
    lengths, and frames of none; numbers that leave some out."""
    voltage, sd, _, draw = drawn(seed, frames, channels)
    plain = Whitening.from_readings(voltage, sd, rho is None, np.sqrt(rho or 0.0) * sd)
    columns = [draw.normal(size=(count, frames, channels)) for count in counts]
    label = draw.integers(-1, 3, frames) * 5
    label[draw.integers(frames)] = 10
    clock = 7 + np.cumsum(np.random.default_rng([seed, 1]).choice([1, 1, 2, 5], frames))
    linked = columns.pop() if len(columns) > 4 else None
    errors = ErrorColumns(*columns, press_label=np.maximum(label, -1), linked=linked)
    return replace(plain, spectrum=spectrum_of(correlation), errors=errors, frame_number=clock)


def written_out(whitening, constant):
    """(D, D): the covariance of the D readings that are there; constant (M,): its sd."""
    row, channel = np.nonzero(whitening.mask)
    apart = np.abs(whitening.frame_number[row][:, None] - whitening.frame_number[row])
    same = channel[:, None] == channel
    covariance = whitening.spectrum.covariance(whitening.frame_number)
    sd, level, errors = whitening.sd[channel], constant[channel], whitening.errors
    found = same * (np.outer(sd, sd) * covariance[row][:, row] + np.outer(level, level))
    everywhere, label = np.ones_like(same), errors.press_label[row]
    for columns, together in (
        (errors.channel, same),
        (errors.channel[:0] if errors.linked is None else errors.linked, same),
        (errors.frame, apart == 0),
        (errors.whole, everywhere),
        (errors.press, (label[:, None] == label) & (label >= 0)),
    ):
        there = columns[:, row, channel]
        found = found + together * (there.T @ there)
    return found


def written(whitening):
    """(D, D): the whitening of the D readings that are there, as a matrix."""
    row, channel = np.nonzero(whitening.mask)
    units = np.zeros((len(row), *whitening.mask.shape))
    units[np.arange(len(row)), row, channel] = 1.0
    return whitening(units)[:, row, channel].T


def assert_is(whitening, covariance):
    """The whitening is a root of the inverse of this covariance, its determinant with it."""
    matrix = written(whitening)
    assert np.allclose(matrix.T @ matrix, np.linalg.inv(covariance), rtol=1e-7, atol=1e-9)
    variances = np.log(whitening.sd[np.nonzero(whitening.mask)[1]] ** 2).sum()
    expected = np.linalg.slogdet(covariance)[1] - variances
    assert np.isclose(whitening.log_determinant, expected, rtol=1e-9, atol=1e-9)


@given(SEEDS, FRAMES, CHANNELS, st.integers(0, 3), st.integers(0, 3))
def test_errors_of_frames_and_of_the_whole_beside_white_noise(seed, frames, channels, own, whole):
    whitening = rigged(seed, frames, channels, (0, own, whole, 0))
    assert_is(whitening, written_out(whitening, np.zeros(channels)))


@given(SEEDS, FRAMES, CHANNELS, st.integers(0, 3), st.integers(0, 3), CORRELATIONS)
def test_errors_of_channels_and_of_the_whole_beside_lasting_noise(
    seed, frames, channels, own, whole, correlation
):
    rho = np.random.default_rng(seed).uniform(0.0, 4.0, channels)
    whitening = rigged(seed, frames, channels, (own, 0, whole, 0), correlation, 1.0)
    whitening = replace(whitening, offset_ratio=rho)
    assert_is(whitening, written_out(whitening, np.sqrt(rho) * whitening.sd))


@given(SEEDS, FRAMES, CHANNELS, st.integers(1, 3), st.integers(0, 3))
def test_errors_of_presses_and_of_the_whole_beside_white_noise(seed, frames, channels, own, whole):
    whitening = rigged(seed, frames, channels, (0, 0, whole, own))
    assert_is(whitening, written_out(whitening, np.zeros(channels)))


@given(SEEDS, FRAMES, CHANNELS, CORRELATIONS, st.integers(0, 6))
def test_errors_of_the_last_press_beside_lasting_noise(seed, frames, channels, correlation, start):
    whitening = rigged(seed, frames, channels, (0, 0, 1, 2), correlation)
    own = np.arange(frames) >= min(start, frames - 1)
    errors = replace(
        whitening.errors,
        press=whitening.errors.press * own[:, None],
        press_label=np.where(own, 3, -1),
    )
    whitening = replace(whitening, errors=errors)
    assert_is(whitening, written_out(whitening, np.zeros(channels)))


@pytest.mark.xfail(reason=LEAK, strict=True)
@pytest.mark.parametrize("between", [0, 1])
def test_errors_of_presses_beside_lasting_noise(between):
    whitening = rigged(5, 12, 6, (0, 0, 0, 2), 0.5)
    label = np.repeat(np.arange(4), 3)
    label[np.arange(12) % 3 < between] = -1
    press = whitening.errors.press * (label >= 0)[:, None]
    whitening = replace(whitening, errors=replace(whitening.errors, press=press, press_label=label))
    assert_is(whitening, written_out(whitening, np.zeros(6)))


@given(SEEDS, FRAMES, st.integers(3, 6), st.integers(0, 2))
def test_errors_that_do_not_meet_are_taken_out_exactly(seed, frames, channels, whole):
    whitening = rigged(seed, frames, channels, (2, 2, whole, 2))
    errors, own = whitening.errors, np.arange(channels) % 3
    apart = {
        kind: getattr(errors, kind) * (own == k)
        for k, kind in enumerate(("channel", "frame", "press"))
    }
    whitening = replace(whitening, errors=replace(errors, **apart))
    assert_is(whitening, written_out(whitening, np.zeros(channels)))


@given(SEEDS, FRAMES, CHANNELS)
def test_errors_of_frames_and_of_their_presses_are_taken_out_exactly(seed, frames, channels):
    whitening = rigged(seed, frames, channels, (0, 2, 0, 2))
    assert_is(whitening, written_out(whitening, np.zeros(channels)))


@given(SEEDS, FRAMES, CHANNELS, st.integers(1, 2), st.integers(0, 2))
def test_linked_errors_beside_frames_and_presses_are_taken_out_exactly(
    seed, frames, channels, own, whole
):
    whitening = rigged(seed, frames, channels, (0, 2, whole, 1, own))
    assert_is(whitening, written_out(whitening, np.zeros(channels)))


@given(SEEDS, FRAMES, CHANNELS, CORRELATIONS)
def test_frames_with_their_presses_then_channels(seed, frames, channels, correlation):
    whitening = rigged(seed, frames, channels, (2, 2, 2, 2), correlation)
    errors, none = whitening.errors, np.zeros((0, frames, channels))
    touches = replace(errors, whole=none, channel=none)
    alone = [touches, replace(errors, whole=none, frame=none, press=none)]
    plain = replace(whitening, errors=None)
    expected = plain(np.random.default_rng(seed).normal(size=(3, frames, channels)))
    values = plain.unwhitened(expected)
    for one in alone:
        expected = replace(whitening, errors=one)(plain.unwhitened(expected))
    together = replace(whitening, errors=replace(errors, whole=none))
    assert np.allclose(together(values), expected, rtol=1e-7, atol=1e-9)
    # What all readings have together adds to whatever the others make of them.
    matrix, row = written(together), np.nonzero(whitening.mask)
    columns = errors.whole[:, row[0], row[1]]
    assert_is(whitening, np.linalg.inv(matrix.T @ matrix) + columns.T @ columns)


def test_an_error_of_one_press_stays_in_it():
    whitening = rigged(6, 7, 5, (0, 0, 0, 2))
    first = whitening.errors.press_label == whitening.errors.press_label.max()
    own = whitening.errors.press[0] * first[:, None]
    plain, taken = replace(whitening, errors=None)(own), whitening(own)
    assert 1 < first.sum() < 7 and not taken[~first].any()
    assert (taken**2).sum() < 1.0 < (plain**2).sum()
    elsewhere = np.random.default_rng(6).normal(size=(7, 5))
    elsewhere[whitening.errors.press_label >= 0] = 0.0
    assert np.allclose(whitening(elsewhere), replace(whitening, errors=None)(elsewhere))


@pytest.mark.parametrize(
    ("kind", "correlation"),
    [("channel", 0.0), ("channel", 0.8), ("frame", 0.0), ("frame", 0.8), ("press", 0.0)],
)
def test_what_is_left_is_compared_with_what_entered(kind, correlation):
    counts = [2 * (kind == one) for one in ("channel", "frame", "whole", "press")]
    whitening = rigged(8, 7, 4, counts, correlation)
    values = np.random.default_rng(9).normal(size=(7, 4))
    entered = whitening.entered(whitening.filtered(getattr(whitening.errors, kind), kind), kind)
    found = whitening.conjugate(whitening(values), kind) * entered
    expected = whitening.transposed(whitening(values)) * getattr(whitening.errors, kind)
    label = whitening.errors.press_label
    rows = label[:, None] == np.unique(label[label >= 0])
    summed = {
        "channel": lambda products: products.sum(axis=1),
        "frame": lambda products: products.sum(axis=2),
        "press": lambda products: products.sum(axis=2) @ rows,
    }[kind]
    if kind == "frame" and correlation:
        # What is white after the filter: only as loud as the noise makes it.
        precision = np.linalg.inv(whitening.spectrum.covariance(whitening.frame_number))
        louder = np.sqrt(np.diag(precision))
        white = np.where(whitening.mask, getattr(whitening.errors, kind), 0.0) / whitening.sd
        assert np.allclose(entered, louder[:, None] * white)
    else:
        assert np.allclose(summed(found), summed(expected))


@given(SEEDS, FRAMES, CHANNELS, st.integers(0, 2), CORRELATIONS)
def test_a_free_constant_beside_errors(seed, frames, channels, own, correlation):
    whitening = rigged(seed, frames, channels, (own, 0, 2, 0), correlation, None)
    none = np.zeros((0, frames, channels))
    plain = replace(
        whitening, errors=ErrorColumns(none, none, none, none, whitening.errors.press_label)
    )
    # What a channel has of its own, less its constant: exact where these do not meet.
    apart = replace(whitening.errors, channel=plain.unwhitened(plain(whitening.errors.channel)))
    whitening = replace(whitening, errors=apart)
    matrix = written(whitening)
    nearly = written_out(whitening, np.full(channels, HUGE))
    assert np.allclose(matrix.T @ matrix, np.linalg.inv(nearly), rtol=1e-4, atol=1e-5)
    more = (
        np.linalg.slogdet(nearly)[1]
        - np.linalg.slogdet(written_out(plain, np.full(channels, HUGE)))[1]
    )
    assert np.isclose(whitening.log_determinant - plain.log_determinant, more, atol=1e-4)


@given(SEEDS, FRAMES, CHANNELS, CORRELATIONS, st.sampled_from([0.0, 2.0, None]))
def test_back_undone_and_determinant_of_errors_of_all_kinds(
    seed, frames, channels, correlation, rho
):
    whitening = rigged(seed, frames, channels, (1, 2, 2, 2, 1), correlation, rho)
    a, b = np.random.default_rng(seed + 1).normal(size=(2, frames, channels))
    forth = whitening(a)
    assert np.isclose((forth * b).sum(), (a * whitening.transposed(b)).sum(), rtol=1e-9, atol=1e-9)
    assert not forth[~whitening.mask].any()
    assert not whitening.transposed(b)[~whitening.mask].any()
    undone = whitening.unwhitened(forth)
    assert np.allclose(whitening(undone), forth, rtol=1e-7, atol=1e-9)
    if rho is not None:
        assert np.allclose(undone, np.where(whitening.mask, a, 0.0), rtol=1e-7, atol=1e-9)
        matrix = written(whitening)
        scaled = matrix * whitening.sd[np.nonzero(whitening.mask)[1]]
        expected = -2.0 * np.linalg.slogdet(scaled)[1]
        assert np.isclose(whitening.log_determinant, expected, rtol=1e-9, atol=1e-9)


def test_what_is_free_stays_taken_out_when_whitening_is_undone():
    whitening = rigged(4, 6, 3, (0, 0, 0, 0), 0.5, None)
    a = np.random.default_rng(4).normal(size=(6, 3))
    again = whitening.unwhitened(whitening(a + np.array([1.0, 20.0, -3.0])))
    assert np.allclose(again, whitening.unwhitened(whitening(a)))
    left = np.where(whitening.mask, a - again, np.nan)
    assert np.allclose(np.nanmax(left, axis=0), np.nanmin(left, axis=0))


@pytest.mark.parametrize(
    "counts", [(0, 0, 0, 0), (1, 0, 0, 0), (0, 2, 0, 0), (0, 0, 3, 0), (0, 0, 0, 2), (2, 2, 2, 2)]
)
@pytest.mark.parametrize("channels", [4, BATCH_COLUMNS + 2])
@pytest.mark.parametrize("correlation", [0.0, 0.6])
@pytest.mark.parametrize("rho", [0.0, 2.0, None])
def test_lengths_are_those_of_channels_whitened_one_by_one(counts, channels, correlation, rho):
    whitening = rigged(7, 6, channels, counts, correlation, rho)
    column = np.random.default_rng(8).normal(size=(6, channels))
    alone = column * np.eye(channels)[:, None, :]
    expected = (whitening(alone) ** 2).sum(axis=(1, 2))
    for some in (np.arange(channels), np.arange(1, channels, 2), np.arange(0)):
        assert np.allclose(whitening.channel_lengths(column, some), expected[some], rtol=1e-9)


def test_whether_channels_stay_apart():
    for kind, apart in enumerate((True, False, False, False)):
        whitening = rigged(9, 5, 4, 2 * np.eye(4, dtype=int)[kind], 0.4)
        assert whitening.by_channel == apart
        one = whitening(np.arange(20.0).reshape(5, 4) * [0.0, 1.0, 0.0, 0.0])
        assert one[:, [0, 2, 3]].any() != apart


def test_frames_in_a_row_need_no_numbers():
    whitening = rigged(10, 7, 4, (1, 2, 1, 2), 0.7)
    values = np.random.default_rng(10).normal(size=(7, 4))
    in_a_row = replace(whitening, frame_number=np.arange(30, 37))
    assert np.allclose(replace(whitening, frame_number=None)(values), in_a_row(values))


def test_no_columns_stay_none_beside_linked_errors():
    rng = np.random.default_rng(2)
    mask = np.ones((4, 3), bool)
    errors = ErrorColumns(
        np.zeros((0, 4, 3)),
        rng.normal(size=(1, 4, 3)),
        np.zeros((0, 4, 3)),
        linked=rng.normal(size=(1, 4, 3)),
    )
    whitening = Whitening(mask, np.ones(3), np.zeros(3), errors=errors)
    assert whitening(np.zeros((0, 4, 3))).shape == (0, 4, 3)


@pytest.mark.parametrize("lasting", [0, 2])
@pytest.mark.parametrize("correlation", [0.0, 0.7])
def test_in_single_precision_the_same_is_left(correlation, lasting):
    """Of columns up to a thousand times the noise, along errors or not, of 1e-5 of what entered."""
    voltage, sd, error, draw = drawn(5, 45, 33)
    label = np.repeat(np.arange(9), 5)
    frame, channel, press, linked = 30.0 * draw.normal(size=(4, 2, 45, 33))
    linked = 0.003 * linked[:lasting]
    errors = ErrorColumns(channel, frame, np.zeros((0, 45, 33)), press, label, linked)
    whitening = Whitening(
        np.isfinite(voltage), sd, (error / sd) ** 2, spectrum_of(correlation), errors=errors
    )
    single = whitening.single_precision
    assert single is not whitening
    values = 1e3 * draw.normal(size=(3, 45, 33))
    values = np.concatenate([values, 30.0 * frame, 30.0 * channel, 30.0 * linked]).astype(
        np.float32
    )
    found, exact = single(values), whitening(values.astype(float))
    assert found.dtype == np.float32 and np.abs(found - exact).max() < 1e-5 * np.abs(values).max()
    assert np.abs(exact).max() > 100.0


def test_long_linked_errors_are_taken_out_in_double_precision():
    draw = np.random.default_rng(12)
    frame, linked = 3.0 * draw.normal(size=(1, 40, 33)), np.ones((1, 40, 33))
    column = draw.normal(1.0, 0.1, size=(40, 33)).astype(np.float32)

    def of_length(most):
        errors = ErrorColumns(linked[:0], frame, linked[:0], linked=linked)
        plain = Whitening(np.ones((40, 33), bool), np.ones(33), np.zeros(33), errors=errors)
        length = next(part.eigenvalues.max() for part in plain.factors if part.acts_on == "linked")
        return replace(plain, errors=replace(errors, linked=np.sqrt(most / length) * linked))

    whitening = of_length(0.99 * MOST_LINKED_IN_SINGLE)
    single = whitening.single_precision
    assert single is not whitening
    exact, found = (one.channel_lengths(column, np.arange(33)) for one in (whitening, single))
    assert np.abs(found / exact - 1.0).max() < 2e-3
    beyond = of_length(1.01 * MOST_LINKED_IN_SINGLE)
    assert beyond.single_precision is beyond


def test_a_free_constant_is_taken_out_in_double_precision():
    voltage, sd, error, _ = drawn(5, 45, 33)
    whitening = Whitening.from_readings(voltage, sd, True, error)
    assert whitening.single_precision is whitening
