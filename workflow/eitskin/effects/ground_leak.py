"""Electrodes that leak to ground."""

import numpy as np

from eitskin.effects.effect import Parameter, Setting, WiringEffect
from eitskin.errors import InputError


class GroundLeak(WiringEffect):
    """An admittance from each named electrode to ground.

    The leaks carry J_l = -Y_l U_l into the skin, U = R (I + J) above ground. Under a floating
    source the skin's potential floats until they sum to 0, the mean of U weighted with Y being 0:
    one leak alone carries nothing. A grounded sink is at 0 V and gives what they take.
    """

    name = "ground-leak"
    order = "leak"
    driver = "static"
    sites = ("electrodes",)
    parameters = {"siemens": Parameter("S", 0.0, 0.0, 1.0, scale=0.02)}
    source = "Zhang, Li 2014"
    mend = "dry and insulate the lead of electrode {site}"
    finding = "{site} {leaks|leak} to ground through {siemens}."
    shown_by = "absolute values, with the source's sink at ground"
    confusable = ("offset",)

    def change(
        self,
        potential: np.ndarray,
        setting: Setting,
        drives: np.ndarray,
        transfer: np.ndarray,
        sink_grounded: bool,
    ) -> np.ndarray:
        """Potentials (N, D, n) with what the leaks carry; InputError for point electrodes."""
        if np.isnan(transfer).any():
            where = "points, with ground-leak"
            raise InputError("skin", "electrode_width_mm", where, "a width above 0")
        admittance = np.broadcast_to(setting.values["siemens"], len(setting.sites))
        leaking, admittance = setting.sites[admittance > 0], admittance[admittance > 0]
        if not len(leaking):
            return potential
        changed = np.empty_like(potential)
        share = np.zeros(potential.shape[2])
        share[leaking] = admittance / admittance.sum()
        for sink in np.unique(drives[:, 1]) if sink_grounded else [None]:
            rows = drives[:, 1] == sink if sink_grounded else slice(None)
            response = transfer[:, :, leaking]
            if sink_grounded:
                response = response - transfer[:, :, [sink]]
                share = np.eye(len(share))[sink]
            above = potential[:, rows][:, :, leaking] - (potential[:, rows] @ share)[:, :, None]
            felt = response[:, leaking] - (share @ response)[:, None]
            system = np.eye(len(leaking)) + admittance[:, None] * felt
            current = -np.linalg.solve(system, np.swapaxes(admittance * above, 1, 2))
            changed[:, rows] = potential[:, rows] + np.swapaxes(response @ current, 1, 2)
        return changed
