"""Where fits begin that no tangent leads to: of a body in place of a sheet, of electrodes much
wider than their owner would guess.

What the beliefs and a candidate leave is computed at a few of its sizes and of what nobody knows of
the contacts, one common factor as free as the beliefs leave it; a fit from the best of these goes
the rest of the way.
"""

from collections.abc import Sequence
from itertools import product

import numpy as np

from eitskin.diagnose.fitting.candidates import Candidate
from eitskin.diagnose.fitting.fit import Problem
from eitskin.errors import InputError

# Calibrations of which the first that there is scales the readings, and by which power.
SCALE = {"factor": 1.0, "current_A": 1.0, "conductivity_S_per_m": -1.0}
# Coordinates of a contact impedance and of a width that nobody knows.
CONTACTS, WIDTHS = (-2.0, 0.0, 2.0), (0.0, 1.0, 2.0, 2.5)
MOST_SCALE = 2.0  # coordinate of the scale; it reaches no further than 3


def is_far(candidate: Candidate) -> bool:
    """Whether a candidate is fitted from here: its effect is far, and at no site alone."""
    return bool(candidate.effect.far) and candidate.scope in ("", "common")


def start(
    problem: Problem,
    effects: list[Candidate],
    theta: np.ndarray,
    candidates: Sequence[Candidate],
    sizes: Sequence[tuple[float, ...]] | None = None,
) -> tuple[float, np.ndarray]:
    """Least chi squared that the beliefs, effects at theta (P,) and candidates leave, and the
    coordinates (P + size,) where they do; infinity where the physics has no such state. sizes: the
    candidates' coordinates that are tried; by default all alike, as far as the first of them is.
    Without a candidate, electrodes of unknown width are tried wider too."""
    names = [item.name for item in problem.model.calibrations]
    contact, width = (
        [i for i, calibration in enumerate(names) if calibration == name]
        for name in ("contact_impedivity_ohm_m2", "electrode_width_mm")
    )
    scale, power = next((names.index(n), power) for n, power in SCALE.items() if n in names)
    sd = problem.model.calibrations[scale].sd
    count = sum(candidate.size for candidate in candidates)
    if sizes is None:
        far = candidates[0].effect.far if candidates else (0.0,)
        sizes = [(size,) * count for size in far]
    least_cost, best = np.inf, np.r_[np.zeros(len(names)), theta[len(names) :], np.zeros(count)]
    recorded = problem.whitening(problem.readings)
    contacts = CONTACTS if contact else CONTACTS[:1]
    widths = WIDTHS if width and not candidates else WIDTHS[:1]
    for size, z, w in product(sizes, contacts, widths):
        trial = np.r_[np.zeros(len(names)), theta[len(names) :], np.array(size)]
        trial[contact], trial[width] = z, w
        try:
            simulated = problem.whitening(problem.voltage(trial, [*effects, *candidates]))
        except InputError:
            continue
        factor = float((simulated * recorded).sum() / (simulated**2).sum())
        if factor > 0.0:
            unlikely = np.log(factor) / sd
            cost = float(((recorded - factor * simulated) ** 2).sum() + unlikely**2)
            if cost < least_cost:
                least_cost, best = cost, trial
                best[scale] = np.clip(power * unlikely, -MOST_SCALE, MOST_SCALE)
    return least_cost, best
