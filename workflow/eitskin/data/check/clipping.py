"""Ceilings that readings do not repeat exactly, because noise or dither was added after clipping.

Equal highest channels alone are no sign: rotational symmetry makes them equal on a good disc. Signs
are a smaller noise of the highest channels, or that they do not rise with touches that should raise
them by the disc's sensitivity and by the changes of the other channels.
"""

from dataclasses import dataclass

import numpy as np

from eitskin.data import alignment, baseline
from eitskin.data.check.measures import channel_noise, successive_noise
from eitskin.data.recording import Recording
from eitskin.errors import InputError
from eitskin.physics.protocol import undriven

EQUAL_SD = 4.0  # standard deviations of noise within which levels count as equal
MIN_CHANNELS = 4  # at a ceiling and below it, for medians over them
MIN_UNTOUCHED = 6  # frames, for a channel's noise from successive differences
SQUASHED_SHARE = 0.25  # of the other channels' noise or rise: below, it is clipped
MIN_RISE_SD = 3.0  # standard deviations; smaller expected rises are skipped
MIN_TOTAL_SD = 20.0  # standard deviations of all expected rises together
MIN_CORRELATION = 0.5  # of the changes with the disc's, for the disc to predict rises


@dataclass(frozen=True)
class Ceiling:
    """Clipped channels, their ceiling, the frames in which any is at it, and the sign of it:
    `noise` or `touch`."""

    channels: np.ndarray
    ceiling: float
    frames: np.ndarray
    sign: str


def ceilings(recording: Recording) -> list[Ceiling]:
    """Ceilings of the channels that share an electrode with their drive, and of the others.

    None of recordings of differences.
    """
    is_untouched = ~recording.frames["touch"].to_numpy(dtype=bool)
    if recording.metadata["values"] == "difference" or is_untouched.sum() < MIN_UNTOUCHED:
        return []
    sizes = np.abs(recording.readings)
    is_measured = np.isfinite(sizes[is_untouched]).sum(axis=0) >= MIN_UNTOUCHED
    untouched_size = np.full(sizes.shape[1], np.nan)
    untouched_size[is_measured] = np.nanmedian(sizes[is_untouched][:, is_measured], axis=0)
    noise = channel_noise(recording.readings[is_untouched])
    successive_sd = np.nan_to_num(
        successive_noise(np.diff(recording.readings[is_untouched], axis=0))
    )
    channels = recording.channels
    is_driven = ~undriven(channels)
    response = _response(recording, is_measured)
    channel_ceilings = []
    for channel_group in (is_driven, ~is_driven):
        rows = np.flatnonzero(channel_group & is_measured & (untouched_size > 0))
        if len(rows) < 2 * MIN_CHANNELS:
            continue
        median_sd = float(np.median(noise[rows]))
        top_rows = rows[untouched_size[rows] >= untouched_size[rows].max() - EQUAL_SD * median_sd]
        lower_rows = np.setdiff1d(rows, top_rows)
        if len(top_rows) < MIN_CHANNELS or len(lower_rows) < MIN_CHANNELS:
            continue
        sign = _sign(top_rows, lower_rows, successive_sd, noise, response)
        if sign:
            ceiling = float(np.median(untouched_size[top_rows]))
            is_at_ceiling = (sizes[:, top_rows] >= ceiling - EQUAL_SD * median_sd).any(axis=1)
            channel_ceilings.append(Ceiling(top_rows, ceiling, np.flatnonzero(is_at_ceiling), sign))
    return channel_ceilings


@dataclass(frozen=True)
class _Response:
    """Changes of the size of readings in touched frames (T, M), observed and, up to a factor, of
    the disc."""

    observed: np.ndarray
    expected: np.ndarray


def _response(recording: Recording, is_measured: np.ndarray) -> _Response | None:
    """None without touches, and where places or electrodes are unknown in the skin's frame."""
    skin, frames = recording.skin, recording.frames
    touch = frames["touch"].to_numpy(dtype=bool)
    if skin.electrode_deg is None or skin.radius_mm is None:
        return None
    if not touch.any() or recording.metadata["position_frame"] != "skin":
        return None
    try:
        change = baseline.steady_changes(recording, "recording")[touch]
    except InputError:  # a session without an untouched frame
        return None
    places = frames.loc[touch, ["x_mm", "y_mm"]].to_numpy(float) @ np.array([1.0, 1.0j])
    loads = frames.loc[touch, "force_N"].to_numpy(float)
    if not np.isfinite(loads).all():
        loads = frames.loc[touch, "depth_mm"].to_numpy(float)
        loads = loads if np.isfinite(loads).all() else np.ones(len(places))
    is_inside = np.abs(places) < 0.98 * skin.radius_mm
    angles = np.array(skin.electrode_deg)
    expected = alignment.sensitivity(recording.channels, angles, places[is_inside] / skin.radius_mm)
    expected *= loads[is_inside, None]
    if recording.metadata["voltage"] == "magnitude":
        disc_readings = alignment.homogeneous_readings(recording.channels, angles)
        return _Response(change[is_inside], expected * np.where(disc_readings < 0, -1.0, 1.0))
    signs = np.where(
        np.nanmedian(recording.readings[~touch][:, is_measured], axis=0) < 0, -1.0, 1.0
    )
    sign = np.ones(len(is_measured))
    sign[is_measured] = signs
    return _Response(change[is_inside] * sign, expected * sign)


def _sign(
    top_rows: np.ndarray,
    lower_rows: np.ndarray,
    successive_sd: np.ndarray,
    noise: np.ndarray,
    response: _Response | None,
) -> str | None:
    if successive_sd[top_rows].max() < SQUASHED_SHARE * np.median(successive_sd[lower_rows]):
        return "noise"
    if response is None or not len(response.observed):
        return None
    is_read = np.isfinite(response.observed)
    observed, expected = np.where(is_read, response.observed, 0.0), response.expected * is_read
    expected_norm = np.linalg.norm(expected, axis=0)[lower_rows]
    observed_norm = np.linalg.norm(observed, axis=0)[lower_rows]
    projections = (observed * expected).sum(axis=0)[lower_rows] / np.where(
        expected_norm > 0, expected_norm, 1.0
    )
    if np.median(projections / np.where(observed_norm > 0, observed_norm, 1.0)) < MIN_CORRELATION:
        return None
    slope = np.median(projections / np.where(expected_norm > 0, expected_norm, 1.0))
    expected_rise, observed_rise = (
        slope * expected[:, top_rows] / noise[top_rows],
        observed[:, top_rows] / noise[top_rows],
    )
    is_raised = expected_rise > MIN_RISE_SD
    power = float((expected_rise[is_raised] ** 2).sum())
    if (
        power < MIN_TOTAL_SD**2
        or abs((expected_rise * observed_rise)[is_raised].sum()) >= SQUASHED_SHARE * power
    ):
        return None
    return "touch"
