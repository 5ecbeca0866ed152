"""What all presses share of their errors, against presses that were moved, and late poses."""

import numpy as np
import pandas as pd
import pytest

from eitskin.data.recording import presses
from eitskin.diagnose.fitting.linearisation import linearised_rig_errors
from eitskin.diagnose.noise.component_sds import component_intervals
from eitskin.diagnose.search.refits import calibrated
from eitskin.diagnose.search.staging import prepared
from eitskin.diagnose.verdict.common_parts import with_common_parts
from small_skin import small_recording, voltage

SHIFT_MM, SCATTER_MM = np.array([0.4, -0.2]), 0.3
DELAY_S, SLIDE_MM = 0.2, 4.0


def components_of(recording):
    """The errors of the rig of a recording in which nothing is named, by name."""
    _, search, _ = prepared(recording, 1)
    search, calibration = calibrated(search)
    rig = linearised_rig_errors(calibration.fit, search.problem.whitening, 0.0)
    sizes = calibration.error_sds
    components = component_intervals(rig, sizes, "V")
    return {c["name"]: c for c in with_common_parts(components, calibration.fit, rig, sizes)}


@pytest.fixture(scope="module")
def moved():
    """Of recordings whose presses are off by chance and all by SHIFT_MM."""
    rigs = []
    for seed in range(4):
        recording = small_recording(places=8, seed=seed)
        rng = np.random.default_rng([seed, 1])
        press = presses(recording)
        off = SHIFT_MM + SCATTER_MM * rng.standard_normal((press.max() + 1, 2))
        touched = press >= 0
        for axis, key in enumerate(("x_mm", "y_mm")):
            recording.frames.loc[touched, key] -= off[press[touched], axis]
        rigs.append(components_of(recording))
    return rigs


def test_the_interval_has_the_chance_mean_of_presses_in_it(moved):
    """Some 0.1 mm of eight presses that are off by 0.3 mm: far more than noise would have."""
    for components in moved:
        part = components["place-per-press"]["common"]
        low, value, high = (np.array(part[key]) for key in ("low", "value", "high"))
        assert ((low < value) & (value < high)).all()
        half = 0.5 * (high - low)
        assert (half > 0.05).all() and (half < 0.5).all()
        assert (np.abs(value - SHIFT_MM) < 3.0 * half).all()


def test_every_common_part_is_stated_also_where_presses_do_not_differ(moved):
    for components in moved:
        for name in ("force-per-press", "force-zero-per-press"):
            entry = components[name]
            assert entry["low"] <= entry["sd"] <= entry["high"] and entry["high"] > 0.0
            part = entry["common"]
            assert part["low"] < 0.0 < part["high"]  # the load cell is right
        assert components["force-delay"]["sd"] == 0.0
        assert "place-delay" not in components  # nothing slides


def test_parts_that_readings_do_not_tell_apart_are_not_stated():
    """Of touches of one force, a cell whose zero is off and one whose factor is."""
    recording = small_recording(noise=1e-4)
    touched = recording.frames["touch"].to_numpy(bool)
    noise = recording.voltage - voltage(recording, [])
    recording.frames.loc[touched, "force_N"] = 5.0
    recording.voltage = voltage(recording, []) + noise
    recording.frames.loc[touched, "force_N"] = 4.8
    components = components_of(recording)
    stated = {name for name, component in components.items() if "common" in component}
    assert "place-per-press" in stated
    assert not stated & {"force-per-press", "force-zero-per-press"}


def test_a_clock_that_nobody_measured_tells_no_delay():
    recording = small_recording()
    recording.metadata["clock"] = "index"
    assert "force-delay" not in components_of(recording)


def test_a_late_pose_shows_where_touches_slide():
    recording = small_recording(noise=1e-4)
    press, time_s = presses(recording), recording.frames["time_s"].to_numpy(float)
    recording.frames["contact"] = pd.array(np.where(press < 0, None, press), "Int64")
    recording.frames[["x_mm", "y_mm"]] *= 0.5
    late = recording.frames[["x_mm", "y_mm"]].copy()
    for number in range(press.max() + 1):
        rows = np.flatnonzero(press == number)
        since_s = time_s[rows] - time_s[rows].mean()
        for key, part in (("x_mm", np.cos(number)), ("y_mm", np.sin(number))):
            speed = SLIDE_MM * part / np.ptp(since_s)
            recording.frames.loc[rows, key] += speed * since_s
            late.loc[rows, key] += speed * (since_s - DELAY_S)
    noise = recording.voltage - voltage(small_recording(), [])
    recording.voltage = voltage(recording, []) + noise
    recording.frames[["x_mm", "y_mm"]] = late
    part = components_of(recording)["place-delay"]["common"]
    half = 0.5 * (part["high"] - part["low"])
    assert half < 0.1 * DELAY_S and abs(part["value"] - DELAY_S) < 3.0 * half
