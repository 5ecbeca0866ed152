"""Fitted values with their 90 % intervals.

Of a value that ended at a bound of what is tried the interval means nothing: `at_bound` says which.
"""

from typing import Protocol

import numpy as np

from eitskin.diagnose.fitting.candidates import Candidate
from eitskin.diagnose.fitting.fit import Problem
from eitskin.diagnose.noise.noise_model import NORMAL_90

NUDGE = 1e-4
UNTOLD = 100.0  # the end of a 90 % interval over its beginning, from which on it tells no size
TOLD = 4.0  # the same, up to which what several parameters come to is told


class Fitted(Protocol):
    """What is read of a fit."""

    @property
    def problem(self) -> Problem:
        """What was fitted."""

    @property
    def effects(self) -> list[Candidate]:
        """The effects fitted."""

    @property
    def theta(self) -> np.ndarray:
        """(P,): the coordinates."""

    @property
    def covariance(self) -> np.ndarray:
        """(P, P) of theta."""

    def place(self, index: int) -> slice:
        """Where an effect's coordinates are among theta."""


def calibration(fit: Fitted) -> dict[str, dict]:
    """Every calibration: value, low, high, unit; `at_bound` (low or high) where it ended at one."""
    covariance = fit.covariance
    found = {}
    for i, item in enumerate(fit.problem.model.calibrations):
        half = NORMAL_90 * float(np.sqrt(covariance[i, i]))
        value, low, high = (item.value(fit.theta[i] + s * half) for s in (0, -1, 1))
        low, high = min(low, high), max(low, high)
        found[item.name] = {"value": value, "low": low, "high": high, "unit": item.unit}
        bound = item.at_bound(fit.theta[i])
        if bound is not None:
            found[item.name]["at_bound"] = bound
    return found


def estimates(fit: Fitted, index: int) -> dict[str, dict]:
    """Every parameter of effect `index`: value, low, high, unit, `at_bound` (low or high, in a list
    None for neither) where one ended there; of several sites as lists parallel to them. By linear
    propagation, of the logarithm where a parameter stays above 0.
    """
    effect, place = fit.effects[index], fit.place(index)
    covariance, theta = fit.covariance[place, place], fit.theta[place]
    value = effect.setting(theta).values
    moved = [
        [effect.setting(theta + sign * NUDGE * unit).values for sign in (1, -1)]
        for unit in np.eye(effect.size)
    ]
    found = {}
    for key, parameter in effect.effect.parameters.items():
        if value[key] is None or (key in effect.start and parameter.neutral == value[key]):
            continue
        at = np.asarray(value[key], float)
        slope = np.array(
            [(np.asarray(up[key]) - np.asarray(down[key])) / (2 * NUDGE) for up, down in moved]
        ).reshape(effect.size, *at.shape)
        variance = np.einsum("p...,pq,q...->...", slope, covariance, slope)
        half = NORMAL_90 * np.sqrt(np.maximum(variance, 0.0))
        if parameter.low > 0 and not parameter.whole:
            low, high = at * np.exp(-half / at), at * np.exp(half / at)
        else:
            low, high = at - half, at + half
        low, high = (np.clip(bound, parameter.low, parameter.high) for bound in (low, high))
        low, high = np.minimum(low, at), np.maximum(high, at)
        ended = effect.at_bound(key, at)
        # Where nothing is the least that is tried, a value near it is small, and may be well known.
        least = ended == "low" if parameter.neutral == parameter.low else np.zeros(at.shape, bool)
        ended[least & (low > parameter.low)] = None
        if effect.scope == "sparse" and at.shape == (1,):
            at, low, high, ended = at[0], low[0], high[0], ended[0]
        numbers = {"value": at.tolist(), "low": low.tolist(), "high": high.tolist()}
        found[key] = {**numbers, "unit": parameter.unit}
        if np.not_equal(ended, np.array(None)).any():
            found[key]["at_bound"] = ended.tolist() if isinstance(ended, np.ndarray) else ended
    return found


def amounts(fit: Fitted, index: int, given: dict[str, dict]) -> dict[str, dict]:
    """What the parameters `apart` of effect `index` come to, value, low, high and unit, where that
    is told and they are not by their estimates `given`: one may be as well where its effect does
    nothing, or its interval is wider than TOLD; none where one ended at a bound. By linear
    propagation of the logarithm."""
    effect, place = fit.effects[index], fit.place(index)
    theta = fit.theta[place]
    apart = {key: given[key] for key in effect.effect.apart if key in given}
    vague = [_vague(each, effect.effect.parameters[key].neutral) for key, each in apart.items()]
    if not any(vague) or any("at_bound" in each for each in apart.values()):
        return {}
    widest = max(_ratio(each) for each in apart.values())

    def of(theta: np.ndarray) -> dict[str, tuple[float, str]]:
        return effect.effect.amounts(effect.setting(theta).values)

    found = {}
    moved = [(of(theta + unit), of(theta - unit)) for unit in NUDGE * np.eye(effect.size)]
    for key, (value, unit) in of(theta).items():
        sides = np.array([[up[key][0], down[key][0]] for up, down in moved])
        # What is less than both its neighbours is at a turn, where it may be nothing.
        if value <= 0.0 or (sides <= 0.0).any() or (sides.min(axis=1) > value).any():
            continue
        slope = np.log(sides[:, 0] / sides[:, 1]) / (2 * NUDGE)
        half = NORMAL_90 * float(np.sqrt(max(slope @ fit.covariance[place, place] @ slope, 0.0)))
        if 2.0 * half < np.log(min(TOLD, widest)):
            low, high = value * np.exp(-half), value * np.exp(half)
            found[key] = {"value": value, "low": float(low), "high": float(high), "unit": unit}
    return found


def _vague(estimate: dict, neutral: float | None) -> bool:
    """Whether one value may be that at which its effect does nothing, or is not TOLD."""
    nothing = neutral is not None and estimate["low"] <= neutral <= estimate["high"]
    return nothing or _ratio(estimate) > TOLD


def _ratio(estimate: dict) -> float:
    """The end of the interval of one value above 0 over its beginning."""
    return estimate["high"] / estimate["low"] if estimate["low"] > 0.0 else np.inf
