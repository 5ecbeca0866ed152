"""Where fits begin that no tangent leads to: of a body in place of a sheet, of electrodes much
wider than their owner would guess.

What the beliefs and a candidate leave is computed at a few of its sizes and of what nobody knows of
the contacts, one common factor free; a fit from the best of these goes the rest of the way.
"""

from itertools import product

import numpy as np

from eitskin.diagnose.candidates import Candidate
from eitskin.diagnose.fit import Problem
from eitskin.errors import InputError

SCALE = ("factor", "current_A")  # calibrations of which one is the readings' scale
# Coordinates of a contact impedance and of a width that nobody knows.
CONTACTS, WIDTHS = (-2.0, 0.0, 2.0), (0.0, 1.0, 2.0, 2.5)


def is_far(candidate: Candidate) -> bool:
    """Whether a candidate is fitted from here: its effect is far, and at no site alone."""
    return bool(candidate.effect.far) and candidate.scope in ("", "common")


def start(
    problem: Problem, effects: list[Candidate], theta: np.ndarray, candidate: Candidate | None
) -> tuple[float, np.ndarray]:
    """Least chi squared that the beliefs, effects at theta (P,) and a candidate leave, and the
    coordinates (P + size,) where they do; infinity where the physics has no such state. Without a
    candidate, electrodes of unknown width are tried wider too."""
    names = [item.name for item in problem.model.calibrations]
    contact, width = (
        [i for i, own in enumerate(names) if own == name]
        for name in ("contact_impedivity_ohm_m2", "electrode_width_mm")
    )
    scale = [i for i, name in enumerate(names) if name in SCALE]
    count, sizes = (candidate.size, candidate.effect.far) if candidate else (0, (0.0,))
    tried = [candidate] if candidate else []
    least, best = np.inf, np.r_[np.zeros(len(names)), theta[len(names) :], np.zeros(count)]
    recorded = problem.whitening(problem.recorded)
    contacts = CONTACTS if contact else CONTACTS[:1]
    widths = WIDTHS if width and not candidate else WIDTHS[:1]
    for size, z, w in product(sizes, contacts, widths):
        there = np.r_[np.zeros(len(names)), theta[len(names) :], np.full(count, size)]
        there[contact], there[width] = z, w
        try:
            simulated = problem.whitening(problem.voltage(there, [*effects, *tried]))
        except InputError:
            continue
        factor = float((simulated * recorded).sum() / (simulated**2).sum())
        left = float(((recorded - factor * simulated) ** 2).sum())
        if left < least and factor > 0.0:
            least, best = left, there
            for i in scale:
                best[i] = np.log(factor) / problem.model.calibrations[i].sd
    return least, best
