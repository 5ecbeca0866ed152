"""What is pressed: every place with every probe, in the order in which the robot goes."""

import hashlib
import json
from dataclasses import dataclass

import numpy as np
import pandas as pd

from eitskin.simulate.layout import polar_grid


@dataclass(frozen=True)
class Contact:
    """One press: its number, probe, session, place from the skin's centre along the robot's base
    axes, and the force that ends it."""

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
    """All presses. Every probe visits every place, in a random order, in equal sessions; targets
    are drawn between the two of `target_N`. The same plan gives the same presses."""
    rng = np.random.default_rng([plan["seed"], 5])
    grid = places(plan)
    found: list[Contact] = []
    for probe in plan["probes_mm"]:
        order = rng.permutation(len(grid))
        for part, chosen in enumerate(np.array_split(order, plan["sessions_per_probe"]), start=1):
            for place in chosen:
                contact = Contact(
                    number=len(found),
                    probe_mm=float(probe),
                    session=f"{probe:g} mm, {part}",
                    x_mm=float(grid["x_mm"][place]),
                    y_mm=float(grid["y_mm"][place]),
                    target_N=float(rng.uniform(*plan["target_N"])),
                )
                found.append(contact)
    return found


def plan_sha256(rig: dict) -> str:
    """Fingerprint of what decides the samples; a capture goes on only where it is the same. Ports,
    speeds, limits, `frame_s` and `session` may change from run to run, and stand in each run's
    record."""
    decisive = {key: rig[key] for key in ("emulated", "skin", "plan")}
    decisive |= {"board": rig["board"]["profile"], "load_cell": rig["load_cell"]["profile"]}
    decisive |= {"centre": rig["pose"]["centre"]}
    return hashlib.sha256(json.dumps(decisive, sort_keys=True).encode()).hexdigest()
