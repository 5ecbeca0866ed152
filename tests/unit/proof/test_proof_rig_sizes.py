"""Sizes of rig errors beside those that were drawn: what counts, and how often they are right."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from eitskin.diagnose.noise.noise_model import NoiseModel
from eitskin.diagnose.noise.spectrum import Spectrum
from proof import rig_sizes
from proof.intervals import wilson
from witness import cases, rig_errors
from witness.rig_errors import RigError

SEEDS = range(301, 346)


def row(kind, true, found, told=True):
    right = 1 / rig_sizes.WITHIN < found / true < rig_sizes.WITHIN
    values = (kind, true, true, found, np.nan, np.nan, 0.1, told, right)
    return dict(zip(rig_sizes.ROW, values, strict=True))


def test_only_what_can_be_told_counts():
    rows = [row("spikes", 1.0, 1.4), row("spikes", 1.0, 0.6), row("spikes", 1.0, 0.0, told=False)]
    table = rig_sizes.table([*rows, row("gain-walk", 2.0, 2.0)]).set_index("rig_error")
    assert table["n"].to_dict() == {"any": 4, "gain-walk": 1, "spikes": 3}
    assert table["told"].to_dict() == {"any": 3, "gain-walk": 1, "spikes": 2}
    assert table["within"].to_dict() == {"any": 2, "gain-walk": 1, "spikes": 1}
    assert table.loc["any", "within_low"] == pytest.approx(wilson(2, 3)[0])
    assert table.loc["spikes", "ratio"] == pytest.approx(1.0)


def test_nothing_counted_is_a_table_all_the_same():
    table = rig_sizes.table([])
    assert table["rig_error"].tolist() == ["any"] and table["told"].tolist() == [0]


@pytest.fixture(scope="module")
def case():
    return cases.draw("null", 1)


def with_error(case, kind, size):
    """The case with one rig error in its readings or its states."""
    error = RigError(kind, size, 5)
    states = rig_errors.reported(case.true_states, [error])
    return replace(case, rig=(error,), states=states), error


@pytest.mark.parametrize(
    ("kind", "size", "unit"),
    [
        ("amplitude-per-frame", 1e-3, 1.0),
        ("common-noise", 1e-3, None),
        ("channel-drift", 1e-3, None),
        ("quadrature", 2e-2, 1.0),
        ("place-per-frame", 0.3, 1.0),
        ("place-per-press", 0.3, 1.0),
        ("force-per-frame", 1e-3, 1.0),
        ("force-per-press", 1e-2, 1.0),
        ("gain-walk", 1e-3, 1.0),
        ("force-zero-walk", 1e-3, 1.0),
    ],
)
def test_what_was_drawn_scatters_by_its_size(case, kind, size, unit):
    found, error = with_error(case, kind, size)
    unit = unit or np.median(np.abs(case.clean[0]))
    true = rig_sizes._true(found, error, np.ones(case.clean.shape, bool))
    walk = kind in ("gain-walk", "force-zero-walk")
    assert true / (size * unit) == pytest.approx(1.0, abs=0.9 if walk else 0.6)
    twice, error = with_error(case, kind, 2.0 * size)
    again = rig_sizes._true(twice, error, np.ones(case.clean.shape, bool))
    assert again == pytest.approx(2.0 * true, rel=1e-2)


def test_each_of_several_errors_of_the_states_has_its_own_size(case):
    kinds = {kind: one for kind, one in rig_errors.USUAL.items() if one.target == "states"}
    errors = tuple(RigError(kind, one.size, 5) for kind, one in kinds.items())
    states = rig_errors.reported(case.true_states, errors)
    together, seen = replace(case, rig=errors, states=states), np.ones(case.clean.shape, bool)
    for error in errors:
        alone, _ = with_error(case, error.kind, error.size)
        true = [rig_sizes._true(one, error, seen) for one in (alone, together)]
        assert true[0] == true[1] > 0.0


def test_presses_that_were_put_aside_do_not_count(case):
    found, error = with_error(case, "force-per-press", 0.02)
    contact = case.true_states["contact"].to_numpy()
    seen = np.isin(contact, [1.0, 2.0])[:, None] & np.ones(case.clean.shape, bool)
    touched = case.true_states["touch"].to_numpy(bool)
    ratio = (found.states["force_N"] / case.true_states["force_N"])[touched]
    off = ratio.groupby(contact[touched]).median() - 1.0
    expected = np.sqrt(np.mean(off[[1.0, 2.0]] ** 2))
    assert rig_sizes._true(found, error, seen) == pytest.approx(expected)


def test_rounding_far_below_the_noise_leaves_nothing_alike(case):
    median = np.median(np.abs(case.clean[0]))
    share = float(np.median(case.noise_V) / median)
    fine, coarse = (with_error(case, "quantisation", k * share) for k in (0.5, 50.0))
    seen = np.ones(case.clean.shape, bool)
    true = [rig_sizes._true(*one, seen) / (one[1].size * median) for one in (fine, coarse)]
    assert true[0] < 0.1 and 0.1 < true[1] < 0.5


def test_noise_of_its_own_beside_what_was_drawn(case):
    loud, _ = with_error(case, "loud-frames", 0.03)
    steady = NoiseModel(case.noise_V, 1e4, "by hand")
    _, true, found, _ = rig_sizes._of_noise(loud, loud.rig[0], steady)
    assert found == 0.0 and round(true * len(case.clean)) == round(0.03 * len(case.clean))
    noise = replace(steady, spectrum=Spectrum((0.9,), (1.0,)))
    slow, _ = with_error(case, "correlated-noise", 0.9)
    lasts, _, found, log_sd = rig_sizes._of_noise(slow, slow.rig[0], noise)
    assert lasts == found == pytest.approx(-1.0 / np.log(0.9)) and log_sd < rig_sizes.TELLABLE_SD


@pytest.mark.long
def test_sizes_that_can_be_told_are_within_a_factor_in_nine_of_ten():
    kinds = rig_sizes.KINDS
    rows = [one for s in SEEDS for one in rig_sizes.measured(kinds[s % len(kinds)], s)]
    whole = rig_sizes.table(rows).set_index("rig_error").loc["any"]
    missed = pd.DataFrame(rows).query("told and not within")
    assert whole["told"] >= 0.5 * len(SEEDS)
    assert whole["within"] >= 0.9 * whole["told"], missed.to_string()
