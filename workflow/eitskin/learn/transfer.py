"""From simulation to recording: models trained on a simulated set, tested on a recording, as they
are and after adaptation (the authors' experiment: CORAL, an affine adapter and isotonic force
calibration on 5 % of the labels).

Frames are changes against the skin's own untouched frame (`baseline.changes`), in V; nothing else
is normalised before a method says so.

    zero-shot          ŝ = f(Δv): the recording's frames through the simulation's scalers
    z-score            each channel of the recording by its own mean and deviation, no label
    CORAL              z-score, then whitened by the recording's covariance and re-coloured with the
                       simulation's, no label (Sun, Feng & Saenko 2016, who turn the source into the
                       target's colours and train again; the inverse map spares the training)
    affine             ŝ' = ŝ + B ŝ + b, ridge towards ŝ, on the 5 %
    isotonic           force alone: F' rises with F̂ (scikit-learn), on the 5 %
    CORAL + adapter    the authors': a ∘ v + b on CORAL's inputs, f frozen, here ridge towards
                       a = 1, b = 0, on the 5 %
    ... + isotonic     their last step, on the same 5 %

References know nothing of a simulation: the mean of the 5 %, the mean of the three of them that are
most alike, the same model trained on the 5 % alone, and on the recording's whole training part.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
import torch
from scipy.linalg import eigh
from sklearn.isotonic import IsotonicRegression
from sklearn.linear_model import Ridge
from sklearn.neighbors import KNeighborsRegressor

from eitskin.data.alignment import homogeneous_readings
from eitskin.data.dataset import Dataset
from eitskin.errors import InputError
from eitskin.learn import networks, train
from eitskin.learn.metrics import METRICS
from eitskin.learn.model_file import Trained
from eitskin.learn.networks import Shape
from eitskin.learn.predict import predict_seeds
from eitskin.learn.train import Budget, Optimiser, Recipe
from eitskin.learn.transfer_runs import (
    CONSTANT,
    DRAWS,
    NEAREST,
    RUNS,
    TRAINED_ALL,
    TRAINED_FEW,
    ZERO_SHOT,
    labelled,
    presses,
)

VALIDATION = 0.2  # of the labelled presses, kept to stop the training on them
RIDGE = 1.0  # a map may stray from the identity as far as a target errs, in standard deviations
STEPS, RATE = 400, 5e-3  # of Adam, for the adapter: the authors'
NEIGHBOURS = 3


def as_simulated(target: Dataset, source: dict, electrode_deg: list[float] | None) -> np.ndarray:
    """The recording's changes (N, M) float64 in the channels, order and signs of the simulation.

    `source` is the simulated set's metadata. Channels are found by source, sink, plus, minus; one
    whose drive or measuring pair is reversed changes sign. Where only magnitudes were recorded, a
    change of |v| gets the sign that the reading has on a homogeneous disc with point electrodes at
    `electrode_deg`. Raises InputError where a channel is missing or has no such sign.
    """
    name, metadata = target.metadata["name"], target.metadata
    column: dict[tuple, tuple[int, float]] = {}
    for k, (a, b, p, m) in enumerate(metadata["channels"]):
        for key, turned in (
            ((a, b, p, m), 1.0),
            ((b, a, m, p), 1.0),
            ((b, a, p, m), -1.0),
            ((a, b, m, p), -1.0),
        ):
            column.setdefault(key, (k, turned))
    wanted = [tuple(channel) for channel in source["channels"]]
    lacking = sum(channel not in column for channel in wanted)
    if lacking:
        found = f"{lacking} of the {len(wanted)} of {source['name']} missing"
        raise InputError(name, "channels", found, "all that its models take")
    index, sign = (np.array(values) for values in zip(*map(column.get, wanted), strict=True))
    if metadata["voltage"] == "magnitude":
        if electrode_deg is None:
            found = "magnitudes, and electrodes whose angles are unknown"
            raise InputError(name, "voltage", found, "signs, or angles that tell them")
        reading = homogeneous_readings(np.array(wanted), np.array(electrode_deg))
        known = np.abs(reading) > 1e-9 * np.nanmax(np.abs(reading))
        if not known.all():
            found = f"{(~known).sum()} magnitudes that are zero or unknown on a homogeneous disc"
            raise InputError(name, "voltage", found, "readings whose sign is known")
        sign = np.sign(reading)
    return target.delta_V[:, index].astype(float) * sign


def z_scored(value: np.ndarray, own: np.ndarray, other: np.ndarray) -> np.ndarray:
    """`value` (N, M) of the domain of which `own` (n, M) are samples, each channel brought to the
    mean and the standard deviation of `other` (m, M)."""
    return _standard(value, own) * other.std(axis=0) + other.mean(axis=0)


def coral(value: np.ndarray, own: np.ndarray, other: np.ndarray) -> np.ndarray:
    """As `z_scored`, but the whole covariance of `own` is brought to that of `other`:

        z C_own^(-1/2) C_other^(1/2), C = cov z + I, z standardised by each domain's own statistics

    (Sun, Feng & Saenko 2016, algorithm 1, with its regularisation).
    """
    whiten = _power(np.cov(_standard(own, own).T) + np.eye(own.shape[1]), -0.5)
    colour = _power(np.cov(_standard(other, other).T) + np.eye(own.shape[1]), 0.5)
    return _standard(value, own) @ whiten @ colour * other.std(axis=0) + other.mean(axis=0)


def _standard(value: np.ndarray, of: np.ndarray) -> np.ndarray:
    scale = of.std(axis=0)
    return (value - of.mean(axis=0)) / np.where(scale > 0, scale, 1.0)


def _power(symmetric: np.ndarray, exponent: float) -> np.ndarray:
    variance, axes = eigh(symmetric)
    return axes * variance**exponent @ axes.T


def affine(
    predicted: np.ndarray, few: np.ndarray, truth: np.ndarray, scale: np.ndarray
) -> np.ndarray:
    """States (N, T) after ŝ + B ŝ + b, where B (T, T) and b are fitted to `truth` (n, T) on the
    predictions `few` (n, T); `scale` (T,) are the targets' standard deviations. A ridge draws B,
    not b, to zero."""
    ridge = Ridge(alpha=RIDGE).fit(few / scale, (truth - few) / scale)
    return predicted + ridge.predict(predicted / scale) * scale


def isotonic(predicted: np.ndarray, few: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Forces (N,) by the rising function that is nearest to `truth` (n,) at `few` (n,)."""
    return IsotonicRegression(out_of_bounds="clip").fit(few, truth).predict(predicted)


def adapter(
    model: Trained, seed: int, few: np.ndarray, truth: np.ndarray, columns: list[int]
) -> tuple[np.ndarray, np.ndarray]:
    """a, b (M,) of v → a ∘ v + b before a seed's frozen predictor, v standardised voltages.

    `few` (n, M): changes in the unit trained on; `truth` (n, C): states, those `columns` of the
    predictor's. Minimises Σ_n mean_C (ŝ - s)² + RIDGE (|a - 1|² + |b|²), states standardised.
    """
    device = train.deterministic()
    shape = Shape.of(model.header, few.shape[1])
    module = model.into(networks.predictor(model.header["model"], shape), seed).to(device)
    voltage = train.standardise(torch.from_numpy(few), model.tensors, "voltage").to(device)
    mean, scale = (model.tensors[f"state_{key}"][columns] for key in ("mean", "scale"))
    state = ((torch.from_numpy(truth) - mean) / scale).float().to(device)
    gain = torch.ones_like(voltage[0]).requires_grad_()
    shift = torch.zeros_like(voltage[0]).requires_grad_()
    adam = torch.optim.Adam([gain, shift], lr=RATE)
    for _ in range(STEPS):
        error = module(gain * voltage + shift)[:, columns] - state
        loss = error.square().mean(dim=1).sum()
        loss = loss + RIDGE * ((gain - 1).square().sum() + shift.square().sum())
        adam.zero_grad()
        loss.backward()
        adam.step()
    return gain.detach().double().cpu().numpy(), shift.detach().double().cpu().numpy()


def common_variables(target: Dataset, source: dict) -> tuple[list[str], dict[str, str]]:
    """The targets that the simulation and the recording share, and of each other one of the
    simulation's why it is left out."""
    theirs, left_out = target.metadata, {}
    for variable in source["targets"]:
        if variable not in theirs["targets"]:
            left_out[variable] = "not known in the recording, or the same in every frame"
        elif variable in ("x", "y") and theirs["position_frame"] != source["position_frame"]:
            left_out[variable] = (
                f"the recording's places are in the {theirs['position_frame']}'s frame"
            )
    return [v for v in source["targets"] if v not in left_out], left_out


def transferred(
    model: Trained,
    source: Dataset,
    source_part: np.ndarray,
    target: Dataset,
    part: np.ndarray,
    electrode_deg: list[float] | None,
    draws: Sequence[np.ndarray],
) -> pd.DataFrame:
    """Rows (RUNS) of the simulation's model on the recording's test part by every method of its own
    (METHODS): one for each run, variable and metric. A run is a seed of the model or, where labels
    are used, one of the `draws` of them, rows (n,) each (else -1), with one of the seeds in turn.

    What cannot be compared is a row with a reason in `left_out` in place of a value. Statistics of
    the recording are those of its training and validation frames, whose labels are not used.
    """
    variables, missing = common_variables(target, source.metadata)
    table = [_left_out("", reason, variable) for variable, reason in missing.items()]
    try:
        changes = as_simulated(target, source.metadata, electrode_deg)
    except InputError as error:
        return pd.DataFrame([_left_out("", str(error))], columns=list(RUNS))
    if not variables:
        return pd.DataFrame(table, columns=list(RUNS))
    columns = [source.metadata["targets"].index(variable) for variable in variables]
    truth = _states(target, variables)
    test, seen = part == "test", part != "test"
    simulated = source.delta_V[source_part == "train"].astype(float)

    inputs = {
        ZERO_SHOT: changes,
        "z-score": z_scored(changes, changes[seen], simulated),
        "CORAL": coral(changes, changes[seen], simulated),
    }
    unit, theirs = target.metadata["unit"], source.metadata["unit"]
    if unit != theirs:
        del inputs[ZERO_SHOT]
        for method in (ZERO_SHOT, "affine", "isotonic"):
            table.append(_left_out(method, f"changes are in {unit}, the simulation's in {theirs}"))
    states = {key: predict_seeds(model, value)[..., columns] for key, value in inputs.items()}

    def scored(
        method: str, draw: int, frames: int, k: int, state: np.ndarray, at: list[int]
    ) -> list[dict]:
        return _scored(method, draw, model.seeds()[k], frames, truth[test], state, variables, at)

    every = list(range(len(variables)))
    for k in range(len(model.seeds())):
        for method, state in states.items():
            table += scored(method, -1, 0, k, state[k][test], every)
    force = [i for i in every if variables[i] == "F"]
    for draw, few in enumerate(draws):
        k = draw % len(model.seeds())
        plain = states[ZERO_SHOT][k] if ZERO_SHOT in states else None
        moved = _by_labels(model, k, plain, inputs["CORAL"], few, truth[few], columns, force, test)
        for method, state, at in moved:
            table += scored(method, draw, len(few), k, state, at)
    return pd.DataFrame(table, columns=list(RUNS))


def _by_labels(
    model: Trained,
    k: int,
    plain: np.ndarray | None,
    aligned: np.ndarray,
    few: np.ndarray,
    truth: np.ndarray,
    columns: list[int],
    force: list[int],
    test: np.ndarray,
) -> list[tuple[str, np.ndarray, list[int]]]:
    """Every method that uses labels, with its states of the rows `test` and which of these it says:
    labels `truth` (n, T) of the rows `few` (n,), of a model's seed, the k-th; plain (N, T): its
    states of the changes as they are, None where there are none; aligned (N, M): changes after
    CORAL; columns: T of the model's states; force: the forces among them."""
    every, moved = list(range(len(columns))), []
    if plain is not None:
        scale = model.tensors["state_scale"].numpy()[columns]
        moved.append(("affine", affine(plain[test], plain[few], truth, scale), every))
        monotone = _with_isotonic(plain[test], plain[few], truth, force)
        moved.append(("isotonic", monotone, force))
    gain, shift = adapter(model, model.seeds()[k], aligned[few], truth, columns)
    state = predict_seeds(model, _adapted(model, aligned, gain, shift))[k][:, columns]
    monotone = _with_isotonic(state[test], state[few], truth, force)
    return [
        *moved,
        ("CORAL + adapter", state[test], every),
        ("CORAL + adapter + isotonic", monotone, force),
    ]


def references(
    trained: Trained,
    target: Dataset,
    part: np.ndarray,
    recipe: Recipe,
    seed: int,
) -> pd.DataFrame:
    """Rows (RUNS) of what the recording alone gives on its test part: the mean of the 5 %, the
    nearest of them, the model trained on them, and `trained`, that on the whole training part.

    A fifth of the labelled presses tells which weights are kept of the training on the 5 %, which
    takes as many steps of Adam as the budget gives the whole part; its seed changes with the draw.
    """
    variables, test = target.metadata["targets"], part == "test"
    truth, every = _states(target, variables), list(range(len(variables)))
    table = []
    for k, state in enumerate(predict_seeds(trained, target.delta_V[test])):
        found = (TRAINED_ALL, -1, trained.seeds()[k], int((part != "test").sum()))
        table += _scored(*found, truth[test], state, variables, every)
    name, whole = trained.header["model"], (part == "train").sum()
    for draw in range(DRAWS):
        few = labelled(target.table, part, seed + draw)
        mean = np.broadcast_to(truth[few].mean(axis=0), truth[test].shape)
        alike = nearest(target.delta_V, part != "test", few, truth[few])[test]
        for method, state in ((CONSTANT, mean), (NEAREST, alike)):
            table += _scored(method, draw, -1, len(few), truth[test], state, variables, every)
        rows = few_alone(target, test, few, name, recipe, whole, seed + draw, draw)
        table += rows
        if rows[0]["left_out"]:
            break
    return pd.DataFrame(table, columns=list(RUNS))


def few_alone(
    target: Dataset,
    test: np.ndarray,
    few: np.ndarray,
    model: str,
    recipe: Recipe,
    whole: int,
    seed: int,
    draw: int,
) -> list[dict]:
    """Rows (RUNS) of a model trained on the rows `few` (n,) alone, on the rows `test` (N,), with as
    many steps of Adam as `whole` training frames would take; a row with the reason where they are
    too few."""
    own = few_parts(target.table, few, seed)
    spent = same_steps(recipe.budget, whole, (own == "train").sum(), recipe.optimiser)
    try:
        trained = train.train_model(target, own, model, replace(recipe, budget=spent), seed)
    except InputError as error:
        return [_left_out(TRAINED_FEW, str(error))]
    (state,) = predict_seeds(trained, target.delta_V[test])
    variables = target.metadata["targets"]
    found = (TRAINED_FEW, draw, seed, len(few), _states(target, variables)[test], state)
    return _scored(*found, variables, list(range(len(variables))))


def nearest(
    delta_V: np.ndarray, seen: np.ndarray, few: np.ndarray, truth: np.ndarray
) -> np.ndarray:
    """States (N, T) of changes (N, M): the mean of those of the three of the rows `few` (n,), whose
    states `truth` (n, T) are known, that are most alike by the cosine; each channel over its root
    mean square in the frames `seen` (N,)."""
    rms = np.sqrt(np.square(delta_V[seen], dtype=float).mean(axis=0))
    value = delta_V / np.where(rms > 0, rms, 1.0)
    known = KNeighborsRegressor(min(NEIGHBOURS, len(few)), metric="cosine")
    return known.fit(value[few], truth).predict(value)


def few_parts(table: pd.DataFrame, few: np.ndarray, seed: int) -> np.ndarray:
    """The part (N,) of each row where only the rows `few` are labelled: a fifth of their presses,
    one at least, is the validation part; all that is not labelled is "unused"."""
    press = presses(table, few)
    drawn = np.random.default_rng([seed, 1]).permutation(press.max() + 1)
    checked = np.isin(press, drawn[: max(1, round(VALIDATION * len(drawn)))])
    part = np.full(len(table), "unused", dtype="<U10")
    part[few] = np.where(checked, "validation", "train")
    return part


def same_steps(budget: Budget, whole: int, few: int, optimiser: Optimiser) -> Budget:
    """The budget with its epochs stretched so that `few` training frames take as many steps of Adam
    as `whole` would (their epochs are shorter)."""
    used = min(whole, budget.samples or whole)
    stretch = np.ceil(used / optimiser.batch_size) / np.ceil(few / optimiser.batch_size)
    return replace(budget, samples=None, epochs=round(budget.epochs * stretch))


def _states(target: Dataset, variables: list[str]) -> np.ndarray:
    return target.states()[:, [target.metadata["targets"].index(v) for v in variables]]


def _adapted(
    model: Trained, delta_V: np.ndarray, gain: np.ndarray, shift: np.ndarray
) -> np.ndarray:
    mean, scale = (model.tensors[f"voltage_{key}"].numpy() for key in ("mean", "scale"))
    return (gain * (delta_V - mean) / scale + shift) * scale + mean


def _with_isotonic(
    state: np.ndarray, few: np.ndarray, truth: np.ndarray, force: list[int]
) -> np.ndarray:
    state = state.copy()
    for i in force:
        state[:, i] = isotonic(state[:, i], few[:, i], truth[:, i])
    return state


def _scored(
    method: str,
    draw: int,
    seed: int,
    frames: int,
    truth: np.ndarray,
    state: np.ndarray,
    variables: list[str],
    at: list[int],
) -> list[dict]:
    return [
        {
            "method": method,
            "draw": draw,
            "seed": seed,
            "labelled_frames": frames,
            "variable": variables[i],
            "metric": name,
            "value": metric(truth[:, i], state[:, i]),
            "left_out": "",
        }
        for i in at
        for name, metric in METRICS.items()
    ]


def _left_out(method: str, reason: str, variable: str = "") -> dict:
    blank = {"draw": -1, "seed": -1, "labelled_frames": 0, "metric": "", "value": np.nan}
    return {"method": method, "variable": variable, **blank, "left_out": reason}
