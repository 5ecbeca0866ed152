"""Presses with a second touch that no label tells: their change is that of touches at two places,
the labelled one and another.

Of the presses of good skins, the disc's sensitivity at one more place explains up to 0.02 of the
change's square, of noisy ones 0.06 with far more left over; a second touch of half the size 0.2.
"""

import numpy as np

from eitskin.data import alignment, baseline
from eitskin.data.check.measures import reading_variance
from eitskin.data.recording import Recording, presses
from eitskin.errors import InputError

NEAR, FAR = 0.15, 0.35  # radii from the labelled place: where its touch is, and where a second is
MIN_GAIN = 0.03  # of the square of a change, that the second place explains
MIN_EXCESS = 5.0  # times that of the median press
MAX_REST = 0.5  # of it, that no place explains
MAX_ALONE = 0.95  # of the square, that one place explains: more is one touch, at another place
MAX_RATIO = 10.0  # of the two touches' sizes
MIN_PRESSES = 4  # for a median press
MAX_SHARE = 0.5  # of the presses: more are no exception
MIN_ENERGY = 100.0  # square of a change over the noise's variance, beyond that of noise


def second_touches(recording: Recording) -> list[np.ndarray]:
    """Rows of each press with a second touch that no label tells, in order of the presses.

    None where places are not in the skin's frame, its radius or angles are unknown, and of
    recordings whose labels hold several touches.
    """
    skin = recording.skin
    is_placed = recording.metadata["position_frame"] == "skin" and skin.radius_mm is not None
    if recording.voltage is None or recording.touches is not None or not is_placed:
        return []
    if skin.electrode_deg is None or skin.radius_mm is None:
        return []
    try:
        change = baseline.steady_changes(recording, "recording")
    except InputError:  # a session without an untouched frame
        return []
    press = presses(recording)
    angles = np.array(skin.electrode_deg)
    if recording.metadata["voltage"] == "magnitude":
        change = change * np.sign(alignment.homogeneous_readings(recording.channels, angles))
    turns = np.exp(2j * np.pi * np.arange(alignment.GRID_ANGLES) / alignment.GRID_ANGLES)
    places = (alignment.GRID_RADII[:, None] * turns).ravel()
    patterns = alignment.sensitivity(recording.channels, angles, places)
    patterns /= np.linalg.norm(patterns, axis=1)[:, None]
    stated = recording.frames[["x_mm", "y_mm"]].to_numpy(float) @ np.array([1.0, 1.0j])
    variance = reading_variance(recording)
    press_rows = [np.flatnonzero(press == number) for number in range(press.max(initial=-1) + 1)]
    gains, is_second = np.zeros((2, len(press_rows)))
    for number, rows in enumerate(press_rows):
        filled = np.nan_to_num(change[rows])
        strongest = int(np.argmax((filled**2).sum(axis=1)))
        signal = filled[strongest]
        noise = float(variance[np.isfinite(change[rows[strongest]])].sum())
        if signal @ signal <= noise + MIN_ENERGY * noise / len(signal):
            continue
        distance = np.abs(places - stated[rows[strongest]] / skin.radius_mm)
        gains[number], is_second[number] = _second(signal, patterns, distance)
    if len(press_rows) < MIN_PRESSES:
        return []
    is_second *= gains > max(MIN_GAIN, MIN_EXCESS * float(np.median(gains)))
    if is_second.mean() > MAX_SHARE:
        return []
    return [press_rows[number] for number in np.flatnonzero(is_second)]


def _second(signal: np.ndarray, patterns: np.ndarray, distance: np.ndarray) -> tuple[float, bool]:
    """Share of the square of a change (M,) that a touch at a second place explains beside the one
    nearest to the labelled place, and whether the two are two touches.

    patterns (G, M): unit changes of places at `distance` (G,) radii from the label."""
    labelled_patterns, patterns_apart = patterns[distance < NEAR], patterns[distance > FAR]
    if not len(labelled_patterns) or not len(patterns_apart):
        return 0.0, False
    power = signal @ signal
    labelled_products = labelled_patterns @ signal
    best = int(np.argmax(np.abs(labelled_products)))
    pattern, amplitude = labelled_patterns[best], labelled_products[best]
    residual = signal - amplitude * pattern
    overlap = patterns_apart @ pattern
    length = np.sqrt(np.maximum(1.0 - overlap**2, 1e-3))
    products = np.sign(amplitude) * (patterns_apart @ residual) / length
    second = int(np.argmax(products))
    gain = max(float(products[second]), 0.0) ** 2 / power
    second_amplitude = products[second] / length[second]
    first_amplitude = abs(amplitude) - overlap[second] * second_amplitude
    is_two = (
        float(residual @ residual) / power - gain < MAX_REST * gain
        and ((patterns @ signal) ** 2).max() < MAX_ALONE * power
        and first_amplitude > 0.0
        and 1.0 / MAX_RATIO < second_amplitude / first_amplitude < MAX_RATIO
    )
    return gain, bool(is_two)
