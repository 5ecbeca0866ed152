"""What others would make of a concealed recording: from the recording and the query alone.

`none`: the owner's belief, its calibrations fitted. Of the tangents of the whole catalogue about
it: `everything`, least squares on all at once; `matched-filter`, one after another by the
diagnosis' own score test; `lasso`. `equation-9`: the paper's perturbations fitted to the
recording. `gp` and `mlp`: black boxes on the residual. What is linear predicts to first order,
the calibrations following.
"""

import warnings
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import solve
from scipy.special import chdtrc
from scipy.stats import norm
from sklearn.exceptions import ConvergenceWarning
from sklearn.linear_model import lasso_path

from eitskin.atomic import atomic_path
from eitskin.data import recording
from eitskin.data.recording import Recording, presses
from eitskin.diagnose.diagnosis import begun, simulator
from eitskin.diagnose.fitting.candidates import Candidate, discrete, log_ways
from eitskin.diagnose.fitting.excerpt import excerpt
from eitskin.diagnose.fitting.fit import Fit, Problem, difference, fit
from eitskin.diagnose.fitting.jacobian import Jacobian
from eitskin.diagnose.fitting.simulator import RecordingSimulator
from eitskin.diagnose.fitting.tangents import Tangents
from eitskin.diagnose.noise.whitening import Whitening
from eitskin.diagnose.search import tones
from eitskin.diagnose.search.proposals import SIGNIFICANT
from eitskin.diagnose.search.screen import log_evidence
from eitskin.diagnose.search.search import LEAST_EVIDENCE, MOST_EFFECTS, Search
from eitskin.diagnose.verdict.result import read_query
from eitskin.effects.effect import SITES
from eitskin.effects.ellipse import Ellipse
from eitskin.effects.mains_interference import MainsInterference
from proof import black_box, cache
from proof.verdicts import FINAL, refuse_sealed

NAMING = ("everything", "matched-filter", "lasso")
METHODS = ("none", *NAMING, "equation-9", "gp", "mlp")
MAINS = "mains-interference"
EQUATION_9 = (
    "ellipse",
    "electrode-position",
    "channel-gain",
    "force-dependent-gain",
    "crosstalk",
)
LEAST = 1e-10  # of a column's squared length: with less beside the calibrations it is theirs
RIDGE = 1e-7  # of the largest eigenvalue: columns are single-precision numbers
PIECE = 4096  # numbers of a column that are taken at once
PENALTIES, SMALLEST = 60, 1e-4  # of the lasso, from the one that leaves nothing in to this share


@dataclass(frozen=True)
class Linear:
    """The catalogue's tangents about a fit of the calibrations, in noise units, orthogonal to them.

    columns (K,): candidate and which of its linear coordinates; length (K,) of what is left of
    each, of a change of typical size;
    gram (K, K) and slope (K,): products of unit columns with each other and with the
    residual; asked (K, Q M): V that the query changes by for one unit column, the calibrations
    following; groups: candidates with their columns' indices; dof: of the residual; chi2.
    """

    columns: list[tuple[Candidate, int]]
    gram: np.ndarray
    slope: np.ndarray
    length: np.ndarray
    asked: np.ndarray
    groups: list[tuple[Candidate, np.ndarray]]
    chi2: float
    dof: int


def linear(search: Search, fitted: Fit, recorded: Recording, query: Recording) -> Linear:
    """The catalogue's tangents about `fitted`, a fit without effects, at recording and query.

    Wires that are open or exchanged have no tangent and are left out; the tone is the strongest in
    the residual.
    """
    here = Tangents(Fit(fitted.problem, [], fitted.theta, fitted.residual, _nothing(fitted)))
    there = _unwhitened(fitted, recorded, query)
    candidates = [c for c in search.candidates if not discrete(c) and c.name != MAINS]
    like = candidates[0]
    tone = tones.score(here, MainsInterference(), like.skin, like.scales)
    candidates += [] if tone is None else [tone.candidate]
    columns: list[tuple[Candidate, int]] = []
    groups: list[tuple[Candidate, np.ndarray]] = []
    at: dict[tuple, list[int]] = {}
    own, asked = [], []
    for candidate in candidates:
        if candidate.scope == "dense" and candidate.kind != "channels":
            continue
        found, far = here.each(candidate), there.each(candidate)
        first, place = found[0] if found else None, []
        for i, column in enumerate(found):
            same = i and column is not None and first is not None and np.array_equal(column, first)
            if column is not None and not same:
                place.append(len(columns))
                columns.append((candidate, i))
                own.append(column)
                beyond = far[i]
                asked.append(np.zeros(there.residual.size) if beyond is None else beyond)
        if place:
            groups.append((candidate, np.array(place)))
        if candidate.scope == "sparse" and len(candidate.own_sites) == 1:
            at[_family(candidate), candidate.sites] = place
    for dense in candidates:
        if dense.scope == "dense" and dense.kind != "channels":
            place = [k for s in dense.own_sites for k in at.get((_family(dense), (s,)), [])]
            if place:
                groups.append((dense, np.array(place)))
    return _projected(fitted, recorded, query, columns, np.array(own), np.array(asked), groups)


def _family(candidate: Candidate) -> tuple:
    return candidate.name, candidate.kind, tuple(sorted(candidate.start.items()))


def _nothing(fitted: Fit) -> Jacobian:
    return Jacobian(np.empty((0, *fitted.residual.shape)))


def _unwhitened(fitted: Fit, recorded: Recording, query: Recording) -> Tangents:
    """Tangents of a query's readings, in the recording's unit."""
    shape = (len(query.frames), len(query.channels))
    plain = Whitening(np.ones(shape, bool), np.ones(shape[1]), np.zeros(shape[1]))
    problem = Problem(RecordingSimulator(recorded, query), np.zeros(shape), plain)
    none = Jacobian(np.empty((0, *shape)))
    return Tangents(Fit(problem, [], fitted.theta, np.zeros(shape), none))


def _projected(
    fitted: Fit,
    recorded: Recording,
    query: Recording,
    columns: list[tuple[Candidate, int]],
    own: np.ndarray,
    asked: np.ndarray,
    groups: list[tuple[Candidate, np.ndarray]],
) -> Linear:
    """The calibrations taken out of the columns, and made to follow in the query."""
    knobs = fitted.jacobian.reshape(len(fitted.theta), -1)
    square = knobs @ knobs.T + np.diag(fitted.prior)
    residual = fitted.residual.ravel()
    residual = residual - knobs.T @ solve(square, knobs @ residual, assume_a="pos")
    predict = simulator(fitted, recorded, query)
    there = predict(fitted.theta)
    moved = [difference(predict, fitted.theta, there, i).ravel() for i in range(len(fitted.theta))]
    gram, slope, shared = _products(own, residual, knobs)
    follow = solve(square, shared, assume_a="pos")
    left = gram - shared.T @ follow
    squared = np.diag(left)
    kept = np.flatnonzero(squared > LEAST * np.diag(gram))
    length = np.sqrt(squared[kept])
    asked = (asked - follow.T @ np.array(moved))[kept] / length[:, None]
    new = {old: k for k, old in enumerate(kept)}
    remaining = [(c, np.array([new[k] for k in at if k in new], int)) for c, at in groups]
    return Linear(
        columns=[columns[k] for k in kept],
        gram=left[np.ix_(kept, kept)] / np.outer(length, length),
        slope=slope[kept] / length,
        length=length,
        asked=asked,
        groups=[(c, at) for c, at in remaining if len(at)],
        chi2=float(residual @ residual),
        dof=fitted.problem.whitening.size - len(fitted.theta),
    )


def _products(own: np.ndarray, residual: np.ndarray, knobs: np.ndarray) -> tuple[np.ndarray, ...]:
    """Of columns (K, D) in single precision, summed in double: with each other (K, K), with the
    residual (K,), with the calibrations' (P, K)."""
    gram = np.zeros((len(own), len(own)))
    slope, shared = np.zeros(len(own)), np.zeros((len(knobs), len(own)))
    for start in range(0, own.shape[1], PIECE):
        piece = slice(start, start + PIECE)
        part = own[:, piece].astype(float)
        gram += part @ part.T
        slope += part @ residual[piece]
        shared += knobs[:, piece] @ part.T
    return gram, slope, shared


def everything(made: Linear) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Least squares on every column at once but those that are a sum of others: which columns (k,),
    their values (k,), and those of them that stand out (n,), |z| beyond SIGNIFICANT over all of
    them (Bonferroni).

    The ridge is that of coordinates with a normal prior of their typical size: with less, what the
    recording leaves open runs away in the query.
    """
    chosen = np.array([k for k, (c, _) in enumerate(made.columns) if c.scope != "common"])
    gram = made.gram[np.ix_(chosen, chosen)]
    inverse = np.linalg.inv(gram + np.diag(made.length[chosen] ** -2))
    values = inverse @ made.slope[chosen]
    sd = np.sqrt(((inverse @ gram) * inverse).sum(axis=1))
    least = norm.isf(0.5 * SIGNIFICANT / len(chosen))
    return chosen, values, chosen[np.abs(values) > least * sd]


def matched_filter(made: Linear) -> tuple[np.ndarray, np.ndarray]:
    """Columns (k,) and values (k,) of candidates taken one after another, each the best by the
    screen's evidence of what is left, all fitted anew after each (Pati et al. 1993), as long as
    one is significant over all of them."""
    chosen = np.zeros(0, int)
    for _ in range(MOST_EFFECTS):
        slope, gram = _left(made, chosen)
        trials = [(_evidence(slope, gram, c, at), k) for k, (c, at) in enumerate(made.groups)]
        evidence, best = max(trials)
        if evidence < LEAST_EVIDENCE:
            break
        at = made.groups[best][1]
        gain, dof = _gain(slope, gram, at)
        if chdtrc(dof, gain) * len(made.groups) >= SIGNIFICANT:
            break
        chosen = np.union1d(chosen, at)
    return chosen, _fitted(made, chosen)


def _left(made: Linear, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Slopes and products of all columns, those chosen projected out."""
    if not len(chosen):
        return made.slope, made.gram
    inverse = np.linalg.pinv(made.gram[np.ix_(chosen, chosen)], RIDGE, hermitian=True)
    across = made.gram[:, chosen] @ inverse
    return made.slope - across @ made.slope[chosen], made.gram - across @ made.gram[chosen]


def _evidence(slope: np.ndarray, gram: np.ndarray, candidate: Candidate, at: np.ndarray) -> float:
    own = gram[np.ix_(at, at)]
    if own.diagonal().max() < 1e-6:
        return -np.inf
    return log_evidence(slope[at], own) - np.log(candidate.looks)


def _gain(slope: np.ndarray, gram: np.ndarray, at: np.ndarray) -> tuple[float, int]:
    size, turn = np.linalg.eigh(gram[np.ix_(at, at)])
    kept = size > RIDGE * size[-1]
    return float((((slope[at] @ turn)[kept]) ** 2 / size[kept]).sum()), int(kept.sum())


def _fitted(made: Linear, chosen: np.ndarray) -> np.ndarray:
    """Least squares on some columns."""
    if not len(chosen):
        return np.zeros(0)
    inverse = np.linalg.pinv(made.gram[np.ix_(chosen, chosen)], RIDGE, hermitian=True)
    return inverse @ made.slope[chosen]


def lasso(made: Linear) -> tuple[np.ndarray, np.ndarray]:
    """Columns (k,) and values (k,) of the lasso (Tibshirani 1996) on unit columns, at the penalty
    whose columns, fitted without it (Belloni and Chernozhukov 2013), have the least extended BIC
    (Chen and Chen 2008): chi squared + number · log dof + 2 log (ways to choose them)."""
    size, turn = np.linalg.eigh(made.gram)
    kept = size > RIDGE * size[-1]
    root = np.sqrt(size[kept])
    design = np.asfortranarray((turn[:, kept] * root).T)
    target = (made.slope @ turn[:, kept]) / root
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # an active set is all that is taken
        _, path, _ = lasso_path(
            design, target, eps=SMALLEST, alphas=PENALTIES, precompute=design.T @ design
        )
    best, chosen = made.chi2, np.zeros(0, int)
    for values in path.T:
        active = np.flatnonzero(values)
        if len(active):
            gain = made.slope[active] @ _fitted(made, active)
            ways = log_ways(len(made.columns), len(active))
            criterion = made.chi2 - gain + len(active) * np.log(made.dof) + 2.0 * ways
            if criterion < best:
                best, chosen = criterion, active
    return chosen, _fitted(made, chosen)


def named(made: Linear, chosen: np.ndarray) -> list[dict]:
    """The effects that columns belong to, as a diagnosis has them, one a name (of the shape one a
    harmonic), sites joined."""
    found: dict[tuple, dict] = {}
    for k in chosen:
        candidate, i = made.columns[k]
        several = tuple(sorted(candidate.start.items())) if candidate.effect.several else ()
        entry = found.setdefault(
            (candidate.name, candidate.kind, several),
            {"name": candidate.name, "alternatives": [], "parameters": {}}
            | {kind: [] for kind in SITES},
        )
        if candidate.kind is not None and candidate.scope != "common":
            sites = (candidate.sites[i],) if candidate.scope == "dense" else candidate.sites
            entry[candidate.kind] = sorted({*entry[candidate.kind], *map(int, sites)})
    return list(found.values())


def equation_9(search: Search, fitted: Fit) -> Fit:
    """The paper's perturbations fitted beside the calibrations: an ellipse, a shift of every
    electrode, a gain of every channel, its slope with the force, crosstalk; noise is the noise.

    One recording has one draw of each; gains are free channel by channel, as equation 9 has them:
    their mirrored draw is not imposed.
    """
    like = search.candidates[0]
    ellipse = Candidate(Ellipse(), None, None, "", {}, like.skin, like.scales)
    own = {c.name: c for c in search.candidates if c.scope in ("", "dense")}
    effects = [ellipse, *(own[name] for name in EQUATION_9[1:] if name in own)]
    start = np.r_[fitted.theta, np.zeros(sum(c.size for c in effects))]
    return fit(fitted.problem, effects, start)


def compare(recorded: Recording, query: Recording, seed: int) -> tuple[dict, dict]:
    """Every method of METHODS on one recording: the effects that it names (None: it names none),
    and its prediction (Q, M) of the query, in the recording's unit."""
    recorded = excerpt(recorded)
    noise, search, _ = begun(recorded, seed)
    before = search.calibrated().fit
    plain = simulator(before, recorded, query)(before.theta)
    made = linear(search, before, recorded, query)
    all_of_it, values, outstanding = everything(made)
    found = {
        "everything": (all_of_it, values, outstanding),
        **{name: (*(got := function(made)), got[0]) for name, function in GREEDY.items()},
    }
    said: dict[str, list | None] = dict.fromkeys(METHODS)
    predicted = {"none": plain}
    for name, (chosen, values, shown) in found.items():
        said[name] = named(made, shown)
        predicted[name] = plain + (values @ made.asked[chosen]).reshape(plain.shape)
    perturbed = equation_9(search, before)
    predicted["equation-9"] = simulator(perturbed, recorded, query)(perturbed.theta)
    misfit = recorded.voltage - search.as_reported(before)
    misfit = np.where(search.problem.whitening.mask, misfit, np.nan)
    states = [r.frames.assign(contact=presses(r)) for r in (recorded, query)]
    learned = black_box.corrections(states[0], misfit, noise.sd, states[1], seed)
    return said, predicted | {name: plain + added for name, added in learned.items()}


GREEDY = {"matched-filter": matched_filter, "lasso": lasso}


def run(cases: list[str], block: Path, seed: int, code: str) -> None:
    """baselines/CASE.npz, predictions (Q, M) by method, and CASE.json, {effects: by method} or,
    beside no predictions, {failed: why}, of every case of a block, each whole before the next
    begins.

    One of the same recording and query by the same code stays, in the final block by any code.
    InputError in a sealed block.
    """
    refuse_sealed(block)
    for case in cases:
        folder = block / "baselines"
        files = {
            name: block / part / f"{case}.parquet"
            for name, part in (("recording", "recordings"), ("query", "queries"))
        }
        made = cache.made_of(code, **files)
        path = folder / f"{case}.json"
        arrays = path.with_suffix(".npz")
        if not (arrays.is_file() and cache.stands(path, made, block.name == FINAL)):
            for old in (path, arrays):
                old.unlink(missing_ok=True)
            cache.write(path, made, partial(_one, files, arrays, seed))
            if not arrays.is_file():
                _write({}, arrays)


def _one(files: dict[str, Path], arrays: Path, seed: int) -> dict:
    recorded = recording.read(files["recording"])
    said, predicted = compare(recorded, read_query(files["query"], recorded), seed)
    _write(predicted, arrays)
    return {"effects": said}


def _write(predicted: dict[str, np.ndarray], arrays: Path) -> None:
    by_method: dict[str, Any] = {**predicted}
    with atomic_path(arrays) as path, path.open("wb") as file:
        np.savez_compressed(file, **by_method)
