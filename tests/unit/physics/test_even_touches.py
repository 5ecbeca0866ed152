"""Touches with even nodes, found several at once, are those found one by one, to the bit."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eitskin.errors import InputError
from eitskin.physics.even_touches import even_touches
from eitskin.physics.forward import ACCURACIES, Forward
from eitskin.physics.geometry import Geometry
from eitskin.physics.touch import Touch

SKIN = Geometry(80.0, 3.0, 0.5, np.arange(16) * 22.5, 5.0, 1e-3)
SHAPED = SKIN.with_values(
    shape_cos={2: 0.02}, shape_sin={3: -0.01}, anisotropy_ratio=1.2, anisotropy_deg=30.0
)


@st.composite
def a_place(draw) -> tuple[float, float, float]:
    away, angle = draw(st.floats(0.0, 90.0)), draw(st.floats(0.0, 2.0 * np.pi))
    return away * np.cos(angle), away * np.sin(angle), draw(st.floats(0.5, 12.0))


@pytest.mark.parametrize("accuracy", ["train", "diagnose"])
@pytest.mark.parametrize("geometry", [SKIN, SHAPED], ids=["disc", "shaped"])
@given(places=st.lists(a_place(), min_size=1, max_size=12, unique=True))
def test_they_are_those_found_one_by_one(geometry, accuracy, places):
    skin, places = Forward(geometry, accuracy), [(1.0, 2.0, 6.0), *places]
    rim, found = skin.electrodes.rim, set()
    with np.errstate(all="ignore"):  # far outside the rim the map's series is nonsense
        touch_accuracy = ACCURACIES[accuracy].touch
        every = list(even_touches(places, geometry, skin.disc, touch_accuracy, skin.electrodes))
    for here, some in every:
        response = some.rim_response(rim)
        for i, place in enumerate(here):
            edge = skin.edge(Touch(*place))
            assert edge.even and not edge.clipped and not edge.held_off
            assert np.array_equal(some.mass[i], edge.mass)
            assert np.array_equal(some.self_response[i], edge.self_response)
            assert np.array_equal(response[i], edge.rim_response(rim))
            found.add(place)
    assert places[0] in found
    for place in set(places) - found:
        try:
            edge = skin.edge(Touch(*place))
        except InputError:
            continue
        assert edge.clipped or not edge.even


def test_what_is_asked_for_beside_a_place_leaves_it_alone():
    places = [(10.0 * k, 3.0 * k - 20.0, 6.0) for k in range(-7, 8)]
    alone = [Forward(SHAPED).place(*place) for place in places]
    for one, other in zip(alone, Forward(SHAPED).places(places), strict=True):
        assert np.array_equal(one.gains, other.gains) and np.array_equal(one.poles, other.poles)


@pytest.mark.parametrize(
    ("first", "told"), [((10.0, 0.0, -5.0), "radius_mm"), ((200.0, 0.0, 5.0), "200")]
)
def test_the_first_place_that_cannot_be_is_told(first, told):
    others = [(200.0, 0.0, 5.0), (10.0, 0.0, 0.0)]
    with pytest.raises(InputError, match=told):
        Forward(SKIN).places([(0.0, 0.0, 5.0), first, *others])
