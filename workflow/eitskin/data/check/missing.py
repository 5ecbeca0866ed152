"""What a recording's frames and metadata lack, and so cannot tell."""

import numpy as np

from eitskin.data.recording import Recording, presses
from eitskin.physics.protocol import reciprocal_channels

HOLD_S = 5.0
HOLD_SPREAD = 0.02
UNLOADED = 0.1


def missing(recording: Recording) -> list[str]:
    """Keys of `sentences.MISSING`: what these frames cannot tell."""
    frames, metadata = recording.frames, recording.metadata
    touch = frames["touch"].to_numpy(dtype=bool)
    rows = np.flatnonzero(~touch)
    difference = metadata["values"] == "difference"
    late = len(rows) > 1 and rows[-1] >= 0.8 * (len(frames) - 1)
    lacks = {
        "absolute": difference,
        "noise": not difference and not (np.diff(rows) == 1).any(),
        "drift": not difference and not late,
        "rates": metadata["clock"] == "index",
        "scan": metadata["frame_s"] is None,
        "sign": metadata["voltage"] == "magnitude",
        "conductivity": metadata["unit"] == "arbitrary" or recording.skin.current_A is None,
        "reciprocity": not len(reciprocal_channels(recording.channels)[0]),
        "touch": not touch.any(),
    }
    if touch.any():
        lacks |= _missing_of_touches(recording)
    return [key for key, applies in lacks.items() if applies]


def _missing_of_touches(recording: Recording) -> dict[str, bool]:
    touched = recording.frames[recording.frames["touch"].to_numpy(dtype=bool)]
    forces = touched["force_N"].dropna()
    held, unloaded, again = _press_facts(recording)
    return {
        "force": not len(forces),
        "forces": len(forces) > 0 and forces.max() < 2.0 * forces.min(),
        "probe": touched["probe_mm"].nunique() < 2,
        "relaxation": recording.metadata["clock"] == "index" or held < HOLD_S,
        "hysteresis": not unloaded,
        "repeatability": not again,
        "placement": recording.metadata["position_frame"] == "robot",
    }


def _press_facts(recording: Recording) -> tuple[float, bool, bool]:
    """Longest hold in s, whether any press is unloaded, whether any place is pressed twice."""
    frames = recording.frames.assign(press=presses(recording))
    longest, unloaded = 0.0, False
    for _, press in frames[frames["press"] >= 0].groupby("press"):
        load = press["force_N"] if press["force_N"].notna().all() else press["depth_mm"]
        load = load.to_numpy(dtype=float)
        if len(load) < 2 or np.isnan(load).any():
            continue
        unloaded |= bool((np.maximum.accumulate(load) - load).max() > UNLOADED * load.max())
        longest = max(longest, _longest_hold(load, press["time_s"].to_numpy()))
    firsts = frames[frames["press"] >= 0].drop_duplicates("press")
    return longest, unloaded, bool(firsts.duplicated(["x_mm", "y_mm"]).any())


def _longest_hold(load: np.ndarray, time_s: np.ndarray) -> float:
    start, longest = 0, 0.0
    for stop in range(len(load)):
        while np.ptp(load[start : stop + 1]) > HOLD_SPREAD * load.max():
            start += 1
        longest = max(longest, float(time_s[stop] - time_s[start]))
    return longest
