"""Where touches were truly, as far as their own readings tell: by Levenberg's (1944) and
Marquardt's (1963) method, each frame's by itself.

Readings of a touch that is a millimetre beside where it is said to be do not follow the error in
proportion. The tangents of a rig's errors are then those of the places and forces found here
(first-order conditional linearisation: Lindstrom, Bates, Biometrics 46, 1990).
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from eitskin.diagnose.fitting.fit import Fit, Problem
from eitskin.diagnose.fitting.linearisation import touch_derivatives
from eitskin.diagnose.fitting.simulator import RecordingSimulator
from eitskin.diagnose.noise.rig_errors import RigErrors
from eitskin.errors import InputError

STRAYS = 3.0  # sd by which touches are followed: more is another fault's
# Up to which readings follow a stray in proportion: of a place, of a force over the largest.
STRAIGHT_MM, STRAIGHT_FORCE = 0.1, 0.03
ROUNDS = 12
START, WORST, LESS, MORE = 1e-3, 1e6, 0.1, 10.0  # damping
ENOUGH = 0.5  # of a frame's chi squared, for which it is not moved on
TINY = 1e-12


def moved(model: RecordingSimulator, said: RecordingSimulator) -> dict[str, np.ndarray]:
    """By how much (N,) a simulator has touches elsewhere than they are said to be, mm and N, by
    columns of the states."""
    return {
        key: np.nan_to_num((model.states[key] - said.states[key]).to_numpy(float))
        for key in ("x_mm", "y_mm", "force_N")
    }


def followed(
    plain: Problem, fitted: Fit, rig: RigErrors, sizes: Mapping[str, float]
) -> RecordingSimulator:
    """The simulator with touches where the readings of a problem have them, within STRAYS of the sd
    that a rig's errors of these sizes give each. A fit's own, where readings follow in proportion
    from where that has them. plain: with touches where they are said to be; rig: about the fit."""
    there, spread = fitted.problem.model, rig.displacement_sds(sizes)
    keys = [key for key in rig.derivatives if spread[key].any()]
    if straight(spread, there) or not keys:
        return there
    sd = np.array([spread[key] for key in keys])
    alone = rig.frame_whitening(sizes)

    def left(model: RecordingSimulator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        voltage = replace(plain, model=model).voltage(fitted.theta, fitted.effects)
        white = alone(np.where(alone.mask, plain.recorded - voltage, 0.0))
        off = np.array([moved(model, plain.model)[key] for key in keys])
        over = off / np.maximum(sd, TINY)
        return white, off, (white**2).sum(axis=1) + (over**2).sum(axis=0)

    white, off, cost = left(there)
    slopes, damping = rig.derivatives, np.full(len(cost), START)
    for number in range(ROUNDS):
        columns = alone(np.array([slopes[key] for key in keys]))
        step, hope = _step(columns, white, off, sd, damping)
        if number == 0 and straight(dict(zip(keys, step, strict=True)), there):
            break
        active = (hope > ENOUGH) & (damping < WORST)
        if not active.any():
            break
        try:
            trial = there.displaced(dict(zip(keys, np.where(active, step, 0.0), strict=True)))
            better = active & (left(trial)[2] < cost)
        except InputError:
            damping *= MORE
            continue
        damping[active] *= np.where(better, LESS, MORE)[active]
        if better.any():
            there = there.displaced(dict(zip(keys, np.where(better, step, 0.0), strict=True)))
            white, off, cost = left(there)
            now = replace(fitted, problem=replace(plain, model=there))
            slopes = touch_derivatives(now, now.voltage())
            if not slopes:
                break
    return there


def straight(strays: Mapping[str, np.ndarray], model: RecordingSimulator) -> bool:
    """Whether readings follow strays (N,), mm and N, by columns of the states, in proportion."""
    touched = model.touched & model.known
    rms = {k: float(np.sqrt((v[touched] ** 2).mean())) for k, v in strays.items() if touched.any()}
    force = rms.pop("force_N", 0.0) / (model.force_max_N or 1.0)
    return force < STRAIGHT_FORCE and all(one < STRAIGHT_MM for one in rms.values())


def _step(
    columns: np.ndarray, white: np.ndarray, off: np.ndarray, sd: np.ndarray, damping: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Each frame's step (K, N) and the decrease (N,) of its cost that it promises. columns
    (K, N, M): whitened tangents; white (N, M): what is left; off (K, N): strays so far, sd (K, N):
    theirs."""
    precision = 1.0 / np.maximum(sd, TINY) ** 2
    gram = np.einsum("knm,lnm->nkl", columns, columns)
    diagonal = np.arange(len(columns))
    gram[:, diagonal, diagonal] += precision.T
    slope = np.einsum("knm,nm->nk", columns, white) - (precision * off).T
    lifted = gram.copy()
    lifted[:, diagonal, diagonal] *= 1.0 + damping[:, None]
    step = np.linalg.solve(lifted, slope[..., None])[..., 0].T
    step = np.clip(off + step, -STRAYS * sd, STRAYS * sd) - off
    hope = 2.0 * np.einsum("kn,nk->n", step, slope) - np.einsum("kn,nkl,ln->n", step, gram, step)
    return step, hope
