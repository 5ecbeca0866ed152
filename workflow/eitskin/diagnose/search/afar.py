"""Where fits begin of candidates that no tangent leads to: a body in place of a sheet.

What the beliefs and a candidate leave is computed at a few of its sizes and a few contact
impedances, one common factor free; a fit from the best of these goes the rest of the way.
"""

from itertools import product

import numpy as np

from eitskin.diagnose.candidates import Candidate
from eitskin.diagnose.fit import Problem
from eitskin.errors import InputError

SCALE = ("factor", "current_A")  # calibrations of which one is the readings' scale
CONTACTS = (-2.0, 0.0, 2.0)  # coordinates of a contact impedance that nobody knows


def is_far(candidate: Candidate) -> bool:
    """Whether a candidate is fitted from here: its effect is far, and at no site alone."""
    return bool(candidate.effect.far) and candidate.scope in ("", "common")


def start(
    problem: Problem, effects: list[Candidate], theta: np.ndarray, candidate: Candidate
) -> tuple[float, np.ndarray]:
    """Least chi squared that the beliefs, effects at theta (P,) and a candidate leave, and the
    coordinates (P + size,) where they do; infinity where the physics has no such state."""
    names = [item.name for item in problem.model.calibrations]
    contact = [i for i, name in enumerate(names) if name == "contact_impedivity_ohm_m2"]
    scale = [i for i, name in enumerate(names) if name in SCALE]
    least, best = np.inf, np.r_[np.zeros(len(names)), theta[len(names) :], np.zeros(candidate.size)]
    recorded = problem.whitening(problem.recorded)
    for size, z in product(candidate.effect.far, CONTACTS if contact else CONTACTS[:1]):
        there = np.r_[np.zeros(len(names)), theta[len(names) :], np.full(candidate.size, size)]
        there[contact] = z
        try:
            simulated = problem.whitening(problem.voltage(there, [*effects, candidate]))
        except InputError:
            continue
        factor = float((simulated * recorded).sum() / (simulated**2).sum())
        left = float(((recorded - factor * simulated) ** 2).sum())
        if left < least and factor > 0.0:
            least, best = left, there
            for i in scale:
                best[i] = np.log(factor) / problem.model.calibrations[i].sd
    return least, best
