"""What is fitted of a recording: the readings that can be compared with a simulation, and their
covariance by noise and numerical error."""

from dataclasses import replace

import numpy as np

from eitskin.data.recording import Recording
from eitskin.diagnose.fitting.candidates import Scales
from eitskin.diagnose.fitting.fit import Problem, fit
from eitskin.diagnose.fitting.reserve_outliers import reserve_outliers
from eitskin.diagnose.fitting.simulator import RecordingSimulator
from eitskin.diagnose.noise.estimate import estimate_noise
from eitskin.diagnose.noise.noise_model import NoiseModel
from eitskin.diagnose.noise.refinement import refine_noise
from eitskin.diagnose.noise.whitening import SOLVER_ERROR, Whitening
from eitskin.errors import InputError
from eitskin.physics.accuracy import untouched_error
from eitskin.physics.geometry import Geometry

# Numerical error of a body that is solved at accuracy `train`, in most channels, over the median
# |v|; and how many times this error the noise of a frame's mean must be to accept it.
BODY_ERROR, NOISE_OVER_ERROR = 1e-4, 3.0
FEW_FRAMES = 3  # whose mean has so much noise that no level is told from it


def problem_of(
    recording: Recording, noise: NoiseModel, model: RecordingSimulator | None = None
) -> tuple[Problem, Scales]:
    """The fitting problem of a recording whose noise is known, and the sizes of its readings.

    model: its simulator, where there is one. Raises InputError where nothing can be compared with
    a simulation.
    """
    model = model or RecordingSimulator(recording)
    readings = comparable_readings(recording, noise, model)
    if not np.isfinite(readings).any():
        count = int(model.touched.sum())
        content = f"{count} touches of unknown force or probe and no other frame"
        raise InputError("recording", "frames", content, "untouched frames, or touches fully known")
    if not np.nan_to_num(readings).any():
        raise InputError("recording", "column voltage_V", "0 in every frame", "readings of a skin")
    median = float(np.nanmedian(np.abs(readings[~model.touched])) or 0.0)
    if model.difference or not np.isfinite(median):
        median = float(np.nanmedian(np.abs(readings)))
    share = float(np.median(noise.sd)) / np.sqrt(len(readings)) / (median or 1.0)
    model.coarse = not model.touched.any() and share > NOISE_OVER_ERROR * BODY_ERROR
    geometry = Geometry.from_skin(model.nominal_skin)
    current = model.nominal_skin.current_A if model.unit != "ohm" else 1.0
    assert current is not None
    error = np.abs(current * untouched_error(geometry, recording.channels, "diagnose"))
    coherent = BODY_ERROR if model.coarse else SOLVER_ERROR
    error = np.hypot(error, np.hypot(coherent * median, noise.rounding_sd))
    whitening = Whitening.from_readings(readings, noise.sd, model.difference, error)
    clock = recording.frames["frame"].to_numpy()
    whitening = replace(whitening, spectrum=noise.spectrum, wander=noise.wander, frame_number=clock)
    return Problem(model, readings, whitening), Scales(median / model.factor, current)


def comparable_readings(
    recording: Recording, noise: NoiseModel, model: RecordingSimulator
) -> np.ndarray:
    """(N, M): the readings that can be compared with a simulation, NaN where a touch's state is not
    known or a reading is lost."""
    lost = (
        np.zeros(recording.readings.shape, bool)
        if noise.rejected_mask is None
        else noise.rejected_mask
    )
    return np.where(model.simulable[:, None] & ~lost, recording.readings, np.nan)


def noise_and_problem(
    recording: Recording, reserve_mask: np.ndarray
) -> tuple[NoiseModel, Problem, Scales]:
    """The noise of a recording, and the fitting problem of its readings less the reserve.

    The noise is first estimated from the readings alone, then from the residuals of the calibrated
    simulation. Channels of which the reserve has all get the noise of their simulated level, and so
    do all channels of up to FEW_FRAMES frames. Loud frames and spikes are sought outside the
    reserve: of the reserve, only readings of a frame that is loud in the others are rejected.
    """
    fitted = replace(recording, voltage=np.where(reserve_mask, np.nan, recording.readings))
    rough_noise = estimate_noise(fitted)
    problem, scales = problem_of(fitted, rough_noise)
    model = problem.model
    start = np.zeros(len(model.calibrations))
    calibrated = fit(problem, [], start, polish=True).voltage()
    simulated = np.where(model.simulable[:, None], calibrated, np.nan)
    if not (model.difference or model.touched.all()):
        of_simulated = np.isnan(fitted.readings).all(axis=0)
        # A law at a level that has the readings' own noise would make weights of this noise.
        of_simulated |= len(fitted.frames) <= FEW_FRAMES
        level = np.abs(calibrated[~model.touched].mean(axis=0))
        rough_noise = rough_noise.with_simulated_level(of_simulated, level)
    noise = refine_noise(fitted, rough_noise, simulated)
    return noise, problem_of(fitted, noise, model)[0], scales


def reserve_problem(
    problem: Problem, recording: Recording, noise: NoiseModel, reserve_mask: np.ndarray
) -> Problem | None:
    """The problem of the reserve's readings (N, M) less the `reserve_outliers`, with the noise of
    the others; None where there are none."""
    comparable = comparable_readings(recording, noise, problem.model)
    outliers = reserve_outliers(recording, reserve_mask, noise.rejected_mask)
    readings = np.where(reserve_mask & ~outliers, comparable, np.nan)
    white = replace(problem.whitening, mask=np.isfinite(readings))
    if white.size <= 0:
        return None
    return replace(problem, readings=readings, whitening=white)
