"""Objects in the later recording: discs that conduct otherwise than the skin that the control saw.

What a disc changes is simulated in full (no linearisation: metal and air are no small changes) on
an even sheet with point electrodes at the angles of the recording, and carried over to the rig as a
share of each reading: (v1 - v0) / v0 = (u1 - u0) / u0, v measured, u simulated. So what an
electrode, an amplifier or the depth of a tank does to a reading leaves the share as it is, to first
order; what depth does to the change itself stays an error. Where a simulated reading is next to
nothing, the share is taken of the overall scale instead. Boards that add one voltage to all
readings spoil such shares, so these are tried of the readings less a common offset too, and the way
that explains more with one object is taken.

Electrodes that moved, all by themselves, and a conductivity that rises across the skin are the
rivals that no fault of the instrument is: to first order, of the same sheet.

Conductivity inside over outside and radius hardly tell from one another where an object is small
or the ratio large: ratio r and radius a act through a² (r - 1) / (r + 1) (Seagar et al. 1987).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import comb, exp, log, sqrt
from typing import Any

import numpy as np
from scipy.optimize import OptimizeResult, least_squares

from eitskin.diagnose.compare.evidence import Evidence, Explained
from eitskin.diagnose.compare.faults import Signature
from eitskin.diagnose.compare.wander import Wander
from eitskin.errors import InputError
from eitskin.physics.forward import Accuracy, Forward, channel_values
from eitskin.physics.geometry import Geometry
from eitskin.physics.protocol import tied_channels
from eitskin.physics.touch import Touch, TouchAccuracy

# A thousandth of a change: a sheet for a tank is wrong by more.
ACCURACY = Accuracy(1, TouchAccuracy(8, 1e-3, 6, 1e-2), 1)
NAME, KIND = "conductivity-patch", "places"
MOST = 4  # objects
FREE = 4  # numbers of each: place, radius, ratio
AGREES = 0.8  # squared correlation of the control's readings with the sheet's
FAINT = 0.05  # of the median simulated reading, below which a share of it means nothing
WORTH = 0.1  # of the difference's square, that the best disc of the grid takes
BRINGS = 0.05  # of the difference's square, that one more object takes
EXPLAINS = 0.75  # of the difference's square beyond noise, that objects which are named take
RINGS = ((0.0, 1), (0.3, 8), (0.5, 12), (0.65, 16), (0.78, 24), (0.88, 32))
RADII = (0.08, 0.18)
LOG_RATIOS = (-4.0, -0.8, 0.8, 4.0)
LEAST_RADIUS, MOST_RADIUS = 0.03, 0.5
MOST_LOG_RATIO = 6.0
MOST_TURN = 9.0  # of the coordinates that keep a disc on the skin
ROOM = 0.98  # of the way to the rim, that a disc's edge comes to
APART = 0.1  # of the smaller radius, between two discs
STARTS = 2  # of each sign, for the first object; one for more
WIDE = 0.3  # radius of a disc that may be two
NEAR = 0.2  # starts closer than this are one
STEPS = 40
RISE = 0.02  # of the conductivity across the skin, for its tangent
BETTER = 1e-4  # of its square, that one more step of a fit must take
FOLDS = 5
PERCENT_90 = 1.645


@dataclass(frozen=True)
class Disc:
    """x, y, radius in units of the skin's radius; ratio: conductivity inside over outside."""

    x: float
    y: float
    radius: float
    ratio: float

    @property
    def conducts(self) -> bool:
        """Better than the skin."""
        return self.ratio > 1.0


@dataclass(frozen=True)
class Objects(Signature):
    """What discs change together, as a fault's signature; at (4 k,): their coordinates."""

    discs: tuple[Disc, ...] = ()
    at: np.ndarray = field(default_factory=lambda: np.zeros(0))


def objects_of(found: Explained) -> Objects:
    """The discs by which a difference is explained."""
    part = found.parts[0]
    assert isinstance(part, Objects)
    return part


class Sheet:
    """An even sheet of radius 1 with point electrodes, and what discs change of its readings.

    channels (M, 4); electrode_deg (n,); signed: whether readings are, else their sizes are taken.
    Channels of driven electrodes have no reading here: 0.
    """

    def __init__(self, channels: np.ndarray, electrode_deg: np.ndarray, signed: bool):
        self.channels, self.signed = channels, signed
        angle = np.asarray(electrode_deg, float)
        self.forward = Forward(
            Geometry(1.0, 1.0, 1.0, angle, np.array(0.0), np.array(0.0)), ACCURACY
        )
        values = channel_values(self.forward.transfer_impedance(), channels)
        self.known = np.isfinite(values)
        self.raw = np.where(self.known, values, 0.0)
        self.plain = self.raw if signed else np.abs(self.raw)

    def agrees(self, mean: np.ndarray, read: np.ndarray) -> bool:
        """Whether readings (M,), V, are such a sheet's, up to a factor."""
        here = read & self.known
        a, b = mean[here], self.plain[here]
        square = float(a @ a) * float(b @ b)
        return square > 0 and float(a @ b) > 0 and (a @ b) ** 2 > AGREES * square

    def gain(self, mean: np.ndarray, read: np.ndarray, offset: bool) -> np.ndarray:
        """(M,) V by which each channel's simulated change is multiplied; offset: whether a common
        one is taken off the readings before."""
        here = read & self.known
        columns = np.column_stack([self.plain, np.ones(len(mean))])[:, : 1 + offset]
        scale, *rest = np.linalg.lstsq(columns[here], mean[here], rcond=None)[0]
        mean = mean - sum(rest)
        faint = FAINT * float(np.median(np.abs(self.plain[here])))
        own = self.plain * (mean - scale * self.plain) / (self.plain**2 + faint**2)
        return np.where(here, scale + own, 0.0)

    def changed(self, discs: Sequence[Disc]) -> np.ndarray:
        """(M,): what discs change, per unit of gain. Raises InputError for ones that meet."""
        impedance = self.forward.transfer_impedance(_touches(discs))
        return self._read(channel_values(impedance, self.channels))

    def _read(self, values: np.ndarray) -> np.ndarray:
        values = np.where(self.known, values, 0.0)
        return (values if self.signed else np.abs(values)) - self.plain

    def slopes(self, discs: Sequence[Disc]) -> np.ndarray:
        """(M, 4 k): derivatives of `changed` by x, y, radius and ratio of each disc."""
        names = [
            f"{key}[{i}]"
            for i in range(len(discs))
            for key in ("x_mm", "y_mm", "radius_mm", "contrast")
        ]
        touches = _touches(discs)
        found = self.forward.derivatives(touches, names)
        columns = np.column_stack([channel_values(found[name], self.channels) for name in names])
        columns[~self.known] = 0.0
        if not self.signed:
            values = channel_values(self.forward.transfer_impedance(touches), self.channels)
            columns *= np.where(values < 0, -1.0, 1.0)[:, None]
        return columns

    @cached_property
    def tangents(self) -> dict[str, np.ndarray]:
        """(M, k), by name: what a shift of each electrode, and a rise of the conductivity along x
        and y, change, per unit."""
        names = [f"electrode_deg[{i}]" for i in range(self.forward.electrodes.n)]
        moved = self.forward.derivatives(parameters=names)
        geometry = self.forward.geometry
        tilted = [
            Forward(geometry.with_values(gradient_across=RISE, gradient_deg=angle), ACCURACY)
            for angle in (0.0, 90.0)
        ]
        rise = [(each.transfer_impedance() - self.forward.transfer_impedance()) for each in tilted]
        found = {"electrode-position": [moved[name] for name in names]}
        found["conductivity-gradient"] = [each / RISE for each in rise]
        sign = np.where(self.known & (self.signed | (self.raw >= 0)), 1.0, -1.0 * self.known)
        return {
            name: np.column_stack(
                [np.where(self.known, channel_values(z, self.channels), 0.0) * sign for z in all_]
            )
            for name, all_ in found.items()
        }

    @cached_property
    def grid(self) -> tuple[list[Disc], np.ndarray]:
        """Discs all over the skin, and what each changes (M, N)."""
        discs, columns = [], []
        ratios = np.exp(LOG_RATIOS)
        for share, count in RINGS:
            for k in range(count):
                place = share * np.exp(2j * np.pi * k / count)
                for radius in RADII:
                    if share + radius >= ROOM:
                        continue
                    found = self.forward.place(place.real, place.imag, radius)
                    change = found.impedance_change(ratios - 1.0)
                    change = change + self.forward.transfer_impedance()
                    columns += [self._read(channel_values(z, self.channels)) for z in change]
                    discs += [Disc(place.real, place.imag, radius, r) for r in ratios.tolist()]
        return discs, np.column_stack(columns)


def _touches(discs: Sequence[Disc]) -> list[Touch]:
    return [Touch(d.x, d.y, d.radius, d.ratio - 1.0) for d in discs]


def _discs(at: np.ndarray) -> list[Disc]:
    """Of coordinates (4 k,): two that turn no disc over the rim, the logarithms of radius and
    ratio."""
    found = []
    for a, b, log_radius, log_ratio in at.reshape(-1, FREE).tolist():
        radius = exp(log_radius)
        reach = ROOM * (1.0 - radius) / sqrt(1.0 + a * a + b * b)
        found.append(Disc(a * reach, b * reach, radius, exp(log_ratio)))
    return found


def _coordinates(disc: Disc) -> np.ndarray:
    """(4,): those of a disc on the skin."""
    place = np.array([disc.x, disc.y]) / (ROOM * (1.0 - disc.radius))
    turned = place / np.sqrt(1.0 - min(float(place @ place), 0.98))
    return np.array([*turned, log(disc.radius), log(disc.ratio)])


def _turns(at: np.ndarray) -> np.ndarray:
    """(4 k, 4 k): derivatives of x, y, radius and ratio of discs by their coordinates."""
    found = np.zeros((len(at), len(at)))
    for i, (disc, (a, b, _, _)) in enumerate(zip(_discs(at), at.reshape(-1, FREE), strict=True)):
        length = 1.0 + a * a + b * b
        reach = ROOM * (1.0 - disc.radius) / np.sqrt(length)
        block = np.zeros((FREE, FREE))
        block[:2, :2] = reach * (np.eye(2) - np.outer([a, b], [a, b]) / length)
        block[:2, 2] = -ROOM * disc.radius / np.sqrt(length) * np.array([a, b])
        block[2, 2], block[3, 3] = disc.radius, disc.ratio
        found[FREE * i : FREE * (i + 1), FREE * i : FREE * (i + 1)] = block
    return found


def _meet(discs: Sequence[Disc]) -> bool:
    return any(
        np.hypot(a.x - b.x, a.y - b.y) < a.radius + b.radius + APART * min(a.radius, b.radius)
        for i, a in enumerate(discs)
        for b in discs[:i]
    )


def _halves(disc: Disc) -> list[list[Disc]]:
    """Two small strong discs within one, side by side as the rim goes, or one behind the other."""
    out = complex(disc.x, disc.y) / (np.hypot(disc.x, disc.y) or 1.0)
    found = []
    for step in (0.55j * disc.radius * out, 0.55 * disc.radius * out):
        sides = (complex(disc.x, disc.y) + sign * step for sign in (1.0, -1.0))
        radius = max(0.35 * disc.radius, LEAST_RADIUS)
        ratio = float(np.exp(LOG_RATIOS[-1 if disc.conducts else 0]))
        found.append([Disc(z.real, z.imag, radius, ratio) for z in sides])
    return found


class Sought:
    """Objects sought in what is left of one difference: `evidence`, in which `known` are explained;
    offset: whether a common one of the control's readings is taken off them."""

    def __init__(
        self, sheet: Sheet, evidence: Evidence, known: Sequence[Signature], offset: bool = False
    ):
        self.sheet, self.evidence, self.known = sheet, evidence, known
        wander = evidence.wander
        self.gain = sheet.gain(wander.mean, wander.usable, offset)
        unknown = wander.usable & ~sheet.known
        self.own = np.eye(len(unknown))[:, unknown]
        self.outside = wander.across(self.own)
        size = np.sqrt((self.outside**2).sum(axis=0))
        self.outside = np.linalg.qr(self.outside[:, size > 0])[0]
        self.left = self._free(evidence.left)
        self._grid: np.ndarray | None = None
        self.before = float(self.left @ self.left)

    def _free(self, white: np.ndarray) -> np.ndarray:
        """Values in units of scale, without what is explained already or nobody can simulate."""
        basis = self.evidence.basis
        white = white - basis @ (basis.T @ white)
        return white - self.outside @ (self.outside.T @ white)

    def _white(self, values: np.ndarray) -> np.ndarray:
        """Changes (M,) or (M, k) per unit of gain, as what is left."""
        gain = self.gain if values.ndim == 1 else self.gain[:, None]
        return self._free(self.evidence.wander.across(gain * values))

    @cached_property
    def one(self) -> OptimizeResult | None:
        """The best fit with one object; None where the best disc of the grid explains next to
        nothing."""
        return self._one_more(np.zeros(0))

    def first(self) -> Explained:
        """The object that explains most by itself."""
        return self._told(self.one)

    def best(self) -> Explained:
        """The objects that explain most, as many as bring enough."""
        chosen: Any = self.one
        while len(chosen.x) < FREE * MOST:
            better = self._one_more(chosen.x)
            if better is None or chosen.cost - better.cost < 0.5 * BRINGS * self.before:
                break
            if self._told(better).evidence < self._told(chosen).evidence:
                break
            chosen = better
        return self._told(chosen)

    def _one_more(self, at: np.ndarray) -> OptimizeResult | None:
        """The best fit with one object more than those at (4 k,), or one of these cut in two."""
        fits = []
        for i, disc in enumerate(_discs(at)):
            if disc.radius < WIDE:
                continue
            rest = np.delete(at.reshape(-1, FREE), i, axis=0).ravel()
            for halves in _halves(disc):
                if not _meet([*_discs(rest), *halves]):
                    start = np.concatenate([rest, *(_coordinates(half) for half in halves)])
                    fits.append(self._fitted(start, self.left, self._white))
        for conducts in (True, False):
            for disc in self._starts(at, conducts):
                fits.append(self._fitted(np.append(at, _coordinates(disc)), self.left, self._white))
        return min(fits, key=lambda fit: fit.cost, default=None)

    def _starts(self, at: np.ndarray, conducts: bool) -> Iterator[Disc]:
        """Discs of the grid, of one sign and off those at (4 k,), that take most of what these
        leave, each apart from the ones before."""
        there = _discs(at)
        left = self.left - (self._white(self.sheet.changed(there)) if there else 0.0)
        discs, columns = self.sheet.grid
        if self._grid is None:
            self._grid = self._white(columns)
        taken = 2.0 * left @ self._grid - (self._grid**2).sum(axis=0)
        given: list[Disc] = []
        for i in np.argsort(-taken):
            disc = discs[i]
            enough = 1 if there else STARTS
            if taken[i] < (0.0 if there else WORTH * self.before) or len(given) == enough:
                return
            if disc.conducts is not conducts or _meet([*there, disc]):
                continue
            if all(np.hypot(disc.x - d.x, disc.y - d.y) > NEAR for d in given):
                given.append(disc)
                yield disc

    def _fitted(
        self,
        start: np.ndarray,
        left: np.ndarray,
        white: Callable[[np.ndarray], np.ndarray],
    ) -> OptimizeResult:
        """The discs that explain most of what is left, in the space that `white` maps changes to,
        each of the sign of its start (4 k,)."""
        refused = np.full(len(left), 1e3 * (np.linalg.norm(left) + 1.0))

        def rest(at: np.ndarray) -> np.ndarray:
            discs = _discs(at)
            if _meet(discs):
                return refused
            try:
                return left - white(self.sheet.changed(discs))
            except InputError:
                return refused

        def slope(at: np.ndarray) -> np.ndarray:
            return -white(self.sheet.slopes(_discs(at)) @ _turns(at))

        low, high = _bounds(start)
        inside = np.clip(start, low + 1e-3, high - 1e-3)
        limits = {"ftol": BETTER, "xtol": BETTER, "max_nfev": STEPS}
        return least_squares(rest, inside, slope, (low, high), x_scale="jac", **limits)

    def _told(self, fit: OptimizeResult) -> Explained:
        """A fit as an explanation, with its evidence."""
        discs = tuple(_discs(fit.x))
        change = self.gain * self.sheet.changed(discs)
        part = Objects(NAME, KIND, tuple(range(len(discs))), self.own, change, discs, fit.x)
        found = self.evidence.of([part], [part])
        places = sum(count for _, count in RINGS)
        spent = 0.5 * FREE * len(discs) * log(self.evidence.count) + log(comb(places, len(discs)))
        return replace(found, evidence=found.evidence - spent)

    def other_sign(self, found: Explained) -> Explained | None:
        """The best explanation with one object of the other sign."""
        part = objects_of(found)
        at = part.at.reshape(-1, FREE)
        rivals = []
        for i, disc in enumerate(part.discs):
            rest = np.delete(at, i, axis=0).ravel()
            starts = list(self._starts(rest, not disc.conducts))
            starts.append(replace(disc, ratio=1.0 / disc.ratio))
            for start in starts:
                rivals.append(
                    self._fitted(np.append(rest, _coordinates(start)), self.left, self._white)
                )
        best = min(rivals, key=lambda fit: fit.cost, default=None)
        return None if best is None else self._told(best)

    def beside(self) -> list[Explained]:
        """What else of the skin may explain: its rivals that are no faults of the instrument."""
        found = []
        for name, columns in self.sheet.tangents.items():
            basis = np.column_stack([self.gain[:, None] * columns, self.own])
            part = Signature(name, KIND, (), basis)
            found.append(self.evidence.of([part], [part]))
        return found

    def explained(self, found: Explained) -> float:
        """The share of the difference's square that objects take, noise left out where known."""
        shift = found.parts[0].shift
        assert shift is not None
        after = self.left - self._free(self.evidence.wander.across(shift))
        noise = float(self.evidence.wander.count) if self.evidence.wander.prior else 0.0
        before = max(self.before - noise, 0.0)
        return 1.0 - max(float(after @ after) - noise, 0.0) / before if before > 0 else 0.0

    def spread(self, found: Explained) -> np.ndarray:
        """(4 k,): standard deviations of the discs' coordinates, from what the fit leaves."""
        at = objects_of(found).at
        slope = self._white(self.sheet.slopes(_discs(at)) @ _turns(at))
        left = self.left - self._white(self.sheet.changed(_discs(at)))
        free = max(self.evidence.wander.count - len(at), 1)
        return np.sqrt(np.diag(np.linalg.pinv(slope.T @ slope)) * float(left @ left) / free)

    def held_out(self, found: Explained) -> dict:
        """Misfit on reciprocal pairs that the objects were not fitted to, with and without these,
        in units of what readings wander; what a skin does without a fault is fitted beside."""
        wander, at = self.evidence.wander, objects_of(found).at
        change = wander.change - sum(p.shift for p in self.known if p.shift is not None)
        scale = np.where(wander.usable, wander.scale, 0.0)
        bases = [scale[:, None] * wander.nuisance, *(p.basis for p in self.known), self.own]
        label = tied_channels(self.sheet.channels)[0]
        groups = np.unique(label[wander.usable])
        np.random.default_rng(0).shuffle(groups)
        square, count = np.zeros(2), 0
        for fold in np.array_split(groups, FOLDS):
            out = np.isin(label, fold) & wander.usable
            kept = wander.usable & ~out
            free = np.column_stack(bases)
            plain = _Beside(free, wander, kept)

            def white(values: np.ndarray, plain: _Beside = plain) -> np.ndarray:
                return plain.rest((self.gain * values.T).T)

            fit = self._fitted(at, plain.rest(change), white)
            told = self.gain * self.sheet.changed(_discs(fit.x))
            for i, known in enumerate((0.0, told)):
                missed = plain.missed(change - known, out)
                square[i] += float(missed @ missed)
            count += int(out.sum())
        before, after = np.sqrt(square / max(count, 1)).tolist()
        return {"pairs": len(groups), "folds": FOLDS, "rms_before": before, "rms_after": after}


def sought(sheet: Sheet, evidence: Evidence, known: Sequence[Signature]) -> Sought | None:
    """Objects sought the way that explains more with one; None where one explains nothing."""
    ways = (False, True) if sheet.signed else (False,)
    tried = [Sought(sheet, evidence, known, offset) for offset in ways]
    found = [(each, each.one.cost) for each in tried if each.one is not None]
    return min(found, key=lambda pair: pair[1], default=(None, 0.0))[0]


def _bounds(start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of coordinates, each ratio on its start's side of 1."""
    low, high = [], []
    for log_ratio in start.reshape(-1, FREE)[:, 3]:
        low += [-MOST_TURN, -MOST_TURN, log(LEAST_RADIUS)]
        high += [MOST_TURN, MOST_TURN, log(MOST_RADIUS)]
        low.append(1e-3 if log_ratio > 0 else -MOST_LOG_RATIO)
        high.append(MOST_LOG_RATIO if log_ratio > 0 else -1e-3)
    return np.array(low), np.array(high)


class _Beside:
    """Some channels, kept (M,), and what else may have changed them, free (M, k)."""

    def __init__(self, free: np.ndarray, wander: Wander, kept: np.ndarray):
        self.kept, self.scale = kept, wander.scale
        self.free = np.where(np.isfinite(wander.scale), 1.0 / wander.scale, 0.0)[:, None] * free
        left, size, right = np.linalg.svd(self.free[kept], full_matrices=False)
        there = size > 1e-6 * max(size.max(initial=0.0), np.finfo(float).tiny)
        self.basis = left[:, there]
        self.back = (right[there].T / size[there]) @ self.basis.T

    def rest(self, values: np.ndarray) -> np.ndarray:
        """Values (M,) or (M, k), V, of the kept channels, in units of scale, without the rest."""
        white = (values.T / self.scale).T[self.kept]
        return white - self.basis @ (self.basis.T @ white)

    def missed(self, values: np.ndarray, out: np.ndarray) -> np.ndarray:
        """Values (M,), V, of channels `out`, in units of scale, less what the kept ones foretell of
        the rest."""
        white = values / self.scale
        return white[out] - self.free[out] @ (self.back @ white[self.kept])


def ends(at: np.ndarray, spread: np.ndarray) -> list[dict[str, tuple[float, float, float]]]:
    """Value, low and high (90 %) of x, y, radius, ratio of each disc, from what their coordinates
    scatter, to first order; a ratio that runs to its bound has no end there (infinite, or 0), and
    stays on its side of 1, since the other sign is an explanation of its own."""
    found = []
    turn = np.abs(_turns(at))
    for i, disc in enumerate(_discs(at)):
        rows = slice(FREE * i, FREE * i + 2)
        half = PERCENT_90 * np.sqrt((turn[rows] ** 2) @ spread**2)
        log_radius, log_ratio = at[FREE * i + 2], at[FREE * i + 3]
        one, two = PERCENT_90 * spread[FREE * i + 2 : FREE * i + 4]
        low, high = log_ratio - two, log_ratio + two
        low, high = (max(low, 0.0), high) if disc.conducts else (low, min(high, 0.0))
        found.append(
            {
                "x": (disc.x, disc.x - half[0], disc.x + half[0]),
                "y": (disc.y, disc.y - half[1], disc.y + half[1]),
                "radius": (disc.radius, *np.exp([log_radius - one, log_radius + one])),
                "ratio": (
                    disc.ratio,
                    float(np.exp(low)) if low > -MOST_LOG_RATIO else 0.0,
                    float(np.exp(high)) if high < MOST_LOG_RATIO else np.inf,
                ),
            }
        )
    return found
