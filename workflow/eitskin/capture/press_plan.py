"""The plan of presses: every place with every probe, in the robot's order."""

import hashlib
import json
from dataclasses import dataclass

import numpy as np
import pandas as pd

from eitskin.data import board
from eitskin.simulate.layout import polar_grid


@dataclass(frozen=True)
class Contact:
    """One press: number, probe, session, place from the skin's centre along the robot's base axes,
    and target force."""

    number: int
    probe_mm: float
    session: str
    x_mm: float
    y_mm: float
    target_N: float


def places(plan: dict) -> pd.DataFrame:
    """The polar grid of touches (the authors' logger): x_mm, y_mm from the centre."""
    shape = {key: plan[key] for key in ("radii", "angles", "inner", "outer")}
    return polar_grid(plan["radius_mm"], probe_mm=0.0, **shape)


def contacts(plan: dict) -> list[Contact]:
    """All presses of a plan, which determines them.

    Every probe visits every place in a random order, in equal sessions; target forces are uniform
    between the two of `target_N`.
    """
    rng = np.random.default_rng([plan["seed"], 5])
    grid = places(plan)
    presses: list[Contact] = []
    for probe in plan["probes_mm"]:
        place_order = rng.permutation(len(grid))
        for session_number, place_rows in enumerate(
            np.array_split(place_order, plan["sessions_per_probe"]), start=1
        ):
            for row in place_rows:
                contact = Contact(
                    number=len(presses),
                    probe_mm=float(probe),
                    session=f"{probe:g} mm, {session_number}",
                    x_mm=float(grid["x_mm"][row]),
                    y_mm=float(grid["y_mm"][row]),
                    target_N=float(rng.uniform(*plan["target_N"])),
                )
                presses.append(contact)
    return presses


def plan_sha256(rig: dict) -> str:
    """Fingerprint of all settings that decide the samples; a capture is resumed only with the same.

    Ports, speeds, limits, `frame_s` and `session` may change from run to run; each run's record
    states them. Raises InputError where the board's file cannot be read.
    """
    decisive_settings = {key: rig[key] for key in ("emulated", "skin", "plan")}
    decisive_settings |= {
        "board": board.identity(rig["board"]["profile"]),
        "load_cell": rig["load_cell"]["profile"],
    }
    decisive_settings |= {"centre": rig["pose"]["centre"]}
    return hashlib.sha256(json.dumps(decisive_settings, sort_keys=True).encode()).hexdigest()
