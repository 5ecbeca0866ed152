"""How large the errors are that every rig adds: learned from a recording, and said.

Sizes are those of the greatest marginal likelihood under half-normal priors in bench units (Fisher
scoring: Harville, JASA 72, 1977); a component that the recording does not ask for has size 0. They
are learned again for every set of effects: an error that is alike in all presses is an effect's,
one that differs from press to press is the rig's.
"""

from collections.abc import Mapping

import numpy as np
from scipy.optimize import nnls

from eitskin import cores
from eitskin.diagnose.fitting.estimates import NORMAL_90
from eitskin.diagnose.noise.estimate import Noise
from eitskin.diagnose.noise.rig import COMPONENTS, Rig, summed
from eitskin.diagnose.noise.whitening import ORDER, Whitening, met

ROUNDS, REFITTED = 8, 2  # of Fisher scoring; where a component is taken out
LEAST_SHARE = 0.05  # of a step of it, that is tried
MOST_SPREAD = 2.0  # sd of the logarithm of a variance that an interval tells
MOST = 3.0  # times the prior's sd: more is no ordinary rig
HARDLY = 0.5  # nats that a component must be worth
# A component is not tried without where it is worth so many nats, by the quadratic of its scoring,
# or has the size at which the climb began, within a factor.
PLAINLY, SAME = 4.0, 1.25
ROUNDING = 1e-9  # least eigenvalue of an information at a diagonal of ones
KEPT_BYTES = 1 << 27  # a scoring that is larger is not kept
SETTLED = 0.05  # nats, by which another round may still raise the likelihood


def learned(
    rig: Rig,
    residual: np.ndarray,
    start: Mapping[str, float],
    kept: "KeptScoring | None" = None,
    ended: "KeptScoring | None" = None,
) -> tuple[dict[str, float], float]:
    """Sizes of the greatest likelihood of a residual (N, M), from a start, and that likelihood;
    0 of what it hardly asks for; kept: where the scoring at a start is kept; ended: where that at
    the end of the climb is to be kept, if there is one: at the sizes found, where no component is
    taken out."""
    sizes, free = _begun(rig, start)
    rounds = ROUNDS if free else 0
    sizes, best, worth = _climbed(rig, residual, sizes, free, rounds, kept, ended)
    climbed = sizes
    for name in sorted(free, key=lambda k: sizes[k] / rig.scales[k]):
        same = sizes[name] < SAME * start.get(name, 0.0) < SAME**2 * sizes[name]
        if sizes[name] > 0.0 and worth.get(name, 0.0) < PLAINLY and not same:
            without = {**sizes, name: 0.0}
            others = [other for other in free if without[other] > 0.0]
            there = rig.whitening(without)  # in use, so that a climb from it meets it again
            found = rig.log_likelihood(without, residual, there)
            if found <= best - HARDLY and others:
                without, found, _ = _climbed(rig, residual, without, others, REFITTED)
            del there
            if found > best - HARDLY:
                sizes, best = without, found
    left = [name for name in free if sizes[name] > 0.0]
    if sizes is not climbed and left:
        sizes, best, _ = _climbed(rig, residual, sizes, left, REFITTED)
    return sizes, best


def _begun(rig: Rig, start: Mapping[str, float]) -> tuple[dict[str, float], list[str]]:
    """Sizes of every component from which learning begins, and which of them are learned."""
    sizes = {name: float(start.get(name, 0.0)) for name in rig.columns}
    sizes |= {name: rig.scales[name] for name in rig.assumed}
    return sizes, [name for name in rig.columns if name not in rig.assumed]


def _climbed(
    rig: Rig,
    residual: np.ndarray,
    sizes: dict[str, float],
    free: list[str],
    rounds: int,
    kept: "KeptScoring | None" = None,
    ended: "KeptScoring | None" = None,
) -> tuple[dict[str, float], float, dict[str, float]]:
    """Sizes after rounds of Fisher scoring of those that are free, their likelihood, and what
    each is worth, as of `_scored`; kept: where the first scoring is kept; ended: where the last
    one is to be."""
    scoring = kept.at(rig, sizes, free) if kept is not None and rounds else None
    if ended is not None:
        ended.clear()
    here = rig.whitening(sizes) if scoring is None else scoring.whitening
    best = rig.log_likelihood(sizes, residual, here)
    worth: dict[str, float] = {}
    for _ in range(rounds):
        if scoring is None:
            scoring = Scoring(rig, here, free)
        target, worth, hoped = _scored(rig, sizes, scoring, residual, free)
        if hoped < SETTLED:
            if ended is not None:
                ended.keep(rig, sizes, free, scoring)
            break
        scoring = None  # the next one takes as much memory
        before = best
        sizes, here, best = _nearer(rig, residual, sizes, here, best, target, hoped)
        if best - before < SETTLED:
            break
    return sizes, best, worth


def _nearer(
    rig: Rig,
    residual: np.ndarray,
    sizes: dict[str, float],
    here: Whitening,
    best: float,
    target: Mapping[str, float],
    hoped: float,
) -> tuple[dict[str, float], Whitening, float]:
    """Sizes as far on their way to others as the likelihood rises above `best`, their whitening,
    and it; hoped: by how many nats it rises to second order on the whole way."""
    share = 1.0
    while share > LEAST_SHARE and share * (2.0 - share) * hoped > SETTLED:
        moved = {
            k: float(np.sqrt((1.0 - share) * sizes[k] ** 2 + share * v**2))
            for k, v in target.items()
        }
        moved = {**sizes, **moved}
        there = rig.whitening(moved)
        found = rig.log_likelihood(moved, residual, there)
        if found > best:
            return moved, there, found
        share *= 0.3
    return sizes, here, best


def findings(
    rig: Rig,
    sizes: Mapping[str, float],
    residual: np.ndarray,
    unit: str,
    noise: Noise | None = None,
) -> list[dict]:
    """Errors that a rig has, as diagnosis.json says them: name, unit, sd with its 90 % interval
    and whether it was learned; residual (N, M) in the recording's `unit`. noise: that of which the
    correlation in time is told."""
    found = []
    if noise is not None and noise.correlation:
        rho, spread = noise.correlation, NORMAL_90 * noise.correlation_sd(noise.correlation)
        low, high = max(rho - spread, -1.0), min(rho + spread, 1.0)
        found.append(_finding("correlated-noise", "1", rho, low, high))
    names = [name for name in rig.columns if sizes.get(name, 0.0) > 0.0]
    if not names:
        return found
    square = np.array([sizes[name] ** 2 for name in names])
    whitening = rig.whitening(sizes)
    information = Scoring(rig, whitening, names).information * np.outer(square, square)
    # Of the variances' logarithms.
    variance = np.diag(np.linalg.pinv(information))
    for name, own in zip(names, variance, strict=True):
        one, size = COMPONENTS[name], sizes[name]
        factor = np.exp(NORMAL_90 * 0.5 * min(np.sqrt(max(own, 0.0)), MOST_SPREAD))
        low, high = size / factor, size * factor
        if name == "quadrature":
            low, size, high = (np.sqrt(np.sqrt(2.0) * value) for value in (low, size, high))
        if name in rig.assumed:
            low = high = size
        if not one.discrepancy:
            own_unit = unit if one.reading else one.unit
            told = name not in rig.assumed
            found.append(_finding(name, own_unit, size, low, high, told))
    return found


def _scored(
    rig: Rig,
    sizes: Mapping[str, float],
    scoring: "Scoring",
    residual: np.ndarray,
    names: list[str],
) -> tuple[dict[str, float], dict[str, float], float]:
    """The sizes of some components that Fisher scoring goes to from `sizes`, at which it is; how
    many nats each of those above 0 is worth there, to second order in its variance: at least, for
    the likelihood falls more steeply towards 0; and by how many, to second order, they are likelier
    together."""
    slope, information = scoring.slope(residual), scoring.information
    unit = np.array([rig.scales[name] ** 2 for name in names])
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
    step = found - start
    hoped = float(slope @ step - 0.5 * step @ information @ step)
    return dict(zip(names, np.sqrt(found * unit).tolist(), strict=True)), worth, hoped


def _finding(
    name: str, unit: str, size: float, low: float, high: float, learned: bool = True
) -> dict:
    values = {"sd": float(size), "low": float(low), "high": float(high)}
    return {"name": name, "unit": unit, **values, "learned": learned}


class Scoring:
    """What scoring the variances of components takes beside a residual: found column by column
    (K,), those of one kind together, and summed over each component's own. information (C, C):
    what is to be expected of it. Where single precision will do it is found in that, and so is
    what depends on it: where a climb goes, and how far intervals of sizes reach. Likelihoods, which
    judge every step, are in double precision."""

    def __init__(self, rig: Rig, whitening: Whitening, names: list[str]):
        self.whitening, self.of_press = whitening, rig.of_press
        whitening, columns_of = whitening.in_single, rig.filtered
        self._unit = np.ones(len(names))  # of the variances
        if whitening is not self.whitening:
            columns_of, self.of_press = rig.in_single, self.of_press.astype(np.float32)
            self._unit = np.array([rig.scales[name] ** 2 for name in names])
        kinds = [
            (each, [i for i, name in enumerate(names) if COMPONENTS[name].each == each])
            for each in ORDER
        ]
        self.kinds = [(each, members) for each, members in kinds if members]

        def unit(kind: tuple[str, list[int]]) -> tuple[np.ndarray, np.ndarray]:
            each, members = kind
            columns = np.concatenate([columns_of[names[i]] for i in members])
            entered = whitening.entered(columns, each)
            own = self._white(whitening, each, entered)
            return own if each == "whole" else entered, own

        def starts(members: list[int]) -> np.ndarray:
            counts = [len(rig.columns[names[i]]) for i in members]
            return np.cumsum([0, *counts[:-1]])

        units = cores.threaded(unit, self.kinds)
        self._starts = [starts(members) for _, members in self.kinds]
        self._along = [along for along, _ in units]
        pairs = [(a, b) for a in range(len(units)) for b in range(a, len(units))]

        def shared(pair: tuple[int, int]) -> np.ndarray:
            (a, own_a), (b, own_b) = ((self.kinds[i][0], units[i][1]) for i in pair)
            return _shared(own_a, a, own_b, b, self.of_press)

        def trace(number: int) -> np.ndarray:
            return _traces(whitening, self.kinds[number][0], units[number][1], self.of_press)

        self._traces = cores.threaded(trace, range(len(units)))
        self.information = np.zeros((len(names), len(names)))
        for (a, b), found in zip(pairs, cores.threaded(shared, pairs), strict=True):
            (_, left), (_, right) = self.kinds[a], self.kinds[b]
            total = np.add.reduceat(found, self._starts[a])
            total = np.add.reduceat(total, self._starts[b], axis=1)
            self.information[np.ix_(left, right)] = 0.5 * total
            self.information[np.ix_(right, left)] = 0.5 * total.T
        self.information /= np.outer(self._unit, self._unit)

    @property
    def nbytes(self) -> int:
        """Bytes of its columns, and about those of the whitening."""
        errors = self.whitening.errors
        of_rig = (
            []
            if errors is None
            else [v for v in vars(errors).values() if isinstance(v, np.ndarray)]
        )
        return sum(one.nbytes for one in self._along) + 2 * sum(one.nbytes for one in of_rig)

    def slope(self, residual: np.ndarray) -> np.ndarray:
        """(C,): score of the variances for a residual (N, M)."""
        white = self.whitening(residual)

        def squares(number: int) -> np.ndarray:
            each, columns = self.kinds[number][0], self._along[number]
            left = white if each == "whole" else self.whitening.left(white, each)
            along = summed(columns * left.astype(columns.dtype), each, self.of_press)
            along = (along[:, None] if each == "whole" else along).astype(float)
            return (along**2).sum(axis=1) - self._traces[number]

        found = np.zeros(len(self.information))
        squared = cores.threaded(squares, range(len(self.kinds)))
        for (_, members), own, first in zip(self.kinds, squared, self._starts, strict=True):
            found[members] = 0.5 * np.add.reduceat(own, first)
        return found / self._unit

    @staticmethod
    def _white(whitening: Whitening, each: str, entered: np.ndarray) -> np.ndarray:
        """Unit columns, as they entered, when all that acts on the same readings is taken out."""
        found = entered
        for part in whitening.parts:
            if part.each == each or each == "whole":
                found = part.apply(found, part.root)
        return found


class KeptScoring:
    """A scoring at sizes from which learning begins: many fits begin from one state, and the next
    round where the last one ended."""

    def __init__(self) -> None:
        self._last: tuple[Rig, dict[str, float], list[str], Scoring] | None = None

    def prepare(self, rig: Rig, start: Mapping[str, float]) -> None:
        """Finds the scoring with which `learned` begins at a start."""
        sizes, free = _begun(rig, start)
        if free:
            self.at(rig, sizes, free)

    def at(self, rig: Rig, sizes: dict[str, float], names: list[str]) -> Scoring:
        """The scoring of some components of a rig at sizes."""
        if self._last is not None:
            own, at, of, scoring = self._last
            if own is rig and at == sizes and of == names:
                return scoring
            self._last = None
        scoring = Scoring(rig, rig.whitening(sizes), names)
        self.keep(rig, sizes, names, scoring)
        return scoring

    def clear(self) -> None:
        """Lets go of the scoring."""
        self._last = None

    def keep(self, rig: Rig, sizes: dict[str, float], names: list[str], scoring: Scoring) -> None:
        """Keeps a scoring as the last, unless it is too large."""
        self._last = None
        if scoring.nbytes < KEPT_BYTES:
            self._last = rig, dict(sizes), list(names), scoring


def _traces(whitening: Whitening, each: str, own: np.ndarray, of_press: np.ndarray) -> np.ndarray:
    """(K,): squared length of unit columns, whitened: own (K, N, M) less what the parts have that
    come after what they act on."""
    square = own**2
    total = square.sum(axis=(1, 2))
    for part in whitening.parts:
        if ORDER.index(part.each) <= ORDER.index(each):
            continue
        less = -part.precision
        if part.each != "channel":
            shared = met(own, part.columns, each, of_press) ** 2
            if part.each == "press":
                shared = np.tensordot(of_press, shared, axes=1)
            total -= (shared * less[:, None]).sum(axis=(0, 2))
        elif each == "frame":
            # It meets a channel's error in one reading alone.
            share = np.einsum("knm,mk->nm", part.columns**2, less)
            total -= np.einsum("jnm,nm->j", square, share)
        else:
            for k, one in enumerate(part.columns):
                pressed = np.einsum("bn,jnm->jbm", of_press, own * one, optimize=True)
                total -= np.einsum("jbm,m->j", pressed**2, less[:, k])
    return total


def _shared(
    a: np.ndarray, each_a: str, b: np.ndarray, each_b: str, of_press: np.ndarray
) -> np.ndarray:
    """(J, K): sums of the squared products of whitened unit columns a (J, N, M) and b (K, N, M), a
    of what is taken out no later than b."""
    if each_a == each_b or each_b != "channel":
        return (met(a, b, each_a, of_press).astype(float) ** 2).sum(axis=0)
    if each_a == "frame":
        # It meets a channel's error in one reading alone.
        return (a**2).reshape(len(a), -1) @ (b**2).reshape(len(b), -1).T
    found = []
    for column in a:
        pressed = np.einsum("bn,knm->kbm", of_press, column * b, optimize=True)
        found.append((pressed**2).sum(axis=(1, 2)))
    return np.array(found)
