"""The baseline of untouched frames, the changes against it, and their noise."""

from dataclasses import replace

import numpy as np
import pandas as pd

from eitskin.data.recording import Recording, voltages
from eitskin.errors import InputError

# Mean square of successive differences over the variance (von Neumann, Annals of Mathematical
# Statistics 12, 1941): of noise 2 on average; below, what is measured drifts.
MAX_NEUMANN = 0.7
MIN_NOISE_FRAMES = 20  # an rms of fewer is uncertain by more than 16 %


def changes(recording: Recording, name: str) -> np.ndarray:
    """Changes (N, M) float64 of all frames against the untouched skin, NaN where unknown.

    The baseline of a frame is the mean of the last run of untouched frames before it in its
    session, or of the next run where there is none before. A skin measured untouched before every
    press is thus followed as it drifts; one measured untouched at the start alone gets the paper's
    V_ref (§ II-B). An untouched frame is compared with the run before its own, as a touch in its
    place would be; in a session's first run with the other frames of that run. Frames of `values:
    difference` are changes already.

    Raises InputError naming `name` for a query and for a session without an untouched frame.
    """
    readings = voltages(recording, name)
    if recording.metadata["values"] == "difference":
        return readings
    touched = recording.frames["touch"].to_numpy(bool)
    difference = np.full(readings.shape, np.nan)
    session_of = sessions(recording.frames)
    for session in np.unique(session_of):
        frames = np.flatnonzero(session_of == session)
        is_untouched = ~touched[frames]
        if not is_untouched.any():
            raise InputError(name, f"session {session}", "no untouched frame", "at least one")
        voltage = readings[frames]
        is_run_start = is_untouched & ~np.concatenate([[False], is_untouched[:-1]])
        run_number = (
            np.cumsum(is_run_start) - 1
        )  # of an untouched frame its own, of a touched one the last
        count, total = np.zeros((2, run_number[-1] + 1, voltage.shape[1]))
        np.add.at(count, run_number[is_untouched], np.isfinite(voltage[is_untouched]))
        np.add.at(total, run_number[is_untouched], np.nan_to_num(voltage[is_untouched]))
        with np.errstate(invalid="ignore", divide="ignore"):
            baseline = (total / count)[np.maximum(run_number - is_untouched, 0)]
            is_first_run = is_untouched & (run_number == 0)
            baseline[is_first_run] = (total[0] - voltage[is_first_run]) / (count[0] - 1)
        difference[frames] = voltage - np.where(np.isfinite(baseline), baseline, np.nan)
    return difference


def steady(recording: Recording) -> Recording:
    """A recording less the factor by which all readings of the untouched skin drift together;
    itself where none does, of queries and differences and without untouched frames.

    The factor of an untouched frame is the median, over the larger half of the channels, of its
    readings over the channels' medians; between untouched frames of a session it is interpolated,
    beyond them it stays. It drifts where its von Neumann ratio is below MAX_NEUMANN.
    """
    touched = recording.frames["touch"].to_numpy(bool)
    is_query = recording.voltage is None
    if is_query or recording.metadata["values"] == "difference" or touched.all():
        return recording
    untouched = pd.DataFrame(recording.readings[~touched])
    usual = untouched.median()
    is_large = usual.abs() >= usual.abs().median()
    ratio = (untouched.loc[:, is_large] / usual[is_large]).median(axis=1).to_numpy()
    is_known = np.isfinite(ratio) & (ratio > 0.0)
    rows, ratio = np.flatnonzero(~touched)[is_known], ratio[is_known]
    if len(ratio) < 2 or (np.diff(ratio) ** 2).mean() >= MAX_NEUMANN * ratio.var():
        return recording
    factor = np.ones(len(touched))
    session_of = sessions(recording.frames)
    for session in np.unique(session_of[rows]):
        of_session = session_of[rows] == session
        frames = np.flatnonzero(session_of == session)
        factor[frames] = np.interp(frames, rows[of_session], ratio[of_session])
    quadrature = recording.quadrature
    if quadrature is not None:
        quadrature = quadrature / factor[:, None]
    return replace(recording, voltage=recording.readings / factor[:, None], quadrature=quadrature)


def steady_changes(recording: Recording, name: str) -> np.ndarray:
    """`changes` of the `steady` recording; raises InputError as these do."""
    return changes(steady(recording), name)


def level(recording: Recording, lost_channels: list[int]) -> np.ndarray | None:
    """Mean reading of all untouched frames (M,), without the channels `lost_channels`.

    None without untouched frames, and for recordings of differences.
    """
    is_untouched = ~recording.frames["touch"].to_numpy(bool)
    if recording.voltage is None or recording.metadata["values"] == "difference":
        return None
    untouched_readings = np.delete(recording.readings[is_untouched], lost_channels, axis=1)
    is_read = np.isfinite(untouched_readings)
    if not is_read.any(axis=0).all():
        return None
    return np.asarray(np.where(is_read, untouched_readings, 0.0).sum(axis=0) / is_read.sum(axis=0))


def sessions(frames: pd.DataFrame) -> np.ndarray:
    """Number of the session of each frame (N,), by first appearance; 0 where none is stated."""
    if "session" not in frames:
        return np.zeros(len(frames), dtype=np.int64)
    return pd.factorize(frames["session"])[0].astype(np.int64)


def untouched_noise(difference: np.ndarray) -> dict | None:
    """Noise statistics of the changes (U, M) of untouched frames.

    `rms` of each channel; `quantile_99`, the `upper_limit` at 99 % of the root mean square of
    change / rms over a frame; `frames`, their number. None below MIN_NOISE_FRAMES, and where a
    channel never changes.
    """
    difference = difference[np.isfinite(difference).all(axis=1)]
    if len(difference) < MIN_NOISE_FRAMES:
        return None
    rms = np.sqrt((difference**2).mean(axis=0))
    if not (rms > 0).all():
        return None
    size = np.sqrt(((difference / rms) ** 2).mean(axis=1))
    return {
        "rms": rms.tolist(),
        "quantile_99": upper_limit(size, 0.99),
        "frames": len(difference),
    }


def upper_limit(values: np.ndarray, share: float) -> float:
    """Upper limit of a new value exchangeable with `values` (n,), at probability `share`.

    The ⌈(n + 1) share⌉-th smallest value (split conformal prediction); the largest where n is too
    small.
    """
    rank = min(len(values), int(np.ceil((len(values) + 1) * share)))
    return float(np.sort(values)[rank - 1])
