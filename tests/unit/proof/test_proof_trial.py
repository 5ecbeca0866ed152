"""What a trial holds against the truth: physics that a fit lacks, and nothing of the rig."""

from types import SimpleNamespace

import pytest

from eitskin.data.recording import Recording
from proof.refit import calibrated, missing
from witness import cases

FRAMES = 40


def left(kind, seed):
    """SNR of what the calibrations alone leave."""
    case = cases.draw(kind, seed, FRAMES)
    recorded = Recording(case.states, case.voltage, None, None, dict(case.metadata))
    _, _, state = calibrated(recorded, 1)
    return missing(SimpleNamespace(explanation=state, recording=recorded), case)


@pytest.mark.parametrize(
    ("error", "seed"), [("place-per-frame", 3), ("place-per-press", 11), ("force-per-press", 3)]
)
def test_errors_of_place_and_force_are_no_missing_physics(error, seed):
    assert left(f"null+rig:{error}", seed) < 0.01


def test_missing_physics_is_what_it_is_without_them():
    bare, by_rig = (left(f"outside:humidity-step{rig}", 3) for rig in ("", "+rig:place-per-press"))
    assert bare > 2.0 and by_rig == pytest.approx(bare, rel=0.2)
