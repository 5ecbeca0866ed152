"""Whether numbers are in the units that their keys and columns name, by what a soft skin can be.

Each doubt names the key or column, what stands there, the factor it is off by, and the mistake it
looks like. Bounds are of physics: no gel bears 5 MPa, nobody presses one with 1 kN, and a disc that
conducts sigma h reads I / (sigma h) times what its shape gives (`alignment.homogeneous_readings`).
"""

from dataclasses import dataclass

import numpy as np

from eitskin.data import alignment
from eitskin.data.check.measures import untouched_readings
from eitskin.data.recording import Recording

THOUSAND = 1e3
# Contacts, width, depth and a conductivity known to 20 % change readings by less than this.
OFF_BY = 10.0
RADIUS_MM = (5.0, 5e3)
THICKNESS_MM = (0.05, 1e3)
LEAST_PROBE_MM, LEAST_DEPTH_MM = 0.1, 0.05
LEAST_WIDTH_MM = 0.05
CURRENT_A = (1e-8, 0.1)  # safe currents are below 10 mA, a converter sees no nA
FORCE_N = (1e-3, 1e3)
BEARABLE_PA = 5e6
PLACES = 3  # at least, to say that all are at the centre
CENTRE = 0.05  # of the radius
LONGEST_FRAME_S = 60.0
SLOWEST_S, IDLE_S, LEAST_FRAMES = 100.0, 10.0, 20  # so long no rig idles after every frame
GRAM_N = 9.81e-3


@dataclass(frozen=True)
class Doubt:
    """A number that is hardly in its unit: of which key or column, what stands there in its unit,
    how many times too large it seems, None where nothing tells, and what it looks like.
    """

    key: str
    found: str
    factor: float | None
    looks_like: str


def doubts(recording: Recording) -> list[Doubt]:
    """Every doubt about a recording's or query's units."""
    found = [*_skin(recording), *_touches(recording), *_times(recording)]
    return [*found, *_amplitude(recording)]


def _skin(recording: Recording) -> list[Doubt]:
    skin, found = recording.skin, []
    for key, (low, high) in (("radius_mm", RADIUS_MM), ("thickness_mm", THICKNESS_MM)):
        value = getattr(skin, key)
        if value is not None and not low <= value <= high:
            found.append(_length(f"skin.{key}", value, value < low))
    if skin.electrode_width_mm and skin.electrode_width_mm < LEAST_WIDTH_MM:
        found.append(_length("skin.electrode_width_mm", skin.electrode_width_mm, True))
    current = skin.current_A if recording.metadata["unit"] == "V" else None
    if current == 1.0:
        looks = "a default that nobody measured; write null where the current is unknown"
        found.append(Doubt("skin.current_A", "1 A", None, looks))
    elif current is not None and current > CURRENT_A[1]:
        found.append(Doubt("skin.current_A", f"{current:g} A", THOUSAND, "mA given as A"))
    elif current is not None and current < CURRENT_A[0]:
        found.append(Doubt("skin.current_A", f"{current:g} A", 1.0 / THOUSAND, "kA given as A"))
    return found


def _touches(recording: Recording) -> list[Doubt]:
    touched = recording.frames[recording.frames["touch"].to_numpy(dtype=bool)]
    if not len(touched):
        return []
    found = _places(recording, touched[["x_mm", "y_mm"]].to_numpy(float))
    probe = touched["probe_mm"].to_numpy(float)
    radius = recording.skin.radius_mm
    largest = _largest(probe)
    if largest and radius is not None and largest > 2.0 * radius:
        found.append(_length("probe_mm", largest, False, "; it is wider than the skin"))
    elif largest and largest < LEAST_PROBE_MM:
        found.append(_length("probe_mm", largest, True))
    depth = _largest(touched["depth_mm"].abs().to_numpy(float))
    if depth and depth < LEAST_DEPTH_MM:
        found.append(_length("depth_mm", depth, True, "; it is the largest"))
    elif depth and radius is not None and depth > 2.0 * radius:
        found.append(_length("depth_mm", depth, False, "; it is more than the skin is across"))
    return found + _forces(touched["force_N"].to_numpy(float), probe)


def _places(recording: Recording, place: np.ndarray) -> list[Doubt]:
    """A robot's frame is scaled to the skin's anyhow."""
    radius = recording.skin.radius_mm
    if radius is None or recording.metadata["position_frame"] != "skin":
        return []
    place = np.unique(place, axis=0)
    farthest = float(np.hypot(*place.T).max())
    if len(place) < PLACES or farthest > CENTRE * radius:
        return []
    found = f"{len(place)} places within {farthest:.3g} mm of the centre, the radius is {radius:g}"
    return [Doubt("x_mm, y_mm", found, 1.0 / THOUSAND, "metres given as mm")]


def _forces(force: np.ndarray, probe_mm: np.ndarray) -> list[Doubt]:
    largest = _largest(force)
    if not largest:
        return []
    if largest < FORCE_N[0]:
        found = f"{largest:.3g} N at the most"
        return [Doubt("force_N", found, 1.0 / THOUSAND, "kN given as N, or a scale left out")]
    probe_mm = np.where(probe_mm >= LEAST_PROBE_MM, probe_mm, np.nan)
    pressure = _largest(force / (np.pi * (0.5e-3 * probe_mm) ** 2))
    if largest <= FORCE_N[1] and not (pressure and pressure > BEARABLE_PA):
        return []
    found = f"{largest:.4g} N at the most"
    if pressure:
        found += f", {pressure / 1e6:.3g} MPa under the probe: no gel bears it"
    if largest <= FORCE_N[1]:
        return [Doubt("force_N", found, 1.0 / GRAM_N, "grams given as N, or mN")]
    return [Doubt("force_N", found, THOUSAND, "mN given as N, or grams")]


def _times(recording: Recording) -> list[Doubt]:
    found, frame_s = [], recording.metadata["frame_s"]
    time = recording.frames["time_s"].to_numpy(float)
    if frame_s is not None and frame_s > LONGEST_FRAME_S:
        found.append(Doubt("frame_s", f"{frame_s:g} s a frame", THOUSAND, "ms given as s"))
    if recording.metadata["clock"] != "measured" or len(time) < LEAST_FRAMES:
        return found
    fastest = float(np.diff(time).min())
    # No two frames are nearer than one takes: in ms, not nearer than 1000 times that.
    slow = SLOWEST_S if frame_s is None else max(IDLE_S, 0.999 * THOUSAND * frame_s)
    if fastest > slow:
        said = f"{fastest:.3g} s between the nearest two of {len(time)} frames"
        if frame_s is not None:
            said += f", of which one takes {frame_s:g} s"
        found.append(Doubt("time_s", said, THOUSAND, "ms given as s"))
    return found


def amplitude(recording: Recording) -> float | None:
    """The untouched readings over those of the believed disc, both in the median of size; None
    where the current, the sheet, the angles or the unit are unknown.
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
    shape = alignment.homogeneous_readings(recording.channels, np.array(skin.electrode_deg))
    values = recording.voltage
    if recording.quadrature is not None:
        values = np.hypot(values, recording.quadrature)
    size = np.abs(untouched_readings(values, recording)[0])
    kept = np.isfinite(shape) & np.isfinite(size)
    expected = float(np.median(np.abs(shape[kept]))) * current / sheet if kept.any() else 0.0
    return float(np.median(size[kept])) / expected if expected > 0 else None


def _amplitude(recording: Recording) -> list[Doubt]:
    times = amplitude(recording)
    if times is None or 1.0 / OFF_BY <= times <= OFF_BY or times == 0:
        return []
    unit = recording.metadata["unit"]
    thousand = abs(np.log10(times) - np.sign(np.log10(times)) * 3.0) < 1.0
    if times > 1 and thousand:
        looks = "mV given as V, or a conductivity in mS/m given as S/m"
    elif thousand:
        looks = "mA given as A, or a thickness in m or a conductivity in S/mm given as mm or S/m"
    else:
        looks = "a wrong gain, current, thickness or conductivity"
    if unit == "ohm":
        looks = looks.replace("mV given as V", "mΩ given as Ω").replace("mA given as A", "kΩ as Ω")
    found = f"{times:.3g} times what current, conductivity and thickness let one expect"
    return [Doubt("voltage_V", found, times, looks)]


def _largest(values: np.ndarray) -> float | None:
    values = values[np.isfinite(values)]
    return float(values.max()) if len(values) else None


def _length(key: str, value: float, small: bool, more: str = "") -> Doubt:
    factor, unit = (1.0 / THOUSAND, "m") if small else (THOUSAND, "µm")
    return Doubt(key, f"{value:.3g} mm{more}", factor, f"{unit} given as mm")
