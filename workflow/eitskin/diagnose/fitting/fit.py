"""Calibrations and effects fitted together: nonlinear least squares on whitened residuals.

The cost of coordinates theta is |W (y - f(theta))|² + Σ p_i theta_i², with readings y, simulation
f, whitening W (the noise's covariance is (WᵀW)⁻¹) and the prior's precisions p.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace

import numpy as np
from scipy.special import erf

from eitskin.diagnose.fitting.candidates import Candidate, exclusive_channels
from eitskin.diagnose.fitting.jacobian import Block, Jacobian, in_groups
from eitskin.diagnose.fitting.simulator import RecordingSimulator
from eitskin.diagnose.noise.whitening import Whitening
from eitskin.effects.effect import Setting
from eitskin.errors import InputError

STEP = 1e-3  # of a coordinate, whose typical change is 1
MAX_ITERATIONS = 30  # of a fit; one that needs more is marked as not converged
FAILURES_TO_RENEWAL = 2  # rejected steps, the second a shorter one, that blame the Jacobian
# Expected decreases of chi squared at which a fit ends: at its optimum, where intervals are at a
# change of 1, and near it; and the share of the misfit that is added to these, as less is enough
# where much is missing.
OPTIMUM_TOLERANCE, ROUGH_TOLERANCE, MISFIT_TOLERANCE = 0.02, 0.2, 3e-5
JACOBIAN_RENEWALS = 1  # in a fit that need not end at its optimum
MAX_STEP = 3.0  # of a coordinate, in typical changes: a linear model holds no further
DECREASE_FACTOR = 2.0  # a step may lower the cost by so many times what a linear model expects
EFFECT_PRIOR_SD = 30.0  # of an effect's coordinate in a fit: keeps it finite and weighs nothing
EIGENVALUE_FLOOR = 1e-14  # of a precision with a diagonal of ones: less is rounding
# Marquardt's damping: at the start, after a rejected step at least, and where a fit is given up;
# its factors after a step that was as good as expected, that was not, and that was rejected.
DAMPING_START, MIN_REJECTED_DAMPING, DAMPING_LIMIT = 1e-6, 1e-3, 1e6
DAMPING_DOWN, DAMPING_INACCURATE, DAMPING_UP = 0.1, 3.0, 30.0
ACCURATE_SHARE = 0.25  # of the expected decrease: less, and the linear model is wrong
MIN_INFORMATION = 1e-12  # of a coordinate that changes nothing, so that damping holds it


@dataclass(frozen=True)
class FitLimits:
    """When a fit gives up. cost: where no cost below this one is to be expected; renewals: how many
    times the Jacobian may be computed anew on the way."""

    cost: float = np.inf
    renewals: int = JACOBIAN_RENEWALS


@dataclass(frozen=True)
class Problem:
    """What is fitted: the readings (N, M) of a recording, NaN where none is fitted, with their
    simulator and their covariance; families: by name the effects at every site that are a little
    wrong without being named."""

    model: RecordingSimulator
    readings: np.ndarray
    whitening: Whitening
    families: Mapping[str, tuple[Candidate, ...]] = field(default_factory=dict)

    def residual(self, theta: np.ndarray, effects: list[Candidate]) -> np.ndarray:
        """(N, M): readings less simulation at theta (P,), whitened. Raises InputError where the
        physics has no solution."""
        with np.errstate(invalid="ignore"):
            return self.whitening(self.readings - self.voltage(theta, effects))

    def voltage(self, theta: np.ndarray, effects: list[Candidate]) -> np.ndarray:
        """(N, M): expected readings at theta (P,); of magnitudes with noise, the mean of a folded
        normal distribution (Leone, Nelson, Nottingham, Technometrics 3, 1961)."""
        simulated = self.model.voltage(*self.split(theta, effects))
        if not self.model.magnitude or self.model.difference:
            return simulated
        scaled = simulated / (np.sqrt(2.0) * self.whitening.sd)
        noise = np.sqrt(2.0 / np.pi) * self.whitening.sd
        return simulated * erf(scaled) + noise * np.exp(-(scaled**2))

    def split(self, theta: np.ndarray, effects: list[Candidate]) -> tuple[np.ndarray, list]:
        """The calibrations' coordinates in theta (P,), and the effects' settings there."""
        start = len(self.model.calibrations)
        calibration, settings = theta[:start], []
        for candidate in effects:
            settings.append(candidate.setting(theta[start : start + candidate.size]))
            start += candidate.size
        return calibration, settings


@dataclass(frozen=True)
class Fit:
    """A set of effects, fitted.

    theta (P,): the calibrations' coordinates, then those of every effect in turn; residual (N, M):
    whitened; slopes: minus its derivative by theta; converged: False where the fit stopped at
    MAX_ITERATIONS.
    """

    problem: Problem
    effects: list[Candidate]
    theta: np.ndarray
    residual: np.ndarray
    slopes: Jacobian
    converged: bool = True
    chi2: float = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "chi2", float((self.residual**2).sum()))

    @property
    def cost(self) -> float:
        """Chi squared plus the prior's part."""
        return float(self.chi2 + self.prior @ self.theta**2)

    @property
    def misfit(self) -> np.ndarray:
        """(N, M): readings less the fit's, in the recording's unit; 0 where none is fitted."""
        return np.where(self.problem.whitening.mask, self.problem.readings - self.voltage(), 0.0)

    @property
    def prior(self) -> np.ndarray:
        """(P,): the prior precision of each coordinate."""
        return _prior(self.problem, len(self.theta))

    @property
    def information(self) -> np.ndarray:
        """(P, P): the information of the data, without the prior's."""
        return self.slopes.gram()

    @property
    def jacobian(self) -> np.ndarray:
        """(P, N, M): minus the residual's derivative by every coordinate."""
        return self.slopes.full()

    @property
    def root(self) -> np.ndarray:
        """(P, P): a square root of the covariance of theta (`inverse_root`)."""
        return inverse_root(self.information + np.diag(self.prior))

    @property
    def covariance(self) -> np.ndarray:
        """(P, P): of theta, from the information and the prior."""
        root = self.root
        return root @ root.T

    def coordinate_slice(self, index: int) -> slice:
        """The slice of theta with the coordinates of effect `index`."""
        start = len(self.problem.model.calibrations)
        start += sum(candidate.size for candidate in self.effects[:index])
        return slice(start, start + self.effects[index].size)

    def settings(self) -> list[Setting]:
        """The effects at their fitted values."""
        return self.problem.split(self.theta, self.effects)[1]

    def family_settings(self) -> list[Setting]:
        """The families at the values of their members."""
        calibration, _ = self.problem.split(self.theta, self.effects)
        return self.problem.model.family_settings(calibration)

    def voltage(self) -> np.ndarray:
        """(N, M): the readings expected by the fit."""
        return self.problem.voltage(self.theta, self.effects)

    def voltage_without(self, index: int) -> np.ndarray:
        """(N, M): readings simulated with the fitted effects other than `index`. Raises InputError
        where they have no physics without it."""
        calibration, settings = self.problem.split(self.theta, self.effects)
        return self.problem.model.voltage(calibration, settings[:index] + settings[index + 1 :])


def inverse_root(precision: np.ndarray) -> np.ndarray:
    """(P, P): R with R Rᵀ = A⁻¹ of a symmetric precision A (P, P). As rounding may make A
    indefinite, eigenvalues below EIGENVALUE_FLOOR, at a diagonal of ones, are raised to it."""
    scale = 1.0 / np.sqrt(np.diag(precision))
    values, vectors = np.linalg.eigh(precision * np.outer(scale, scale))
    return scale[:, None] * vectors / np.sqrt(np.maximum(values, EIGENVALUE_FLOOR))


def _prior(problem: Problem, size: int) -> np.ndarray:
    calibration_count = len(problem.model.calibrations)
    return np.r_[np.ones(calibration_count), np.full(size - calibration_count, EFFECT_PRIOR_SD**-2)]


def derivative(
    problem: Problem,
    theta: np.ndarray,
    effects: list[Candidate],
    residual: np.ndarray,
    index: int | np.ndarray,
) -> np.ndarray:
    """(N, M): minus the derivative of the residual by coordinate `index` of theta (P,), or by
    several coordinates moved together; residual (N, M): at theta."""
    return -difference(
        lambda shifted_theta: problem.residual(shifted_theta, effects), theta, residual, index
    )


def difference(
    value: Callable[[np.ndarray], np.ndarray],
    theta: np.ndarray,
    start_value: np.ndarray,
    index: int | np.ndarray,
) -> np.ndarray:
    """Finite difference of a function of theta (P,), whose value there is `start_value`, by
    coordinate `index` or by several moved together: forward, or backward where the physics has no
    solution ahead. Raises InputError where it has none on either side."""
    shifted_theta = theta.copy()
    shifted_theta[index] += STEP
    try:
        return (value(shifted_theta) - start_value) / STEP
    except InputError:
        shifted_theta[index] -= 2 * STEP
        return (start_value - value(shifted_theta)) / STEP


def fit(
    problem: Problem,
    effects: list[Candidate],
    start: np.ndarray,
    jacobian: np.ndarray | None = None,
    polish: bool = False,
    limits: FitLimits | None = None,
) -> Fit:
    """Fit by the method of Levenberg (1944) and Marquardt (1963), with the Jacobian updated by
    Broyden's (1965).

    start (P,): theta to begin at; jacobian (P, N, M): minus the residual's derivative there, NaN
    in the columns that are not known, None where none is; polish: end at the optimum, with a fresh
    Jacobian, instead of near it; limits: when to give up, by default never, with as many renewals
    of the Jacobian as iterations where the fit is polished, JACOBIAN_RENEWALS where it is not. A
    step to where the physics has no solution is rejected like one that raises the cost. Raises
    InputError where the physics has none at the start.
    """
    limits = limits or FitLimits(renewals=MAX_ITERATIONS if polish else JACOBIAN_RENEWALS)
    theta, prior = np.array(start, float), _prior(problem, len(start))
    residual = problem.residual(theta, effects)
    is_fresh = jacobian is None
    slopes = _slopes(problem, theta, effects, residual, jacobian)
    cost = (residual**2).sum() + prior @ theta**2
    dof = max(problem.whitening.size - len(theta), 1)
    damping, failed, renewals = DAMPING_START, 0, limits.renewals
    tolerance = OPTIMUM_TOLERANCE if polish else ROUGH_TOLERANCE
    converged = True
    for _ in range(MAX_ITERATIONS):
        information = slopes.gram() + np.diag(prior)
        slope = slopes.products_with(residual) - prior * theta
        ridge = np.diag(damping * np.maximum(np.diag(information), MIN_INFORMATION))
        step = np.linalg.solve(information + ridge, slope)
        expected = float(2 * step @ slope - step @ information @ step)
        if cost - DECREASE_FACTOR * max(expected, 0.0) > limits.cost:
            break
        if expected < tolerance + MISFIT_TOLERANCE * max(cost - dof, 0.0):
            if is_fresh or expected < 0 or (failed == 0 and not polish) or renewals == 0:
                break
            slopes = _slopes(problem, theta, effects, residual)
            is_fresh, failed, renewals = True, 0, renewals - 1
            continue
        step = np.clip(step, -MAX_STEP, MAX_STEP)
        try:
            trial_residual = problem.residual(theta + step, effects)
        except InputError:
            trial_residual = np.full_like(residual, np.inf)
        trial_cost = (trial_residual**2).sum() + prior @ (theta + step) ** 2
        if trial_cost < cost:
            slopes.broyden_update(step, residual - trial_residual - slopes.change_along(step))
            accurate = cost - trial_cost > ACCURATE_SHARE * expected
            theta, residual, cost = theta + step, trial_residual, trial_cost
            damping = damping * (DAMPING_DOWN if accurate else DAMPING_INACCURATE)
            is_fresh, failed = False, 0 if accurate else failed + 1
        else:
            failed += 1
            if is_fresh or renewals == 0 or failed % FAILURES_TO_RENEWAL:
                damping = max(damping * DAMPING_UP, MIN_REJECTED_DAMPING)
                if damping > DAMPING_LIMIT:
                    break
            else:
                slopes = _slopes(problem, theta, effects, residual)
                is_fresh, renewals = True, renewals - 1
    else:
        converged = False
    if polish and not is_fresh:
        slopes = _slopes(problem, theta, effects, residual)
    return Fit(problem, list(effects), theta, residual, slopes, converged)


def gauss_newton_step(fitted: Fit, min_decrease: float = 0.0) -> Fit:
    """A fit after one step of Gauss and Newton, its slopes as they were; the fit itself where the
    step does not lower the cost, or is expected to lower it by less than `min_decrease`."""
    problem = fitted.problem
    root, whitened_step = _whitened_step(fitted)
    if whitened_step @ whitened_step < min_decrease:
        return fitted
    step = np.clip(root @ whitened_step, -MAX_STEP, MAX_STEP)
    try:
        residual = problem.residual(fitted.theta + step, fitted.effects)
    except InputError:
        return fitted
    stepped_fit = replace(fitted, theta=fitted.theta + step, residual=residual)
    return stepped_fit if stepped_fit.cost < fitted.cost else fitted


def expected_decrease(fitted: Fit) -> float:
    """The decrease of the cost, gᵀ C g, that is expected of a step of Gauss and Newton: g half the
    cost's gradient, C the covariance of theta."""
    _, whitened_step = _whitened_step(fitted)
    return float(whitened_step @ whitened_step)


def _whitened_step(fitted: Fit) -> tuple[np.ndarray, np.ndarray]:
    """The square root R (P, P) of theta's covariance, and w (P,) with the step of Gauss and Newton
    R w."""
    slope = fitted.slopes.products_with(fitted.residual) - fitted.prior * fitted.theta
    root = fitted.root
    return root, root.T @ slope


def renewed_slopes(fitted: Fit) -> Fit:
    """A fit with its slopes computed anew at its theta."""
    slopes = _slopes(fitted.problem, fitted.theta, fitted.effects, fitted.residual)
    return replace(fitted, slopes=slopes)


def rewhitened(fitted: Fit, problem: Problem) -> Fit:
    """A fit with its residual and slopes in the covariance of another problem of the same readings;
    the slopes of its simulation stay."""
    names = [attribute.name for attribute in fields(problem)]
    if all(getattr(problem, name) is getattr(fitted.problem, name) for name in names):
        return fitted
    old, new = fitted.problem.whitening, problem.whitening
    residual = problem.residual(fitted.theta, fitted.effects)
    slopes = fitted.slopes.mapped(lambda columns: new(old.unwhitened(columns)), new.by_channel)
    return replace(fitted, problem=problem, residual=residual, slopes=slopes)


def _slopes(
    problem: Problem,
    theta: np.ndarray,
    effects: list[Candidate],
    residual: np.ndarray,
    columns: np.ndarray | None = None,
) -> Jacobian:
    """Minus the residual's derivative at theta (P,). Of columns (P, N, M) those that are NaN are
    computed, all of them where there are no columns; those of members of families are as the
    simulator has them. Coordinates that change channels exclusive to each are differenced
    together; those of a body at accuracy train, in a tenth of the time, as by `Tangents`."""
    shape = residual.shape
    missing = np.ones(len(theta), bool) if columns is None else np.isnan(columns[:, 0]).any(axis=1)
    model = problem.model
    if missing.any() and not model.coarse and model.is_body(*problem.split(theta, effects)):
        problem = replace(problem, model=model.with_coarse_bodies())
        residual = problem.residual(theta, effects)
    exclusive = []
    start = len(problem.model.calibrations)
    for candidate in effects:
        coordinates = np.arange(start, start + candidate.size)
        start += candidate.size
        other_effects = [c.effect for c in effects if c is not candidate]
        channel_masks = exclusive_channels(candidate, other_effects, problem.model.channels)
        if channel_masks is not None and candidate.size > 1:
            exclusive.append((coordinates, channel_masks))
    # Whitening spreads a channel's change to others where frames have errors of a rig.
    whitening, blocks = problem.whitening, []
    if whitening.by_channel:
        single_channel = [pair for pair in exclusive if (pair[1].sum(axis=1) == 1).all()]
        blocks = [(coordinates, masks.argmax(axis=1)) for coordinates, masks in single_channel]
    if columns is None:
        size = len(theta) - sum(len(coordinates) for coordinates, _ in blocks)
        empty = [Block(*block, np.zeros(shape)) for block in blocks]
        slopes = Jacobian(np.empty((size, *shape)), empty)
    else:
        slopes = Jacobian.from_full(columns, blocks)
    members, member_columns = problem.model.member_columns
    if len(members):
        rows = np.searchsorted(slopes.column_coordinates, members)
        slopes.columns[rows] = in_groups(whitening, member_columns)
        missing[members] = False
    for coordinates, channel_masks in exclusive:
        if missing[coordinates].any():
            joint_column = derivative(problem, theta, effects, residual, coordinates)
            if whitening.by_channel:
                slopes.set_columns(coordinates, channel_masks, joint_column)
            else:
                separate_columns = channel_masks[:, None, :] * whitening.unwhitened(joint_column)
                rows = np.searchsorted(slopes.column_coordinates, coordinates)
                slopes.columns[rows] = in_groups(whitening, separate_columns)
            missing[coordinates] = False
    for i in np.flatnonzero(missing):
        all_channels = np.ones((1, shape[1]), bool)
        column = derivative(problem, theta, effects, residual, int(i))
        slopes.set_columns(np.array([i]), all_channels, column)
    return slopes
