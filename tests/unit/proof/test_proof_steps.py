import numpy as np
import pytest

from proof import steps
from witness import cases


@pytest.mark.parametrize("kind", steps.PLANTED)
def test_a_planted_step_is_as_long_as_it_says_and_begins_at_its_frame(kind):
    case = cases.draw("null", 3)
    recorded, frame = steps.planted(case, kind, 20.0, np.random.default_rng(0))
    added = (recorded.voltage - case.voltage) / case.noise_V
    assert not added[:frame].any()
    assert np.linalg.norm(added[frame:], axis=1) == pytest.approx(20.0)
    untouched = np.flatnonzero(~case.states["touch"].to_numpy(bool))
    assert untouched[1] < frame <= untouched[-2]
    if kind == "one electrode":
        changed = recorded.channels[added[-1] != 0]
        assert any((changed == e).any(axis=1).all() for e in range(cases.N_ELECTRODES))


def test_the_table_counts_what_is_found(monkeypatch):
    monkeypatch.setattr(steps, "RIGS", ("null",))
    monkeypatch.setattr(steps, "SIZES", (1.0, 1000.0))
    lines = list(steps.table(2))
    assert lines[1] == "  null: 0 of 2 (seeds [])"
    assert "  every channel, 1 noises: 0 %, 0 %; 0 %" in lines
    assert "  every channel, 1000 noises: 100 %, 100 %; 0 %" in lines
