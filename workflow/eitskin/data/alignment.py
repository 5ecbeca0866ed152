"""From the robot's coordinates to the skin's: a similarity fitted to the hotspots of touches.

A touch's hotspot is the place of the small touch whose change of the readings correlates best with
the observed one: back-projection through the first-order sensitivity of a homogeneous disc with
point electrodes, normalised at each place (by Cauchy-Schwarz the maximum is at the true place of a
small touch). Points of the unit disc are complex numbers.
"""

from dataclasses import dataclass

import numpy as np

from eitskin.data import baseline
from eitskin.data.recording import Recording
from eitskin.errors import InputError
from eitskin.physics import neumann

STRONG_N = 0.8  # weaker touches change readings by little more than noise
MAX_TOUCHES = 200  # more do not make the fit more accurate than the hotspots' grid
MIN_TOUCHES = 3  # two determine the similarity, a third its residual
GRID_RADII = np.linspace(0.04, 0.96, 24)  # radii 0.04 apart
GRID_ANGLES = 96  # 0.06 radii apart near the rim
ROBUST_ROUNDS = 50  # of reweighting, far beyond convergence


@dataclass(frozen=True)
class Similarity:
    """skin = scale R(rotation) mirror(robot) + shift, where mirror is y -> -y if `is_mirrored`.

    Skin coordinates are in mm, or in skin radii where the radius is unknown (scale then is 1 /
    radius_mm). `residual` is the median distance from a hotspot to its touch's place in the same
    unit, `rival_residual` that of the best fit of the other handedness, `touches` their number.
    """

    scale: float
    rotation_deg: float
    is_mirrored: bool
    shift: tuple[float, float]
    residual: float
    rival_residual: float
    touches: int

    @property
    def turn(self) -> complex:
        """Scale and rotation as one factor of complex coordinates."""
        return complex(self.scale * np.exp(1j * np.deg2rad(self.rotation_deg)))

    def __call__(self, x_mm: np.ndarray, y_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Skin coordinates of places in the robot's coordinates."""
        robot = np.asarray(x_mm) + 1j * np.asarray(y_mm)
        skin = self.turn * (np.conj(robot) if self.is_mirrored else robot) + complex(*self.shift)
        return skin.real, skin.imag

    def robot_place(self, x: float, y: float) -> tuple[float, float]:
        """The robot's coordinates of a place in the skin's."""
        robot = (complex(x, y) - complex(*self.shift)) / self.turn
        robot = np.conj(robot) if self.is_mirrored else robot
        return float(robot.real), float(robot.imag)


def homogeneous_readings(channels: np.ndarray, electrode_deg: np.ndarray) -> np.ndarray:
    """Readings (M,) of the untouched disc with point electrodes, in units of current / sheet
    conductance.

    NaN where a measured electrode is driven, as a point source's own potential is infinite.
    """
    angle = np.deg2rad(np.asarray(electrode_deg))
    source, sink, plus, minus = channels.T
    with np.errstate(divide="ignore", invalid="ignore"):
        rim = neumann.rim_potential(angle[:, None] - angle[None, :])
        reading = rim[plus, source] - rim[plus, sink] - rim[minus, source] + rim[minus, sink]
    return np.where(np.isfinite(reading), reading, np.nan)


def sensitivity(channels: np.ndarray, electrode_deg: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Change of each reading per unit of added conductance at `places` (G,) of the disc: (G, M).

    -grad u_drive . grad u_measure (Geselowitz 1971), where u = -ln|x - e| / pi for a unit current
    at a rim point e.
    """
    electrode = np.exp(1j * np.deg2rad(np.asarray(electrode_deg)))
    gradient = -1.0 / (np.pi * np.conj(places[:, None] - electrode[None, :]))
    drive = gradient[:, channels[:, 0]] - gradient[:, channels[:, 1]]
    measure = gradient[:, channels[:, 2]] - gradient[:, channels[:, 3]]
    return -(drive * np.conj(measure)).real


def back_projection(projection: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Projection (G, N) of changes (N, M) on the normalised sensitivity of each place.

    `projection` (G, M) is the `sensitivity`; NaN readings are skipped.
    """
    is_read = np.isfinite(change)
    norm = np.sqrt(projection**2 @ is_read.T.astype(float))
    return projection @ np.where(is_read, change, 0.0).T / np.where(norm > 0.0, norm, 1.0)


def hotspots(recording: Recording, rows: np.ndarray) -> np.ndarray:
    """Hotspots (K,) complex in the unit disc of the touches of frames `rows` (K,).

    NaN readings are skipped. Opposite pairs that measure opposite ones read a touch alike at a
    place and across the centre from it: in the skin's frame the one nearer to the label is taken.
    Raises InputError where the electrodes' angles are unknown.
    """
    angles = recording.skin.electrode_deg
    if angles is None:
        expected = "the electrodes' angles, to place touches"
        raise InputError("recording", "skin.electrode_deg", "null", expected)
    change = baseline.steady_changes(recording, "recording")[rows]
    channels = recording.channels
    if recording.metadata["voltage"] == "magnitude":
        change = change * np.sign(homogeneous_readings(channels, np.array(angles)))
    turns = np.exp(2j * np.pi * np.arange(GRID_ANGLES) / GRID_ANGLES)
    places = (GRID_RADII[:, None] * turns[None, :]).ravel()
    projection = sensitivity(channels, np.array(angles), places)
    hotspot = places[np.argmax(np.abs(back_projection(projection, change)), axis=0)]
    across = sensitivity(channels, np.array(angles), -places)
    if recording.metadata["position_frame"] == "skin" and np.allclose(across, projection):
        stated = recording.frames[["x_mm", "y_mm"]].to_numpy(float)[rows] @ np.array([1.0, 1.0j])
        hotspot = np.where((hotspot * np.conj(stated)).real < 0.0, -hotspot, hotspot)
    return hotspot


def strongest_touches(recording: Recording) -> np.ndarray:
    """Rows of at most MAX_TOUCHES touched frames that have readings, the strongest first.

    By force, from STRONG_N on, where it is known, else by the norm of the readings' change.
    """
    change = baseline.steady_changes(recording, "recording")
    is_read = np.isfinite(change).any(axis=1)
    touched = np.flatnonzero(recording.frames["touch"].to_numpy(bool) & is_read)
    force = recording.frames["force_N"].to_numpy()[touched]
    if np.isfinite(force).any():
        touched, strength = touched[force >= STRONG_N], force[force >= STRONG_N]
    else:
        strength = np.sqrt(np.nansum(change[touched] ** 2, axis=1))
    return touched[np.argsort(-strength, kind="stable")][:MAX_TOUCHES]


def fit(recording: Recording) -> Similarity:
    """The similarity from robot to skin, with or without a mirror, of the smaller residual.

    For a recording in the skin's frame it should be the identity, which tests the electrodes'
    numbering. Raises InputError for a query and for too few strong touches.
    """
    rows = strongest_touches(recording)
    if len(rows) < MIN_TOUCHES:
        expected = f"{MIN_TOUCHES} of {STRONG_N} N or more"
        raise InputError("recording", "touches", f"{len(rows)} strong ones", expected)
    robot = recording.frames[["x_mm", "y_mm"]].to_numpy()[rows] @ np.array([1.0, 1.0j])
    skin = hotspots(recording, rows) * (recording.skin.radius_mm or 1.0)
    direct_fit, mirrored_fit = _fit_turn(robot, skin), _fit_turn(np.conj(robot), skin)
    is_mirrored = mirrored_fit[2] < direct_fit[2]
    (turn, shift, residual), rival = (
        (mirrored_fit, direct_fit) if is_mirrored else (direct_fit, mirrored_fit)
    )
    return Similarity(
        scale=float(abs(turn)),
        rotation_deg=float(np.rad2deg(np.angle(turn))),
        is_mirrored=bool(is_mirrored),
        shift=(float(shift.real), float(shift.imag)),
        residual=residual,
        rival_residual=rival[2],
        touches=len(rows),
    )


def _fit_turn(robot: np.ndarray, skin: np.ndarray) -> tuple[complex, complex, float]:
    """turn, shift and median distance of skin = turn robot + shift, by least absolute distances."""
    weight = np.ones(len(robot))
    for _ in range(ROBUST_ROUNDS):
        centre_robot = np.average(robot, weights=weight)
        centre_skin = np.average(skin, weights=weight)
        arms = robot - centre_robot
        spread = np.sum(weight * np.abs(arms) ** 2)
        if spread == 0.0:
            raise InputError("recording", "touches", "all at one place", "several places")
        turn = np.sum(weight * np.conj(arms) * (skin - centre_skin)) / spread
        shift = centre_skin - turn * centre_robot
        distance = np.abs(skin - turn * robot - shift)
        weight = 1.0 / np.maximum(distance, 1e-3 * np.abs(skin).max())
    return turn, shift, float(np.median(distance))
