"""What others would make of a concealed recording: from the recording and the query alone.

`none`: the owner's belief, its calibrations fitted. Of the tangents of the whole catalogue about
it: `everything`, least squares on all at once; `matched-filter`, one after another by the
diagnosis' own score test; `lasso`. `equation-9`: the paper's perturbations fitted to the
recording. `gp` and `mlp`: black boxes on the residual. What is linear predicts to first order,
the calibrations following.
"""

import warnings
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import chdtrc
from scipy.stats import norm
from sklearn.exceptions import ConvergenceWarning
from sklearn.linear_model import lasso_path

from eitskin.atomic import atomic_path
from eitskin.data import recording
from eitskin.data.recording import Recording, presses
from eitskin.diagnose.fitting.candidates import Candidate, log_subset_count
from eitskin.diagnose.fitting.query import simulator
from eitskin.diagnose.search.gates import CHANCE, EFFECTS_OF_A_SET, EVIDENCE
from eitskin.diagnose.search.screen import log_evidence
from eitskin.diagnose.verdict.record import read_query
from eitskin.effects.effect import SITES
from proof import black_box, ledger
from proof.refit import Refit
from proof.tangent_basis import TangentBasis, equation_9, tangent_basis
from proof.verdicts import FINAL, refuse_sealed

NAMING = ("everything", "matched-filter", "lasso")
METHODS = ("none", *NAMING, "equation-9", "gp", "mlp")
RIDGE = 1e-7  # of the largest eigenvalue: columns are single-precision numbers
SHORTEST = 1e-6  # squared length of a unit column beside others: with less it is a sum of them
PENALTIES = 60  # of the lasso's path
SMALLEST = 1e-4  # the last penalty of it, over that which leaves nothing in


def everything(basis: TangentBasis) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Least squares on every column at once but those that are a sum of others: which columns (k,),
    their values (k,), and those of them that stand out (n,), |z| beyond CHANCE over all of
    them (Bonferroni).

    The ridge is that of coordinates with a normal prior of their typical size: with less, what the
    recording leaves open runs away in the query.
    """
    index = np.array([k for k, (c, _) in enumerate(basis.columns) if c.scope != "common"])
    gram = basis.gram[np.ix_(index, index)]
    inverse = np.linalg.inv(gram + np.diag(basis.length[index] ** -2))
    values = inverse @ basis.slope[index]
    sd = np.sqrt(((inverse @ gram) * inverse).sum(axis=1))
    threshold = norm.isf(0.5 * CHANCE.threshold / len(index))
    return index, values, index[np.abs(values) > threshold * sd]


def matched_filter(basis: TangentBasis) -> tuple[np.ndarray, np.ndarray]:
    """Columns (k,) and values (k,) of candidates taken one after another, each the best by the
    screen's evidence of the residual, all fitted anew after each (Pati et al. 1993), as long as
    one is significant over all of them."""
    active = np.zeros(0, int)
    for _ in range(int(EFFECTS_OF_A_SET.threshold)):
        slope, gram = _beside(basis, active)
        evidence, best = max(
            (_evidence(slope, gram, candidate, place), k)
            for k, (candidate, place) in enumerate(basis.groups)
        )
        if evidence < EVIDENCE.threshold:
            break
        place = basis.groups[best][1]
        gain, dof = _gain(slope, gram, place)
        if chdtrc(dof, gain) * len(basis.groups) >= CHANCE.threshold:
            break
        active = np.union1d(active, place)
    return active, _least_squares(basis, active)


def _beside(basis: TangentBasis, active: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Slopes and products of all columns, the active ones projected out."""
    if not len(active):
        return basis.slope, basis.gram
    inverse = np.linalg.pinv(basis.gram[np.ix_(active, active)], RIDGE, hermitian=True)
    across = basis.gram[:, active] @ inverse
    return basis.slope - across @ basis.slope[active], basis.gram - across @ basis.gram[active]


def _evidence(
    slope: np.ndarray, gram: np.ndarray, candidate: Candidate, place: np.ndarray
) -> float:
    products = gram[np.ix_(place, place)]
    if products.diagonal().max() < SHORTEST:
        return -np.inf
    return log_evidence(slope[place], products) - np.log(candidate.looks)


def _gain(slope: np.ndarray, gram: np.ndarray, place: np.ndarray) -> tuple[float, int]:
    """How much χ² falls with some columns fitted, and their degrees of freedom."""
    eigenvalues, rotation = np.linalg.eigh(gram[np.ix_(place, place)])
    full = eigenvalues > RIDGE * eigenvalues[-1]
    gain = (((slope[place] @ rotation)[full]) ** 2 / eigenvalues[full]).sum()
    return float(gain), int(full.sum())


def _least_squares(basis: TangentBasis, active: np.ndarray) -> np.ndarray:
    if not len(active):
        return np.zeros(0)
    inverse = np.linalg.pinv(basis.gram[np.ix_(active, active)], RIDGE, hermitian=True)
    return inverse @ basis.slope[active]


def lasso(basis: TangentBasis) -> tuple[np.ndarray, np.ndarray]:
    """Columns (k,) and values (k,) of the lasso (Tibshirani 1996) on unit columns, at the penalty
    whose columns, fitted without it (Belloni and Chernozhukov 2013), have the least extended BIC
    (Chen and Chen 2008): chi squared + number · log dof + 2 log (ways to choose them)."""
    eigenvalues, rotation = np.linalg.eigh(basis.gram)
    full = eigenvalues > RIDGE * eigenvalues[-1]
    root = np.sqrt(eigenvalues[full])
    design = np.asfortranarray((rotation[:, full] * root).T)
    target = (basis.slope @ rotation[:, full]) / root
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # an active set is all that is taken
        _, path, _ = lasso_path(
            design, target, eps=SMALLEST, alphas=PENALTIES, precompute=design.T @ design
        )
    least_criterion, best = basis.chi2, np.zeros(0, int)
    for values in path.T:
        active = np.flatnonzero(values)
        if len(active):
            gain = basis.slope[active] @ _least_squares(basis, active)
            ways = log_subset_count(len(basis.columns), len(active))
            criterion = basis.chi2 - gain + len(active) * np.log(basis.dof) + 2.0 * ways
            if criterion < least_criterion:
                least_criterion, best = criterion, active
    return best, _least_squares(basis, best)


def named(basis: TangentBasis, columns: np.ndarray) -> list[dict]:
    """The effects that columns belong to, as a diagnosis has them, one a name (of the shape one a
    harmonic), sites joined."""
    entries: dict[tuple, dict] = {}
    for k in columns:
        candidate, i = basis.columns[k]
        start_values = tuple(sorted(candidate.start.items())) if candidate.effect.several else ()
        entry = entries.setdefault(
            (candidate.name, candidate.kind, start_values),
            {"name": candidate.name, "alternatives": [], "parameters": {}}
            | {kind: [] for kind in SITES},
        )
        if candidate.kind is not None and candidate.scope != "common":
            sites = (candidate.sites[i],) if candidate.scope == "dense" else candidate.sites
            entry[candidate.kind] = sorted({*entry[candidate.kind], *map(int, sites)})
    return list(entries.values())


def compare(recorded: Recording, query: Recording, seed: int) -> tuple[dict, dict]:
    """Every method of METHODS on one recording: the effects that it names (None: it names none),
    and its prediction (Q, M) of the query, in the recording's unit."""
    refit = Refit.of(recorded, seed)
    plain = refit.prediction(refit.nothing, query)
    basis = tangent_basis(refit, query)
    columns, values, outstanding = everything(basis)
    fits = {"everything": (columns, values, outstanding)}
    for name, method in (("matched-filter", matched_filter), ("lasso", lasso)):
        columns, values = method(basis)
        fits[name] = columns, values, columns
    entries: dict[str, list | None] = dict.fromkeys(METHODS)
    predicted = {"none": plain}
    for name, (columns, values, outstanding) in fits.items():
        entries[name] = named(basis, outstanding)
        change = (values @ basis.query_change[columns]).reshape(plain.shape)
        predicted[name] = plain + change
    perturbed = equation_9(refit)
    predicted["equation-9"] = simulator(perturbed, refit.recorded, query)(perturbed.theta)
    states = [r.frames.assign(contact=presses(r)) for r in (refit.recorded, query)]
    corrections = black_box.corrections(states[0], refit.misfit(), refit.noise.sd, states[1], seed)
    return entries, predicted | {name: plain + change for name, change in corrections.items()}


def run(cases: list[str], block: Path, seed: int, code: str) -> None:
    """baselines/CASE.npz, predictions (Q, M) by method, and CASE.json, {effects: by method} or,
    beside no predictions, {failed: why}, of every case of a block, each whole before the next
    begins.

    One of the same recording and query by the same code stays, in the final block by any code.
    InputError in a sealed block.
    """
    refuse_sealed(block)
    for case in cases:
        files, path = ledger.files_of(block, case), block / "baselines" / f"{case}.json"
        provenance, arrays = ledger.sources(code, **files), path.with_suffix(".npz")
        if not (arrays.is_file() and ledger.stands(path, provenance, block.name == FINAL)):
            for old in (path, arrays):
                old.unlink(missing_ok=True)
            row = ledger.outcome(partial(_compared, files, arrays, seed))
            ledger.write(path, {**row, "made": provenance})
            if not arrays.is_file():
                _write({}, arrays)


def _compared(files: dict[str, Path], arrays: Path, seed: int) -> dict:
    recorded = recording.read(files["recording"])
    entries, predicted = compare(recorded, read_query(files["query"], recorded), seed)
    _write(predicted, arrays)
    return {"effects": entries}


def _write(predicted: dict[str, np.ndarray], arrays: Path) -> None:
    by_method: dict[str, Any] = {**predicted}
    with atomic_path(arrays) as path, path.open("wb") as file:
        np.savez_compressed(file, **by_method)
