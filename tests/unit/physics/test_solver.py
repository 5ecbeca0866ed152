"""What solved skins share, and what they are said to take."""

import numpy as np
import pytest

from eitskin.physics import solver
from eitskin.physics.depth import DepthForward, span
from eitskin.physics.geometry import Geometry, Patch
from eitskin.physics.solver import EffortExceeded, SolvedSkins, forward_model, skin_capacity

SHEET = Geometry(80.0, 3.0, 0.5, 22.5 * np.arange(16), 5.0, 2e-3)
BODY = SHEET.with_values(thickness_mm=20.0, deep=True, electrode_height_mm=8.0)
CONTACTS = 2e-3 * np.linspace(1.0, 1.5, 16)


def test_bodies_that_differ_in_their_contacts_share_all_else_bit_for_bit():
    near = SolvedSkins()
    first = near.solve(BODY, "train")
    poorer = BODY.with_values(contact_impedivity_ohm_m2=CONTACTS)
    found = near.solve(poorer, "train")
    assert found.electrodes.interaction is first.electrodes.interaction
    assert found.effort < first.effort
    alone = DepthForward(poorer, span(poorer), "train")
    assert np.array_equal(found.transfer_impedance(), alone.transfer_impedance())
    place = (20.0, 10.0, 6.0)
    here, there = (f.place(*place).impedance_change(np.array([2.0])) for f in (found, alone))
    assert np.array_equal(here, there)


@pytest.mark.parametrize(
    "values",
    [
        {"thickness_mm": 21.0},
        {"electrode_height_mm": 7.0},
        {"electrode_z_mm": 9.0},
        {"electrode_width_mm": 4.0},
        {"contact_impedivity_ohm_m2": 2e-4},
    ],
    ids=lambda values: next(iter(values)),
)
def test_bodies_that_differ_otherwise_share_nothing(values):
    first = forward_model(BODY, "train")
    other = BODY.with_values(**values)
    found, alone = forward_model(other, "train", first), forward_model(other, "train")
    assert found.electrodes.interaction is not first.electrodes.interaction
    assert np.array_equal(found.transfer_impedance(), alone.transfer_impedance())
    assert found.effort == alone.effort


def test_of_large_bodies_fewer_are_kept(monkeypatch):
    body = forward_model(BODY, "train")
    sheet = forward_model(SHEET, "train")
    matrices = body.electrodes.interaction.nbytes + 8 * len(body.relaxed_modes.inner) ** 2
    assert body.nbytes == matrices > sheet.nbytes
    assert skin_capacity(sheet.nbytes) == skin_capacity(body.nbytes) == solver.MAX_SKINS
    monkeypatch.setattr(solver, "MAX_BYTES", 2 * body.nbytes)
    near = SolvedSkins()
    for turn in range(4):
        near.solve(BODY.with_values(electrode_deg=22.5 * np.arange(16) + turn), "train")
        assert len(near._solved) == min(turn + 1, 2)
    monkeypatch.setattr(solver, "MAX_BYTES", 0)
    near.solve(BODY, "train")
    assert len(near._solved) == 1


def test_a_body_counts_for_many_sheets_and_the_larger_for_more():
    near = SolvedSkins()
    near.solve(SHEET, "train")
    assert near.effort == 1.0
    plain = near.solve(BODY, "train")
    crowded = near.solve(BODY.with_values(contact_impedivity_ohm_m2=2e-4), "train")
    assert 1.0 < plain.effort < crowded.effort
    assert near.effort == 1.0 + plain.effort + crowded.effort
    patched = near.solve(SHEET.with_values(patches=(Patch(20.0, 10.0, 15.0, 2.0),)), "train")
    assert patched.effort == 1.0
    assert forward_model(SHEET, "train").touch_effort < patched.touch_effort
    assert forward_model(SHEET, "train").touch_effort < plain.touch_effort


def test_a_body_that_shares_its_expansion_counts_for_less():
    whole = forward_model(BODY, "diagnose")
    shared = forward_model(BODY.with_values(contact_impedivity_ohm_m2=CONTACTS), "diagnose", whole)
    assert 2.0 < whole.effort < 10.0
    assert shared.effort < 0.8 * whole.effort


def test_what_may_be_solved_ends_and_the_limit_with_it():
    near = SolvedSkins()
    with pytest.raises(EffortExceeded), near.within(1.5):
        near.solve(SHEET, "train")
        near.solve(SHEET, "train")
        near.solve(SHEET, "train")
    assert near.effort == 2.0
    near.solve(SHEET, "train")


def test_a_limit_inside_another_leaves_that_one_as_it_was():
    near = SolvedSkins()
    with pytest.raises(EffortExceeded), near.within(1.5):
        with near.within(100.0):
            near.solve(SHEET, "train")
        near.solve(SHEET, "train")
        near.solve(SHEET, "train")
    assert near.effort == 2.0
    with pytest.raises(EffortExceeded), near.within(2.5), near.within(100.0):
        near.solve(SHEET, "train")
        near.solve(SHEET, "train")


def test_what_forked_parts_solve_counts_as_spent():
    near = SolvedSkins()
    near.solve(SHEET, "train")

    def counted(skins):
        for _ in range(skins):
            near.solve(SHEET, "train")
        return near.effort

    assert near.forked(counted, [2, 3]) == [3.0, 4.0]  # each from where it was forked
    assert near.effort == 6.0
