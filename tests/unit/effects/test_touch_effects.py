"""Effects on the touch, each against its definition written out."""

import numpy as np
import pandas as pd
import pytest

from eitskin.effects.effect import Frames
from eitskin.effects.settings import settings, site_counts
from eitskin.physics.force_history import ForceHistory
from eitskin.physics.protocol import channel_table
from eitskin.simulate.readings import apply_force, apply_touch

CHANNELS = channel_table(16)
TIME = np.array([0.0, 4.0, 8.0, 12.0, 16.0, 20.0, 24.0])
FORCE = np.array([0.0, 2.0, 5.0, 8.0, 6.0, 3.0, 4.0])
PRESS = np.array([-1, 0, 0, 0, 0, 0, 0])
HISTORY = ForceHistory.of_frames(TIME, FORCE, PRESS)
FRAMES = Frames(TIME, FORCE, CHANNELS, HISTORY, 0.35, 8.0)
TOUCHES = pd.DataFrame(
    {
        "x_mm": np.where(PRESS < 0, np.nan, 10.0),
        "y_mm": np.where(PRESS < 0, np.nan, -30.0),
        "radius_mm": np.where(PRESS < 0, np.nan, 5.0),
        "force_N": FORCE,
        "felt_N": FORCE,
        "contrast_per_N": 0.9,
    }
)


def chosen(*items):
    effects = [{"name": name, "parameters": parameters} for name, parameters in items]
    return settings(effects, site_counts(CHANNELS), (0, 0))


def touches(*items):
    return apply_touch(TOUCHES, chosen(*items), FRAMES)


def contrast(*items):
    table = touches(*items)
    return (table["contrast_per_N"] * table["felt_N"]).to_numpy()


def test_contrast_ratio_and_law():
    assert contrast(("touch-contrast", {"ratio": 1.4})) == pytest.approx(0.9 * 1.4 * FORCE)
    assert contrast(("contact-law", {"exponent": 0.7})) == pytest.approx(0.9 * FORCE**0.7)


def test_radius():
    assert touches(("probe-radius", {"ratio": 1.2}))["radius_mm"][1:].to_numpy() == pytest.approx(6)
    grown = touches(("contact-area-growth", {"exponent": 1 / 3}))["radius_mm"].to_numpy()
    assert grown[1:] == pytest.approx(5.0 * FORCE[1:] ** (1 / 3))
    assert np.isnan(grown[0])


def test_registration():
    table = touches(("registration", {"dx_mm": 1.0, "dy_mm": -2.0, "rotation_deg": 90.0}))
    assert table["x_mm"][1:].to_numpy() == pytest.approx(30.0 + 1.0)
    assert table["y_mm"][1:].to_numpy() == pytest.approx(10.0 - 2.0)


def test_relaxation_takes_off_what_has_followed():
    found = contrast(("relaxation", {"fraction": 0.3, "tau_s": 5.0}))
    assert found == pytest.approx(0.9 * (FORCE - 0.3 * HISTORY.relaxed_N(5.0)))


def test_a_step_of_force_fades_by_the_fraction():
    time = 100.0 * np.arange(4)
    force = np.full(4, 6.0)
    history = ForceHistory.of_frames(time, force, np.zeros(4, dtype=int))
    frames = Frames(time, force, CHANNELS, history)
    table = TOUCHES[:4].assign(force_N=force, felt_N=force)
    item = ("relaxation", {"fraction": 0.25, "tau_s": 5.0})
    felt = apply_touch(table, chosen(item), frames)["felt_N"].to_numpy()
    assert felt[0] > 5.8 and felt[1:] == pytest.approx(0.75 * 6.0)


def test_hysteresis_is_on_the_unloading_branch_alone():
    """The last frame presses harder again, but is still below the peak."""
    factor = np.array([1, 1, 1, 1, 1 + 0.2 * (1 - 6 / 8), 1 + 0.2 * (1 - 3 / 8), 1 + 0.2 * 0.5])
    assert contrast(("hysteresis", {"fraction": 0.2})) == pytest.approx(0.9 * FORCE * factor)


def test_the_order_in_the_list_does_not_matter():
    items = [
        ("contact-law", {"exponent": 0.7}),
        ("relaxation", {"fraction": 0.3, "tau_s": 5.0}),
        ("hysteresis", {"fraction": 0.2}),
        ("touch-contrast", {"ratio": 1.4}),
    ]
    assert contrast(*items) == pytest.approx(contrast(*items[::-1]), rel=1e-14)
    relaxed = FORCE - 0.3 * HISTORY.relaxed_N(5.0)
    expected = 0.9 * 1.4 * relaxed**0.7
    assert contrast(*items)[:4] == pytest.approx(expected[:4])


def test_lag_and_offset_are_of_the_true_force():
    """On a ramp of 3/4 N/s."""
    found = apply_force(FRAMES, chosen(("force-lag", {"lag_s": 0.4})))
    assert found.force_N[1:4] == pytest.approx([2 + 0.3, 5 + 0.3, 8 - 0.2])
    assert found.force_N[0] == 0 and found.force_N[6] == pytest.approx(4.1)
    raised = apply_force(FRAMES, chosen(("force-offset", {"offset_N": -0.5}))).force_N
    assert raised == pytest.approx([0, *(FORCE[1:] - 0.5)])
    both = ("force-lag", {"lag_s": 0.4}), ("force-offset", {"offset_N": -0.5})
    assert apply_force(FRAMES, chosen(*both)).force_N[1] == pytest.approx(1.8)
