"""Pairs of sessions with a fault planted between them, and how what is said of them is judged."""

import numpy as np
import pandas as pd

from eitskin.data.recording import validate
from eitskin.diagnose.compare.difference import difference
from proof import pair_skins, pairs, planted
from proof.pair_skins import DEVELOPMENT, REPORT, SIMULATED


def small(kind: str) -> pairs.Case:
    """The first simulated pair of eight electrodes with a fault of a kind."""
    cases = (pairs.draw(DEVELOPMENT, SIMULATED, kind, number) for number in range(40))
    return next(c for c in cases if c is not None and c.control.n_electrodes == 8)


def test_a_pair_is_the_same_each_time_and_without_a_fault_for_every_kind():
    one, other = (pairs.draw(DEVELOPMENT, SIMULATED, "drive-gain", 0) for _ in range(2))
    assert np.array_equal(one.later.voltage, other.later.voltage) and one.fault == other.fault
    none = pairs.draw(DEVELOPMENT, SIMULATED, planted.NONE, 0)
    assert np.array_equal(one.control.voltage, none.control.voltage)
    drives = np.isin(one.later.channels[:, 0], one.fault["drives"])
    assert np.array_equal(one.later.voltage[:, ~drives], none.later.voltage[:, ~drives])
    assert np.array_equal(one.later.voltage[: one.since], none.later.voltage[: one.since])
    assert 7.0 < one.snr < 43.0
    elsewhere = pairs.draw(REPORT, SIMULATED, planted.NONE, 0)
    assert elsewhere.control.voltage.shape != none.control.voltage.shape or not np.array_equal(
        elsewhere.control.voltage, none.control.voltage
    )


def test_simulated_sessions_are_recordings_and_cross_their_wires():
    sessions = pair_skins.simulated(np.random.default_rng(3))
    (a, b), crossed = sessions.crossed
    for each in (sessions.control, sessions.later, crossed):
        validate(each, "pair")
    moved = np.isin(crossed.channels, (a, b)).any(axis=1)
    assert np.array_equal(crossed.voltage[:, ~moved], sessions.later.voltage[:, ~moved])
    assert not np.isclose(crossed.voltage[:, moved], sessions.later.voltage[:, moved]).all()


def test_the_walk_begins_nowhere_else_than_where_it_says():
    rng = np.random.default_rng(0)
    plain = rng.normal(size=(4, 30))
    walk = pair_skins._walk(rng, 40, plain, np.full(30, 1e-3))
    assert walk.shape == (40, 4) and (walk[:, 0] == 1.0).all()
    assert np.abs(np.diff(walk[:, 1:], axis=0)).max() < 0.1


def test_what_is_said_is_judged_by_its_site():
    case = small("drive-gain")
    said = difference(case.control, case.later, pairs.NAMES)
    row = pairs.judged(case, said)
    place = ("drives", tuple(sorted(case.fault["drives"])))
    right = [one.explanation.place == place for one in said.findings if one.named]
    assert row["at_site"] == (right == [True])
    assert row["false"] == (not all(right))
    other = {**case.fault, "drives": [7 - d for d in case.fault["drives"]]}
    swapped = pairs.Case(case.control, case.later, other, 0, 9.0, 9.0)
    assert not pairs.judged(swapped, said)["at_site"]
    unharmed = pairs.Case(case.control, case.later, None, 0, 0.0, 0.0)
    assert pairs.judged(unharmed, said)["false"] == bool(right)


def test_a_row_of_other_code_is_made_again(monkeypatch, tmp_path):
    made = []
    monkeypatch.setattr(pairs, "NUMBERS", {REPORT: {SIMULATED: (0, 1)}})
    monkeypatch.setattr(pairs, "_row", lambda *asked: made.append(asked) or {"kind": "none"})
    (tmp_path / "rows").mkdir()
    for code in ("a", "a", "b"):
        monkeypatch.setattr(pairs, "CODE", code)
        assert pairs.rows(REPORT, tmp_path)["kind"].tolist() == ["none"]
    assert len(made) == 2


def test_the_table_counts_shares():
    rows = pd.DataFrame(
        [
            {"source": "a", "kind": kind, "snr": snr, "since": since, "said_since": said}
            | {"at_site": site, "named": site, "false": false}
            for kind, snr, since, said, site, false in (
                ("drive-gain", 10.0, 5, 6, True, False),
                ("drive-gain", 10.0, 0, -1, False, True),
                ("drive-gain", 2.0, 0, -1, False, False),
                ("none", 0.0, 0, -1, False, False),
            )
        ]
    )
    text = pairs.table(rows)
    assert "| a fault of SNR 8 or more in the difference | 2 | 1: 50 %" in text
    assert "| a fault of less | 1 | 0: 0 %" in text and "| no fault | 1 |" in text
    assert "1 of 1 found beginnings" in text
