"""A ceiling that no reading repeats exactly, because noise or a converter's dither came after it.

That the highest channels are equal is no sign: rotation makes them so on a good disc. Signs are
that their noise is squashed, or that touches that should raise them, by the disc and by what the
other channels show, do not.
"""

from dataclasses import dataclass

import numpy as np

from eitskin.data import alignment, baseline
from eitskin.data.check.measures import channel_noise, successive_noise
from eitskin.data.recording import Recording
from eitskin.errors import InputError
from eitskin.physics.protocol import undriven

EQUAL = 4.0  # standard deviations of noise, within which levels are one
LEAST_CHANNELS = 4
LEAST_UNTOUCHED = 6
SQUASHED = 0.25  # of what the other channels have
RAISED = 3.0  # standard deviations; smaller rises of a reading are left out
CLEAR = 20.0  # standard deviations of all rises together
AGREE = 0.5  # correlation of changes with the disc's, for the disc to be believed


@dataclass(frozen=True)
class Ceiling:
    """The channels that stop at a ceiling, that ceiling, the frames in which some of them are at
    it, and the sign: `noise` or `touch`.
    """

    channels: np.ndarray
    ceiling: float
    frames: np.ndarray
    sign: str


def ceilings(recording: Recording) -> list[Ceiling]:
    """Ceilings of the channels that share an electrode with their drive, and of the others; none
    of differences.
    """
    free = ~recording.frames["touch"].to_numpy(dtype=bool)
    if recording.metadata["values"] == "difference" or free.sum() < LEAST_UNTOUCHED:
        return []
    values = np.abs(recording.readings)
    whole = np.isfinite(values[free]).sum(axis=0) >= LEAST_UNTOUCHED
    level = np.full(values.shape[1], np.nan)
    level[whole] = np.nanmedian(values[free][:, whole], axis=0)
    noise = channel_noise(recording.readings[free])
    quiet = np.nan_to_num(successive_noise(np.diff(recording.readings[free], axis=0)))
    channels = recording.channels
    driven = ~undriven(channels)
    response = _response(recording, whole)
    found = []
    for kind in (driven, ~driven):
        rows = np.flatnonzero(kind & whole & (level > 0))
        if len(rows) < 2 * LEAST_CHANNELS:
            continue
        sd = float(np.median(noise[rows]))
        top = rows[level[rows] >= level[rows].max() - EQUAL * sd]
        below = np.setdiff1d(rows, top)
        if len(top) < LEAST_CHANNELS or len(below) < LEAST_CHANNELS:
            continue
        sign = _sign(top, below, quiet, noise, response)
        if sign:
            ceiling = float(np.median(level[top]))
            at = (values[:, top] >= ceiling - EQUAL * sd).any(axis=1)
            found.append(Ceiling(top, ceiling, np.flatnonzero(at), sign))
    return found


@dataclass(frozen=True)
class _Response:
    """Changes of size of each channel in touched frames (T, M), and the disc's up to a factor
    (T, M).
    """

    observed: np.ndarray
    expected: np.ndarray


def _response(recording: Recording, whole: np.ndarray) -> _Response | None:
    """None where nobody touches, or places or electrodes are not known in the skin's frame."""
    skin, frames = recording.skin, recording.frames
    touch = frames["touch"].to_numpy(dtype=bool)
    if skin.electrode_deg is None or skin.radius_mm is None:
        return None
    if not touch.any() or recording.metadata["position_frame"] != "skin":
        return None
    try:
        change = baseline.changes(recording, "recording")[touch]
    except InputError:  # a session without an untouched frame
        return None
    place = frames.loc[touch, ["x_mm", "y_mm"]].to_numpy(float) @ np.array([1.0, 1.0j])
    load = frames.loc[touch, "force_N"].to_numpy(float)
    if not np.isfinite(load).all():
        load = frames.loc[touch, "depth_mm"].to_numpy(float)
        load = load if np.isfinite(load).all() else np.ones(len(place))
    inside = np.abs(place) < 0.98 * skin.radius_mm
    angles = np.array(skin.electrode_deg)
    expected = alignment.sensitivity(recording.channels, angles, place[inside] / skin.radius_mm)
    expected *= load[inside, None]
    if recording.metadata["voltage"] == "magnitude":
        shape = alignment.homogeneous_readings(recording.channels, angles)
        return _Response(change[inside], expected * np.where(shape < 0, -1.0, 1.0))
    turned = np.where(np.nanmedian(recording.readings[~touch][:, whole], axis=0) < 0, -1.0, 1.0)
    sign = np.ones(len(whole))
    sign[whole] = turned
    return _Response(change[inside] * sign, expected * sign)


def _sign(
    top: np.ndarray,
    below: np.ndarray,
    quiet: np.ndarray,
    noise: np.ndarray,
    response: _Response | None,
) -> str | None:
    if quiet[top].max() < SQUASHED * np.median(quiet[below]):
        return "noise"
    if response is None or not len(response.observed):
        return None
    known = np.isfinite(response.observed)
    observed, expected = np.where(known, response.observed, 0.0), response.expected * known
    length = np.linalg.norm(expected, axis=0)[below]
    size = np.linalg.norm(observed, axis=0)[below]
    along = (observed * expected).sum(axis=0)[below] / np.where(length > 0, length, 1.0)
    if np.median(along / np.where(size > 0, size, 1.0)) < AGREE:
        return None
    slope = np.median(along / np.where(length > 0, length, 1.0))
    wanted, seen = slope * expected[:, top] / noise[top], observed[:, top] / noise[top]
    raised = wanted > RAISED
    power = float((wanted[raised] ** 2).sum())
    if power < CLEAR**2 or abs((wanted * seen)[raised].sum()) >= SQUASHED * power:
        return None
    return "touch"
