"""From the robot's coordinates to the skin's: a similarity fitted on where touches light up.

A touch's hotspot is the place whose small touch would change the readings most alike:
back-projection of the change through the first-order sensitivity of a homogeneous disc with point
electrodes, each place normalised by its own norm (by Cauchy-Schwarz the true place of a small touch
wins). The unit disc is the complex plane.
"""

from dataclasses import dataclass

import numpy as np

from eitskin.data import baseline
from eitskin.data.recording import Recording
from eitskin.errors import InputError
from eitskin.physics import neumann

STRONG_N = 0.8
MOST_TOUCHES = 200
LEAST_TOUCHES = 3
GRID_RADII = np.linspace(0.04, 0.96, 24)
GRID_ANGLES = 96
ROBUST_ROUNDS = 50


@dataclass(frozen=True)
class Similarity:
    """skin = scale * R(rotation) * (mirror) * robot + shift; mirror: y -> -y of the robot, first.

    Skin coordinates in mm, or in skin radii where the radius is unknown (scale then is 1 /
    radius_mm). `residual` is the median distance from a hotspot to its touch's place, in the same
    unit, and `rival_residual` that of the best fit of the other handedness; `touches` were fitted.
    """

    scale: float
    rotation_deg: float
    mirrored: bool
    shift: tuple[float, float]
    residual: float
    rival_residual: float
    touches: int

    def __call__(self, x_mm: np.ndarray, y_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Skin coordinates of places in the robot's."""
        robot = np.asarray(x_mm) + 1j * np.asarray(y_mm)
        turn = self.scale * np.exp(1j * np.deg2rad(self.rotation_deg))
        skin = turn * (np.conj(robot) if self.mirrored else robot) + complex(*self.shift)
        return skin.real, skin.imag


def homogeneous_readings(channels: np.ndarray, electrode_deg: np.ndarray) -> np.ndarray:
    """(M,) V sheet-conductance / current: readings of the untouched disc, point electrodes.

    NaN where a measured electrode is driven (a point's own potential is infinite).
    """
    angle = np.deg2rad(np.asarray(electrode_deg))
    source, sink, plus, minus = channels.T
    with np.errstate(divide="ignore", invalid="ignore"):
        rim = neumann.rim_potential(angle[:, None] - angle[None, :])
        reading = rim[plus, source] - rim[plus, sink] - rim[minus, source] + rim[minus, sink]
    return np.where(np.isfinite(reading), reading, np.nan)


def sensitivity(channels: np.ndarray, electrode_deg: np.ndarray, places: np.ndarray) -> np.ndarray:
    """(G, M): change of each reading per unit of added conductance at `places` (G,) in the disc.

    -grad u_drive . grad u_measure (Geselowitz 1971), u of a unit current at a rim point e being
    -ln|x - e| / pi.
    """
    electrode = np.exp(1j * np.deg2rad(np.asarray(electrode_deg)))
    gradient = -1.0 / (np.pi * np.conj(places[:, None] - electrode[None, :]))
    drive = gradient[:, channels[:, 0]] - gradient[:, channels[:, 1]]
    measure = gradient[:, channels[:, 2]] - gradient[:, channels[:, 3]]
    return -(drive * np.conj(measure)).real


def back_projection(projection: np.ndarray, change: np.ndarray) -> np.ndarray:
    """(G, N): how alike changes (N, M) are to what a small touch at each place changes, in their
    unit; projection (G, M) as `sensitivity`. Lost readings, NaN, are left out.
    """
    usable = np.isfinite(change)
    norm = np.sqrt(projection**2 @ usable.T.astype(float))
    return projection @ np.where(usable, change, 0.0).T / norm


def hotspots(recording: Recording, rows: np.ndarray) -> np.ndarray:
    """(K,) complex in the unit disc: where the touches of frames `rows` light up.

    Lost readings are left out. Raises InputError where the electrodes' angles are unknown.
    """
    angles = recording.skin.electrode_deg
    if angles is None:
        expected = "the electrodes' angles, to place touches"
        raise InputError("recording", "skin.electrode_deg", "null", expected)
    change = baseline.changes(recording, "recording")[rows]
    channels = recording.channels
    if recording.metadata["voltage"] == "magnitude":
        change = change * np.sign(homogeneous_readings(channels, np.array(angles)))
    turns = np.exp(2j * np.pi * np.arange(GRID_ANGLES) / GRID_ANGLES)
    places = (GRID_RADII[:, None] * turns[None, :]).ravel()
    projection = sensitivity(channels, np.array(angles), places)
    return places[np.argmax(np.abs(back_projection(projection, change)), axis=0)]


def strongest_touches(recording: Recording) -> np.ndarray:
    """Rows of at most 200 touched frames, the strongest first: by force from 0.8 N on where it is
    known, else by how much they change the readings.
    """
    touched = np.flatnonzero(recording.frames["touch"])
    force = recording.frames["force_N"].to_numpy()[touched]
    if np.isfinite(force).any():
        touched, strength = touched[force >= STRONG_N], force[force >= STRONG_N]
    else:
        change = baseline.changes(recording, "recording")[touched]
        strength = np.sqrt(np.nansum(change**2, axis=1))
    return touched[np.argsort(-strength, kind="stable")][:MOST_TOUCHES]


def fit(recording: Recording) -> Similarity:
    """The similarity robot -> skin, with or without a mirror, whichever leaves less.

    For a recording that is in the skin's frame already it should come out as no change at all: a
    test of the electrodes' numbering. Raises InputError for a query or one with too few strong
    touches.
    """
    rows = strongest_touches(recording)
    if len(rows) < LEAST_TOUCHES:
        expected = f"{LEAST_TOUCHES} of {STRONG_N} N or more"
        raise InputError("recording", "touches", f"{len(rows)} strong ones", expected)
    robot = recording.frames[["x_mm", "y_mm"]].to_numpy()[rows] @ np.array([1.0, 1.0j])
    skin = hotspots(recording, rows) * (recording.skin.radius_mm or 1.0)
    straight, mirrored = _fit_turn(robot, skin), _fit_turn(np.conj(robot), skin)
    flip = mirrored[2] < straight[2]
    (turn, shift, residual), rival = (mirrored, straight) if flip else (straight, mirrored)
    return Similarity(
        scale=float(abs(turn)),
        rotation_deg=float(np.rad2deg(np.angle(turn))),
        mirrored=bool(flip),
        shift=(float(shift.real), float(shift.imag)),
        residual=residual,
        rival_residual=rival[2],
        touches=len(rows),
    )


def _fit_turn(robot: np.ndarray, skin: np.ndarray) -> tuple[complex, complex, float]:
    """turn, shift, median distance of skin = turn * robot + shift, by least absolute distances."""
    weight = np.ones(len(robot))
    for _ in range(ROBUST_ROUNDS):
        centre_robot = np.average(robot, weights=weight)
        centre_skin = np.average(skin, weights=weight)
        arm = robot - centre_robot
        spread = np.sum(weight * np.abs(arm) ** 2)
        if spread == 0.0:
            raise InputError("recording", "touches", "all at one place", "several places")
        turn = np.sum(weight * np.conj(arm) * (skin - centre_skin)) / spread
        shift = centre_skin - turn * centre_robot
        distance = np.abs(skin - turn * robot - shift)
        weight = 1.0 / np.maximum(distance, 1e-3 * np.abs(skin).max())
    return turn, shift, float(np.median(distance))
