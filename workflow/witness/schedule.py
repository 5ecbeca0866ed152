"""Places, times and forces of presses: the frames of a recording and of its query."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from eitskin.data.recording import frames_table
from witness.outlines import Outline

REACH = 0.93  # discs lie within this share of the radius: clear of the electrodes
PROBES_MM = (7.0, 10.0, 15.0)  # diameters of usual probes
OTHER_PROBE_MM = 12.0  # between them, for a query's press with another probe


@dataclass(frozen=True)
class Keep:
    """Discs (x, y, radius), mm, with edges at least `apart_mm` from the edge of every touch.
    crossed: edges may cross but are not that close to tangent; clear: no touch lies within a disc;
    outline: of a skin on which every touch lies, its edge at least `off_rim_mm` from the rim.
    """

    discs: tuple[tuple[float, float, float], ...] = ()
    apart_mm: float = 1.5
    crossed: bool = False
    clear: bool = False
    outline: Outline | None = None
    off_rim_mm: float = 0.0

    def allows(self, x: float, y: float, radius: float) -> bool:
        """Whether a touch is allowed at a place."""
        room_mm = np.inf if self.outline is None else self.outline.depth(complex(x, y))
        if room_mm < radius + self.off_rim_mm:
            return False
        for a, b, disc_radius in self.discs:
            centre_distance = float(np.hypot(x - a, y - b))
            gap = centre_distance - disc_radius - radius
            if not self.clear:
                gap = max(gap, abs(disc_radius - radius) - centre_distance)
            if (abs(gap) if self.crossed else gap) < self.apart_mm:
                return False
        return True


def _place(
    rng: np.random.Generator, radius_mm: float, probe_mm: float, keep: Keep
) -> tuple[float, float]:
    """A random allowed place with the touch's disc on the skin."""
    while True:
        r = np.sqrt(rng.uniform()) * (REACH * radius_mm - 0.5 * probe_mm)
        phi = rng.uniform(0.0, 2.0 * np.pi)
        x, y = r * np.cos(phi), r * np.sin(phi)
        if keep.allows(x, y, 0.5 * probe_mm):
            return float(x), float(y)


def _forces(
    rng: np.random.Generator, peak_N: float, loading: int, hold: int, unloading: int
) -> np.ndarray:
    """The forces of one press: rising to the peak, held, falling."""
    up = np.sort(rng.uniform(0.1, 0.9, loading - 1)) if loading > 1 else np.zeros(0)
    down = np.sort(rng.uniform(0.1, 0.9, unloading))[::-1]
    return np.round(peak_N * np.concatenate([up, np.ones(1 + hold), down]), 4)


class Clock:
    """The times of frames, 0.5 to 3 s apart, at least a frame's duration."""

    def __init__(self, rng: np.random.Generator, frame_s: float, start_s: float = 0.0):
        self.rng, self.frame_s, self.now_s = rng, frame_s, start_s
        self.rhythm = rng.uniform(0.6, 2.5)

    def next(self) -> float:
        """The start of the next frame, s."""
        start_s = self.now_s
        wait = np.clip(self.rhythm * self.rng.uniform(0.8, 1.25), 0.5, 3.0)
        self.now_s = round(start_s + max(float(wait), 1.05 * self.frame_s), 4)
        return start_s


def _table(rows: list[tuple], presses: list[int]) -> pd.DataFrame:
    time, touch, x, y, force, probe = (np.array(column) for column in zip(*rows, strict=True))
    table = frames_table(time, touch.astype(bool), x, y, force, probe)
    contact = pd.array([None if press < 0 else press for press in presses], dtype="Int64")
    return table.assign(contact=contact)


def untouched_frames(count: int, period_s: float) -> pd.DataFrame:
    """Untouched frames, one every `period_s`."""
    frames = frames_table(np.round(period_s * np.arange(count), 4), np.zeros(count, bool))
    return frames.assign(contact=pd.array([None] * count, dtype="Int64"))


def recording_frames(
    rng: np.random.Generator,
    radius_mm: float,
    frame_s: float,
    keep: Keep,
    number: int | None = None,
) -> pd.DataFrame:
    """100 to 150 frames: untouched ones at the start and before each of 10 to 14 presses, which
    load and unload, some held; two or three probes. number: of frames instead, with presses in
    proportion."""
    clock = Clock(rng, frame_s)
    count = int(rng.integers(10, 15))
    probes = list(rng.choice(PROBES_MM, int(rng.integers(2, 4)), replace=False))
    frame_count = int(rng.integers(100, 151))
    if number is not None:
        count, frame_count = round(count * number / 125), number
    initial_frames = int(rng.integers(2, 7))
    press_frames = np.full(count, (frame_count - initial_frames - count) // count)
    press_frames[
        rng.permutation(count)[: frame_count - initial_frames - count - press_frames.sum()]
    ] += 1
    rows = [(clock.next(), False, np.nan, np.nan, 0.0, np.nan) for _ in range(initial_frames)]
    presses = [-1] * initial_frames
    for press in range(count):
        probe = float(probes[press % len(probes)])
        x, y = _place(rng, radius_mm, probe, keep)
        rows.append((clock.next(), False, np.nan, np.nan, 0.0, np.nan))
        presses.append(-1)
        size = int(press_frames[press])
        hold = int(rng.integers(1, max(2, size // 2))) if rng.uniform() < 0.4 and size > 4 else 0
        unloading = int(rng.integers(1, max(2, (size - hold) // 2 + 1)))
        forces = _forces(rng, rng.uniform(2.0, 10.0), size - hold - unloading, hold, unloading)
        for force in forces:
            rows.append((clock.next(), True, x, y, float(force), probe))
            presses.append(press)
    return _table(rows, presses)


def query_frames(
    rng: np.random.Generator,
    recording: pd.DataFrame,
    radius_mm: float,
    frame_s: float,
    keep: Keep,
    number: int | None = None,
) -> pd.DataFrame:
    """24 to 40 frames after the recording's, in complete presses at new places: within its forces,
    in a higher band, with another probe. number: of frames instead, 15 or more, in five presses."""
    largest = float(recording["force_N"].max())
    recorded_probes = sorted(recording["probe_mm"].dropna().unique())
    clock = Clock(rng, frame_s, float(recording["time_s"].iloc[-1]) + 5.0)
    kinds = ["inside", "higher", "other probe", "higher", "inside"]
    if number is None:
        kinds = kinds[: int(rng.integers(4, 6))]
    else:
        press_frames = np.full(len(kinds), number // len(kinds) - 1)
        press_frames[: number % len(kinds)] += 1
    press = int(recording["contact"].max())
    rows, presses = [], []
    for index, kind in enumerate(kinds):
        probe = OTHER_PROBE_MM if kind == "other probe" else float(rng.choice(recorded_probes))
        x, y = _place(rng, radius_mm, probe, keep)
        band = (1.05, 1.3) if kind == "higher" else (0.5, 1.0)
        press += 1
        rows.append((clock.next(), False, np.nan, np.nan, 0.0, np.nan))
        presses.append(-1)
        loading, unloading = int(rng.integers(3, 5)), int(rng.integers(2, 4))
        if number is not None:
            loading = int(rng.integers(1, press_frames[index]))
            unloading = int(press_frames[index]) - loading
        forces = _forces(rng, largest * rng.uniform(*band), loading, 0, unloading)
        for force in forces:
            rows.append((clock.next(), True, x, y, float(force), probe))
            presses.append(press)
    return _table(rows, presses)
