"""The default recording: a simulated twin of the paper's skin and of the way it was pressed.

Complete electrodes with contacts of their own, a gel that dries while it is pressed, three probes,
six sessions, 1 mm steps until the force is reached, untouched frames before every press (§ II-D
and the authors' logger). It is a simulation and says so: `source` is "simulation".
"""

from pathlib import Path

import numpy as np
import pandas as pd

from eitskin.data import recording
from eitskin.effects.settings import settings, site_counts
from eitskin.physics.geometry import Geometry
from eitskin.physics.protocol import channel_table
from eitskin.physics.skin import Skin
from eitskin.simulate.layout import polar_grid
from eitskin.simulate.readings import simulate


def presses(
    grid: pd.DataFrame,
    probes_mm: list[float],
    sessions_per_probe: int,
    step_mm: float,
    settle_s: float,
    travel_s: float,
    untouched_frames: int,
    target_N: list[float],
    stiffness: dict,
    frame_s: float,
    rng: np.random.Generator,
) -> pd.DataFrame:
    """States of all frames, in order: the columns of a recording, with session and contact.

    Every probe visits the places of `grid` in a random order, in equal sessions. A press goes down
    by `step_mm` until a force drawn between the two of `target_N` is reached; the force is
    N_per_mm (probe / 10 mm) depth^exponent, its stiffness scattered by `scatter` from place to
    place.
    """
    low_N, high_N = target_N
    rows: list[dict] = []
    time, contact = 0.0, 0
    for probe in probes_mm:
        order = rng.permutation(len(grid))
        for part, places in enumerate(np.array_split(order, sessions_per_probe), start=1):
            for place in places:
                session = {"session": f"{probe:g} mm, {part}"}
                for _ in range(untouched_frames):
                    rows.append({**session, "time_s": time, "touch": False, "contact": None})
                    time += frame_s + 0.05
                target = rng.uniform(low_N, high_N)
                stiff = stiffness["N_per_mm"] * probe / 10.0
                stiff *= np.exp(stiffness["scatter"] * rng.standard_normal())
                depth = force = 0.0
                while force < target:
                    depth += step_mm
                    force = stiff * depth ** stiffness["exponent"]
                    time += settle_s
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
                    time += frame_s + 0.05
                time += travel_s
                contact += 1
    frames = pd.DataFrame(rows)
    frames.insert(0, "frame", np.arange(len(frames), dtype=np.int64))
    frames["force_N"] = frames["force_N"].where(frames["touch"], 0.0)
    return frames


def write(
    path: str | Path,
    seed: int,
    skin: dict,
    protocol: dict,
    touch_grid: dict,
    press: dict,
    effects: list[dict],
    noise: float,
    accuracy: str,
) -> None:
    """Write the twin, a recording; the blocks are those of `twin` in the configuration.

    `noise`: standard deviation of a reading over the median |v| of its frame.
    """
    believed = Skin.from_metadata(skin, "config.yaml: twin")
    geometry = Geometry.from_skin(believed)
    channels = channel_table(len(geometry.electrode_deg), **protocol)
    rng = np.random.default_rng([seed, 3])
    grid = polar_grid(geometry.radius_mm, probe_mm=0.0, **touch_grid)
    frames = presses(grid, rng=rng, **press)
    effect_settings = settings(effects, site_counts(channels), (seed, 0))
    metadata = recording.metadata_of(
        channels, believed.metadata(), "simulation", "magnitude", frame_s=press["frame_s"]
    )
    twin = recording.Recording(frames, None, None, None, metadata)
    clean = simulate(
        frames,
        recording.presses(twin),
        believed,
        channels,
        effect_settings,
        accuracy,
        frame_s=press["frame_s"],
        progress=True,
    )
    scale = noise * np.median(np.abs(clean), axis=1, keepdims=True)
    twin.voltage = np.abs(clean + scale * rng.standard_normal(clean.shape))
    recording.write(twin, path)
