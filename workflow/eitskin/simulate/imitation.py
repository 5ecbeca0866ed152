"""States imitated from a recording: its presses, at other places and with other forces."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from eitskin.data.recording import Recording, frames_table, presses
from eitskin.errors import InputError
from eitskin.simulate import state_priors

IMITATED = "note_imitated"  # column of a recording whose presses are not all to be imitated


@dataclass(frozen=True)
class PressPrior:
    """What presses are taken to be where the recording does not say: `forces`, the distribution
    (mean_N, sd_N, max_N) of a press's force, and the probe's width `probe_mm`."""

    forces: dict
    probe_mm: float


def imitated_presses(
    recorded: Recording, sessions: int, rng: np.random.Generator, prior: PressPrior
) -> pd.DataFrame:
    """Frames of `sessions` recordings, each with as many presses as `recorded`, with columns
    `session` and `contact`; each session's clock starts at 0.

    A press takes its preceding untouched frames, its timing and its probe from a random press of
    the recording; its place is uniform over the disc of the recording's touches, or within an
    outline as near to its rim as they are, its largest force
    is drawn from the interpolated quantiles of theirs, with the press's other forces in proportion.
    Unknown forces, one for each press, and an unknown probe follow the prior. Frames that are False
    in a column IMITATED are not used. Raises InputError without a touch at a known place.
    """
    frames, press = recorded.frames, presses(recorded)
    if IMITATED in frames:
        is_imitated = frames[IMITATED].to_numpy(bool)
        frames, press = frames[is_imitated].reset_index(drop=True), press[is_imitated]
    xy = frames[["x_mm", "y_mm"]].to_numpy(float)
    if not np.isfinite(xy[press >= 0]).all() or not (press >= 0).any():
        raise InputError("recording", "x_mm, y_mm", "no touch, or an unknown place", "known places")
    probe = frames["probe_mm"].fillna(prior.probe_mm).to_numpy(float)
    force, time = frames["force_N"].to_numpy(float), frames["time_s"].to_numpy(float)
    stops = [int(np.flatnonzero(press == label)[-1]) + 1 for label in range(press.max() + 1)]
    spans = list(zip([0, *stops[:-1]], stops, strict=True))
    wait = np.median(np.diff(time[: stops[-1]]))
    durations = [
        time[stop] - time[start] if stop < len(time) else time[stop - 1] + wait - time[start]
        for start, stop in spans
    ]
    touched_frames = [press[start:stop] >= 0 for start, stop in spans]
    peak_N = np.array(
        [
            force[start:stop][is_touched].max()
            for (start, stop), is_touched in zip(spans, touched_frames, strict=True)
        ]
    )
    rim = recorded.skin.rim
    reach = float(np.max(np.hypot(*xy[press >= 0].T) + 0.5 * probe[press >= 0]))
    if rim is not None:
        touched_place = xy[press >= 0] @ np.array([1.0, 1.0j])
        clearance_mm = float(np.min(rim.depth(touched_place) - 0.5 * probe[press >= 0]))
    tables = []
    for session in range(sessions):
        clock_s = 0.0
        for contact, k in enumerate(rng.integers(len(spans), size=len(spans))):
            (start, stop), is_touched = spans[k], touched_frames[k]
            normal, rank = rng.standard_normal(3), rng.uniform()
            if np.isfinite(peak_N).all():
                press_N = force[start:stop] * np.quantile(peak_N, rank) / peak_N[k]
            else:
                press_N = np.full(stop - start, state_priors.force_N(normal[2], **prior.forces))
            width = probe[start:stop][is_touched][0]
            if rim is None:
                x, y = state_priors.place_mm(normal[None, :2], reach - 0.5 * width)[0]
            else:
                margin_mm = max(clearance_mm + 0.5 * width, 0.0)
                x, y = state_priors.place_within(rng, 1, rim, margin_mm)[0]
            press_frames = frames_table(
                time[start:stop] - time[start] + clock_s, is_touched, x, y, press_N, width
            )
            press_frames["contact"] = pd.array(np.where(is_touched, contact, -1), dtype="Int64")
            tables.append(press_frames.assign(session=f"{session}"))
            clock_s += float(durations[k])
    table = pd.concat(tables, ignore_index=True)
    table["frame"] = np.arange(len(table), dtype=np.int64)
    table["contact"] = table["contact"].where(table["touch"])
    return table
