"""The default recording: a simulated twin of the paper's skin and of the way it was pressed.

Complete electrodes with contacts of their own, a gel that dries while it is pressed, three probes,
six sessions, 1 mm steps until the force is reached, untouched frames before every press (§ II-D
and the authors' logger). It is a simulation and says so: `source` is "simulation".
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from eitskin.data import recording
from eitskin.effects.settings import settings, site_counts
from eitskin.physics.geometry import Geometry
from eitskin.physics.protocol import channel_table
from eitskin.physics.skin import Skin
from eitskin.simulate.layout import touch_grid
from eitskin.simulate.readings import simulate

PAUSE_S = 0.05  # assumed pause of the board between two frames


@dataclass(frozen=True)
class PressPlan:
    """How the twin is pressed, by the names of the configuration's block `press`.

    Every probe presses all places in `sessions_per_probe` sessions, with `untouched_frames` before
    each press. A press goes down by `step_mm`, settles for `settle_s`, and ends at a force drawn
    between the two of `target_N`; stiffness: N_per_mm, exponent and scatter of the force
    N_per_mm (probe / 10 mm) depth^exponent, log-normal from press to press.
    """

    probes_mm: list[float]
    sessions_per_probe: int
    step_mm: float
    settle_s: float
    travel_s: float
    untouched_frames: int
    target_N: list[float]
    stiffness: dict
    frame_s: float


def presses(grid: pd.DataFrame, plan: PressPlan, rng: np.random.Generator) -> pd.DataFrame:
    """States of all frames, in order: the columns of a recording, with session and contact.

    Every probe visits the places of `grid` in a random order.
    """
    low_N, high_N = plan.target_N
    stiffness = plan.stiffness
    frame_interval_s = plan.frame_s + PAUSE_S
    rows: list[dict] = []
    time, contact = 0.0, 0
    for probe in plan.probes_mm:
        order = rng.permutation(len(grid))
        for part, places in enumerate(np.array_split(order, plan.sessions_per_probe), start=1):
            for place in places:
                session = {"session": f"{probe:g} mm, {part}"}
                for _ in range(plan.untouched_frames):
                    rows.append({**session, "time_s": time, "touch": False, "contact": None})
                    time += frame_interval_s
                target = rng.uniform(low_N, high_N)
                stiff = stiffness["N_per_mm"] * probe / 10.0
                stiff *= np.exp(stiffness["scatter"] * rng.standard_normal())
                depth = force = 0.0
                while force < target:
                    depth += plan.step_mm
                    force = stiff * depth ** stiffness["exponent"]
                    time += plan.settle_s
                    rows.append(
                        {
                            **session,
                            "time_s": time,
                            "touch": True,
                            "contact": contact,
                            "x_mm": grid["x_mm"][place],
                            "y_mm": grid["y_mm"][place],
                            "force_N": force,
                            "probe_mm": probe,
                            "depth_mm": depth,
                        }
                    )
                    time += frame_interval_s
                time += plan.travel_s
                contact += 1
    frames = pd.DataFrame(rows)
    frames.insert(0, "frame", np.arange(len(frames), dtype=np.int64))
    frames["force_N"] = frames["force_N"].where(frames["touch"], 0.0)
    return frames


@dataclass(frozen=True)
class Twin:
    """The blocks of `twin` in the configuration; noise: standard deviation of a reading over the
    median |v| of its frame."""

    seed: int
    skin: dict
    protocol: dict
    touch_grid: dict
    press: dict
    effects: list[dict]
    noise: float
    accuracy: str


def write(path: str | Path, twin: Twin) -> None:
    """Write the twin, a recording."""
    believed = Skin.from_metadata(twin.skin, "config.yaml: twin")
    geometry = Geometry.from_skin(believed)
    channels = channel_table(len(geometry.electrode_deg), **twin.protocol)
    plan = PressPlan(**twin.press)
    rng = np.random.default_rng([twin.seed, 3])
    grid = touch_grid(believed, probe_mm=0.0, **twin.touch_grid)
    frames = presses(grid, plan, rng)
    effect_settings = settings(twin.effects, site_counts(channels), (twin.seed, 0))
    metadata = recording.metadata_of(
        channels, believed.metadata(), "simulation", "magnitude", frame_s=plan.frame_s
    )
    recorded = recording.Recording(frames, None, None, None, metadata)
    clean = simulate(
        frames,
        recording.presses(recorded),
        believed,
        channels,
        effect_settings,
        twin.accuracy,
        frame_s=plan.frame_s,
        progress=True,
    )
    scale = twin.noise * np.median(np.abs(clean), axis=1, keepdims=True)
    recorded.voltage = np.abs(clean + scale * rng.standard_normal(clean.shape))
    recording.write(recorded, path)
