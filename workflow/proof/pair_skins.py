"""Two sessions of one skin without a fault between them: control and later recording.

Real ones are two stretches of one recording; the first half of each set is for development, the
second for the reports. Of the IIRC's tank they are frames with the rod carried round, dealt to the
two sessions by twos; of the LCT's its three empty repeats, which are for the reports alone.
Simulated ones, for sites without any real recording, are of a skin whose contacts and conductivity
walk, within a session and between the two, seen by a rig with gains of its own.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from eitskin.data import importers
from eitskin.data.importers import iirc_tank
from eitskin.data.importers.description import describe
from eitskin.data.importers.matlab_file import named_arrays
from eitskin.data.recording import Recording, frames_table
from eitskin.physics.forward import Forward, channel_values
from eitskin.physics.geometry import Geometry, even_angles
from eitskin.physics.protocol import channel_table
from proof.real_sets import present

DEVELOPMENT, REPORT, SECOND, THIRD = "development", "report", "second-report", "third-report"
SIMULATED = "simulated"
STRETCHES = ("hydrogel-skin-16", "hydrogel-skin-8")
REPEATS, ROD = "lct-tank", "iirc-tank"
FRAMES = (20, 60)  # untouched, of a session
PATTERNS = ("adjacent", "adjacent"), ("opposite", "adjacent"), ("skip-2", "skip-2")
ELECTRODES = (8, 16, 16, 16, 32)
NOISE = (1e-4, 1e-3)  # of the median reading
WALKED = (0.5, 10.0)  # by how much of the noise a skin walks within a session
GAIN_WALK = 0.3  # of the noise, of each channel by itself within a session
FRAME_S = 0.3


@dataclass(frozen=True)
class Sessions:
    """Two recordings without a fault between them; crossed: a pair of electrodes whose exchange in
    the later one can be simulated, and the later recording with it; None where none can."""

    control: Recording
    later: Recording
    crossed: tuple[tuple[int, int], Recording] | None = None


def sources(block: str) -> dict[str, Callable[[np.random.Generator], Sessions]]:
    """Where pairs of sessions come from, by name; real sets that are absent are left out."""
    draws: dict[str, Callable[[np.random.Generator], Sessions]] = {SIMULATED: simulated}
    names = {*STRETCHES, ROD} if block == DEVELOPMENT else {*STRETCHES, ROD, REPEATS}
    for name, path in present(names).items():
        if name == ROD:
            draws[name] = partial(_dealt, _rod(path), block)
        elif name == REPEATS:
            draws[name] = partial(_repeats, importers.load(path))
        else:
            draws[name] = partial(_stretches, _still(importers.load(path)), block)
    return draws


def rows_of(recorded: Recording, rows: np.ndarray) -> Recording:
    """Some frames of a recording nobody touches, numbered anew."""
    time = recorded.frames["time_s"].to_numpy(float)[rows]
    frames = frames_table(time - time[0], np.zeros(len(rows), bool))
    return Recording(frames, recorded.readings[rows], None, None, recorded.metadata)


def _still(recorded: Recording) -> Recording:
    return rows_of(recorded, np.flatnonzero(~recorded.frames["touch"].to_numpy(bool)))


def _half(recorded: Recording, block: str) -> np.ndarray:
    """Frames of a recording that belong to a block."""
    count = len(recorded.frames)
    return np.arange(count // 2) if block == DEVELOPMENT else np.arange(count // 2, count)


def _stretches(recorded: Recording, block: str, rng: np.random.Generator) -> Sessions:
    """Two stretches of one half of a recording, in order."""
    rows = _half(recorded, block)
    control_count, later_count = rng.integers(FRAMES[0], FRAMES[1] + 1, 2)
    room = len(rows) - control_count - later_count
    pause = int(rng.integers(0, min(room, FRAMES[1]) + 1))
    start = int(rng.integers(0, room - pause + 1))
    control = rows[start : start + control_count]
    later = rows[start + control_count + pause :][:later_count]
    return Sessions(rows_of(recorded, control), rows_of(recorded, later))


def _dealt(recorded: Recording, block: str, rng: np.random.Generator) -> Sessions:
    """Neighbouring frames of one half of a recording, one to each session."""
    rows = _half(recorded, block)
    twos = rng.permuted(rows[: len(rows) // 2 * 2].reshape(-1, 2), axis=1)
    control, later = (rows_of(recorded, r) for r in twos.T)
    return Sessions(control, later)


def _repeats(recorded: Recording, rng: np.random.Generator) -> Sessions:
    """Two of three repeats, and the third."""
    later_row, *control_rows = rng.permutation(len(recorded.frames))
    control, later = (rows_of(recorded, np.sort(r)) for r in (control_rows, [later_row]))
    return Sessions(control, later)


def _rod(path: Path) -> Recording:
    """The IIRC's frames with a rod at unknown places, as if nobody touched."""
    reading = iirc_tank.readings(named_arrays(path, iirc_tank.ARRAYS)[1]).real
    channels = channel_table(iirc_tank.N_ELECTRODES)
    angles = even_angles(iirc_tank.N_ELECTRODES)
    metadata = describe(channels, angles, f"{path.name}, rod", "signed")
    frames = frames_table(np.arange(len(reading)), np.zeros(len(reading), bool))
    return Recording(frames, reading, None, None, metadata)


def simulated(rng: np.random.Generator) -> Sessions:
    """A skin of 8, 16 or 32 electrodes, read in one of three patterns, signed or not."""
    n = int(rng.choice(ELECTRODES))
    channels = channel_table(n, *PATTERNS[int(rng.integers(len(PATTERNS)))])
    magnitude = bool(rng.uniform() < 0.3)
    angles = even_angles(n) + rng.normal(0.0, 24.0 / n, n)
    width = 80.0 / n
    contact = 2e-3 * np.exp(rng.normal(0.0, 0.3, n))
    forward = Forward(Geometry(85.0, 3.0, 0.5, angles, np.full(n, width), contact))
    slopes = forward.derivatives(
        parameters=[f"contact_impedivity_ohm_m2[{e}]" for e in range(n)] + ["conductivity_S_per_m"]
    )
    impedances = [forward.transfer_impedance()]
    steps = [*contact, 0.5]
    impedances += [slope * step for slope, step in zip(slopes.values(), steps, strict=True)]
    counts = rng.integers(FRAMES[0], FRAMES[1] + 1, 2)
    pause = int(rng.exponential(counts.mean()))
    gain = np.exp(rng.normal(0.0, 0.01, len(channels)))
    a, b = (int(e) for e in rng.choice(n, 2, replace=False))
    wires = np.arange(n)
    wires[[a, b]] = b, a
    plain, crossed = (
        np.array([channel_values(z, table) for z in impedances]) * gain
        for table in (channels, wires[channels])
    )
    noise = rng.uniform(*np.log(NOISE))
    noise = np.exp(noise) * 0.5 * (np.median(np.abs(plain[0])) + np.abs(plain[0]))
    walk = _walk(rng, counts.sum() + pause, plain, noise)
    channel_walk = np.cumsum(rng.normal(size=(len(walk), len(channels))), axis=0)
    channel_walk *= GAIN_WALK * noise / np.sqrt(counts.mean())
    scatter = channel_walk + noise * rng.normal(size=channel_walk.shape)
    plain_voltage = walk @ plain + scatter
    crossed_voltage = walk @ crossed + scatter
    later = slice(counts[0] + pause, None)
    skin = {"radius_mm": 85.0, "electrode_width_mm": width}
    kind = "magnitude" if magnitude else "signed"
    metadata = describe(channels, angles, "simulation", kind, unit="V", clock="measured", skin=skin)
    metadata["frame_s"] = FRAME_S

    def recorded(voltage: np.ndarray) -> Recording:
        frames = frames_table(np.arange(len(voltage)) * 0.5, np.zeros(len(voltage), bool))
        return Recording(frames, np.abs(voltage) if magnitude else voltage, None, None, metadata)

    swapped = (a, b), recorded(crossed_voltage[later])
    return Sessions(recorded(plain_voltage[: counts[0]]), recorded(plain_voltage[later]), swapped)


def _walk(rng: np.random.Generator, count: int, plain: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """(N, k): how much of each impedance (k, M) is there in each frame; the first stays whole, the
    others walk, each by as much within a session of 40 frames as WALKED times the noise."""
    size = np.exp(rng.uniform(*np.log(WALKED)))
    visibility = np.sqrt(((plain[1:] / noise) ** 2).mean(axis=1))
    step = (
        size
        * rng.uniform(0.2, 1.0, len(visibility))
        / (visibility * np.sqrt(40.0 * len(visibility)))
    )
    steps = rng.normal(size=(count, len(visibility))) * step
    return np.column_stack([np.ones(count), np.cumsum(steps, axis=0)])
