"""Kinds of effects that are mistaken for one another: declared, complete, drawn as promised."""

import numpy as np
import pytest

from eitskin.effects import EFFECTS
from eitskin.errors import InputError
from proof import confusable
from witness.cases import together
from witness.strengths import DRAWN


def test_taken_both_ways():
    for name in DRAWN:
        for other in confusable.confounders(name):
            assert name in confusable.confounders(other)
            assert name in EFFECTS[other].confusable or other in EFFECTS[name].confusable
    assert "relaxation" in confusable.confounders("hysteresis")
    assert "ellipse" not in confusable.confounders("domain-shape")  # the witness draws none


def test_cells_can_be_drawn_together():
    cells = confusable.cells()
    assert len(cells) == len(set(cells)) > 20
    assert all(a < b and together((a, b)) for a, b in cells)
    assert ("electrode-open", "electrode-swap") not in cells


def test_a_decoy_holds_its_confounder_alone():
    case = confusable.draw("decoy:contact-drift", 4, frames=30)
    assert [effect["name"] for effect in case.effects] == ["conductivity-drift"]
    assert case.kind == "decoy:contact-drift" and 9.0 <= case.snr[0] <= 63.0
    again = confusable.draw("decoy:contact-drift", 4, frames=30)
    assert np.array_equal(case.voltage, again.voltage)


def test_a_confusable_pair_is_a_cell():
    case = confusable.draw("confusable", 2, frames=30)
    names = tuple(sorted(effect["name"] for effect in case.effects))
    assert names in confusable.cells() and len(case.states) == 30


def test_every_cell_comes_in_turn(monkeypatch):
    drawn = []
    monkeypatch.setattr(confusable.cases, "draw", lambda *_, names: drawn.append(tuple(names)))
    for seed in range(400):
        confusable.draw("confusable", seed)
    assert set(drawn) == set(confusable.cells())


@pytest.mark.parametrize("kind", ["pair", "decoy:nothing", "decoy", "decoy:drive-gain:1"])
def test_refuses_unknown_kinds(kind):
    with pytest.raises(InputError, match="kind"):
        confusable.draw(kind, 1)
