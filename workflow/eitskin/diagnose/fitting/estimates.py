"""Fitted values with their 90 % intervals.

The interval of a value at a bound of its range means nothing: `at_bound` says which bound.
"""

from typing import Protocol

import numpy as np

from eitskin.diagnose.fitting.candidates import Candidate
from eitskin.diagnose.fitting.fit import Problem
from eitskin.diagnose.fitting.simulator import Member
from eitskin.diagnose.noise.noise_model import NORMAL_90

DIFFERENCE_STEP = 1e-4  # of a coordinate: central differences of formulas, without a simulation
# High over low end of a 90 % interval: from the first on a size is not given in words; up to the
# second the amounts of a combination of parameters are stated.
UNINFORMATIVE_RATIO, INFORMATIVE_RATIO = 100.0, 4.0


class Fitted(Protocol):
    """What is needed of a fit."""

    @property
    def problem(self) -> Problem:
        """The problem that was fitted."""

    @property
    def effects(self) -> list[Candidate]:
        """The fitted effects."""

    @property
    def theta(self) -> np.ndarray:
        """(P,): the fitted coordinates."""

    @property
    def covariance(self) -> np.ndarray:
        """(P, P): of theta."""

    def coordinate_slice(self, index: int) -> slice:
        """The slice of theta with an effect's coordinates."""


def calibration(fit: Fitted) -> dict[str, dict]:
    """Of every calibration by name: value, low, high, unit; at_bound (low or high) where the value
    is at one."""
    covariance = fit.covariance
    intervals = {}
    for i, item in enumerate(fit.problem.model.calibrations):
        if isinstance(item, Member):
            continue
        half_width = NORMAL_90 * float(np.sqrt(covariance[i, i]))
        value, low, high = (item.value(fit.theta[i] + s * half_width) for s in (0, -1, 1))
        low, high = min(low, high), max(low, high)
        intervals[item.name] = {"value": value, "low": low, "high": high, "unit": item.unit}
        bound = item.at_bound(fit.theta[i])
        if bound is not None:
            intervals[item.name]["at_bound"] = bound
    return intervals


def length_scale(fit: Fitted) -> dict[str, float]:
    """The radius, mm, that stands for the size of a skin of which no length is known; empty where
    one is."""
    model = fit.problem.model
    radius_mm = model.nominal_skin.radius_mm
    return {"radius_mm": radius_mm} if model.is_scaleless and radius_mm is not None else {}


def estimates(fit: Fitted, index: int) -> dict[str, dict]:
    """Of every parameter of effect `index` by name: value, low, high, unit; at_bound where a value
    is at a bound (low or high, in a list None for neither). Lists have one value a site. Errors
    are propagated linearly, those of the logarithm where a parameter stays above 0.
    """
    effect, coordinates = fit.effects[index], fit.coordinate_slice(index)
    covariance, theta = fit.covariance[coordinates, coordinates], fit.theta[coordinates]
    values = effect.setting(theta).values
    neighbours = [
        [effect.setting(theta + sign * DIFFERENCE_STEP * unit).values for sign in (1, -1)]
        for unit in np.eye(effect.size)
    ]
    intervals = {}
    for key, parameter in effect.effect.parameters.items():
        if values[key] is None or (key in effect.start and parameter.neutral == values[key]):
            continue
        value = np.asarray(values[key], float)
        slope = np.array(
            [
                (np.asarray(up[key]) - np.asarray(down[key])) / (2 * DIFFERENCE_STEP)
                for up, down in neighbours
            ]
        ).reshape(effect.size, *value.shape)
        variance = np.einsum("p...,pq,q...->...", slope, covariance, slope)
        half_width = NORMAL_90 * np.sqrt(np.maximum(variance, 0.0))
        if parameter.low > 0 and not parameter.whole:
            low, high = value * np.exp(-half_width / value), value * np.exp(half_width / value)
        else:
            low, high = value - half_width, value + half_width
        low, high = (np.clip(end, parameter.low, parameter.high) for end in (low, high))
        low, high = np.minimum(low, value), np.maximum(high, value)
        bound = effect.at_bound(key, value)
        # A value near a lower bound that is neutral is a small one, and may be well determined.
        if parameter.neutral == parameter.low:
            bound[(bound == "low") & (low > parameter.low)] = None
        if effect.scope == "sparse" and value.shape == (1,):
            value, low, high, bound = value[0], low[0], high[0], bound[0]
        numbers = {"value": value.tolist(), "low": low.tolist(), "high": high.tolist()}
        intervals[key] = {**numbers, "unit": parameter.unit}
        if np.not_equal(bound, np.array(None)).any():
            listed = isinstance(bound, np.ndarray)
            intervals[key]["at_bound"] = bound.tolist() if listed else bound
    return intervals


def range_share(fit: Fitted, index: int) -> float:
    """Largest share of the range of a size of effect `index`, a parameter with a neutral value,
    that its 90 % interval holds, of several sites the least; of the logarithm where a parameter
    stays above 0. 0 where amounts are stated in the place of parameters."""
    intervals = estimates(fit, index)
    if amounts(fit, index, intervals):
        return 0.0
    shares = [0.0]
    for key, interval in intervals.items():
        parameter = fit.effects[index].effect.parameters[key]
        if parameter.neutral is None:
            continue
        scaled = np.log if parameter.low > 0 and not parameter.whole else np.asarray
        width = scaled(np.array(interval["high"])) - scaled(np.array(interval["low"]))
        shares.append(float((width / (scaled(parameter.high) - scaled(parameter.low))).min()))
    return max(shares)


def amounts(fit: Fitted, index: int, parameter_estimates: dict[str, dict]) -> dict[str, dict]:
    """The amounts of the combination of effect `index` by name: value, low, high, unit, with the
    errors of the logarithm propagated linearly.

    Those with an interval below INFORMATIVE_RATIO, and narrower than a parameter's, where some
    parameter's estimate holds its neutral value or is wider than INFORMATIVE_RATIO; none where a
    parameter is at a bound, or the effect has no combination.
    """
    effect, coordinates = fit.effects[index], fit.coordinate_slice(index)
    theta = fit.theta[coordinates]
    combination = effect.effect.combination
    if combination is None:
        return {}
    confounded = {
        key: parameter_estimates[key]
        for key in combination.parameters
        if key in parameter_estimates
    }
    undetermined = [
        _is_undetermined(estimate, effect.effect.parameters[key].neutral)
        for key, estimate in confounded.items()
    ]
    if not any(undetermined) or any("at_bound" in estimate for estimate in confounded.values()):
        return {}
    widest = max(_ratio(estimate) for estimate in confounded.values())

    def amounts_at(theta: np.ndarray) -> dict[str, tuple[float, str]]:
        return combination.amounts(effect.setting(theta).values)

    intervals = {}
    neighbours = [
        (amounts_at(theta + step), amounts_at(theta - step))
        for step in DIFFERENCE_STEP * np.eye(effect.size)
    ]
    for key, (value, unit) in amounts_at(theta).items():
        sides = np.array([[up[key][0], down[key][0]] for up, down in neighbours])
        # An amount below both its neighbours is at a minimum, and may be 0 there.
        if value <= 0.0 or (sides <= 0.0).any() or (sides.min(axis=1) > value).any():
            continue
        slope = np.log(sides[:, 0] / sides[:, 1]) / (2 * DIFFERENCE_STEP)
        variance = slope @ fit.covariance[coordinates, coordinates] @ slope
        half_width = NORMAL_90 * float(np.sqrt(max(variance, 0.0)))
        if 2.0 * half_width < np.log(min(INFORMATIVE_RATIO, widest)):
            low, high = value * np.exp(-half_width), value * np.exp(half_width)
            intervals[key] = {"value": value, "low": float(low), "high": float(high), "unit": unit}
    return intervals


def _is_undetermined(estimate: dict, neutral: float | None) -> bool:
    """Whether the interval of one value holds the neutral value, or is wider than
    INFORMATIVE_RATIO."""
    may_be_neutral = neutral is not None and estimate["low"] <= neutral <= estimate["high"]
    return may_be_neutral or _ratio(estimate) > INFORMATIVE_RATIO


def _ratio(estimate: dict) -> float:
    """High over low end of the interval of one value, infinite where it reaches 0."""
    return estimate["high"] / estimate["low"] if estimate["low"] > 0.0 else np.inf
