"""Touched places are remembered within a number of bytes, and several are solved at once."""

from itertools import chain

import numpy as np
import pytest

from eitskin import cores
from eitskin.errors import InputError
from eitskin.physics import forward, patch, touch_cache
from eitskin.physics.geometry import Geometry, Patch
from eitskin.physics.solver import forward_model
from eitskin.physics.touch_cache import ContactCoupling, TouchCache, TouchCoupling

SKIN = Geometry(80.0, 3.0, 0.5, np.arange(16) * 22.5, 5.0, 1e-3)


def test_the_oldest_go_first_where_there_is_no_more_room(monkeypatch):
    monkeypatch.setattr(touch_cache, "CACHE_BYTES", 100)
    kept, met = TouchCache(), []

    def ask(x_mm: float, nbytes: int) -> None:
        place = (x_mm, 0.0, 1.0)
        none = np.zeros(0)
        kept.get(
            TouchCoupling,
            place,
            lambda: met.append(x_mm) or TouchCoupling(np.zeros(nbytes // 8), none, none),
        )

    for x_mm in (0.0, 1.0, 0.0):  # 40 bytes each
        ask(x_mm, 40)
    assert met == [0.0, 1.0]
    ask(2.0, 72)
    assert [(x, 0.0, 1.0) in kept for x in (0.0, 1.0, 2.0)] == [False, False, True]
    ask(3.0, 504)  # more than there is room for: kept alone
    assert [(x, 0.0, 1.0) in kept for x in (2.0, 3.0)] == [False, True]


def test_kinds_of_one_place_share_the_room(monkeypatch):
    monkeypatch.setattr(touch_cache, "CACHE_BYTES", 100)
    kept, place = TouchCache(), (0.0, 0.0, 1.0)
    touched = kept.get(TouchCoupling, place, lambda: TouchCoupling(*np.zeros((3, 2))))
    entered = kept.get(ContactCoupling, place, lambda: ContactCoupling(*np.zeros((2, 2)), 1.0, 1.0))
    assert kept.get(TouchCoupling, place, pytest.fail) is touched
    assert kept.get(ContactCoupling, place, pytest.fail) is entered
    kept.get(ContactCoupling, (1.0, 0.0, 1.0), lambda: ContactCoupling(*np.zeros((2, 2)), 1.0, 1.0))
    assert place not in kept  # the oldest of either kind


@pytest.mark.parametrize("patch", [(), (Patch(20.0, 10.0, 12.0, 3.0),)])
def test_a_new_place_that_leaks_has_its_edge_found_once(monkeypatch, patch):
    skin = forward_model(SKIN.with_values(patches=patch))
    edges, find = [], type(skin).edge
    monkeypatch.setattr(type(skin), "edge", lambda *a: edges.append(find(*a)) or edges[-1])
    for _ in range(2):
        skin.contact(-30.0, 5.0, 6.0)
    assert len(edges) == 1


@pytest.mark.parametrize(
    "geometry",
    [
        SKIN,
        SKIN.with_values(gradient_across=0.2),
        SKIN.with_values(patches=(Patch(20.0, 10.0, 12.0, 3.0),)),
        SKIN.with_values(deep=True, electrode_height_mm=2.0),
    ],
    ids=["sheet", "gradient", "patch", "body"],
)
def test_several_places_are_those_of_each_alone(geometry):
    places = [(5.0, 0.0, 6.0), (30.0, 41.0, 7.5), (20.0, 10.0, 6.0), (5.0, 1.0, 6.0)]
    together, alone = forward_model(geometry), forward_model(geometry)
    contrast = np.array([0.5, 9.0])
    for place, modes in zip(places, together.places(places), strict=True):
        own = alone.place(*place).impedance_change(contrast)
        np.testing.assert_allclose(
            modes.impedance_change(contrast), own, rtol=0.0, atol=1e-11 * np.abs(own).max()
        )


def test_places_that_are_shared_out_have_the_same_bytes(monkeypatch):
    monkeypatch.setattr(forward, "PARALLEL_EFFORT", 1.0)
    monkeypatch.setattr(forward, "PLACES_PER_TASK", 3)
    places = [(x_mm, 5.0, 6.0) for x_mm in np.linspace(-40.0, 40.0, 9)]
    forked, here = [], cores.forked
    monkeypatch.setattr(cores, "forked", lambda of, parts: forked.append(parts) or here(of, parts))
    found = []
    for count in (1, 2):
        monkeypatch.setenv("OMP_NUM_THREADS", str(count))
        skin = forward_model(SKIN)
        skin.places(places[:1])
        found.append(skin.places([*places, places[3]]))
        assert all(place in skin._touch_cache for place in places)
    (parts,) = forked
    assert [len(share) for share in parts] == [2, 1]
    assert sorted(chain(*chain(*parts))) == sorted(places[1:])
    for one, other in zip(*found, strict=True):
        assert np.array_equal(one.gains, other.gains) and np.array_equal(one.poles, other.poles)


def test_a_patch_that_moves_meets_the_touches_of_the_one_before(monkeypatch):
    """Their edges are found once, but where the patch comes so near that they need other nodes."""
    places = [(x_mm, 5.0, 6.0) for x_mm in np.linspace(-40.0, 40.0, 9)]
    patches = [Patch(20.0 + shift, 10.0, 12.0, 3.0) for shift in (0.0, 1e-3, 15.0)]
    made, edge = [], patch.TouchEdge
    monkeypatch.setattr(patch, "TouchEdge", lambda *a, **k: made.append(a[0].x_mm) or edge(*a, **k))
    near, counts = None, []
    for own in patches:
        alone = forward_model(SKIN.with_values(patches=(own,))).places(places)
        made.clear()
        near = forward_model(SKIN.with_values(patches=(own,)), donor=near)
        for one, other in zip(near.places(places), alone, strict=True):
            assert np.array_equal(one.gains, other.gains) and np.array_equal(one.poles, other.poles)
        counts.append(len(made))
    crossed = 2  # their nodes are graded towards the patch
    assert counts[:2] == [len(places), crossed]
    assert crossed < counts[2] < len(places)


def test_touches_that_serve_one_patch_alone_take_no_room(monkeypatch):
    """Edges across the patch's take 50 times as much as others."""
    places = [(20.0 + shift, 20.0, 6.0) for shift in np.linspace(-3.0, 3.0, 12)]  # across it
    near = forward_model(SKIN.with_values(patches=(Patch(20.0, 10.0, 12.0, 3.0),)))
    near.places([(-30.0, 5.0, 6.0), *places])
    kept = [place for kind, place in near.bare._touch_cache._responses if kind is patch.BareTouch]
    assert kept == [(-30.0, 5.0, 6.0)]


def test_the_first_place_that_is_refused_is_told_on_two_cores_too(monkeypatch):
    monkeypatch.setattr(forward, "PARALLEL_EFFORT", 1.0)
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    places = [(x_mm, 0.0, 6.0) for x_mm in (0.0, 10.0, 95.0, 91.0, 99.0)]
    with pytest.raises(InputError, match=r"\(95, 0\) mm"):
        forward_model(SKIN).places(places)
