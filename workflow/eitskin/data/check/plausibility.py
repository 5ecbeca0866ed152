"""Whether numbers are in the units of their keys and columns, by the physics of soft skins.

Bounds are physical: no gel bears 5 MPa, nobody presses one with 1 kN, and a disc of sheet
conductance sigma h reads I / (sigma h) times `alignment.homogeneous_readings`.
"""

from dataclasses import dataclass

import numpy as np

from eitskin.data import alignment
from eitskin.data.check.measures import untouched_readings
from eitskin.data.recording import Recording

THOUSAND = 1e3
# Contacts, width, depth and a conductivity known to 20 % change readings by a smaller factor.
MAX_AMPLITUDE_FACTOR = 10.0
RADIUS_MM = (5.0, 5e3)  # from a fingertip to a room
THICKNESS_MM = (0.05, 1e3)  # from a printed film to a deep tank
MIN_PROBE_MM, MIN_DEPTH_MM = 0.1, 0.05  # thinner is a needle; less is within a robot's error
MIN_WIDTH_MM = 0.05  # of an electrode: below a printed trace
CURRENT_A = (1e-8, 0.1)  # safe currents are below 10 mA, a converter sees no nA
FORCE_N = (1e-3, 1e3)  # below a load cell's resolution, and beyond a robot's payload
BEARABLE_PA = 5e6  # above the strength of soft gels
PLACES = 3  # at least, for all of them to be suspiciously near the centre
CENTRE = 0.05  # of the radius
MAX_FRAME_S = 60.0  # a slow multiplexer takes some seconds
SLOWEST_S, IDLE_S, MIN_FRAMES = 100.0, 10.0, 20  # no rig idles that long after every frame
GRAM_N = 9.81e-3  # weight of a gram


@dataclass(frozen=True)
class Doubt:
    """An implausible number: its key or column, its value in words, the factor by which it seems
    too large (None where unknown), and the likely mistake."""

    key: str
    observed: str
    factor: float | None
    likely_mistake: str


def doubts(recording: Recording) -> list[Doubt]:
    """All doubts about the units of a recording or query."""
    unit_doubts = [*_skin(recording), *_touches(recording), *_times(recording)]
    return [*unit_doubts, *_amplitude(recording)]


def _skin(recording: Recording) -> list[Doubt]:
    skin, skin_doubts = recording.skin, []
    for key, (low, high) in (("radius_mm", RADIUS_MM), ("thickness_mm", THICKNESS_MM)):
        value = getattr(skin, key)
        if value is not None and not low <= value <= high:
            skin_doubts.append(_length(f"skin.{key}", value, value < low))
    if skin.electrode_width_mm and skin.electrode_width_mm < MIN_WIDTH_MM:
        skin_doubts.append(_length("skin.electrode_width_mm", skin.electrode_width_mm, True))
    current = skin.current_A if recording.metadata["unit"] == "V" else None
    if current == 1.0:
        mistake = "a default that nobody measured; write null where the current is unknown"
        skin_doubts.append(Doubt("skin.current_A", "1 A", None, mistake))
    elif current is not None and current > CURRENT_A[1]:
        skin_doubts.append(Doubt("skin.current_A", f"{current:g} A", THOUSAND, "mA given as A"))
    elif current is not None and current < CURRENT_A[0]:
        skin_doubts.append(
            Doubt("skin.current_A", f"{current:g} A", 1.0 / THOUSAND, "kA given as A")
        )
    return skin_doubts


def _touches(recording: Recording) -> list[Doubt]:
    touched = recording.frames[recording.frames["touch"].to_numpy(dtype=bool)]
    if not len(touched):
        return []
    touch_doubts = _places(recording, touched[["x_mm", "y_mm"]].to_numpy(float))
    probe = touched["probe_mm"].to_numpy(float)
    radius = recording.skin.radius_mm
    largest_probe_mm = _largest(probe)
    if largest_probe_mm and radius is not None and largest_probe_mm > 2.0 * radius:
        touch_doubts.append(
            _length("probe_mm", largest_probe_mm, False, "; it is wider than the skin")
        )
    elif largest_probe_mm and largest_probe_mm < MIN_PROBE_MM:
        touch_doubts.append(_length("probe_mm", largest_probe_mm, True))
    largest_depth_mm = _largest(touched["depth_mm"].abs().to_numpy(float))
    if largest_depth_mm and largest_depth_mm < MIN_DEPTH_MM:
        touch_doubts.append(_length("depth_mm", largest_depth_mm, True, "; it is the largest"))
    elif largest_depth_mm and radius is not None and largest_depth_mm > 2.0 * radius:
        touch_doubts.append(
            _length("depth_mm", largest_depth_mm, False, "; it is more than the skin is across")
        )
    return touch_doubts + _forces(touched["force_N"].to_numpy(float), probe)


def _places(recording: Recording, place: np.ndarray) -> list[Doubt]:
    """Doubts about places in the skin's frame; a robot's frame is scaled to the skin's anyway."""
    radius = recording.skin.radius_mm
    if radius is None or recording.metadata["position_frame"] != "skin":
        return []
    place = np.unique(place, axis=0)
    farthest = float(np.hypot(*place.T).max())
    if len(place) < PLACES or farthest > CENTRE * radius:
        return []
    observation = (
        f"{len(place)} places within {farthest:.3g} mm of the centre, the radius is {radius:g}"
    )
    return [Doubt("x_mm, y_mm", observation, 1.0 / THOUSAND, "metres given as mm")]


def _forces(force: np.ndarray, probe_mm: np.ndarray) -> list[Doubt]:
    largest = _largest(force)
    if not largest:
        return []
    if largest < FORCE_N[0]:
        observation = f"{largest:.3g} N at the most"
        return [Doubt("force_N", observation, 1.0 / THOUSAND, "kN given as N, or a scale left out")]
    probe_mm = np.where(probe_mm >= MIN_PROBE_MM, probe_mm, np.nan)
    pressure = _largest(force / (np.pi * (0.5e-3 * probe_mm) ** 2))
    if largest <= FORCE_N[1] and not (pressure and pressure > BEARABLE_PA):
        return []
    observation = f"{largest:.4g} N at the most"
    if pressure:
        observation += f", {pressure / 1e6:.3g} MPa under the probe: no gel bears it"
    if largest <= FORCE_N[1]:
        return [Doubt("force_N", observation, 1.0 / GRAM_N, "grams given as N, or mN")]
    return [Doubt("force_N", observation, THOUSAND, "mN given as N, or grams")]


def _times(recording: Recording) -> list[Doubt]:
    time_doubts, frame_s = [], recording.metadata["frame_s"]
    time = recording.frames["time_s"].to_numpy(float)
    if frame_s is not None and frame_s > MAX_FRAME_S:
        time_doubts.append(Doubt("frame_s", f"{frame_s:g} s a frame", THOUSAND, "ms given as s"))
    if recording.metadata["clock"] != "measured" or len(time) < MIN_FRAMES:
        return time_doubts
    min_interval_s = float(np.diff(time).min())
    # The interval is at least frame_s: if it is in ms, at least 1000 times that.
    max_interval_s = SLOWEST_S if frame_s is None else max(IDLE_S, 0.999 * THOUSAND * frame_s)
    if min_interval_s > max_interval_s:
        observation = f"{min_interval_s:.3g} s between the nearest two of {len(time)} frames"
        if frame_s is not None:
            observation += f", of which one takes {frame_s:g} s"
        time_doubts.append(Doubt("time_s", observation, THOUSAND, "ms given as s"))
    return time_doubts


def amplitude(recording: Recording) -> float | None:
    """Ratio of the median |untouched reading| to that of the stated disc.

    None where current, sheet conductance, angles or unit are unknown.
    """
    skin, metadata = recording.skin, recording.metadata
    sheet = (
        None
        if skin.conductivity_S_per_m is None or skin.thickness_mm is None
        else (skin.conductivity_S_per_m * skin.thickness_mm * 1e-3)
    )
    current = {"V": skin.current_A, "ohm": 1.0, "arbitrary": None}[metadata["unit"]]
    if recording.voltage is None or metadata["values"] == "difference":
        return None
    if sheet is None or current is None or skin.electrode_deg is None:
        return None
    disc_readings = alignment.homogeneous_readings(recording.channels, np.array(skin.electrode_deg))
    values = recording.voltage
    if recording.quadrature is not None:
        values = np.hypot(values, recording.quadrature)
    sizes = np.abs(untouched_readings(values, recording)[0])
    is_comparable = np.isfinite(disc_readings) & np.isfinite(sizes)
    expected_size = (
        float(np.median(np.abs(disc_readings[is_comparable]))) * current / sheet
        if is_comparable.any()
        else 0.0
    )
    return float(np.median(sizes[is_comparable])) / expected_size if expected_size > 0 else None


def _amplitude(recording: Recording) -> list[Doubt]:
    factor = amplitude(recording)
    if (
        factor is None
        or 1.0 / MAX_AMPLITUDE_FACTOR <= factor <= MAX_AMPLITUDE_FACTOR
        or factor == 0
    ):
        return []
    unit = recording.metadata["unit"]
    is_thousandfold = abs(np.log10(factor) - np.sign(np.log10(factor)) * 3.0) < 1.0
    if factor > 1 and is_thousandfold:
        mistake = "mV given as V, or a conductivity in mS/m given as S/m"
    elif is_thousandfold:
        mistake = "mA given as A, or a thickness in m or a conductivity in S/mm given as mm or S/m"
    else:
        mistake = "a wrong gain, current, thickness or conductivity"
    if unit == "ohm":
        mistake = mistake.replace("mV given as V", "mΩ given as Ω").replace(
            "mA given as A", "kΩ as Ω"
        )
    observation = f"{factor:.3g} times what current, conductivity and thickness let one expect"
    return [Doubt("voltage_V", observation, factor, mistake)]


def _largest(values: np.ndarray) -> float | None:
    values = values[np.isfinite(values)]
    return float(values.max()) if len(values) else None


def _length(key: str, value: float, is_small: bool, remark: str = "") -> Doubt:
    factor, unit = (1.0 / THOUSAND, "m") if is_small else (THOUSAND, "µm")
    return Doubt(key, f"{value:.3g} mm{remark}", factor, f"{unit} given as mm")
