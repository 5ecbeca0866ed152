"""What every rig adds and nobody wants named: errors of known form, their sizes unknown.

An amplitude of the source that jitters, a robot that misses, a load cell that wanders: a
component's columns are what one unit of it does to the readings, about a fit. `rig_sizes` learns
how large they are.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from weakref import WeakValueDictionary

import numpy as np

from eitskin.data.recording import elapsed
from eitskin.diagnose.fitting.fit import Fit, Problem
from eitskin.diagnose.fitting.simulator import RecordingSimulator
from eitskin.diagnose.noise.whitening import RigErrors, Whitening, frames_of_presses
from eitskin.errors import InputError

STEP_MM = 0.05  # of a place, inwards
STEP_FORCE = 0.02  # of a force, downwards; of the largest upwards, where it is less than that
WALKS = 12  # sine waves of a random walk (Karhunen-Loeve)
SLOW_WALKS = 6  # of a channel's own, or of a force's zero
# Quadrature adds its square, whose tail is exponential: a channel is told from the others by as
# much as outweighs that.
TAIL = 2.5
LASTING = ("quadrature", "static-discrepancy", "touch-discrepancy")  # a value a channel
TOGETHER = ("amplitude-per-frame", "common-noise", "gain-walk")  # move a frame's readings as one
PHASES = 32  # of a converter's step
LEAST_FRAMES = 6  # of touches, fewer of which show no scatter
LEAST_PRESSES = 3


@dataclass(frozen=True)
class Component:
    """One kind of error: the unit of its size; scale: sd of its half-normal prior, of the median
    |v| where `reading`; each: what has an error of its own. A discrepancy is no rig's error: it
    stands for physics without a name, and never enters a verdict's chi squared."""

    name: str
    unit: str
    scale: float
    each: str
    reading: bool = False
    discrepancy: bool = False


COMPONENTS = {
    one.name: one
    for one in (
        Component("amplitude-per-frame", "1", 2e-3, "frame"),
        Component("common-noise", "V", 2e-3, "frame", reading=True),
        Component("place-per-frame", "mm", 1.0, "frame"),
        Component("force-per-frame", "N", 0.1, "frame"),
        Component("place-per-press", "mm", 1.0, "press"),
        Component("force-per-press", "1", 0.1, "press"),
        Component("gain-walk", "1", 1e-2, "whole"),
        Component("force-zero-walk", "N", 0.2, "whole"),
        Component("quantisation", "V", 1.0, "whole", reading=True),
        Component("channel-drift", "V", 2e-3, "channel", reading=True),
        Component("quadrature", "1", 2e-3, "channel"),
        Component("static-discrepancy", "1", 2e-2, "channel", discrepancy=True),
        Component("touch-discrepancy", "1", 0.2, "channel", discrepancy=True),
    )
}


@dataclass(frozen=True)
class Rig:
    """Components about a fit: columns (K, N, M) of one unit each, by name; `plain`: the covariance
    without them; scales: the priors' sd, in the columns' units. tangents (N, M): derivatives by
    columns of the states; courses: for each column of some components, along which of these the
    frames (N,) stray by its unit. label (N,): the press that a touch is of,
    -1 none. assumed: components of which the recording shows no scatter: they
    have the size of the prior's sd."""

    plain: Whitening
    columns: dict[str, np.ndarray]
    scales: dict[str, float]
    tangents: dict[str, np.ndarray]
    courses: dict[str, list[tuple[str, np.ndarray]]]
    label: np.ndarray
    assumed: frozenset[str]
    _made: WeakValueDictionary = field(
        default_factory=WeakValueDictionary, init=False, repr=False, compare=False
    )

    @classmethod
    def about(cls, fit: Fit, plain: Whitening, step: float) -> "Rig":
        """The components that a recording can have, about a fit; step: as of `Noise`."""
        voltage = fit.voltage()
        level = _level(fit.problem)
        slopes = tangents(fit, voltage)
        courses = {
            name: own
            for name, own in _courses(fit.problem.model).items()
            if all(key in slopes for key, _ in own)
        }
        columns = dict(_columns(fit.problem.model, voltage, step))
        for name, own in courses.items():
            columns[name] = np.array([course[:, None] * slopes[key] for key, course in own])
        scales = {
            name: COMPONENTS[name].scale * (level if COMPONENTS[name].reading else 1.0)
            for name in columns
        }
        columns = {k: np.where(plain.mask, v, 0.0) for k, v in columns.items()}
        model = fit.problem.model
        label = np.where(model.touched & model.known, model.press, -1)
        few = len(np.unique(label[label >= 0])) < LEAST_PRESSES
        scattered = ("place-per-press", "force-per-press", "force-zero-walk")
        assumed = frozenset(name for name in scattered if few and name in columns)
        return cls(plain, columns, scales, slopes, courses, label, assumed)

    def __getstate__(self) -> dict:
        found_anew = "_made", "filtered", "in_single"
        return {name: value for name, value in vars(self).items() if name not in found_anew}

    def __setstate__(self, state: dict) -> None:
        vars(self).update(state, _made=WeakValueDictionary())

    @cached_property
    def filtered(self) -> dict[str, np.ndarray]:
        """`columns` as of `Whitening.filtered`."""
        return {k: self.plain.filtered(v, COMPONENTS[k].each) for k, v in self.columns.items()}

    @cached_property
    def in_single(self) -> dict[str, np.ndarray]:
        """`filtered` of errors as large as the prior's sd, in single precision: in the recording's
        unit squares of squares would overflow."""
        own = self.filtered.items()
        return {k: (self.scales[k] * columns).astype(np.float32) for k, columns in own}

    @property
    def of_press(self) -> np.ndarray:
        """(B, N): whether a frame is of a press."""
        return frames_of_presses(self.label)

    def whitening(
        self, sizes: Mapping[str, float], discrepancy: bool = True, fitted: bool = False
    ) -> Whitening:
        """The covariance with components of these sizes; those that this rig has no columns for add
        nothing. fitted: as fits have it, quadrature TAIL times as wide and with its mean, errors
        of a channel that stay as they are linked, where frames or presses have any. One that was
        made here and is in use is given again, with what it has found."""
        there = {k: v for k, v in sizes.items() if v > 0.0 and k in self.columns}
        fitted = fitted and any(name in LASTING for name in there)
        key = discrepancy, fitted, *there.items()
        made = self._made.get(key)
        if made is None:
            self._made[key] = made = self._whitening(there, discrepancy, fitted)
        return made

    def _whitening(self, sizes: Mapping[str, float], discrepancy: bool, fitted: bool) -> Whitening:
        parts: dict[str, list[tuple[float, np.ndarray]]]
        parts = {"channel": [], "frame": [], "whole": [], "press": [], "linked": []}
        for name, size in sizes.items():
            one, unit = COMPONENTS[name], self.filtered[name]
            if discrepancy or not one.discrepancy:
                wide = TAIL if fitted and name == "quadrature" else 1.0
                each = "linked" if fitted and name in LASTING else one.each
                parts[each].append((wide * size, unit))
                if fitted and name == "quadrature":
                    # A square with a mean of sqrt(2) times less than its sd: all readings are more.
                    parts["whole"].append((size / np.sqrt(2.0), unit))
        if not parts["frame"] and not parts["press"]:
            parts["channel"] += parts.pop("linked")
        if not any(parts.values()):
            return self.plain
        found = {each: _scaled(own, self.plain.mask.shape) for each, own in parts.items()}
        return replace(self.plain, errors=RigErrors(**found, label=self.label, filtered=True))

    def log_prior(self, sizes: Mapping[str, float]) -> float:
        """Log density of sizes, above that of none."""
        return -0.5 * sum((sizes.get(name, 0.0) / own) ** 2 for name, own in self.scales.items())

    def log_likelihood(
        self,
        sizes: Mapping[str, float],
        residual: np.ndarray,
        whitening: Whitening | None = None,
    ) -> float:
        """Log density of a residual (N, M) in the recording's unit, with the prior of the sizes,
        up to a constant that is the same for all sizes; whitening: of these, where it is there."""
        whitening = whitening or self.whitening(sizes)
        chi2 = float((whitening(residual) ** 2).sum())
        return -0.5 * (chi2 + whitening.log_determinant) + self.log_prior(sizes)

    def spread(self, sizes: Mapping[str, float]) -> dict[str, np.ndarray]:
        """Sd (N,) with which touches stray, mm and N, by columns of the states."""
        found = {key: np.zeros(len(self.label)) for key in self.tangents}
        for name, courses in self.courses.items():
            for key, course in courses:
                found[key] += (sizes.get(name, 0.0) * course) ** 2
        return {key: np.sqrt(square) for key, square in found.items()}

    def alone(self, sizes: Mapping[str, float]) -> Whitening:
        """Each frame's covariance by itself with its touch where it is: noise, what moves its
        readings together, and the rms that the errors of a channel have. What physics without a
        name may explain no touch is followed for."""
        own = [sizes.get(n, 0.0) * self.columns[n] for n in TOGETHER if n in self.columns]
        none = np.zeros((0, *self.plain.mask.shape))
        variance = self.plain.sd**2
        count = np.maximum(self.plain.mask.sum(axis=0), 1)
        for name, columns in self.columns.items():
            if COMPONENTS[name].each == "channel":
                square = (sizes.get(name, 0.0) * columns) ** 2
                variance = variance + square.sum(axis=(0, 1)) / count
        errors = RigErrors(none, np.concatenate([none, *own]), none)
        still = np.zeros_like(self.plain.rho)
        return replace(self.plain, sd=np.sqrt(variance), rho=still, correlation=0.0, errors=errors)

    def followed(self, strays: Mapping[str, np.ndarray]) -> np.ndarray:
        """(N, M): what strays (N,) change in the readings, in proportion; 0 where the physics has
        no tangents."""
        moved = [strays[key][:, None] * tangent for key, tangent in self.tangents.items()]
        return sum(moved, start=np.zeros(self.plain.mask.shape))


def _scaled(columns: list[tuple[float, np.ndarray]], shape: tuple[int, ...]) -> np.ndarray:
    """(K, N, M): columns one after the other, each times its size."""
    found = np.empty((sum(len(own) for _, own in columns), *shape))
    start = 0
    for size, own in columns:
        np.multiply(own, size, out=found[start : start + len(own)])
        start += len(own)
    return found


def summed(products: np.ndarray, each: str, of_press: np.ndarray) -> np.ndarray:
    """(K, ...) sums of products (K, N, M) over what one error of a component acts on."""
    if each == "whole":
        return products.sum(axis=(1, 2))
    if each == "channel":
        return products.sum(axis=1)
    rows = products.sum(axis=2)
    return rows if each == "frame" else rows @ of_press.T


def _level(problem: Problem) -> float:
    """Median |v| of what was recorded; of its noise, where that is more."""
    there = problem.whitening.mask
    recorded = np.median(np.abs(problem.recorded[there]))
    return float(max(recorded, np.median(problem.whitening.sd)))


def _columns(
    model: RecordingSimulator, voltage: np.ndarray, step: float
) -> Iterator[tuple[str, np.ndarray]]:
    """(name, columns) of what one unit of every component of the readings does."""
    yield "amplitude-per-frame", voltage[None]
    yield "common-noise", np.ones((1, *voltage.shape))
    if len(voltage) >= LEAST_FRAMES:
        yield "gain-walk", _walk(model, WALKS)[:, :, None] * voltage
        yield "channel-drift", _walk(model, SLOW_WALKS)[:, :, None] * np.ones(voltage.shape)
    touched = model.touched & model.known
    level = np.zeros(voltage.shape[1])
    if not model.difference:
        still = voltage if touched.all() else voltage[~touched]
        level = still.mean(axis=0)
        if model.magnitude:
            # A channel's phase is the same in all frames.
            yield "quadrature", np.abs(voltage)[None]
        else:
            yield "static-discrepancy", np.broadcast_to(np.abs(level), (1, *voltage.shape))
        if step:
            yield "quantisation", _phases(voltage, step)
    if touched.any():
        yield "touch-discrepancy", np.where(touched[:, None], voltage - level, 0.0)[None]


def _phases(voltage: np.ndarray, step: float) -> np.ndarray:
    """(PHASES, N, M): 1 where a reading is to be expected in that part of a converter's step, else
    0. Those in one part are off alike, wherever the steps begin: rounding's mean error is periodic
    (Widrow, Kollar, Quantization Noise, 2008)."""
    part = np.floor(voltage / step * PHASES) % PHASES
    return (part == np.arange(PHASES)[:, None, None]).astype(float)


def _courses(model: RecordingSimulator) -> dict[str, list[tuple[str, np.ndarray]]]:
    """Along which column of the states, and how much in every frame (N,), touches stray by one unit
    of every column of a component."""
    touched = model.touched & model.known
    own, every = touched & (model.press >= 0), touched.astype(float)
    load = np.where(touched, model.states["force_N"].to_numpy(float), 0.0)
    found = {}
    if touched.sum() >= LEAST_FRAMES:
        found["place-per-frame"] = [("x_mm", every), ("y_mm", every)]
        found["force-per-frame"] = [("force_N", every)]
    if own.any():
        found["place-per-press"] = [("x_mm", every), ("y_mm", every)]
        found["force-per-press"] = [("force_N", every * load)]
        found["force-zero-walk"] = [("force_N", wave * every) for wave in _walk(model, SLOW_WALKS)]
    return found


def tangents(fit: Fit, voltage: np.ndarray) -> dict[str, np.ndarray]:
    """Derivatives (N, M) of a fit's readings `voltage` by place and force of each frame's touch;
    none by force where no touch has any, none at all where nobody touches or the physics has
    none."""
    model = fit.problem.model
    touched = model.touched & model.known
    knobs, chosen = fit.problem.split(fit.theta, fit.effects)
    if not touched.any():
        return {}
    force, most = model.states["force_N"].to_numpy(float), model.force_max_N
    steps = {
        key: np.where(model.states[key].to_numpy(float) > 0.0, -STEP_MM, STEP_MM)
        for key in ("x_mm", "y_mm")
    }
    if most > 0.0:
        steps["force_N"] = STEP_FORCE * np.where(force > STEP_FORCE * most, -force, most)
    found = {}
    for key, step in steps.items():
        try:
            there = model.displaced({key: step}).voltage(knobs, chosen)
        except InputError:
            return {}
        found[key] = np.where(touched[:, None], (there - voltage) / step[:, None], 0.0)
    return found


def _walk(model: RecordingSimulator, count: int) -> np.ndarray:
    """(count, N): the sine waves of a random walk over the recording from 0, of sd 1 at its end."""
    rate = (np.arange(count)[:, None] + 0.5) * np.pi
    return np.sqrt(2.0) * np.sin(rate * elapsed(model.states)) / rate
