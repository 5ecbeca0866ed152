"""The catalogue's tangents about a fit of the calibrations, at a recording and at its query."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve

from eitskin.data.recording import Recording
from eitskin.diagnose.fitting.candidates import Candidate, is_discrete
from eitskin.diagnose.fitting.fit import Fit, Problem, difference, fit
from eitskin.diagnose.fitting.jacobian import Jacobian
from eitskin.diagnose.fitting.query import simulator
from eitskin.diagnose.fitting.simulator import RecordingSimulator
from eitskin.diagnose.fitting.tangents import Tangents
from eitskin.diagnose.noise.whitening import Whitening
from eitskin.diagnose.search import tones
from eitskin.effects.ellipse import Ellipse
from eitskin.effects.mains_interference import MainsInterference
from proof.refit import Refit

MAINS = "mains-interference"
EQUATION_9 = (
    "ellipse",
    "electrode-position",
    "channel-gain",
    "force-dependent-gain",
    "crosstalk",
)
LEAST = 1e-10  # of a column's squared length: with less beside the calibrations it is theirs
PIECE = 4096  # numbers of a column that are summed at once, to bound the memory


@dataclass(frozen=True)
class TangentBasis:
    """The catalogue's tangents about a fit of the calibrations, in noise units, orthogonal to them.

    columns (K,): candidate and which of its linear coordinates; length (K,) of each column, of a
    change of typical size, beside the calibrations; gram (K, K) and slope (K,): products of unit
    columns with each other and with the residual; query_change (K, Q M): V that the query changes
    by for one unit column, the calibrations following; groups: candidates with their columns'
    indices; dof: of the residual; chi2.
    """

    columns: list[tuple[Candidate, int]]
    gram: np.ndarray
    slope: np.ndarray
    length: np.ndarray
    query_change: np.ndarray
    groups: list[tuple[Candidate, np.ndarray]]
    chi2: float
    dof: int


@dataclass(frozen=True)
class _Columns:
    """Raw tangents: names (K,), at the recording (K, D) and the query (K, Q M), by candidate."""

    names: list[tuple[Candidate, int]]
    recorded: np.ndarray
    query: np.ndarray
    groups: list[tuple[Candidate, np.ndarray]]


def tangent_basis(refit: Refit, query: Recording) -> TangentBasis:
    """The catalogue's tangents about the calibrations of a recording, and what they do to a query.

    Wires that are open or exchanged have no tangent and are left out; the tone is the strongest in
    the residual.
    """
    fitted = refit.nothing.fit
    columns = _columns(refit, _at_recording(fitted), _at_query(fitted, query))
    return _projected(refit, query, columns)


def _columns(refit: Refit, at_recording: Tangents, at_query: Tangents) -> _Columns:
    candidates = [c for c in refit.search.candidates if not is_discrete(c) and c.name != MAINS]
    like = candidates[0]
    tone = tones.score(at_recording, MainsInterference(), like.skin, like.scales)
    candidates += [] if tone is None else [tone[0].candidate]
    names: list[tuple[Candidate, int]] = []
    groups: list[tuple[Candidate, np.ndarray]] = []
    places: dict[tuple, list[int]] = {}  # columns of single sites
    recorded, query = [], []
    for candidate in candidates:
        if _is_dense(candidate):
            continue
        columns, query_columns = (
            at_recording.coordinate_columns(candidate),
            at_query.coordinate_columns(candidate),
        )
        head, place = columns[0] if columns else None, []
        for i, column in enumerate(columns):
            repeats = i and column is not None and head is not None and np.array_equal(column, head)
            if column is not None and not repeats:
                place.append(len(names))
                names.append((candidate, i))
                recorded.append(column)
                change = query_columns[i]
                query.append(np.zeros(at_query.residual.size) if change is None else change)
        if place:
            groups.append((candidate, np.array(place)))
        if candidate.scope == "sparse" and len(candidate.site_indices) == 1:
            places[_family(candidate), candidate.sites] = place
    for dense in filter(_is_dense, candidates):
        place = [k for s in dense.site_indices for k in places.get((_family(dense), (s,)), [])]
        if place:
            groups.append((dense, np.array(place)))
    return _Columns(names, np.array(recorded), np.array(query), groups)


def _is_dense(candidate: Candidate) -> bool:
    """Whether a candidate's columns are those of others, a site each."""
    return candidate.scope == "dense" and candidate.kind != "channels"


def _family(candidate: Candidate) -> tuple:
    return candidate.name, candidate.kind, tuple(sorted(candidate.start.items()))


def _at_recording(fitted: Fit) -> Tangents:
    no_slopes = Jacobian(np.empty((0, *fitted.residual.shape)))
    return Tangents(Fit(fitted.problem, [], fitted.theta, fitted.residual, no_slopes))


def _at_query(fitted: Fit, query: Recording) -> Tangents:
    """Tangents of a query's readings, in the recording's unit."""
    shape = (len(query.frames), len(query.channels))
    unit = Whitening(np.ones(shape, bool), np.ones(shape[1]), np.zeros(shape[1]))
    problem = Problem(RecordingSimulator(query, fitted.problem.model), np.zeros(shape), unit)
    no_slopes = Jacobian(np.empty((0, *shape)))
    return Tangents(Fit(problem, [], fitted.theta, np.zeros(shape), no_slopes))


def _projected(refit: Refit, query: Recording, columns: _Columns) -> TangentBasis:
    """The calibrations taken out of the columns, and made to follow in the query."""
    fitted = refit.nothing.fit
    knobs = fitted.jacobian.reshape(len(fitted.theta), -1)
    square = knobs @ knobs.T + np.diag(fitted.prior)
    residual = fitted.residual.ravel()
    residual = residual - knobs.T @ solve(square, knobs @ residual, assume_a="pos")
    predict = simulator(fitted, refit.recorded, query)
    voltage = predict(fitted.theta)
    knob_changes = [
        difference(predict, fitted.theta, voltage, i).ravel() for i in range(len(fitted.theta))
    ]
    gram, slope, shared = _products(columns.recorded, residual, knobs)
    follow = solve(square, shared, assume_a="pos")
    projected = gram - shared.T @ follow
    squared = np.diag(projected)
    free = np.flatnonzero(squared > LEAST * np.diag(gram))
    length = np.sqrt(squared[free])
    query_change = (columns.query - follow.T @ np.array(knob_changes))[free] / length[:, None]
    index_of = {column: k for k, column in enumerate(free)}
    groups = [
        (candidate, np.array([index_of[k] for k in place if k in index_of], int))
        for candidate, place in columns.groups
    ]
    return TangentBasis(
        columns=[columns.names[k] for k in free],
        gram=projected[np.ix_(free, free)] / np.outer(length, length),
        slope=slope[free] / length,
        length=length,
        query_change=query_change,
        groups=[(candidate, place) for candidate, place in groups if len(place)],
        chi2=float(residual @ residual),
        dof=fitted.problem.whitening.size - len(fitted.theta),
    )


def _products(
    columns: np.ndarray, residual: np.ndarray, knobs: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of columns (K, D) in single precision, summed in double: with each other (K, K), with the
    residual (K,), with the calibrations' (P, K)."""
    count = len(columns)
    gram, slope = np.zeros((count, count)), np.zeros(count)
    shared = np.zeros((len(knobs), count))
    for start in range(0, columns.shape[1], PIECE):
        piece = slice(start, start + PIECE)
        part = columns[:, piece].astype(float)
        gram += part @ part.T
        slope += part @ residual[piece]
        shared += knobs[:, piece] @ part.T
    return gram, slope, shared


def equation_9(refit: Refit) -> Fit:
    """The paper's perturbations fitted beside the calibrations: an ellipse, a shift of every
    electrode, a gain of every channel, its slope with the force, crosstalk; noise is the noise.

    One recording has one draw of each; gains are free channel by channel, as equation 9 has them:
    their mirrored draw is not imposed.
    """
    fitted, candidates = refit.nothing.fit, refit.search.candidates
    like = candidates[0]
    ellipse = Candidate(Ellipse(), None, None, "", {}, like.skin, like.scales)
    by_name = {c.name: c for c in candidates if c.scope in ("", "dense")}
    effects = [ellipse, *(by_name[name] for name in EQUATION_9[1:] if name in by_name)]
    start = np.r_[fitted.theta, np.zeros(sum(c.size for c in effects))]
    return fit(fitted.problem, effects, start)
