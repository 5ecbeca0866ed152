"""Geometry judged on reciprocal pairs left out, on simulated tanks and the real ones."""

import numpy as np
import pytest

from eitskin.data import check, importers
from eitskin.errors import InputError
from proof.tank_geometry import (
    FAMILIES,
    Family,
    Untouched,
    floor,
    judge,
    sentence,
    splits,
    without_drawing,
)
from shared_data import shared_data

TANKS = "pyeidors-tank/measurements"


@pytest.fixture(scope="module")
def iirc():
    return importers.load(shared_data("iirc-tank/iirc_data_2006.mat"))


def test_splits_hold_out_half_and_differ():
    drawn = splits(104, 20, 1)
    assert (drawn.sum(axis=1) == 52).all()
    assert len(np.unique(drawn, axis=0)) == 20


def test_an_even_sheet_leaves_no_floor_and_is_fitted_exactly(iirc):
    untouched = Untouched.of(iirc)
    sheet = Family(untouched, FAMILIES[1])
    clean = Untouched(
        sheet.reading(np.log([0.05]), "train"),
        untouched.channels,
        untouched.pairs,
        untouched.skin,
        untouched.n_electrodes,
    )
    every = np.ones(len(clean.reading), bool)
    assert clean.separation.max() + 1 == 7
    assert floor(clean, every, every) < 1e-6
    theta, _ = Family(clean, FAMILIES[1]).fit(every)
    assert np.exp(theta[0]) == pytest.approx(0.05, rel=0.02)


@pytest.mark.long
def test_the_drawing_tells_the_third_dimension_and_without_it_a_class_is_left(iirc):
    table = judge(iirc, count=20).set_index("geometry")
    assert table.loc["body"].held_out <= 0.041
    assert table.loc["body"].physical and not table.loc["sheet of any width"].physical
    assert sentence(table.reset_index()).startswith("third-dimension: ")
    blind = sentence(judge(without_drawing(iirc), count=3))
    assert blind.startswith("third-dimension or electrode-width")


def test_the_broken_recording_is_called_unusable_with_its_reason():
    folder = shared_data(f"{TANKS}/EIT_DEV_Test")
    [path] = [p for p in folder.glob("*Hz.csv")]
    found = check.check(importers.load(path))
    assert not found.ok
    assert "42 % rms" in found.of_topic("order")[0].sentence


def test_recordings_without_reciprocal_pairs_are_refused():
    path = shared_data("hydrogel-skin/ohmc16.mat")
    with pytest.raises(InputError, match="reciprocal pairs"):
        Untouched.of(importers.load(path))
