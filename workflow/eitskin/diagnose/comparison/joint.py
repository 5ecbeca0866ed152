"""Several recordings of one skin in one fit: every effect found in any of them, in all of them."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np

from eitskin.diagnose.diagnosis import Diagnosis
from eitskin.diagnose.fitting.candidates import Candidate
from eitskin.diagnose.fitting.fit import Fit, Problem, fit
from eitskin.diagnose.fitting.held_out import HeldOut, held_out
from eitskin.diagnose.fitting.simulator import MOST, Calibration, RecordingSimulator
from eitskin.diagnose.search.gates import CONFUSED
from eitskin.effects.effect import Parameter
from eitskin.errors import InputError

# A coordinate of a fit: the effect's place among those of all parts (CALIBRATED for none), the
# parameter's or the calibration's name, and its site (of polar parameters the axis) or None.
Label = tuple[int, str, int | None]
CALIBRATED = -1
# What parts must be believed alike for their parameters to be the same ones; the conductivity is
# known to nobody and calibrated in any case.
ALIKE = ("channels", "unit", "values", "voltage", "position_frame")
FREE = "conductivity_S_per_m"


@dataclass(frozen=True)
class Shared:
    """An effect as all parts have it. own: where it stands in the diagnosis of a part that found
    it; alternatives: names that some part cannot tell from it."""

    candidate: Candidate
    own: Mapping[str, int]
    alternatives: frozenset[str] = frozenset()

    @property
    def switch(self) -> bool:
        """Whether the effect is there or not, without a value at which it does nothing."""
        return not self.candidate.linear.any()


@dataclass(frozen=True)
class Held(Candidate):
    """A candidate whose values in `start` are held: only how strong it is, is fitted."""

    def _coordinates(self) -> Iterator[tuple[str, int | None]]:
        return (name for name in Candidate._coordinates(self) if name[0] not in self.start)


@dataclass(frozen=True)
class Part:
    """One recording with its own fit of all effects. which: for each effect of the fit its place
    among all; fold (N,): frames that are left out together."""

    name: str
    fit: Fit
    which: tuple[int, ...]
    fold: np.ndarray

    @property
    def labels(self) -> list[Label]:
        """What each coordinate of the fit is."""
        found: list[Label] = [
            (CALIBRATED, c.name, None) for c in self.fit.problem.model.calibrations
        ]
        for e, candidate in zip(self.which, self.fit.effects, strict=True):
            polar = candidate.effect.polar and candidate.effect.polar[0]
            for key, place in candidate.names:
                site = place if place is None or key == polar else candidate.own_sites[place]
                found.append((e, key, site))
        return found

    @property
    def scale(self) -> float:
        """Chi squared over its degrees of freedom, at least 1: by it variances are too small
        where the fit does not explain all (Birge 1932)."""
        return excess(self.fit.chi2, self.fit.problem.whitening.size - len(self.fit.theta))

    @property
    def spread(self) -> np.ndarray:
        """(P, P): covariance of the fit's coordinates, so widened."""
        return self.scale * self.fit.covariance


def excess(chi2: float, dof: int) -> float:
    """Chi squared over its degrees of freedom, at least 1."""
    return max(1.0, chi2 / max(dof, 1))


def check(founds: Mapping[str, Diagnosis]) -> None:
    """Raise InputError unless there are two parts or more, of one skin read in one way."""
    if len(founds) < 2:
        raise InputError("comparison", "parts", len(founds), "two or more")
    (first, reference), *others = founds.items()
    for name, found in others:
        pairs = [(k, reference.recorded.metadata[k], found.recorded.metadata[k]) for k in ALIKE]
        mine, its = (f.recorded.skin.metadata() for f in (found, reference))
        pairs += [(f"skin.{k}", its[k], mine[k]) for k in its if k != FREE]
        for key, expected, given in pairs:
            if given != expected:
                short = f"{given!s:.60}"
                raise InputError(name, f"key {key}", short, f"the same as in {first}")


def union(founds: Mapping[str, Diagnosis]) -> list[Shared]:
    """The effects found in any part, each once.

    Effects of one name are one, at all their sites; where one part has a value for every site, all
    have. An effect that a part cannot tell from another part's at the same place is that one.
    """
    all_: list[Shared] = []
    for name, found in founds.items():
        for i, candidate in enumerate(found.after.effects):
            confused = {g.rival for g in found.gaps[i] if g.gap < CONFUSED} if found.gaps else set()
            for e, other in enumerate(all_):
                own = {**other.own, name: i}
                joined = _merged(other.candidate, candidate)
                if joined is not None:
                    all_[e] = Shared(joined, own, other.alternatives | confused)
                    break
                alike = other.candidate.name in confused or candidate.name in other.alternatives
                place = (candidate.kind, candidate.sites)
                if (
                    alike
                    and name not in other.own
                    and place
                    == (
                        other.candidate.kind,
                        other.candidate.sites,
                    )
                ):
                    names = other.alternatives | confused | {candidate.name}
                    all_[e] = Shared(other.candidate, own, names - {other.candidate.name})
                    break
            else:
                all_.append(Shared(candidate, {name: i}, frozenset(confused)))
    return all_


def _merged(a: Candidate, b: Candidate) -> Candidate | None:
    """One candidate for two of one name, None where they are different effects."""
    if (a.name, a.kind) != (b.name, b.kind) or _whole(a) != _whole(b):
        return None
    keys = [{key for key, _ in c.names} for c in (a, b)]
    if not (keys[0] <= keys[1] or keys[1] <= keys[0]):
        return None
    more = b if keys[0] < keys[1] else a
    if (a.sites, a.scope) == (b.sites, b.scope):
        return more
    if not a.effect.parameters:
        return None
    scope = "sparse" if a.scope == b.scope == "sparse" else "dense"
    return replace(more, sites=tuple(sorted({*a.own_sites, *b.own_sites})), scope=scope)


def _whole(candidate: Candidate) -> dict[str, float]:
    parameters = candidate.effect.parameters
    return {k: v for k, v in candidate.start.items() if parameters[k].whole}


def fitted(
    founds: Mapping[str, Diagnosis], shared: list[Shared], there: list[dict[str, bool]]
) -> list[Part]:
    """Every part with all effects fitted to it. there: for each effect whether a part has it;
    False counts for those that are switched alone."""
    force_max_N = max(f.search.problem.model.force_max_N for f in founds.values())
    reference: dict[str, Calibration] = {}
    parts = []
    for name, found in founds.items():
        own = found.after.fit
        model = RecordingSimulator(found.recorded)
        # Parameters that are relative to a recording's own start or extremes become the same.
        model.force_max_N = force_max_N
        believed = model.calibrations
        model.calibrations = [reference.setdefault(c.name, c) for c in believed]
        values = [c.value(u) for c, u in zip(believed, own.theta[: len(believed)], strict=True)]
        start = [_coordinate(c, v) for c, v in zip(model.calibrations, values, strict=True)]
        columns = [
            column if c == other else np.full_like(column, np.nan)
            for c, other, column in zip(believed, model.calibrations, own.jacobian, strict=False)
        ]
        effects, which = [], []
        for e, effect in enumerate(shared):
            if effect.switch and not there[e][name]:
                continue
            candidate = effect.candidate if name in effect.own else _elsewhere(founds, effect)
            coordinates, derivatives = np.zeros(candidate.size), np.full(candidate.size, np.nan)
            source = np.zeros(candidate.size, int)
            if name in effect.own and own.effects[effect.own[name]].name == candidate.name:
                place = own.place(effect.own[name])
                before = own.effects[effect.own[name]]
                coordinates, derivatives, source = _carried(before, own.theta[place], candidate)
                source = source + place.start
            effects.append(candidate)
            which.append(e)
            start.extend(coordinates)
            columns.extend(d * own.jacobian[i] for d, i in zip(derivatives, source, strict=True))
        problem = replace(found.search.problem, model=model)
        jacobian = np.array(columns).reshape(len(start), *own.residual.shape)
        best = fit(problem, effects, np.array(start), jacobian)
        parts.append(Part(name, best, tuple(which), found.search.fold))
    return parts


def _elsewhere(founds: Mapping[str, Diagnosis], effect: Shared) -> Candidate:
    """An effect for a part that did not find it: where it is and how it acts, if no reading says
    so while it does nothing, is held as the first part that found it has it."""
    candidate = effect.candidate
    how = {
        key
        for (key, _), linear in zip(candidate.names, candidate.linear, strict=True)
        if not linear
    }
    part, i = next(iter(effect.own.items()))
    state = founds[part].after
    if effect.switch or not how or state.effects[i].name != candidate.name:
        return candidate
    values = state.effects[i].setting(state.fit.theta[state.fit.place(i)]).values
    start = {**candidate.start, **{key: values[key] for key in how}}
    same = (candidate.kind, candidate.sites, candidate.scope)
    return Held(candidate.effect, *same, start, candidate.skin, candidate.scales, candidate.looks)


def _coordinate(calibration: Calibration, value: float) -> float:
    """The coordinate at which a calibration has a value: the inverse of its `value`."""
    start, sd = calibration.start, calibration.sd
    moved = (np.log(value / start) if calibration.log else value - start) / (sd * MOST)
    return float(MOST * np.arctanh(np.clip(moved, -0.999, 0.999)))


def _carried(
    own: Candidate, values: np.ndarray, to: Candidate
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coordinates (size,) of `to` at which it does what `own` does at `values`; by how much `own`'s
    moves as one of them does, NaN where they are not one to one; and which of `own`'s it is."""
    found, slope = np.zeros(to.size), np.full(to.size, np.nan)
    source = np.zeros(to.size, int)
    polar = to.effect.polar and to.effect.polar[0]
    for i, (key, place) in enumerate(to.names):
        name = (key, place)
        if key != polar and place is not None:
            site = to.own_sites[place]
            one = own.scope != "common" and site in own.own_sites
            name = (key, own.own_sites.index(site) if one else None)
        if name not in own.names:
            continue
        parameter = to.effect.parameters[key]
        source[i] = own.names.index(name)
        scale = own.scales.of(parameter), to.scales.of(parameter)
        value = _origin(own, key, parameter) + scale[0] * values[source[i]]
        found[i] = (value - _origin(to, key, parameter)) / scale[1]
        if name[1] is not None or place is None:
            slope[i] = scale[1] / scale[0]
    return found, slope, source


def _origin(candidate: Candidate, key: str, parameter: Parameter) -> float:
    """Where a parameter's coordinate is 0, in the unit in which coordinates add."""
    if candidate.effect.polar and key == candidate.effect.polar[0]:
        return 0.0
    value = candidate.start.get(key, candidate.effect.neutral(key, candidate.skin))
    assert value is not None
    return float(np.log(value)) if parameter.low > 0 else float(value)


@dataclass(frozen=True)
class View:
    """A part as a joint fit has it: what `estimates` reads of a fit."""

    problem: Problem
    effects: list[Candidate]
    theta: np.ndarray
    covariance: np.ndarray
    place = Fit.place


class Joint:
    """Parts fitted together, to be given to `fit` as its problem: readings one part after another.

    groups: for a label the parts that share one value, each a tuple of names; a label that is not
    in it has one value for all.
    """

    def __init__(self, parts: list[Part], groups: Mapping[Label, list[tuple[str, ...]]]):
        self.parts = parts
        places: dict[tuple, int] = {}
        keys = [[_joint_key(label, p.name, groups) for label in p.labels] for p in parts]
        ordered = sorted((k for own in keys for k in own), key=lambda k: k[0][0] != CALIBRATED)
        for key in ordered:
            places.setdefault(key, len(places))
        self.index = [np.array([places[k] for k in own], int) for own in keys]
        self.size = len(places)
        calibrations = [k for k in places if k[0][0] == CALIBRATED]
        self.model = SimpleNamespace(calibrations=calibrations)
        own = [p.fit.problem.whitening for p in parts]
        mask = np.concatenate([w.mask for w in own])
        # Every part has its own noise: of all together there is none in volts.
        self.whitening = SimpleNamespace(
            mask=mask,
            size=sum(w.size for w in own),
            by_channel=True,
            unwhitened=lambda values: np.full_like(values, np.nan),
        )

    def residual(self, theta: np.ndarray, effects: list) -> np.ndarray:
        """(N, M) whitened residuals of all parts at joint coordinates (P,)."""
        pairs = zip(self.parts, self.index, strict=True)
        return np.concatenate([p.fit.problem.residual(theta[i], p.fit.effects) for p, i in pairs])

    def fitted(self) -> "Together":
        """The joint fit, from the inverse-covariance weighted mean of the parts' own."""
        information, slope = np.zeros((self.size, self.size)), np.zeros(self.size)
        least, most = np.full((2, self.size), np.nan)
        rows = np.cumsum([0, *(len(p.fit.residual) for p in self.parts)])
        width = self.parts[0].fit.residual.shape[1]
        jacobian = np.zeros((self.size, rows[-1], width))
        for k, (part, index) in enumerate(zip(self.parts, self.index, strict=True)):
            own = part.fit.information + np.diag(part.fit.prior)
            information[np.ix_(index, index)] += own
            slope[index] += own @ part.fit.theta
            jacobian[index, rows[k] : rows[k + 1]] = part.fit.jacobian
            least[index] = np.fmin(least[index], part.fit.theta)
            most[index] = np.fmax(most[index], part.fit.theta)
        # Between the parts' own values, where far from linear parts might pull it out of physics.
        start = np.clip(np.linalg.solve(information, slope), least, most)
        # As far as `fit` asks, it is a Problem.
        return Together(self, fit(self, [], start, jacobian))  # type: ignore[arg-type]


def _joint_key(label: Label, part: str, groups: Mapping[Label, list[tuple[str, ...]]]) -> tuple:
    group = next((g for g in groups.get(label, []) if part in g), ())
    return label, group


@dataclass(frozen=True)
class Together:
    """A joint fit of parts."""

    joint: Joint
    fit: Fit

    @property
    def held_out(self) -> HeldOut:
        """What it predicts for frames left out."""
        return held_out(self.fit, np.concatenate([p.fold for p in self.joint.parts]))

    def views(self) -> dict[str, View]:
        """Every part as the joint fit has it, by name."""
        scale = excess(self.fit.chi2, self.joint.whitening.size - self.joint.size)
        covariance = scale * self.fit.covariance
        found = {}
        for part, index in zip(self.joint.parts, self.joint.index, strict=True):
            square = covariance[np.ix_(index, index)]
            own = part.fit
            found[part.name] = View(own.problem, own.effects, self.fit.theta[index], square)
        return found
