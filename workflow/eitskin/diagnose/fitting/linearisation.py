"""A fit's readings and their derivatives by the touches, for the errors of a rig."""

import numpy as np

from eitskin.data.recording import elapsed
from eitskin.diagnose.fitting.families import family_columns, family_name
from eitskin.diagnose.fitting.fit import Fit
from eitskin.diagnose.fitting.tangents import Tangents
from eitskin.diagnose.noise.linearisation import Linearisation
from eitskin.diagnose.noise.rig_errors import RigErrors
from eitskin.diagnose.noise.whitening import Whitening
from eitskin.errors import InputError

STEP_MM = 0.05  # of a place, inwards: far below a touch's width, far above the solver's error
STEP_FORCE = 0.02  # of a force, downwards; of the largest upwards, where it is less than that


def linearised_rig_errors(fit: Fit, noise_whitening: Whitening, converter_step: float) -> RigErrors:
    """The errors of a rig about a fit; noise_whitening: the covariance without them;
    converter_step: as in `NoiseModel`."""
    return RigErrors.from_linearisation(linearisation(fit, converter_step), noise_whitening)


def linearisation(fit: Fit, converter_step: float) -> Linearisation:
    """A fit's readings with their derivatives; converter_step: as in `NoiseModel`."""
    problem = fit.problem
    model, whitening = problem.model, problem.whitening
    voltage = fit.voltage()
    touched = model.touched & model.simulable
    typical = np.median(np.abs(problem.readings[whitening.mask]))
    fitted_names = {family_name(candidate) for candidate in model.families}
    absent = {n: members for n, members in problem.families.items() if n not in fitted_names}
    families = family_columns(Tangents(fit), absent) if absent else {}
    return Linearisation(
        voltage=voltage,
        derivatives=touch_derivatives(fit, voltage),
        touched=touched,
        press=np.where(touched, model.press, -1),
        states={
            column: model.states[column].to_numpy(float) for column in ("x_mm", "y_mm", "force_N")
        },
        time_s=model.states["time_s"].to_numpy(float),
        timed=model.timed,
        elapsed=elapsed(model.states),
        difference=model.difference,
        magnitude=model.magnitude,
        typical_reading=float(max(typical, np.median(whitening.sd))),
        converter_step=converter_step,
        number=whitening.numbers,
        noise_sd=whitening.sd,
        wander=whitening.wander,
        families=families,
    )


def touch_derivatives(fit: Fit, voltage: np.ndarray) -> dict[str, np.ndarray]:
    """Derivatives (N, M) of a fit's readings `voltage` by place and force of each frame's touch, by
    column of the states.

    None by force where no touch has any; none at all where nobody touches or the physics has none.
    """
    model = fit.problem.model
    touched = model.touched & model.simulable
    if not touched.any():
        return {}
    force_N, largest_N = model.states["force_N"].to_numpy(float), model.force_max_N
    steps = {
        column: np.where(model.states[column].to_numpy(float) > 0.0, -STEP_MM, STEP_MM)
        for column in ("x_mm", "y_mm")
    }
    if largest_N > 0.0:
        direction = np.where(force_N > STEP_FORCE * largest_N, -force_N, largest_N)
        steps["force_N"] = STEP_FORCE * direction
    calibration, settings = fit.problem.split(fit.theta, fit.effects)
    derivatives = {}
    for column, step in steps.items():
        try:
            displaced = model.with_displacements({column: step}).voltage(calibration, settings)
        except InputError:
            return {}
        derivatives[column] = np.where(touched[:, None], (displaced - voltage) / step[:, None], 0.0)
    return derivatives
