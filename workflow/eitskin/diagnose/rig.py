"""What every rig adds and nobody wants named: sizes learned from the recording.

A component is an error of known form and unknown size: an amplitude of the source that jitters, a
robot that misses, a load cell that wanders. Its columns are what one unit of it does to the
readings, about a fit. The sizes are those of the greatest marginal likelihood under half-normal
priors in bench units (Fisher scoring: Harville, JASA 72, 1977); a component that the recording does
not ask for has size 0. They are learned again for every set of effects: an error that is alike in
all presses is an effect's, one that differs from press to press is the rig's.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import nnls

from eitskin.diagnose.fit import Fit, Problem
from eitskin.diagnose.simulator import RecordingSimulator
from eitskin.diagnose.whitening import ORDER, RigErrors, Whitening
from eitskin.errors import InputError

STEP_MM = 0.05  # of a place, inwards
STEP_FORCE = 0.02  # of a force, downwards; of the largest upwards, where it is less than that
WALKS = 12  # sine waves of a random walk (Karhunen-Loeve)
SLOW_WALKS = 6  # of a channel's own, or of a force's zero
ROUNDS, REFITTED = 8, 2  # of Fisher scoring; where a component is taken out
LEAST_SHARE = 0.05  # of a step of it, that is tried
WITHIN = 1.6449  # sd: 90 % of a normal distribution
MOST_SPREAD = 2.0  # sd of the logarithm of a variance that an interval tells
# Quadrature adds its square, whose tail is exponential: a channel is told from the others by as
# much as outweighs that.
TAIL = 2.5
MOST = 3.0  # times the prior's sd: more is no ordinary rig
HARDLY = 0.5  # nats that a component must be worth
PLAINLY = 4.0  # nats, by the quadratic of its scoring, from which it is not tried without ...
SAME = 1.25  # ... nor where its size is what it was, within this factor
ROUNDING = 1e-9  # least eigenvalue of an information at a diagonal of ones
SETTLED = 0.05  # nats, by which another round may still raise the likelihood
LEAST_FRAMES = 6  # of touches, fewer of which show no scatter
LEAST_PRESSES = 3
# Sizes up to which readings follow a stray in proportion.
STRAIGHT = {"place-per-frame": 0.1, "place-per-press": 0.1, "force-per-press": 0.03}


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

    @classmethod
    def about(cls, fit: Fit, plain: Whitening, rounding: float) -> "Rig":
        """The components that a recording can have, about a fit; rounding: as of `Noise`."""
        voltage = fit.voltage()
        level = _level(fit.problem)
        tangents = _tangents(fit, voltage)
        courses = _courses(fit.problem.model) if tangents else {}
        columns = dict(_columns(fit.problem.model, voltage, rounding))
        for name, own in courses.items():
            columns[name] = np.array([course[:, None] * tangents[key] for key, course in own])
        scales = {
            name: COMPONENTS[name].scale * (level if COMPONENTS[name].reading else 1.0)
            for name in columns
        }
        columns = {k: np.where(plain.mask, v, 0.0) for k, v in columns.items()}
        model = fit.problem.model
        label = np.where(model.touched & model.known, model.press, -1)
        few = len(np.unique(label[label >= 0])) < LEAST_PRESSES
        own = ("place-per-press", "force-per-press", "force-zero-walk")
        assumed = frozenset(name for name in own if few and name in columns)
        return cls(plain, columns, scales, tangents, courses, label, assumed)

    @property
    def of_press(self) -> np.ndarray:
        """(B, N): whether a frame is of a press."""
        return (np.unique(self.label[self.label >= 0])[:, None] == self.label).astype(float)

    def whitening(
        self, sizes: Mapping[str, float], discrepancy: bool = True, tail: float = 1.0
    ) -> Whitening:
        """The covariance with components of these sizes, quadrature's `tail` times as wide."""
        parts = {"channel": [], "frame": [], "whole": [], "press": []}
        for name, size in sizes.items():
            one = COMPONENTS[name]
            if size > 0.0 and (discrepancy or not one.discrepancy):
                wide = tail if name == "quadrature" else 1.0
                parts[one.each].append(wide * size * self.columns[name])
        empty = np.zeros((0, *self.plain.mask.shape))
        if not any(parts.values()):
            return self.plain
        found = {k: np.concatenate([empty, *v]) for k, v in parts.items()}
        return replace(self.plain, errors=RigErrors(**found, label=self.label))

    def log_prior(self, sizes: Mapping[str, float]) -> float:
        """Log density of sizes, above that of none."""
        return -0.5 * sum((size / self.scales[name]) ** 2 for name, size in sizes.items())

    def log_likelihood(self, sizes: Mapping[str, float], residual: np.ndarray) -> float:
        """Log density of a residual (N, M) in the recording's unit, with the prior of the sizes,
        up to a constant that is the same for all sizes."""
        whitening = self.whitening(sizes)
        chi2 = float((whitening(residual) ** 2).sum())
        return -0.5 * (chi2 + whitening.log_determinant) + self.log_prior(sizes)

    def strays(self, sizes: Mapping[str, float], residual: np.ndarray) -> dict[str, np.ndarray]:
        """By how much the places (mm) and forces (N) of the frames are off, (N,) each, by their
        columns of the states: what is to be expected, given a residual (N, M). Empty where errors
        are so small that readings follow them in proportion."""
        if all(sizes.get(name, 0.0) < most for name, most in STRAIGHT.items()):
            return {}
        whitening = self.whitening(sizes)
        white = whitening(residual)
        found = {key: np.zeros(len(residual)) for key in self.tangents}
        for name, courses in self.courses.items():
            if sizes.get(name, 0.0) > 0.0:
                each = COMPONENTS[name].each
                if each == "whole":
                    products = whitening(self.columns[name]) * white
                else:
                    columns = whitening.entered(self.columns[name], each)
                    products = columns * whitening.left(white, each)
                along = _summed(products, each, self.of_press)
                along = sizes[name] ** 2 * along
                if each == "press":
                    along = along @ self.of_press
                for (key, course), size in zip(courses, along, strict=True):
                    found[key] += size * course
        return found

    def followed(self, strays: Mapping[str, np.ndarray]) -> np.ndarray:
        """(N, M): what strays (N,) change in the readings, in proportion."""
        return sum(step[:, None] * self.tangents[key] for key, step in strays.items())

    def learned(
        self, residual: np.ndarray, start: Mapping[str, float]
    ) -> tuple[dict[str, float], float]:
        """Sizes of the greatest likelihood of a residual (N, M), from a start, and that likelihood;
        0 of what it hardly asks for."""
        sizes = {name: float(start.get(name, 0.0)) for name in self.columns}
        sizes |= {name: self.scales[name] for name in self.assumed}
        free = [name for name in self.columns if name not in self.assumed]
        sizes, best, worth = self._climbed(residual, sizes, free, ROUNDS if free else 0)
        for name in sorted(free, key=lambda k: sizes[k] / self.scales[k]):
            same = sizes[name] < SAME * start.get(name, 0.0) < SAME**2 * sizes[name]
            if sizes[name] > 0.0 and worth.get(name, 0.0) < PLAINLY and not same:
                without = {**sizes, name: 0.0}
                others = [other for other in free if without[other] > 0.0]
                found = self.log_likelihood(without, residual)
                if found <= best - HARDLY and others:
                    without, found, _ = self._climbed(residual, without, others, REFITTED)
                if found > best - HARDLY:
                    sizes, best = without, found
        left = [name for name in free if sizes[name] > 0.0]
        sizes, best, _ = self._climbed(residual, sizes, left, REFITTED if left else 0)
        return sizes, best

    def _climbed(
        self, residual: np.ndarray, sizes: dict[str, float], free: list[str], rounds: int
    ) -> tuple[dict[str, float], float, dict[str, float]]:
        """Sizes after rounds of Fisher scoring of those that are free, their likelihood, and what
        each is worth, as of `_scored`."""
        best, worth = self.log_likelihood(sizes, residual), {}
        for _ in range(rounds):
            target, worth = self._scored(sizes, residual, free)
            before = best
            sizes, best = self._nearer(residual, sizes, best, target)
            if best - before < SETTLED:
                break
        return sizes, best, worth

    def _nearer(
        self,
        residual: np.ndarray,
        sizes: dict[str, float],
        best: float,
        target: Mapping[str, float],
    ) -> tuple[dict[str, float], float]:
        """Sizes as far on their way to others as the likelihood rises above `best`, and it."""
        share = 1.0
        while share > LEAST_SHARE:
            moved = {
                k: float(np.sqrt((1.0 - share) * sizes[k] ** 2 + share * v**2))
                for k, v in target.items()
            }
            found = self.log_likelihood({**sizes, **moved}, residual)
            if found > best:
                return {**sizes, **moved}, found
            share *= 0.3
        return sizes, best

    def findings(self, sizes: Mapping[str, float], residual: np.ndarray, unit: str) -> list[dict]:
        """Errors that a rig has, as diagnosis.json says them: name, unit, sd with its 90 % interval
        and whether it was learned; residual (N, M) in the recording's `unit`."""
        found, rho = [], self.plain.correlation
        if rho:
            # Of a coefficient from so many steps (Bartlett 1946).
            spread = WITHIN * np.sqrt((1.0 - rho**2) / self.plain.mask.sum())
            found.append(_finding("correlated-noise", "1", rho, rho - spread, rho + spread))
        names = [name for name in self.columns if sizes.get(name, 0.0) > 0.0]
        if not names:
            return found
        square = np.array([sizes[name] ** 2 for name in names])
        information = _Scored(self, sizes, residual, names).information * np.outer(square, square)
        # Of the variances' logarithms.
        variance = np.diag(np.linalg.pinv(information))
        for name, own in zip(names, variance, strict=True):
            one, size = COMPONENTS[name], sizes[name]
            factor = np.exp(WITHIN * 0.5 * min(np.sqrt(max(own, 0.0)), MOST_SPREAD))
            low, high = size / factor, size * factor
            if name == "quadrature":
                low, size, high = (np.sqrt(np.sqrt(2.0) * value) for value in (low, size, high))
            if name in self.assumed:
                low = high = size
            if not one.discrepancy:
                own_unit = unit if one.reading else one.unit
                told = name not in self.assumed
                found.append(_finding(name, own_unit, size, low, high, told))
        return found

    def _scored(
        self, sizes: Mapping[str, float], residual: np.ndarray, names: list[str]
    ) -> tuple[dict[str, float], dict[str, float]]:
        """The sizes of some components that Fisher scoring goes to from `sizes`, and how many nats
        each of those above 0 is worth there, to second order in its variance: at least, for the
        likelihood falls more steeply towards 0."""
        scored = _Scored(self, sizes, residual, names)
        slope, information = scored.slope, scored.information
        unit = np.array([self.scales[name] ** 2 for name in names])
        slope, information = slope * unit - 0.5, information * np.outer(unit, unit)
        start = np.array([sizes[name] ** 2 for name in names]) / unit
        each = np.sqrt(np.maximum(np.diag(information), ROUNDING))
        length, turn = np.linalg.eigh(information / np.outer(each, each))
        root = np.sqrt(np.maximum(length, ROUNDING))[:, None] * turn.T * each
        target = np.linalg.solve(root.T, information @ start + slope)
        most = [np.inf if COMPONENTS[name].discrepancy else MOST**2 for name in names]
        found = np.minimum(nnls(root, target)[0], most)
        there = np.flatnonzero(found)
        spread = np.diag(np.linalg.inv((root.T @ root)[np.ix_(there, there)]))
        worth = {
            names[i]: float(0.5 * found[i] ** 2 / own) for i, own in zip(there, spread, strict=True)
        }
        return dict(zip(names, np.sqrt(found * unit).tolist(), strict=True)), worth


def _finding(
    name: str, unit: str, size: float, low: float, high: float, learned: bool = True
) -> dict:
    values = {"sd": float(size), "low": float(low), "high": float(high)}
    return {"name": name, "unit": unit, **values, "learned": learned}


class _Scored:
    """Score (C,) and expected information (C, C) of the components' variances."""

    def __init__(
        self, rig: Rig, sizes: Mapping[str, float], residual: np.ndarray, names: list[str]
    ):
        whitening = rig.whitening(sizes)
        white, of_press = whitening(residual), rig.of_press
        entered = {n: whitening.entered(rig.columns[n], COMPONENTS[n].each) for n in names}
        own = {n: self._white(whitening, COMPONENTS[n].each, entered[n]) for n in names}
        count = len(names)
        slope, self.information = np.zeros(count), np.zeros((count, count))
        for i, name in enumerate(names):
            each = COMPONENTS[name].each
            if each == "whole":
                along = _summed(own[name] * white, each, of_press)
            else:
                along = _summed(entered[name] * whitening.left(white, each), each, of_press)
            slope[i] = 0.5 * ((along**2).sum() - _trace(whitening, each, own[name], of_press))
            for j in range(i + 1):
                other = COMPONENTS[names[j]].each
                shared = _shared(own[names[j]], other, own[name], each, of_press)
                self.information[i, j] = self.information[j, i] = 0.5 * shared
        self.slope = slope

    @staticmethod
    def _white(whitening: Whitening, each: str, entered: np.ndarray) -> np.ndarray:
        """Unit columns, as they entered, when all that acts on the same readings is taken out."""
        found = entered
        for part in whitening.parts:
            if part.each == each or each == "whole":
                found = part.apply(found, part.root)
        return found


def _summed(products: np.ndarray, each: str, of_press: np.ndarray) -> np.ndarray:
    """(K, ...) sums of products (K, N, M) over what one error of a component acts on."""
    if each == "whole":
        return products.sum(axis=(1, 2))
    if each == "channel":
        return products.sum(axis=1)
    rows = products.sum(axis=2)
    return rows if each == "frame" else rows @ of_press.T


def _trace(whitening: Whitening, each: str, own: np.ndarray, of_press: np.ndarray) -> float:
    """Squared length of all unit columns, whitened: own (K, N, M) less what the parts have that
    come after what they act on."""
    total = float((own**2).sum())
    for part in whitening.parts:
        if ORDER.index(part.each) <= ORDER.index(each):
            continue
        less = -part.precision
        for k, unit in enumerate(part.columns):
            along = own * unit
            if part.each == "whole":
                total -= float((_summed(along, each, of_press) ** 2).sum() * less[0, k])
            elif each == "frame" and part.each == "press":
                total -= float(less[:, k] @ (of_press @ (along.sum(axis=2) ** 2).sum(axis=0)))
            elif each == "frame":
                total -= float((along**2 * less[:, k]).sum())
            else:
                pressed = np.einsum("bn,knm->kbm", of_press, along, optimize=True)
                total -= float((pressed**2 * less[:, k]).sum())
    return total


def _shared(a: np.ndarray, each_a: str, b: np.ndarray, each_b: str, of_press: np.ndarray) -> float:
    """Sum of the squared products of whitened unit columns (K, N, M)."""
    if ORDER.index(each_a) > ORDER.index(each_b):
        a, each_a, b, each_b = b, each_b, a, each_a
    if each_a == "whole":
        return float(((a.reshape(len(a), -1) @ b.reshape(len(b), -1).T) ** 2).sum())
    total = 0.0
    for column in a:
        products = column * b
        if each_a == each_b or each_b == "whole":
            found = _summed(products, each_a, of_press)
        elif each_a == "frame":
            # It meets a channel's error in one reading, a press's in one frame.
            found = products if each_b == "channel" else products.sum(axis=2)
        else:
            found = np.einsum("bn,knm->kbm", of_press, products, optimize=True)
        total += float((found**2).sum())
    return total


def _level(problem: Problem) -> float:
    """Median |v| of what was recorded; of its noise, where that is more."""
    there = problem.whitening.mask
    recorded = np.median(np.abs(problem.recorded[there]))
    return float(max(recorded, np.median(problem.whitening.sd)))


def _columns(
    model: RecordingSimulator, voltage: np.ndarray, rounding: float
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
        name = "quadrature" if model.magnitude else "static-discrepancy"
        yield name, np.broadcast_to(np.abs(level), (1, *voltage.shape))
        if rounding:
            yield (
                "quantisation",
                np.array([own * np.ones(voltage.shape) for own in _alike(level, rounding)]),
            )
    if touched.any():
        yield "touch-discrepancy", np.where(touched[:, None], voltage - level, 0.0)[None]


def _alike(level: np.ndarray, rounding: float) -> Iterator[np.ndarray]:
    """(M,) masks of channels that rounding moves together: untouched levels (M,) that follow one
    another by less than it does."""
    order = np.argsort(level)
    label = np.cumsum(np.diff(level[order], prepend=level[order[0]]) > rounding)
    for one in range(label[-1] + 1):
        yield np.isin(np.arange(len(level)), order[label == one])


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


def _tangents(fit: Fit, voltage: np.ndarray) -> dict[str, np.ndarray]:
    """Derivatives (N, M) of readings by place and force of each frame's touch; none where nobody
    touches or the physics has none."""
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
    time = model.states["time_s"].to_numpy(float)
    if not np.isfinite(time).all() or np.ptp(time) <= 0.0:
        time = np.arange(len(time), dtype=float)
    share = (time - time[0]) / max(float(np.ptp(time)), 1e-9)
    rate = (np.arange(count)[:, None] + 0.5) * np.pi
    return np.sqrt(2.0) * np.sin(rate * share) / rate
