"""Score tests of every candidate, and how surprising the best of so many would be by chance."""

from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from scipy.special import chdtrc

from eitskin import cores
from eitskin.diagnose.fitting.candidates import Candidate, log_subset_count
from eitskin.diagnose.fitting.tangents import Tangents

NULL_DRAWS = 20_000  # so that a global p-value of CHANCE is known to a fifth of itself
BATCH = 4_000  # draws at once, of some megabytes
STACKED = 64  # columns whose products are computed at once
ROUNDING = 1e-9  # of the largest eigenvalue: less is rounding
AMPLITUDES = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0)  # prior sd of a coordinate, the best of them taken
MOST_SITES = 5
SIZES = MOST_SITES - 1  # of subsets, two sites and more


def log_evidence(slope: np.ndarray, information: np.ndarray) -> float:
    """Log evidence, relative to none, of coordinates with a normal prior about 0 whose likelihood's
    score is `slope` (k,) and information (k, k); the prior's sd is the best of AMPLITUDES.
    """
    if not len(slope):
        return -np.inf
    size, turn = np.linalg.eigh(information)
    size, turned = np.maximum(size, 0.0), slope @ turn
    return float(best_amplitude([evidence_along(turned, size, a).sum() for a in AMPLITUDES]))


def evidence_along(slope: np.ndarray, information: np.ndarray, amplitude: float) -> np.ndarray:
    """Log evidence (k,) of coordinates that are independent, each with the prior sd `amplitude`."""
    gain = slope**2 / (information + amplitude**-2)
    return 0.5 * (gain - np.log1p(amplitude**2 * information))


def best_amplitude(evidence: list) -> np.ndarray:
    """The largest over AMPLITUDES, less what choosing among them costs."""
    return np.max(evidence, axis=0) - np.log(len(AMPLITUDES))


def explained_square(columns: np.ndarray, residual: np.ndarray) -> tuple[float, int]:
    """Squared length of residual (D,) in the span of columns (k, D), and that span's dimension."""
    size, turn = np.linalg.eigh(columns @ columns.T)
    nonzero = size > ROUNDING * size[-1]
    slope = (columns @ residual) @ turn[:, nonzero]
    return float((slope**2 / size[nonzero]).sum()), int(nonzero.sum())


def chance_p_value(gain: float, dof: int, choices: int = 1) -> float:
    """P-value of a gain of chi squared with `dof` coordinates, the best of so many choices.

    Choices count as independent, which is conservative: Šidák (1967), for more coordinates than one
    by Royen's (2014) Gaussian correlation inequality.
    """
    single = float(chdtrc(dof, max(gain, 0.0)))
    return float(-np.expm1(choices * np.log1p(-single))) if single < 1.0 else 1.0


@dataclass(frozen=True)
class Score:
    """A candidate's score test.

    gain: of chi squared; dof: degrees of freedom; log_evidence: linear, with the prior over sites;
    choices: among how many it was chosen as the best, beyond what a `NullDistribution` counts as
    looks; information (k, k): of the coordinates, where each has some; absorbed:
    whether errors of the rig were left out of the covariance, for they may have taken the effect.
    """

    candidate: Candidate
    gain: float
    dof: int
    log_evidence: float
    choices: int = 1
    information: np.ndarray | None = field(default=None, repr=False)
    absorbed: bool = False

    @property
    def p_value(self) -> float:
        """P-value of this one look, by chance alone."""
        return chance_p_value(self.gain, self.dof, self.choices)


def score(tangents: Tangents, candidate: Candidate) -> Score | None:
    """Rao's (1948) score test of one candidate; None where it changes nothing to first order."""
    columns = tangents.columns(candidate)
    if not len(columns):
        return None
    gain, dof = explained_square(columns, tangents.residual)
    information = columns @ columns.T
    evidence = log_evidence(columns @ tangents.residual, information)
    evidence -= np.log(candidate.looks)
    is_whole = len(columns) == tangents.column_count(candidate)
    return Score(candidate, gain, dof, evidence, information=information if is_whole else None)


def best_few(tangents: Tangents, dense: Candidate) -> Score | None:
    """Score of the `subset` of a dense candidate; None where there is none."""
    best_subset = subset(tangents, dense)
    if best_subset is None:
        return None
    score_test = score(tangents, best_subset)
    return None if score_test is None else replace(score_test, choices=subset_choices(best_subset))


def subset_choices(candidate: Candidate) -> int:
    """Of the sites of a sparse candidate of two or more: the subsets of any size, every size
    weighing the same."""
    return SIZES * candidate.looks


def subset(tangents: Tangents, dense: Candidate) -> Candidate | None:
    """The sparse candidate of two or more sites that a forward selection finds among the sites of a
    dense one: as long as the evidence, with the prior over subsets, grows."""
    singles = [tangents.columns(sparse(dense, (site,))) for site in dense.site_indices]
    usable = [i for i, column in enumerate(singles) if len(column) == 1]
    if len(usable) < 3:
        return None
    columns = np.concatenate([singles[i] for i in usable])
    slope, information = columns @ tangents.residual, columns @ columns.T
    selected: list[int] = []
    best = -np.inf
    while len(selected) < min(MOST_SITES, len(usable) - 1):
        trials = [
            (_subset_evidence(slope, information, [*selected, i], len(usable)), i)
            for i in range(len(usable))
            if i not in selected
        ]
        evidence, i = max(trials)
        if evidence <= best:
            break
        best = evidence
        selected.append(i)
    if len(selected) < 2:
        return None
    return sparse(dense, tuple(sorted(dense.site_indices[usable[i]] for i in selected)))


def _subset_evidence(
    slope: np.ndarray, information: np.ndarray, subset_sites: list[int], count: int
) -> float:
    rows = np.array(subset_sites)
    evidence = log_evidence(slope[rows], information[np.ix_(rows, rows)])
    return evidence - log_subset_count(count, len(subset_sites))


def sparse(dense: Candidate, sites: tuple[int, ...]) -> Candidate:
    """The sparse candidate of some of a dense one's sites."""
    looks = round(np.exp(log_subset_count(len(dense.site_indices), len(sites))))
    return replace(dense, sites=sites, scope="sparse", looks=int(looks))


@dataclass(frozen=True)
class NullDistribution:
    """The least p-value of the whole catalogue where nothing is missing, by simulation.

    least_p_values (draws,), sorted: of the candidates' score tests on whitened noise through their
    own tangents; free: how many further independent looks there are.
    """

    least_p_values: np.ndarray
    free: int

    def p_value(self, p: float) -> float:
        """How often chance alone gives a least p-value of p or less; at least 1 / (draws + 1)."""
        below = np.searchsorted(self.least_p_values, p, side="right")
        share = (1.0 + below) / (1.0 + len(self.least_p_values))
        return float(1.0 - (1.0 - share) * (1.0 - min(p, 1.0)) ** self.free)


def null_distribution(
    tangents: Tangents, candidates: list[Candidate], free: int, seed: int
) -> NullDistribution:
    """Draw NULL_DRAWS recordings without any effect, as far as the score tests see them."""
    groups: list[np.ndarray] = []
    distinct: list[np.ndarray] = []
    numbers: dict[float, int] = {}
    rng = np.random.default_rng(seed)
    mark = rng.standard_normal(tangents.residual.size)  # one number tells a column from another
    for candidate in candidates:
        place = []
        for column in tangents.coordinate_columns(candidate):
            if column is None:
                continue
            key = float(column @ mark)
            if key not in numbers:
                numbers[key] = len(distinct)
                distinct.append(column)
            place.append(numbers[key])
        if place:
            groups.append(np.array(place))
    if not groups:
        return NullDistribution(np.ones(1), free)
    size, turn = np.linalg.eigh(_correlations(distinct))
    root = (turn * np.sqrt(np.maximum(size, 0.0))).astype(np.float32)
    root[np.abs(root) < np.finfo(np.float32).eps] = 0.0  # denormal numbers take a hundredfold time
    gram = (turn * np.maximum(size, 0.0)) @ turn.T
    whiten = []
    for group in groups:
        if len(group) > 1:
            value, vector = np.linalg.eigh(gram[np.ix_(group, group)])
            nonzero = value > ROUNDING * value[-1]
            turned = vector[:, nonzero] / np.sqrt(value[nonzero])
            whiten.append((group, turned.astype(np.float32)))
    least_p_values = []
    for _ in range(NULL_DRAWS // BATCH):
        normal = rng.standard_normal((BATCH, len(root)), dtype=np.float32) @ root.T
        worst = chdtrc(1, (normal**2).max(axis=1))
        for group, turned in whiten:
            gain = ((normal[:, group] @ turned) ** 2).sum(axis=1)
            worst = np.minimum(worst, _tail(turned.shape[1], gain))
        least_p_values.append(worst)
    return NullDistribution(np.sort(np.concatenate(least_p_values)), free)


def _correlations(columns: list[np.ndarray]) -> np.ndarray:
    """(K, K): cosines of the angles between columns (D,), of which no second copy is made."""
    gram = np.empty((len(columns), len(columns)))

    def fill_rows(i: int) -> None:
        rows = np.array(columns[i : i + STACKED], float)
        for j in range(i, len(columns), STACKED):
            block = rows if j == i else np.array(columns[j : j + STACKED], float)
            gram[i : i + STACKED, j : j + STACKED] = rows @ block.T

    cores.threaded(fill_rows, range(0, len(columns), STACKED))
    upper = np.triu(gram)
    length = np.sqrt(np.diag(gram))
    return (upper + np.triu(gram, 1).T) / np.outer(length, length)


def _tail(dof: int, gain: np.ndarray) -> np.ndarray:
    """chi2_dof's upper tail, off a table: the function itself takes microseconds a value."""
    grid, log_tail = _table(dof)
    return np.exp(np.interp(gain, grid, log_tail))


@lru_cache
def _table(dof: int) -> tuple[np.ndarray, np.ndarray]:
    grid = np.linspace(0.0, dof + 60.0 + 12.0 * np.sqrt(dof), 3000)
    return grid, np.log(chdtrc(dof, grid))
