"""Information that a recording's frames and metadata do not contain."""

from collections import deque

import numpy as np

from eitskin.data.recording import Recording, presses
from eitskin.physics.protocol import reciprocal_channels

HOLD_S = 5.0  # of constant load, for relaxation to be seen
HOLD_SPREAD = 0.02  # of the largest load: constant within a load cell's noise
UNLOADED = 0.1  # of the largest load: a fall by more is unloading


def missing_information(recording: Recording) -> list[str]:
    """Keys of `sentences.MISSING` that apply to a recording."""
    frames, metadata = recording.frames, recording.metadata
    touch = frames["touch"].to_numpy(dtype=bool)
    untouched_rows = np.flatnonzero(~touch)
    difference = metadata["values"] == "difference"
    has_late_untouched = len(untouched_rows) > 1 and untouched_rows[-1] >= 0.8 * (len(frames) - 1)
    gaps = {
        "absolute": difference,
        "noise": not difference and not (np.diff(untouched_rows) == 1).any(),
        "drift": not difference and not has_late_untouched,
        "rates": metadata["clock"] == "index",
        "scan": metadata["frame_s"] is None,
        "sign": metadata["voltage"] == "magnitude",
        "conductivity": metadata["unit"] == "arbitrary" or recording.skin.current_A is None,
        "reciprocity": not len(reciprocal_channels(recording.channels)[0]),
        "touch": not touch.any(),
    }
    if touch.any():
        gaps |= _touch_gaps(recording)
    return [key for key, is_missing in gaps.items() if is_missing]


def _touch_gaps(recording: Recording) -> dict[str, bool]:
    touched = recording.frames[recording.frames["touch"].to_numpy(dtype=bool)]
    forces = touched["force_N"].dropna()
    longest_hold_s, has_unloading, has_repeated_place = _press_properties(recording)
    return {
        "force": not len(forces),
        "forces": len(forces) > 0 and forces.max() < 2.0 * forces.min(),
        "probe": touched["probe_mm"].nunique() < 2,
        "relaxation": recording.metadata["clock"] == "index" or longest_hold_s < HOLD_S,
        "hysteresis": not has_unloading,
        "repeatability": not has_repeated_place,
        "placement": recording.metadata["position_frame"] == "robot",
    }


def _press_properties(recording: Recording) -> tuple[float, bool, bool]:
    """Longest hold in s, whether any press has unloading, whether any place is pressed twice."""
    frames = recording.frames
    touch = frames["touch"].to_numpy(dtype=bool)
    keys = ("force_N", "depth_mm", "time_s")
    force, depth, time_s = (frames[key].to_numpy(float) for key in keys)
    press = presses(recording)[touch]
    rows = np.flatnonzero(touch)[np.argsort(press, kind="stable")]
    press_starts = np.flatnonzero(np.diff(np.sort(press), prepend=-1))
    longest_hold_s, has_unloading = 0.0, False
    for press_rows in np.split(rows, press_starts[1:]):
        load = depth[press_rows] if np.isnan(force[press_rows]).any() else force[press_rows]
        if len(load) < 2 or np.isnan(load).any():
            continue
        has_unloading |= bool((np.maximum.accumulate(load) - load).max() > UNLOADED * load.max())
        longest_hold_s = max(longest_hold_s, _longest_hold(load, time_s[press_rows]))
    has_repeated_place = frames.loc[rows[press_starts], ["x_mm", "y_mm"]].duplicated().any()
    return longest_hold_s, has_unloading, bool(has_repeated_place)


def _longest_hold(load: np.ndarray, time_s: np.ndarray) -> float:
    """The longest time in which the load (n,) varies by at most HOLD_SPREAD of its maximum."""
    max_spread, longest_s, start = HOLD_SPREAD * load.max(), 0.0, 0
    falling, rising = deque[int](), deque[int]()  # sliding maxima and minima of the window
    for stop in range(len(load)):
        for queue, sign in ((falling, 1.0), (rising, -1.0)):
            while queue and sign * load[queue[-1]] <= sign * load[stop]:
                queue.pop()
            queue.append(stop)
        while load[falling[0]] - load[rising[0]] > max_spread:
            start += 1
            for queue in (falling, rising):
                if queue[0] < start:
                    queue.popleft()
        longest_s = max(longest_s, float(time_s[stop] - time_s[start]))
    return longest_s
