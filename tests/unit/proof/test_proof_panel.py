"""Which cases a block has."""

from collections import Counter

import numpy as np
import pytest

from eitskin.effects import EFFECTS
from proof import panel
from proof.blocks import case_names
from proof.panel import GAPS, numbers, plan
from witness.cases import together
from witness.generators import GENERATORS, LAWS
from witness.outside import OUTSIDE
from witness.strengths import DRAWN

ROOT = bytes(range(32))


@pytest.fixture
def real(monkeypatch):
    kinds = ["real:a-tank:offset", "real:a-tank:none"]
    monkeypatch.setattr(panel.planted, "kinds", lambda: kinds)
    return kinds


@pytest.mark.parametrize("size", [1, 2, 4, 24, 60, 300, 301])
def test_a_block_is_as_large_as_it_says(size):
    found = numbers(size, tuple(panel.SHARES))
    assert sum(found.values()) == size
    for key, share in panel.SHARES.items():
        assert abs(found[key] - size * share / 300) < 1


def test_the_final_block_is_what_was_promised(real):
    block = plan("final", 300, ROOT)
    assert list(block) == case_names(300)
    assert Counter(one.group for one in block.values()) == {
        **{k: v for k, v in panel.SHARES.items() if k != "real"},
        "real": 24,
    }
    singles = Counter(one.kind for one in block.values() if one.group == "single")
    assert set(singles) == {f"single:{name}" for name in DRAWN} and set(singles.values()) == {3}
    cells = [one.names for one in block.values() if one.kind == panel.PAIR]
    assert set(cells) <= set(panel.cells()) and len(set(cells)) == len(cells)
    laws = {one.kind.partition(":")[2] for one in block.values() if one.group == "outside"}
    assert len(laws) >= 12 and laws <= set(LAWS)
    for one in block.values():
        assert one.names is None or together(one.names)
        if one.group == "decoy":
            missing = one.kind.partition(":")[2]
            assert missing not in one.names
            assert set(one.names) <= set(panel.confounders(missing))
    assert len({one.seed for one in block.values()}) == 300


def test_gaps_are_wanted_in_turn(real):
    block = plan("final", 300, ROOT).values()
    for key in ("single", "pair", "confusable", "triple"):
        wanted = Counter(one.gap for one in block if one.group == key)
        assert set(wanted) == set(GAPS) and max(wanted.values()) - min(wanted.values()) <= 1
    for key in ("null", "decoy", "outside", "real"):
        assert {one.gap for one in block if one.group == key} == {None}


def test_what_nothing_was_tuned_on_is_kept_from_tuning(real):
    for block, known in (("development", OUTSIDE), ("demo", OUTSIDE), ("gate", LAWS)):
        laws = {
            one.kind.partition(":")[2]
            for one in plan(block, 300, ROOT).values()
            if one.group == "outside"
        }
        assert laws <= set(known)
        assert (laws <= set(OUTSIDE)) == (known is OUTSIDE)


def test_every_generator_has_nulls(real):
    block = plan("final", 300, ROOT).values()
    nulls = {one.generator for one in block if one.kind == "null"}
    able = {name for name, one in GENERATORS.items() if one.can("null")}
    assert nulls == able
    for one in block:
        if one.generator != panel.RECORDED:
            words = [one.kind] if one.names is None else [f"single:{n}" for n in one.names]
            assert all(GENERATORS[one.generator].can(word) for word in words)


def test_a_body_is_told_of_more_often_than_there_is_one(real):
    block = plan("final", 300, ROOT).values()
    told = [one for one in block if one.deep]
    bodies = [one for one in told if panel.DEEP in one.names]
    assert all(one.deep for one in block if panel.DEEP in (one.names or ()))
    assert bodies and len(told) >= 4 * len(bodies)
    assert {"null", "single", "decoy"} <= {one.group for one in told if one not in bodies}


@pytest.mark.parametrize("number", range(5))
def test_no_generator_that_solves_every_depth_is_given_a_body_that_is_to_conduct_as_a_sheet(
    real, number
):
    block = plan("final", 300, bytes([number]) * len(ROOT)).values()
    assert not any(GENERATORS[one.generator].solid for one in block if one.deep)


def test_without_real_recordings_the_others_fill_the_block(monkeypatch, capsys):
    monkeypatch.setattr(panel.planted, "kinds", lambda: [])
    block = plan("gate", 24, ROOT)
    assert len(block) == 24 and "real" not in set(one.group for one in block.values())
    assert "SKIPPED" in capsys.readouterr().err


def test_a_root_decides_and_the_order_tells_nothing(real):
    assert plan("gate", 24, ROOT) == plan("gate", 24, ROOT)
    blocks = [plan("gate", 24, bytes([k]) * 32) for k in range(60)]
    nulls = np.array([[one.kind == "null" for one in block.values()] for block in blocks])
    share = nulls.mean()
    spread = np.sqrt(share * (1 - share) / len(blocks))
    assert np.abs(nulls.mean(axis=0) - share).max() < 4 * spread


def test_what_looks_alike_is_taken_both_ways():
    for name in DRAWN:
        for other in panel.confounders(name):
            assert name in panel.confounders(other)
            assert name in EFFECTS[other].confusable or other in EFFECTS[name].confusable
    assert "relaxation" in panel.confounders("hysteresis")
    assert "ellipse" not in panel.confounders("domain-shape")  # the witness draws none


def test_cells_can_be_drawn_together():
    cells = panel.cells()
    assert len(cells) == len(set(cells)) > 20
    assert all(a < b and together((a, b)) for a, b in cells)
    assert ("electrode-open", "electrode-swap") not in cells
