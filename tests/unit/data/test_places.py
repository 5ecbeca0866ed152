import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from eitskin.data.places import places
from eitskin.data.recording import ONE_PLACE_MM


def test_repeated_positions_are_places():
    xy = np.array([[0.0, 0], [10, 0], [0, 0.3], [10.4, 0], [0, 0]])
    place, rule = places(xy)
    assert place.tolist() == [0, 1, 0, 1, 0] and "within 1 mm of each other" in rule


@given(st.integers(0, 1000), st.integers(2, 6), st.booleans())
def test_jitter_never_splits_a_place(seed, repeats, all_over):
    """Points on half millimetres, where rounding would tear them apart, or on the edges of blocks;
    all over: so many alone that places are blocks."""
    draw = np.random.default_rng(seed)
    points = draw.permutation(
        np.stack(np.meshgrid(*[np.arange(-20.5, 20, 5)] * 2), -1).reshape(-1, 2)
    )
    repeated_points = points[: 10 if all_over else len(points)]
    pressed = np.concatenate([points, *[repeated_points] * (1 if all_over else repeats)])
    place, rule = places(pressed + draw.uniform(-0.02, 0.02, pressed.shape))
    assert ("blocks" in rule) == all_over
    for point in repeated_points:
        assert len(set(place[(pressed == point).all(axis=1)])) == 1
    if not all_over:
        assert place.max() + 1 == len(points)


@given(st.integers(0, 100))
def test_so_many_free_positions_that_most_chain_are_still_blocks(seed):
    xy = np.random.default_rng(seed).uniform(-35, 35, (2500, 2))
    place, rule = places(xy)
    assert "blocks" in rule and place.max() + 1 <= 64


def test_a_skin_swept_over_has_blocks_for_places():
    """Positions that chain into one another from rim to rim leave no place to hold out."""
    sweep = np.stack([np.linspace(-60, 60, 1000), np.repeat(np.arange(4.0), 250)], axis=1)
    place, rule = places(sweep)
    assert "blocks" in rule and place.max() + 1 == 8


@given(st.integers(0, 1000))
def test_free_positions_are_grouped_into_blocks(seed):
    xy = np.random.default_rng(seed).uniform(-70, 70, (500, 2))
    place, rule = places(xy)
    assert "blocks" in rule
    assert place.max() + 1 == len(np.unique(place)) <= 64
    side = np.ptp(xy, axis=0).max() / 8
    for k in range(place.max() + 1):
        assert np.ptp(xy[place == k], axis=0).max() <= side + 2 * ONE_PLACE_MM


def test_one_position_pressed_twice_or_all_alone_is_still_a_place():
    assert places(np.zeros((1, 2)))[0].tolist() == [0]
