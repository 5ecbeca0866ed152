"""Places and forces of touches estimated from their readings, each frame's by itself, by the
method of Levenberg (1944) and Marquardt (1963).

The readings of a touch that is a millimetre beside its reported place are not linear in that error.
The errors of a rig are then linearised about the places and forces estimated here (first-order
conditional linearisation: Lindstrom, Bates, Biometrics 46, 1990).
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from eitskin.diagnose.fitting.fit import Fit, Problem
from eitskin.diagnose.fitting.linearisation import touch_derivatives
from eitskin.diagnose.fitting.simulator import RecordingSimulator
from eitskin.diagnose.noise.rig_errors import RigErrors
from eitskin.errors import InputError

MAX_DISPLACEMENT_SDS = 3.0  # beyond these a displacement is another fault's
# Displacements in which readings are linear: of a place, and of a force over the largest one.
LINEAR_MM, LINEAR_FORCE = 0.1, 0.03
MAX_ITERATIONS = 12  # a frame that has not ended by then keeps its best state
# Marquardt's damping: at the start, where a frame is given up, and its factors after a better and
# after a worse step.
DAMPING_START, DAMPING_LIMIT, DAMPING_DOWN, DAMPING_UP = 1e-3, 1e6, 0.1, 10.0
MIN_DECREASE = 0.5  # of a frame's chi squared: a third of its sd by one coordinate (√2)
MIN_SD = 1e-12  # mm and N, against a division by 0 where an error does not act


def displacements(model: RecordingSimulator, reported: RecordingSimulator) -> dict[str, np.ndarray]:
    """Displacements (N,) of a simulator's touches from the reported ones, in mm and N, by column of
    the states."""
    return {
        key: np.nan_to_num((model.states[key] - reported.states[key]).to_numpy(float))
        for key in ("x_mm", "y_mm", "force_N")
    }


def relocated_touches(
    problem: Problem, fitted: Fit, rig: RigErrors, error_sds: Mapping[str, float]
) -> RecordingSimulator:
    """The simulator with touches at the places and forces of the largest posterior density, within
    MAX_DISPLACEMENT_SDS of the reported ones; the fit's simulator where the readings are linear in
    the displacements.

    problem: with touches as reported; rig: the rig's errors linearised about the fit; error_sds:
    their standard deviations by name, which are the prior of the displacements.
    """
    model, displacement_sds = fitted.problem.model, rig.displacement_sds(error_sds)
    keys = [key for key in rig.derivatives if displacement_sds[key].any()]
    if is_proportional(displacement_sds, model) or not keys:
        return model
    sd = np.array([displacement_sds[key] for key in keys])
    frame_whitening = rig.frame_whitening(error_sds)

    def state(model: RecordingSimulator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Whitened residual (N, M), displacements (K, N) and the cost (N,) of every frame."""
        voltage = replace(problem, model=model).voltage(fitted.theta, fitted.effects)
        white = frame_whitening(np.where(frame_whitening.mask, problem.readings - voltage, 0.0))
        displacement = np.array([displacements(model, problem.model)[key] for key in keys])
        scaled = displacement / np.maximum(sd, MIN_SD)
        return white, displacement, (white**2).sum(axis=1) + (scaled**2).sum(axis=0)

    white, displacement, cost = state(model)
    slopes, damping = rig.derivatives, np.full(len(cost), DAMPING_START)
    for iteration in range(MAX_ITERATIONS):
        columns = frame_whitening(np.array([slopes[key] for key in keys]))
        step, decrease = _step(columns, white, displacement, sd, damping)
        if iteration == 0 and is_proportional(dict(zip(keys, step, strict=True)), model):
            break
        active = (decrease > MIN_DECREASE) & (damping < DAMPING_LIMIT)
        if not active.any():
            break
        try:
            trial_model = model.with_displacements(
                dict(zip(keys, np.where(active, step, 0.0), strict=True))
            )
            better = active & (state(trial_model)[2] < cost)
        except InputError:
            damping *= DAMPING_UP
            continue
        damping[active] *= np.where(better, DAMPING_DOWN, DAMPING_UP)[active]
        if better.any():
            model = model.with_displacements(
                dict(zip(keys, np.where(better, step, 0.0), strict=True))
            )
            white, displacement, cost = state(model)
            relocated_fit = replace(fitted, problem=replace(problem, model=model))
            slopes = touch_derivatives(relocated_fit, relocated_fit.voltage())
            if not slopes:
                break
    return model


def is_proportional(displacement: Mapping[str, np.ndarray], model: RecordingSimulator) -> bool:
    """Whether readings are linear in displacements (N,) of their touches, in mm and N, by column of
    the states: whether the rms of these is below LINEAR_MM and LINEAR_FORCE."""
    touched = model.touched & model.simulable
    rms = {
        k: float(np.sqrt((v[touched] ** 2).mean()))
        for k, v in displacement.items()
        if touched.any()
    }
    force = rms.pop("force_N", 0.0) / (model.force_max_N or 1.0)
    return force < LINEAR_FORCE and all(rms_mm < LINEAR_MM for rms_mm in rms.values())


def _step(
    columns: np.ndarray,
    white: np.ndarray,
    displacement: np.ndarray,
    sd: np.ndarray,
    damping: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """The step (K, N) of every frame and the decrease (N,) of its cost that is expected. columns
    (K, N, M): whitened derivatives; white (N, M): the whitened residual; displacement (K, N): the
    displacements at present, sd (K, N): their prior's."""
    precision = 1.0 / np.maximum(sd, MIN_SD) ** 2
    gram = np.einsum("knm,lnm->nkl", columns, columns)
    diagonal = np.arange(len(columns))
    gram[:, diagonal, diagonal] += precision.T
    slope = np.einsum("knm,nm->nk", columns, white) - (precision * displacement).T
    damped = gram.copy()
    damped[:, diagonal, diagonal] *= 1.0 + damping[:, None]
    step = np.linalg.solve(damped, slope[..., None])[..., 0].T
    step = (
        np.clip(displacement + step, -MAX_DISPLACEMENT_SDS * sd, MAX_DISPLACEMENT_SDS * sd)
        - displacement
    )
    decrease = 2.0 * np.einsum("kn,nk->n", step, slope) - np.einsum(
        "kn,nkl,ln->n", step, gram, step
    )
    return step, decrease
