"""What a recording's frames and metadata lack, and so cannot tell."""

from collections import deque

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
    frames = recording.frames
    touch = frames["touch"].to_numpy(dtype=bool)
    keys = ("force_N", "depth_mm", "time_s")
    force, depth, time_s = (frames[key].to_numpy(float) for key in keys)
    press = presses(recording)[touch]
    rows = np.flatnonzero(touch)[np.argsort(press, kind="stable")]
    first = np.flatnonzero(np.diff(np.sort(press), prepend=-1))
    longest, unloaded = 0.0, False
    for one in np.split(rows, first[1:]):
        load = depth[one] if np.isnan(force[one]).any() else force[one]
        if len(load) < 2 or np.isnan(load).any():
            continue
        unloaded |= bool((np.maximum.accumulate(load) - load).max() > UNLOADED * load.max())
        longest = max(longest, _longest_hold(load, time_s[one]))
    again = frames.loc[rows[first], ["x_mm", "y_mm"]].duplicated().any()
    return longest, unloaded, bool(again)


def _longest_hold(load: np.ndarray, time_s: np.ndarray) -> float:
    """The longest time within which the load (n,) varies by HOLD_SPREAD of its largest at most."""
    spread, longest, start = HOLD_SPREAD * load.max(), 0.0, 0
    falling, rising = deque[int](), deque[int]()  # frames whose load none since exceeds, undercuts
    for stop in range(len(load)):
        for kept, sign in ((falling, 1.0), (rising, -1.0)):
            while kept and sign * load[kept[-1]] <= sign * load[stop]:
                kept.pop()
            kept.append(stop)
        while load[falling[0]] - load[rising[0]] > spread:
            start += 1
            for kept in (falling, rising):
                if kept[0] < start:
                    kept.popleft()
        longest = max(longest, float(time_s[stop] - time_s[start]))
    return longest
