"""Recordings, or sessions, of one skin compared: what they share, and what changed between them."""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.stats import chi2, false_discovery_control

from eitskin.data.recording import Recording
from eitskin.diagnose.comparison import sentences
from eitskin.diagnose.comparison.joint import (
    CALIBRATED,
    Joint,
    Label,
    Part,
    Shared,
    Together,
    View,
    check,
    excess,
    fitted,
    union,
)
from eitskin.diagnose.comparison.tested import Comparison, Tested
from eitskin.diagnose.diagnosis import Diagnosis
from eitskin.diagnose.fitting.estimates import calibration, estimates
from eitskin.errors import InputError

DISCOVERY = 0.01  # q below which a value is said to have changed
EQUAL = 0.05  # p above which neighbouring parts are said to have one value


def parts(recording: Recording, file: str | Path = "recording") -> dict[str, Recording]:
    """A recording's sessions by name, in order of time, each a recording on the same clock.

    A session that cannot stand alone (no untouched frame among absolute values, or every reading
    lost) is joined to the one before it, the first to the one after, as `a + b`. Raises InputError
    where the recording names no session in some row, or fewer than two can stand alone.
    """
    frames = recording.frames
    if "session" not in frames:
        raise InputError(file, "column session", "nothing", "it, to tell sessions apart")
    missing = np.flatnonzero(frames["session"].isna())
    if len(missing):
        raise InputError(file, f"column session, row {missing[0]}", "null", "a session's name")
    label = frames["session"].to_numpy(dtype=object)
    joined: list[list[str]] = []
    for name in pd.unique(label):
        lone = joined and not _stands(recording, np.isin(label, joined[-1]))
        if joined and (lone or not _stands(recording, label == name)):
            joined[-1].append(name)
        else:
            joined.append([name])
    if len(joined) < 2:
        found = f"{len(set(label))} in all, {len(joined)} that can stand alone"
        expected = "two sessions or more, each with readings and an untouched frame"
        raise InputError(file, "column session", found, expected)
    return {" + ".join(names): _rows(recording, np.isin(label, names)) for names in joined}


def _stands(recording: Recording, rows: np.ndarray) -> bool:
    if recording.voltage is not None and np.isnan(recording.voltage[rows]).all():
        return False
    touched = recording.frames["touch"].to_numpy(bool)[rows]
    return recording.metadata["values"] == "difference" or not touched.all()


def _rows(recording: Recording, rows: np.ndarray) -> Recording:
    """Some frames of a recording, numbered anew."""
    frames = recording.frames[rows].reset_index(drop=True)
    frames["frame"] = np.arange(len(frames), dtype=np.int64)
    touches = recording.touches
    return replace(
        recording,
        frames=frames,
        voltage=None if recording.voltage is None else recording.voltage[rows],
        quadrature=None if recording.quadrature is None else recording.quadrature[rows],
        touches=touches and [t for t, row in zip(touches, rows, strict=True) if row],
    )


def compare(founds: Mapping[str, Diagnosis]) -> Comparison:
    """Diagnoses of one skin, in order of time, compared.

    Every effect found in any part is fitted in every part. Each parameter and each calibration is
    tested for equality (chi squared of the values with their covariances, widened where a part's
    fit leaves more than noise), false discoveries held by Benjamini & Hochberg (1995). Equal ones
    get one value in a joint fit, of which the inverse-covariance weighted mean is the start. The
    tests are linear about each part's own fit: no change is kept unless the joint fit with all of
    them is better than that without any, by its likelihood ratio.
    Raises InputError unless the parts are of one skin, read in one way.
    """
    check(founds)
    shared = union(founds)
    there = [{name: not s.switch or name in s.own for name in founds} for s in shared]
    own = fitted(founds, shared, there)
    uniform = [dict(by_part) for by_part in there]
    switched = []
    for e in (e for e, effect in enumerate(shared) if effect.switch):
        test, everywhere = _switch(founds, shared, there, e, own)
        switched.append(test)
        uniform[e] = dict.fromkeys(founds, everywhere)
    while True:
        tested = _discovered([*_tests(own), *switched])
        same = [t for t in tested if not t.keys and not t.changed]
        same = [t for t in same if there[t.effect] != uniform[t.effect]]
        if not same:
            break
        # What is there in all parts, or in none, changes the values of all that is beside it.
        for test in same:
            there[test.effect] = uniform[test.effect]
        alike = {t.effect: t.groups for t in same}
        switched = [replace(t, groups=alike.get(t.effect, t.groups)) for t in switched]
        own = fitted(founds, shared, there)
    tones = _own_phases(shared, list(founds))
    groups = {label: t.groups for t in tested if t.changed for label in _labels(t, shared)}
    as_found = Joint(own, {**groups, **tones}).fitted()
    all_shared, p_value = as_found, None
    if groups or uniform != there:
        plain = own if uniform == there else fitted(founds, shared, uniform)
        all_shared = Joint(plain, tones).fitted()
        p_value = _likelihood_ratio(all_shared, as_found)
        if p_value >= DISCOVERY:
            tested = [_unchanged(test) for test in tested]
            as_found, own, there = all_shared, plain, uniform
    told = [_told(test, shared, own, as_found, there) for test in tested]
    held = all_shared.held_out, as_found.held_out
    return Comparison(list(founds), shared, told, p_value, *held)


def _likelihood_ratio(less: Together, more: Together) -> float:
    """How often noise alone makes a joint fit so much better than one with fewer values."""
    dof = max(more.joint.size - less.joint.size, 1)
    scale = excess(more.fit.chi2, more.joint.whitening.size - more.joint.size)
    return float(chi2.sf(max(0.0, less.fit.chi2 - more.fit.chi2) / scale, dof))


def _unchanged(test: Tested) -> Tested:
    return replace(test, groups=[tuple(name for run in test.groups for name in run)])


def _labels(test: Tested, shared: list[Shared]) -> list[Label]:
    """The coordinates that hold what is tested."""
    if test.effect != CALIBRATED and test.keys:
        polar = shared[test.effect].candidate.effect.polar
        if polar and test.keys[0] == polar[0]:
            return [(test.effect, polar[0], axis) for axis in (0, 1)]
    return [(test.effect, key, test.site) for key in test.keys]


def _own_phases(shared: list[Shared], names: list[str]) -> dict[Label, list[tuple[str, ...]]]:
    """A tone's phase is its recording's own: so are the two coordinates that hold it."""
    own: list[tuple[str, ...]] = [(name,) for name in names]
    return {
        (e, polar[0], axis): own
        for e, effect in enumerate(shared)
        if _tone(effect) and (polar := effect.candidate.effect.polar) is not None
        for axis in (0, 1)
    }


def _tone(effect: Shared) -> bool:
    return effect.candidate.effect.tone


def _tests(own: list[Part]) -> list[Tested]:
    """Every value that some part has, tested where two have it."""
    order: dict[tuple[int, str, int | None], None] = {}
    for part in own:
        for e, key, place in part.labels:
            order.setdefault((e, key, None if _is_axis(part, e, key) else place))
    return [_test(own, *key) for key in order]


def _is_axis(part: Part, e: int, key: str) -> bool:
    if e == CALIBRATED:
        return False
    polar = part.fit.effects[part.which.index(e)].effect.polar
    return polar is not None and key == polar[0]


def _test(own: list[Part], e: int, key: str, site: int | None) -> Tested:
    have = [p for p in own if any(label[:2] == (e, key) for label in p.labels)]
    keys: tuple[str, ...] = (key,)
    estimated = {}
    for part in have:
        at = [i for i, label in enumerate(part.labels) if label[:2] == (e, key)]
        if site is not None:
            at = [i for i in at if part.labels[i][2] == site]
        value, covariance = part.fit.theta[at], part.spread[np.ix_(at, at)]
        if _is_axis(part, e, key):
            effect = part.fit.effects[part.which.index(e)].effect
            if effect.tone:  # whose phase is its recording's own: only its size
                size = np.hypot(*value)
                slope = value / size if size > 0 else np.array([1.0, 0.0])
                value, covariance = np.array([size]), (slope @ covariance @ slope).reshape(1, 1)
            else:
                assert effect.polar is not None
                keys = effect.polar[:2]
        estimated[part.name] = value, covariance
    names = tuple(estimated)
    if len(names) < 2:
        return Tested(e, keys, site, None, None, None, None, [names])
    statistic, _, _ = _mean(list(estimated.values()))
    dof = (len(names) - 1) * len(next(iter(estimated.values()))[0])
    p = float(chi2.sf(statistic, dof))
    runs = _runs(estimated)
    return Tested(e, keys, site, statistic, dof, p, None, runs)


def _mean(estimated: list[tuple[np.ndarray, np.ndarray]]) -> tuple[float, np.ndarray, np.ndarray]:
    """Chi squared of values (d,) with covariances (d, d) about their mean, the mean, its own
    covariance."""
    weights = [np.linalg.inv(covariance) for _, covariance in estimated]
    together = np.linalg.inv(sum(weights))
    mean = together @ sum(w @ v for w, (v, _) in zip(weights, estimated, strict=True))
    off = [(v - mean, w) for w, (v, _) in zip(weights, estimated, strict=True)]
    return float(sum(d @ w @ d for d, w in off)), mean, together


def _runs(estimated: dict[str, tuple[np.ndarray, np.ndarray]]) -> list[tuple[str, ...]]:
    """Neighbouring parts joined, the likeliest equal ones first, two runs at least."""
    runs: list[tuple[str, ...]] = [(name,) for name in estimated]
    values = list(estimated.values())
    while len(runs) > 2:
        pairs = [_mean(values[i : i + 2]) for i in range(len(runs) - 1)]
        best = int(np.argmin([pair[0] for pair in pairs]))
        if chi2.sf(pairs[best][0], len(values[0][0])) < EQUAL:
            break
        runs[best : best + 2] = [runs[best] + runs[best + 1]]
        values[best : best + 2] = [pairs[best][1:]]
    return runs


def _discovered(tested: list[Tested]) -> list[Tested]:
    """With q-values; what is no discovery has one value in all parts."""
    q = iter(false_discovery_control([t.p for t in tested if t.p is not None], method="bh"))
    found = []
    for test in tested:
        own = None if test.p is None else float(next(q))
        changed = own is not None and own < DISCOVERY
        found.append(replace(test if changed else _unchanged(test), q=own))
    return found


def _switch(
    founds: Mapping[str, Diagnosis],
    shared: list[Shared],
    there: list[dict[str, bool]],
    e: int,
    own: list[Part],
) -> tuple[Tested, bool]:
    """An effect that is there or not: what it costs to have it in every part or in none; and
    whether every part, rather than none, is the cheaper."""
    everywhere, nowhere = (
        _cost(
            founds,
            shared,
            [dict.fromkeys(founds, all_) if i == e else t for i, t in enumerate(there)],
        )
        for all_ in (True, False)
    )
    left = min(everywhere, nowhere) - sum(part.fit.chi2 for part in own)
    statistic = max(0.0, left / max(part.scale for part in own))
    dof = len(founds) - 1
    runs: list[tuple[str, ...]] = []
    for name in founds:
        if runs and there[e][runs[-1][-1]] == there[e][name]:
            runs[-1] += (name,)
        else:
            runs.append((name,))
    p = float(chi2.sf(statistic, dof))
    return Tested(e, (), None, statistic, dof, p, None, runs), everywhere < nowhere


def _cost(
    founds: Mapping[str, Diagnosis], shared: list[Shared], there: list[dict[str, bool]]
) -> float:
    """Chi squared of all parts, infinite where the physics has no solution."""
    try:
        return sum(part.fit.chi2 for part in fitted(founds, shared, there))
    except InputError:
        return math.inf


def _told(
    test: Tested,
    shared: list[Shared],
    own: list[Part],
    together: Together,
    there: list[dict[str, bool]],
) -> Tested:
    """With values and in words."""
    if not test.keys:
        present = there[test.effect]
        part = next(p for p in own if present[p.name]) if any(present.values()) else None
        sentence = sentences.switched(test, shared[test.effect].candidate, part, present)
        return replace(test, there=present, sentence=sentence)
    views = together.views()
    have = {p.name: p for p in own if any(name in p.labels for name in _labels(test, shared))}
    values = {
        name: _picked(test, p, View(p.fit.problem, p.fit.effects, p.fit.theta, p.spread))
        for name, p in have.items()
    }
    combined = []
    for run in test.groups:
        if test.effect != CALIBRATED and _tone(shared[test.effect]) and len(run) > 1:
            combined.append(_averaged([values[name] for name in run]))
        else:
            combined.append(_picked(test, have[run[0]], views[run[0]]))
    last = have[test.groups[-1][0]]
    finding = ""
    if test.effect != CALIBRATED:
        view = views[last.name]
        finding = sentences.found(test, last, view, _at_site(test, last, view))
    sentence = sentences.changed(test, combined, finding, shared)
    return replace(test, values=values, combined=combined, sentence=sentence)


def _averaged(values: list[dict]) -> dict:
    """The inverse-variance weighted mean of {parameter: {value, low, high, unit}}."""
    found = {}
    for key, first in values[0].items():
        value = np.array([v[key]["value"] for v in values])
        half = np.array([0.5 * (v[key]["high"] - v[key]["low"]) for v in values])
        mean, width = np.average(value, weights=half**-2.0), np.sum(half**-2.0) ** -0.5
        numbers = {"value": mean, "low": mean - width, "high": mean + width}
        found[key] = {**{k: float(v) for k, v in numbers.items()}, "unit": first["unit"]}
    return found


def _picked(test: Tested, part: Part, view: View) -> dict:
    """{parameter: {value, low, high, unit}} of what is tested, at its site."""
    if test.effect == CALIBRATED:
        return {key: calibration(view)[key] for key in test.keys}
    found = _at_site(test, part, view)
    return {key: found[key] for key in test.keys if key in found}


def _at_site(test: Tested, part: Part, view: View) -> dict:
    """Every parameter of the effect tested, at the site."""
    index = part.which.index(test.effect)
    found = {}
    for key, estimate in estimates(view, index).items():
        if isinstance(estimate["value"], list) and test.site is not None:
            place = view.effects[index].own_sites.index(test.site)
            at = {name: own[place] for name, own in estimate.items() if isinstance(own, list)}
            estimate = {k: v for k, v in {**estimate, **at}.items() if v is not None}
        found[key] = estimate
    return found
