"""Calibrations and effects fitted together: nonlinear least squares on whitened residuals."""

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace

import numpy as np
from scipy.special import erf

from eitskin.diagnose.fitting.candidates import Candidate, own_channels
from eitskin.diagnose.fitting.jacobian import Block, Jacobian, in_groups
from eitskin.diagnose.fitting.simulator import RecordingSimulator
from eitskin.diagnose.noise.whitening import Whitening
from eitskin.effects.effect import Setting
from eitskin.errors import InputError

STEP = 1e-3
MOST_ROUNDS = 30
STALE = 2  # steps in vain, the second a shorter one, for which the Jacobian is found anew
ENOUGH = 0.02  # of chi squared, where a fit ends at its optimum; intervals are 1
NEARLY = 0.2  # where it need not
ROUGH = 3e-5  # of the misfit: where much is missing, less is enough
RENEWALS = 1  # of the Jacobian, in a fit that need not end at its optimum
FARTHEST = 3.0  # a coordinate's step
HOPE = 2.0  # times the decrease that a linear model promises
WIDE = 30.0  # sd of an effect's coordinate while it is fitted: a guard, no opinion
ROUNDING = 1e-14  # of a precision's eigenvalues beside its diagonal


@dataclass(frozen=True)
class Problem:
    """What is fitted: recorded readings (N, M), their simulator, their covariance."""

    model: RecordingSimulator
    recorded: np.ndarray
    whitening: Whitening

    def residual(self, theta: np.ndarray, effects: list[Candidate]) -> np.ndarray:
        """(N, M) whitened recording minus simulation; InputError where the physics has none."""
        with np.errstate(invalid="ignore"):
            return self.whitening(self.recorded - self.voltage(theta, effects))

    def voltage(self, theta: np.ndarray, effects: list[Candidate]) -> np.ndarray:
        """(N, M): the readings to be expected; of magnitudes with noise, the mean of a folded
        normal distribution (Leone, Nelson, Nottingham, Technometrics 3, 1961)."""
        simulated = self.model.voltage(*self.split(theta, effects))
        if not self.model.magnitude or self.model.difference:
            return simulated
        over = simulated / (np.sqrt(2.0) * self.whitening.sd)
        noise = np.sqrt(2.0 / np.pi) * self.whitening.sd
        return simulated * erf(over) + noise * np.exp(-(over**2))

    def split(self, theta: np.ndarray, effects: list[Candidate]) -> tuple[np.ndarray, list]:
        """Calibration coordinates (P,), and the effects' settings."""
        start = len(self.model.calibrations)
        knobs, settings = theta[:start], []
        for candidate in effects:
            settings.append(candidate.setting(theta[start : start + candidate.size]))
            start += candidate.size
        return knobs, settings


@dataclass(frozen=True)
class Fit:
    """A set of effects fitted: theta (P,) the calibrations' coordinates, then each effect's;
    residual (N, M) whitened; slopes, minus the residual's derivative; ended: whether not for the
    number of rounds alone."""

    problem: Problem
    effects: list[Candidate]
    theta: np.ndarray
    residual: np.ndarray
    slopes: Jacobian
    ended: bool = True
    chi2: float = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "chi2", float((self.residual**2).sum()))

    @property
    def cost(self) -> float:
        """Chi squared, and what the prior adds."""
        return float(self.chi2 + self.prior @ self.theta**2)

    @property
    def misfit(self) -> np.ndarray:
        """(N, M): readings less the fit's, in the recording's unit; 0 where there are none."""
        return np.where(self.problem.whitening.mask, self.problem.recorded - self.voltage(), 0.0)

    @property
    def prior(self) -> np.ndarray:
        """(P,): the prior's precision of each coordinate."""
        return _prior(self.problem, len(self.theta))

    @property
    def information(self) -> np.ndarray:
        """(P, P): the data's, without the prior's."""
        return self.slopes.gram()

    @property
    def jacobian(self) -> np.ndarray:
        """(P, N, M): minus the residual's derivative by every coordinate."""
        return self.slopes.full()

    @property
    def root(self) -> np.ndarray:
        """(P, P): of the covariance of theta, as of `inverse_root`."""
        return inverse_root(self.information + np.diag(self.prior))

    @property
    def covariance(self) -> np.ndarray:
        """(P, P) of theta."""
        root = self.root
        return root @ root.T

    def place(self, index: int) -> slice:
        """Where the coordinates of effect `index` stand in theta."""
        start = len(self.problem.model.calibrations)
        start += sum(candidate.size for candidate in self.effects[:index])
        return slice(start, start + self.effects[index].size)

    def settings(self) -> list[Setting]:
        """The effects at their fitted values."""
        return self.problem.split(self.theta, self.effects)[1]

    def voltage(self) -> np.ndarray:
        """(N, M): what the fit has for the recording."""
        return self.problem.voltage(self.theta, self.effects)

    def without(self, index: int) -> np.ndarray:
        """(N, M): what is simulated without effect `index`, the others as they are fitted;
        InputError where no skin has the rest alone."""
        knobs, chosen = self.problem.split(self.theta, self.effects)
        return self.problem.model.voltage(knobs, chosen[:index] + chosen[index + 1 :])


def inverse_root(precision: np.ndarray) -> np.ndarray:
    """(P, P): R of a symmetric precision (P, P), R Rᵀ its inverse. Rounding may have left it not
    positive: no eigenvalue, at a diagonal of ones, counts as less than ROUNDING."""
    scale = 1.0 / np.sqrt(np.diag(precision))
    values, vectors = np.linalg.eigh(precision * np.outer(scale, scale))
    return scale[:, None] * vectors / np.sqrt(np.maximum(values, ROUNDING))


def _prior(problem: Problem, size: int) -> np.ndarray:
    knobs = len(problem.model.calibrations)
    return np.r_[np.ones(knobs), np.full(size - knobs, WIDE**-2)]


def derivative(
    problem: Problem,
    theta: np.ndarray,
    effects: list[Candidate],
    residual: np.ndarray,
    index: int | np.ndarray,
) -> np.ndarray:
    """(N, M): minus the residual's derivative by coordinate `index`, or by several together."""
    return -difference(lambda moved: problem.residual(moved, effects), theta, residual, index)


def difference(
    value: Callable[[np.ndarray], np.ndarray],
    theta: np.ndarray,
    there: np.ndarray,
    index: int | np.ndarray,
) -> np.ndarray:
    """Derivative of `value`, which is `there` at theta (P,), by coordinate `index`, or by several
    together: forwards, backwards where the physics has nothing ahead."""
    moved = theta.copy()
    moved[index] += STEP
    try:
        return (value(moved) - there) / STEP
    except InputError:
        moved[index] -= 2 * STEP
        return (there - value(moved)) / STEP


def fit(
    problem: Problem,
    effects: list[Candidate],
    start: np.ndarray,
    jacobian: np.ndarray | None = None,
    polish: bool = False,
    enough: float = np.inf,
    renewals: int | None = None,
) -> Fit:
    """Levenberg (1944) and Marquardt's (1963) method, the Jacobian kept up by Broyden's (1965).

    start (P,); jacobian (P, N, M) at the start, where it is known, NaN columns where it is not;
    polish: end with a fresh Jacobian, at its optimum, else near it; enough: give up where no cost
    below it is in sight; renewals: of the Jacobian on the way, at most; None: as many as a polish
    takes, else RENEWALS. A step into physics that has no solution is refused like one that does
    not help.
    """
    theta, prior = np.array(start, float), _prior(problem, len(start))
    residual = problem.residual(theta, effects)
    fresh = jacobian is None
    slopes = _slopes(problem, theta, effects, residual, jacobian)
    cost = (residual**2).sum() + prior @ theta**2
    dof = max(problem.whitening.size - len(theta), 1)
    damping, failed = 1e-6, 0
    if renewals is None:
        renewals = MOST_ROUNDS if polish else RENEWALS
    ended = True
    for _ in range(MOST_ROUNDS):
        information = slopes.gram() + np.diag(prior)
        slope = slopes.against(residual) - prior * theta
        lift = np.diag(damping * np.maximum(np.diag(information), 1e-12))
        step = np.linalg.solve(information + lift, slope)
        expected = float(2 * step @ slope - step @ information @ step)
        if cost - HOPE * max(expected, 0.0) > enough:
            break
        if expected < (ENOUGH if polish else NEARLY) + ROUGH * max(cost - dof, 0.0):
            if fresh or expected < 0 or (failed == 0 and not polish) or renewals == 0:
                break
            slopes = _slopes(problem, theta, effects, residual)
            fresh, failed, renewals = True, 0, renewals - 1
            continue
        step = np.clip(step, -FARTHEST, FARTHEST)
        try:
            moved = problem.residual(theta + step, effects)
        except InputError:
            moved = np.full_like(residual, np.inf)
        new_cost = (moved**2).sum() + prior @ (theta + step) ** 2
        if new_cost < cost:
            slopes.learn(step, residual - moved - slopes.along(step))
            useful = cost - new_cost > 0.25 * expected
            theta, residual, cost = theta + step, moved, new_cost
            damping = damping * (0.1 if useful else 3.0)
            fresh, failed = False, 0 if useful else failed + 1
        else:
            failed += 1
            if fresh or renewals == 0 or failed % STALE:
                damping = max(damping * 30.0, 1e-3)
                if damping > 1e6:
                    break
            else:
                slopes = _slopes(problem, theta, effects, residual)
                fresh, renewals = True, renewals - 1
    else:
        ended = False
    if polish and not fresh:
        slopes = _slopes(problem, theta, effects, residual)
    return Fit(problem, list(effects), theta, residual, slopes, ended)


def stepped(fitted: Fit, least: float = 0.0) -> Fit:
    """A fit after a step of Gauss and Newton, itself where that does not help, or promises to lower
    the cost by less than `least`; the slopes stay."""
    problem = fitted.problem
    root, along = _along(fitted)
    if along @ along < least:
        return fitted
    step = np.clip(root @ along, -FARTHEST, FARTHEST)
    try:
        residual = problem.residual(fitted.theta + step, fitted.effects)
    except InputError:
        return fitted
    moved = replace(fitted, theta=fitted.theta + step, residual=residual)
    return moved if moved.cost < fitted.cost else fitted


def promised(fitted: Fit) -> float:
    """By how much a step of Gauss and Newton promises to lower the cost."""
    _, along = _along(fitted)
    return float(along @ along)


def _along(fitted: Fit) -> tuple[np.ndarray, np.ndarray]:
    """The covariance's root (P, P), and the step of Gauss and Newton in its units (P,)."""
    slope = fitted.slopes.against(fitted.residual) - fitted.prior * fitted.theta
    root = fitted.root
    return root, root.T @ slope


def refreshed(fitted: Fit) -> Fit:
    """A fit with its slopes found anew where it is."""
    slopes = _slopes(fitted.problem, fitted.theta, fitted.effects, fitted.residual)
    return replace(fitted, slopes=slopes)


def whitened_anew(fitted: Fit, problem: Problem) -> Fit:
    """A fit's residual in another problem of the same readings, its slopes in that covariance."""
    if all(
        getattr(problem, one.name) is getattr(fitted.problem, one.name) for one in fields(problem)
    ):
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
    known: np.ndarray | None = None,
) -> Jacobian:
    """The Jacobian; of columns known (P, N, M), those that are NaN by differences. Coordinates that
    move channels of their own are moved together."""
    shape = residual.shape
    unknown = np.ones(len(theta), bool) if known is None else np.isnan(known[:, 0]).any(axis=1)
    apart = []
    start = len(problem.model.calibrations)
    for candidate in effects:
        place = np.arange(start, start + candidate.size)
        start += candidate.size
        others = [c.effect for c in effects if c is not candidate]
        own = own_channels(candidate, others, problem.model.channels)
        if own is not None and candidate.size > 1:
            apart.append((place, own))
    # Rig errors take a channel's change on to others.
    whitening, blocks = problem.whitening, []
    if whitening.by_channel:
        single = [pair for pair in apart if (pair[1].sum(axis=1) == 1).all()]
        blocks = [(place, own.argmax(axis=1)) for place, own in single]
    if known is None:
        size = len(theta) - sum(len(place) for place, _ in blocks)
        empty = [Block(*block, np.zeros(shape)) for block in blocks]
        slopes = Jacobian(np.empty((size, *shape)), empty)
    else:
        slopes = Jacobian.of(known, blocks)
    for place, own in apart:
        if unknown[place].any():
            together = derivative(problem, theta, effects, residual, place)
            if whitening.by_channel:
                slopes.put(place, own, together)
            else:
                alone = own[:, None, :] * whitening.unwhitened(together)
                slopes.columns[np.searchsorted(slopes.at, place)] = in_groups(whitening, alone)
            unknown[place] = False
    for i in np.flatnonzero(unknown):
        every = np.ones((1, shape[1]), bool)
        slopes.put(np.array([i]), every, derivative(problem, theta, effects, residual, int(i)))
    return slopes
