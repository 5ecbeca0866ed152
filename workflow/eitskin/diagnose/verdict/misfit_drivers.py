"""What a misfit may vary with: laws of time, press, force and place, one number a frame each."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from eitskin.data.recording import Recording, presses

LEAST_LEVELS = 3  # values that a law needs, to be more than a difference between two frames


@dataclass(frozen=True)
class Law:
    """`course` (N,) over the frames, asked for what of it `beyond` (N, Q) does not show already.

    `statistic` and `site` name it; `phrase` says what a misfit does that follows it. `touch`: only
    touched frames have it; `local`: each electrode is asked for it too.
    """

    statistic: str
    site: str
    phrase: str
    course: np.ndarray
    beyond: np.ndarray
    touch: bool = True
    local: bool = False

    def cleared(self, weight: np.ndarray) -> np.ndarray:
        """(N,) the course less `beyond`, by least squares with weights (N,)."""
        root = np.sqrt(weight)
        fit = np.linalg.lstsq(self.beyond * root[:, None], self.course * root, rcond=None)[0]
        rest = np.where(weight > 0.0, self.course - self.beyond @ fit, 0.0)
        size = np.sqrt(weight @ self.course**2)
        return rest if np.sqrt(weight @ rest**2) > 1e-6 * size else np.zeros_like(rest)


def laws(recording: Recording) -> Iterator[Law]:
    """Every law that the recording's frames have; none of constant or missing information."""
    touch = recording.frames["touch"].to_numpy(bool)
    every = np.ones((len(touch), 1))
    yield from _of_time(recording, np.column_stack([every, touch]))
    if not touch.any():
        return
    if not touch.all():
        phrase = "differs between touched and untouched frames"
        yield Law("touched", "", phrase, touch.astype(float), every, local=True)
    yield from _of_press(recording, touch)
    yield from _of_force(recording, touch)
    yield from _of_place(recording, touch)


def load_direction(recording: Recording) -> np.ndarray:
    """(N,) 1 where the force of a press rises, -1 where it falls, 0 where nobody can tell.

    By the step from the frame before; in the first of a press by the step to the next.
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


def _of_time(recording: Recording, beyond: np.ndarray) -> Iterator[Law]:
    frames = recording.frames
    if recording.metadata["clock"] == "measured":
        statistic, phrase, when = "time", "drifts with time", frames["time_s"].to_numpy(float)
    else:
        statistic, phrase = "order", "drifts from frame to frame"
        when = np.arange(len(frames), dtype=float)
    if len(frames) >= LEAST_LEVELS:
        yield Law(statistic, "", phrase, _unit(when), beyond, touch=False, local=True)
    if "session" in frames and frames["session"].nunique(dropna=False) > 1:
        for name, rows in frames.groupby("session", dropna=False, sort=False).indices.items():
            course = _marked(rows, len(frames))
            phrase = f"is other in session {name} than in the others"
            yield Law("session", str(name), phrase, course, beyond, touch=False)


def _of_press(recording: Recording, touch: np.ndarray) -> Iterator[Law]:
    frames, press = recording.frames, presses(recording)
    touched = touch[:, None].astype(float)
    labels = np.unique(press[press >= 0])
    if len(labels) > 1:
        for label in labels:
            rows = np.flatnonzero(press == label)
            x, y = frames["x_mm"].iloc[rows[0]], frames["y_mm"].iloc[rows[0]]
            phrase = f"is other in press {label}, at ({x:.4g}, {y:.4g}) mm, than in the others"
            yield Law("press", str(label), phrase, _marked(rows, len(frames)), touched)
    probe = frames["probe_mm"].to_numpy(float)
    sizes = np.unique(probe[np.isfinite(probe)])
    if len(sizes) > 1:
        for size in sizes:
            phrase = f"is other under the probe of {size:g} mm than under the others"
            yield Law("probe", f"{size:g} mm", phrase, (probe == size).astype(float), touched)
    if recording.metadata["clock"] == "measured":
        time, dwell = frames["time_s"].to_numpy(float), np.zeros(len(frames))
        for label in labels:
            rows = press == label
            dwell[rows] = time[rows] - time[rows].min()
        if len(np.unique(dwell[touch])) >= LEAST_LEVELS:
            beyond = np.column_stack([touch, _known_force(recording)])
            phrase = "changes as a press goes on"
            yield Law("dwell", "", phrase, _unit(dwell), beyond, local=True)


def _of_force(recording: Recording, touch: np.ndarray) -> Iterator[Law]:
    force = _known_force(recording)
    if len(np.unique(force[touch])) < LEAST_LEVELS:
        return
    phrase, touched = "changes with the force", touch[:, None].astype(float)
    yield Law("force", "", phrase, force, touched, local=True)
    direction = load_direction(recording)
    if (direction > 0).any() and (direction < 0).any():
        beyond = np.column_stack([touch, force])
        phrase = "differs between loading and unloading"
        yield Law("load direction", "", phrase, direction, beyond, local=True)


def _of_place(recording: Recording, touch: np.ndarray) -> Iterator[Law]:
    x, y = (recording.frames[key].fillna(0.0).to_numpy(float) for key in ("x_mm", "y_mm"))
    touched = touch[:, None].astype(float)
    for site, course in {"x": x, "y": y, "r²": x**2 + y**2}.items():
        if len(np.unique(course[touch])) >= LEAST_LEVELS:
            phrase = f"changes with the touch's {site}"
            yield Law("position", site, phrase, _unit(course), touched)


def _known_force(recording: Recording) -> np.ndarray:
    """(N,) in units of the largest; 0 where nobody measured it."""
    return _unit(recording.frames["force_N"].fillna(0.0).to_numpy(float))


def _unit(course: np.ndarray) -> np.ndarray:
    return course / max(np.abs(course).max(), 1e-300)


def _marked(rows: np.ndarray, count: int) -> np.ndarray:
    course = np.zeros(count)
    course[rows] = 1.0
    return course
