"""Admittances from the skin's terminals to ground, all of them together.

They carry the currents J = -Y U into the skin, U = R (I + J) above ground. Under a floating source
the skin's potential floats until they sum to 0, the mean of U weighted with Y being 0: one leak
alone carries nothing. A grounded sink is at 0 V and gives what they take.
"""

import numpy as np

from eitskin.errors import InputError


def leaking_potential(
    potential: np.ndarray,
    admittance: np.ndarray,
    impedance: np.ndarray,
    drives: np.ndarray,
    sink_grounded: bool,
) -> np.ndarray:
    """Potentials (N, D, n) V per A of the terminals, including the currents of their leaks.

    potential (N, D, n) without leaks; admittance (N, n) S; impedance (N, n, n) ohm; drives (D, 2):
    source and sink. Raises InputError for point electrodes, whose own potential is unbounded.
    """
    if np.isnan(impedance).any():
        actual = "points, with a leak to ground"
        raise InputError("skin", "electrode_width_mm", actual, "a width above 0")
    sites = np.flatnonzero((admittance > 0).any(axis=0))
    if not len(sites):
        return potential
    admittance = admittance[:, sites]
    changed = np.empty_like(potential)
    total = admittance.sum(axis=1, keepdims=True)
    mean = np.zeros((len(potential), potential.shape[2]))
    mean[:, sites] = np.where(total > 0, admittance, 1.0) / np.where(total > 0, total, len(sites))
    for sink in np.unique(drives[:, 1]) if sink_grounded else [None]:
        rows = slice(None) if sink is None else drives[:, 1] == sink
        response = impedance[:, :, sites]
        if sink is not None:
            response = response - impedance[:, :, [sink]]
            mean = np.broadcast_to(np.eye(potential.shape[2])[sink], mean.shape)
        zero = np.einsum("fdi,fi->fd", potential[:, rows], mean)
        height = potential[:, rows][:, :, sites] - zero[:, :, None]
        leak_response = response[:, sites] - np.einsum("fi,fij->fj", mean, response)[:, None]
        system = np.eye(len(sites)) + admittance[:, :, None] * leak_response
        leak_potential = np.swapaxes(admittance[:, None] * height, 1, 2)
        current = -np.linalg.solve(system, leak_potential)
        changed[:, rows] = potential[:, rows] + np.swapaxes(response @ current, 1, 2)
    return changed
