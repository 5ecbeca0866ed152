"""States like a recording's: its presses, at other places and of other strength."""

import numpy as np
import pandas as pd

from eitskin.data.recording import Recording, frames_table, presses
from eitskin.errors import InputError
from eitskin.simulate import state_priors

IMITATED = "note_imitated"  # of a recording of which not all presses are left


def alike(
    recorded: Recording, sessions: int, rng: np.random.Generator, forces: dict, probe_mm: float
) -> pd.DataFrame:
    """Frames of `sessions` recordings, each of as many presses as `recorded` has, with `session`
    and `contact`; each session's clock starts at 0.

    A press keeps the untouched frames before it, its timing and its probe from one of the
    recording's, drawn; its place is drawn evenly from the disc that the recording's touches reach,
    its largest force from theirs (interpolated quantiles), the others in proportion. A force that
    nobody measured is drawn, one a press, by `forces` (mean_N, sd_N, max_N); an unknown probe is
    `probe_mm`. Where the recording has a column IMITATED, frames without it are left aside.
    Raises InputError without a touch at a known place.
    """
    frames, press = recorded.frames, presses(recorded)
    if IMITATED in frames:
        kept = frames[IMITATED].to_numpy(bool)
        frames, press = frames[kept].reset_index(drop=True), press[kept]
    xy = frames[["x_mm", "y_mm"]].to_numpy(float)
    if not np.isfinite(xy[press >= 0]).all() or not (press >= 0).any():
        raise InputError("recording", "x_mm, y_mm", "no touch, or an unknown place", "known places")
    probe = frames["probe_mm"].fillna(probe_mm).to_numpy(float)
    force, time = frames["force_N"].to_numpy(float), frames["time_s"].to_numpy(float)
    ends = [int(np.flatnonzero(press == label)[-1]) + 1 for label in range(press.max() + 1)]
    spans = list(zip([0, *ends[:-1]], ends, strict=True))
    wait = np.median(np.diff(time[: ends[-1]]))
    lasts = [time[b] - time[a] if b < len(time) else time[b - 1] + wait - time[a] for a, b in spans]
    touched = [press[a:b] >= 0 for a, b in spans]
    peak = np.array([force[a:b][on].max() for (a, b), on in zip(spans, touched, strict=True)])
    reach = float(np.max(np.hypot(*xy[press >= 0].T) + 0.5 * probe[press >= 0]))
    parts = []
    for session in range(sessions):
        now = 0.0
        for contact, k in enumerate(rng.integers(len(spans), size=len(spans))):
            (a, b), on = spans[k], touched[k]
            normal, part = rng.standard_normal(3), rng.uniform()
            if np.isfinite(peak).all():
                own = force[a:b] * np.quantile(peak, part) / peak[k]
            else:
                own = np.full(b - a, state_priors.force_N(normal[2], **forces))
            width = probe[a:b][on][0]
            x, y = state_priors.place_mm(normal[None, :2], reach - 0.5 * width)[0]
            one = frames_table(time[a:b] - time[a] + now, on, x, y, own, width)
            one["contact"] = pd.array(np.where(on, contact, -1), dtype="Int64")
            parts.append(one.assign(session=f"{session}"))
            now += float(lasts[k])
    table = pd.concat(parts, ignore_index=True)
    table["frame"] = np.arange(len(table), dtype=np.int64)
    table["contact"] = table["contact"].where(table["touch"])
    return table
