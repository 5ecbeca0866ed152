"""A one-sided misfit's law: recovered where it was put in, judged on the real hydrogel skin."""

from dataclasses import replace

import numpy as np
import pytest

from eitskin.data import importers
from shared_data import shared_data
from studies.ground_return import Drives, Fitted, GroundReturn, OwnersLaw, judge, sentence


@pytest.fixture(scope="module")
def skin():
    return importers.load(shared_data("hydrogel-skin/ohmc16.mat"))


def test_the_law_is_recovered_from_half_of_the_drives(skin):
    drives = Drives.of(skin)
    law = GroundReturn(drives)
    true = np.array([-2.0, -1.5, -0.45, 2.0])
    recorded = 3.0 * law.readings(true, drives.transfer_impedance)[0]
    kept = drives.channels[:, 0] % 2 == 0
    fitted = Fitted.to(law, recorded, kept, law.start)
    predicted = fitted.readings(drives.transfer_impedance)[0]
    error = np.linalg.norm((predicted - recorded)[~kept]) / np.linalg.norm(recorded[~kept])
    assert error < 0.01


def test_reversal_changes_nothing_for_the_owner_and_something_through_ground(skin):
    drives = Drives.of(skin)
    plain = OwnersLaw(drives).readings(np.zeros(0), drives.transfer_impedance)[0]
    assert np.allclose(plain, plain[drives.reversed], rtol=1e-9)
    values = np.array([-2.0, -1.5, -0.45, 2.0])
    one_sided = GroundReturn(drives).readings(values, drives.transfer_impedance)[0]
    assert np.abs(one_sided - one_sided[drives.reversed]).max() > 0.1 * one_sided.max()


@pytest.mark.long
def test_the_hydrogel_skin_is_described_and_shuffled_channels_are_unexplained(skin):
    table = judge(skin, count=4)
    rows = table.set_index("law")
    law, means = rows.iloc[-1], rows.loc["free means over rotations"]
    assert law.held_out < means.held_out < 0.5 * rows.iloc[0].held_out
    assert law.reversal_explained > 0.8 and law.touch_correlation > 0.45
    assert "Law: " in sentence(table)
    order = np.random.default_rng(1).permutation(skin.voltage.shape[1])
    assert "Unexplained" in sentence(judge(replace(skin, voltage=skin.voltage[:, order]), count=2))
