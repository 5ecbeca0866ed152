"""What a misfit may vary with: laws of time, press, force and place, one number a frame each."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from eitskin.data.recording import Recording, presses

LEAST_LEVELS = 3  # of a law; two would be a difference between two frames
ROUNDING = 1e-6  # of a law's size: what remains below it is what least squares round


@dataclass(frozen=True)
class Law:
    """`values` (N,) over the frames, tested for what `nuisances` (N, Q) do not explain of them.

    `statistic` and `site` name it; `phrase` says what a misfit does that follows it. `touch`: only
    touched frames have it; `local`: every electrode is tested for it too.
    """

    statistic: str
    site: str
    phrase: str
    values: np.ndarray
    nuisances: np.ndarray
    touch: bool = True
    local: bool = False

    def cleared(self, weight: np.ndarray) -> np.ndarray:
        """(N,) the values less what `nuisances` explain, by least squares with weights (N,)."""
        root = np.sqrt(weight)
        design = self.nuisances * root[:, None]
        coefficients = np.linalg.lstsq(design, self.values * root, rcond=None)[0]
        residual = np.where(weight > 0.0, self.values - self.nuisances @ coefficients, 0.0)
        size = np.sqrt(weight @ self.values**2)
        is_explained = np.sqrt(weight @ residual**2) <= ROUNDING * size
        return np.zeros_like(residual) if is_explained else residual


def laws(recording: Recording) -> Iterator[Law]:
    """Every law that the recording's frames have; none of constant or missing information."""
    touch = recording.frames["touch"].to_numpy(bool)
    constant = np.ones((len(touch), 1))
    yield from _time_laws(recording, np.column_stack([constant, touch]))
    if not touch.any():
        return
    if not touch.all():
        phrase = "differs between touched and untouched frames"
        yield Law("touched", "", phrase, touch.astype(float), constant, local=True)
    yield from _press_laws(recording, touch)
    yield from _force_laws(recording, touch)
    yield from _place_laws(recording, touch)


def load_direction(recording: Recording) -> np.ndarray:
    """(N,) 1 where the force of a press rises, -1 where it falls, 0 where nobody can tell.

    By the step from the previous frame; in the first frame of a press by the step to the next.
    """
    force, press = recording.frames["force_N"].to_numpy(float), presses(recording)
    direction = np.zeros(len(press))
    for label in np.unique(press[press >= 0]):
        rows = np.flatnonzero(press == label)
        if len(rows) > 1:
            step = np.diff(force[rows])
            direction[rows] = np.nan_to_num(np.sign(np.append(step[0], step)))
    return direction


def nearness(recording: Recording) -> np.ndarray | None:
    """(N, n) of each frame's touch to each electrode, 1 / (1 + (distance / pitch)²), 0 where
    untouched; None where nobody knows where the electrodes are."""
    skin = recording.skin
    if skin.radius_mm is None or skin.electrode_deg is None:
        return None
    if recording.metadata["position_frame"] != "skin":
        return None
    angle = np.radians(skin.electrode_deg)
    x, y = (recording.frames[key].to_numpy(float)[:, None] for key in ("x_mm", "y_mm"))
    distance = np.hypot(x - skin.radius_mm * np.cos(angle), y - skin.radius_mm * np.sin(angle))
    pitch = 2.0 * np.pi * skin.radius_mm / len(angle)
    return np.nan_to_num(1.0 / (1.0 + (distance / pitch) ** 2))


def _time_laws(recording: Recording, nuisances: np.ndarray) -> Iterator[Law]:
    frames = recording.frames
    if recording.metadata["clock"] == "measured":
        statistic, phrase = "time", "drifts with time"
        time = frames["time_s"].to_numpy(float)
    else:
        statistic, phrase = "order", "drifts from frame to frame"
        time = np.arange(len(frames), dtype=float)
    if len(frames) >= LEAST_LEVELS:
        yield Law(statistic, "", phrase, _unit(time), nuisances, touch=False, local=True)
    if "session" in frames and frames["session"].nunique(dropna=False) > 1:
        for name, rows in frames.groupby("session", dropna=False, sort=False).indices.items():
            indicator = _indicator(rows, len(frames))
            phrase = f"differs in session {name} from the others"
            yield Law("session", str(name), phrase, indicator, nuisances, touch=False)


def _press_laws(recording: Recording, touch: np.ndarray) -> Iterator[Law]:
    frames, press = recording.frames, presses(recording)
    touched = touch[:, None].astype(float)
    labels = np.unique(press[press >= 0])
    if len(labels) > 1:
        for label in labels:
            rows = np.flatnonzero(press == label)
            x, y = frames["x_mm"].iloc[rows[0]], frames["y_mm"].iloc[rows[0]]
            phrase = f"differs in press {label}, at ({x:.4g}, {y:.4g}) mm, from the others"
            yield Law("press", str(label), phrase, _indicator(rows, len(frames)), touched)
    probe = frames["probe_mm"].to_numpy(float)
    sizes = np.unique(probe[np.isfinite(probe)])
    if len(sizes) > 1:
        for size in sizes:
            phrase = f"differs under the probe of {size:g} mm from the others"
            yield Law("probe", f"{size:g} mm", phrase, (probe == size).astype(float), touched)
    if recording.metadata["clock"] == "measured":
        time, dwell = frames["time_s"].to_numpy(float), np.zeros(len(frames))
        for label in labels:
            rows = press == label
            dwell[rows] = time[rows] - time[rows].min()
        if len(np.unique(dwell[touch])) >= LEAST_LEVELS:
            nuisances = np.column_stack([touch, _known_force(recording)])
            phrase = "changes as a press goes on"
            yield Law("dwell", "", phrase, _unit(dwell), nuisances, local=True)


def _force_laws(recording: Recording, touch: np.ndarray) -> Iterator[Law]:
    force = _known_force(recording)
    if len(np.unique(force[touch])) < LEAST_LEVELS:
        return
    phrase, touched = "changes with the force", touch[:, None].astype(float)
    yield Law("force", "", phrase, force, touched, local=True)
    direction = load_direction(recording)
    if (direction > 0).any() and (direction < 0).any():
        nuisances = np.column_stack([touch, force])
        phrase = "differs between loading and unloading"
        yield Law("load direction", "", phrase, direction, nuisances, local=True)


def _place_laws(recording: Recording, touch: np.ndarray) -> Iterator[Law]:
    x, y = (recording.frames[key].fillna(0.0).to_numpy(float) for key in ("x_mm", "y_mm"))
    touched = touch[:, None].astype(float)
    for site, coordinate in {"x": x, "y": y, "r²": x**2 + y**2}.items():
        if len(np.unique(coordinate[touch])) >= LEAST_LEVELS:
            phrase = f"changes with the touch's {site}"
            yield Law("position", site, phrase, _unit(coordinate), touched)


def _known_force(recording: Recording) -> np.ndarray:
    """(N,) in units of the largest; 0 where nobody measured it."""
    return _unit(recording.frames["force_N"].fillna(0.0).to_numpy(float))


def _unit(values: np.ndarray) -> np.ndarray:
    return values / max(np.abs(values).max(), 1e-300)


def _indicator(rows: np.ndarray, count: int) -> np.ndarray:
    indicator = np.zeros(count)
    indicator[rows] = 1.0
    return indicator
