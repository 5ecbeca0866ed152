"""From simulation to recording: models trained on a simulated set, tested on a recording, as they
are and after adaptation (the authors' experiment: CORAL, an affine adapter and isotonic force
calibration on 5 % of the labels).

Frames are changes against the untouched frame of the same skin (`baseline.changes`), in V, without
further normalisation unless the method states one.

    zero-shot          ŝ = f(Δv): the recording's frames through the simulation's scalers
    z-score            each channel of the recording by its own mean and deviation, no label
    CORAL              z-score, then whitened by the recording's covariance and re-coloured with the
                       simulation's, no label (Sun, Feng & Saenko 2016, who map the source to the
                       target and train again; the inverse map needs no training)
    affine             ŝ' = ŝ + B ŝ + b, ridge towards ŝ, on the 5 %
    isotonic           force alone: F' rises with F̂ (scikit-learn), on the 5 %
    CORAL + adapter    the authors': a ∘ v + b on CORAL's inputs, f frozen, here ridge towards
                       a = 1, b = 0, on the 5 %
    ... + isotonic     their last step, on the same 5 %

References do without a simulation: the mean of the 5 %, the mean of the three nearest of them, the
same model trained on the 5 % alone, and on the recording's whole training part.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

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
from eitskin.learn.train import Budget, Optimiser, Recipe, Split
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

VALIDATION = 0.2  # of the labelled presses, held out to select the epoch
RIDGE = 1.0  # a deviation from the identity costs as much as an error, both in standard deviations
STEPS, RATE = 400, 5e-3  # of Adam, for the adapter: the authors'
TUNING_STEPS, TUNING_RATE = 100, 1e-4  # of Adam, from a network's weights on
NEIGHBOURS = 3  # as many as a few labelled presses allow


def as_simulated(target: Dataset, source: dict, electrode_deg: list[float] | None) -> np.ndarray:
    """The recording's changes (N, M) float64 in the channels, order and signs of the simulation.

    `source` is the simulated set's metadata. Channels are matched by source, sink, plus, minus; one
    whose drive or measuring pair is reversed changes sign. Where only magnitudes were recorded, a
    change of |v| takes the sign of the reading on a homogeneous disc with point electrodes at
    `electrode_deg`. Raises InputError for a missing channel and for one without such a sign.
    """
    name, metadata = target.metadata["name"], target.metadata
    column: dict[tuple, tuple[int, float]] = {}
    for k, (anode, cathode, plus, minus) in enumerate(metadata["channels"]):
        for key, factor in (
            ((anode, cathode, plus, minus), 1.0),
            ((cathode, anode, minus, plus), 1.0),
            ((cathode, anode, plus, minus), -1.0),
            ((anode, cathode, minus, plus), -1.0),
        ):
            column.setdefault(key, (k, factor))
    source_channels = [tuple(channel) for channel in source["channels"]]
    missing_count = sum(channel not in column for channel in source_channels)
    if missing_count:
        content = f"{missing_count} of the {len(source_channels)} of {source['name']} missing"
        raise InputError(name, "channels", content, "all that its models take")
    index, sign = (
        np.array(values) for values in zip(*map(column.get, source_channels), strict=True)
    )
    if metadata["voltage"] == "magnitude":
        if electrode_deg is None:
            content = "magnitudes, and electrodes whose angles are unknown"
            raise InputError(name, "voltage", content, "signs, or angles that tell them")
        reading = homogeneous_readings(np.array(source_channels), np.array(electrode_deg))
        has_sign = np.abs(reading) > 1e-9 * np.nanmax(np.abs(reading))
        if not has_sign.all():
            content = (
                f"{(~has_sign).sum()} magnitudes that are zero or unknown on a homogeneous disc"
            )
            raise InputError(name, "voltage", content, "readings whose sign is known")
        sign = np.sign(reading)
    return target.delta_V[:, index].astype(float) * sign


def z_scored(
    value: np.ndarray, domain_samples: np.ndarray, reference_samples: np.ndarray
) -> np.ndarray:
    """Values (N, M) of the domain of `domain_samples` (n, M), each channel mapped to the mean and
    the standard deviation of `reference_samples` (m, M)."""
    return _standard(value, domain_samples) * reference_samples.std(
        axis=0
    ) + reference_samples.mean(axis=0)


def coral(
    value: np.ndarray, domain_samples: np.ndarray, reference_samples: np.ndarray
) -> np.ndarray:
    """As `z_scored`, with the covariance of the domain mapped to that of the reference:

        z C_domain^(-1/2) C_reference^(1/2), C = cov z + I, z standardised within each domain

    (Sun, Feng & Saenko 2016, algorithm 1, with its regularisation).
    """
    whiten = _power(
        np.cov(_standard(domain_samples, domain_samples).T) + np.eye(domain_samples.shape[1]), -0.5
    )
    colour = _power(
        np.cov(_standard(reference_samples, reference_samples).T) + np.eye(domain_samples.shape[1]),
        0.5,
    )
    return _standard(value, domain_samples) @ whiten @ colour * reference_samples.std(
        axis=0
    ) + reference_samples.mean(axis=0)


def _standard(value: np.ndarray, samples: np.ndarray) -> np.ndarray:
    scale = samples.std(axis=0)
    return (value - samples.mean(axis=0)) / np.where(scale > 0, scale, 1.0)


def _power(symmetric: np.ndarray, exponent: float) -> np.ndarray:
    variance, axes = eigh(symmetric)
    return axes * variance**exponent @ axes.T


def affine(
    predicted: np.ndarray, labelled_predictions: np.ndarray, truth: np.ndarray, scale: np.ndarray
) -> np.ndarray:
    """States (N, T) after ŝ + B ŝ + b, with B (T, T) and b fitted to `truth` (n, T) on
    `labelled_predictions` (n, T); `scale` (T,): the targets' standard deviations. A ridge shrinks
    B, not b, to zero."""
    ridge = Ridge(alpha=RIDGE).fit(
        labelled_predictions / scale, (truth - labelled_predictions) / scale
    )
    return predicted + ridge.predict(predicted / scale) * scale


def isotonic(
    predicted: np.ndarray, labelled_predictions: np.ndarray, truth: np.ndarray
) -> np.ndarray:
    """Forces (N,) mapped by the isotonic regression of `truth` (n,) on `labelled_predictions`
    (n,)."""
    return (
        IsotonicRegression(out_of_bounds="clip").fit(labelled_predictions, truth).predict(predicted)
    )


def adapter(
    model: Trained, seed: int, labelled_changes: np.ndarray, truth: np.ndarray, columns: list[int]
) -> tuple[np.ndarray, np.ndarray]:
    """a, b (M,) of v → a ∘ v + b before a seed's frozen predictor, v standardised voltages.

    `labelled_changes` (n, M), in the unit of the training set; `truth` (n, C): states, `columns` of
    the predictor's. Minimises Σ_n mean_C (ŝ - s)² + RIDGE (|a - 1|² + |b|²), states standardised.
    """
    device = train.deterministic()
    shape = Shape.from_header(model.header, labelled_changes.shape[1])
    module = model.load_into(networks.predictor(model.header["model"], shape), seed).to(device)
    voltage = train.standardise(torch.from_numpy(labelled_changes), model.tensors, "voltage").to(
        device
    )
    mean, scale = (model.tensors[f"state_{key}"][columns] for key in ("mean", "scale"))
    standardised_truth = ((torch.from_numpy(truth) - mean) / scale).float().to(device)
    gain = torch.ones_like(voltage[0]).requires_grad_()
    shift = torch.zeros_like(voltage[0]).requires_grad_()
    adam = torch.optim.Adam([gain, shift], lr=RATE)
    for _ in range(STEPS):
        error = module(gain * voltage + shift)[:, columns] - standardised_truth
        loss = error.square().mean(dim=1).sum()
        loss = loss + RIDGE * ((gain - 1).square().sum() + shift.square().sum())
        adam.zero_grad()
        loss.backward()
        adam.step()
    return gain.detach().double().cpu().numpy(), shift.detach().double().cpu().numpy()


def fine_tuned(
    model: Trained, seed: int, labelled_changes: np.ndarray, truth: np.ndarray, columns: list[int]
) -> Trained:
    """The predictor of one seed, its weights trained on from labels: changes (n, M) in the unit of
    the training set and states (n, C), `columns` of the predictor's, by TUNING_STEPS of Adam at
    TUNING_RATE."""
    device = train.deterministic()
    shape = Shape.from_header(model.header, labelled_changes.shape[1])
    module = model.load_into(networks.predictor(model.header["model"], shape), seed).to(device)
    module.requires_grad_(True)
    voltage = train.standardise(torch.from_numpy(labelled_changes), model.tensors, "voltage")
    mean, scale = (model.tensors[f"state_{key}"][columns] for key in ("mean", "scale"))
    state = ((torch.from_numpy(truth) - mean) / scale).float().to(device)
    voltage, adam = voltage.to(device), torch.optim.Adam(module.parameters(), lr=TUNING_RATE)
    for _ in range(TUNING_STEPS):
        loss = (module(voltage)[:, columns] - state).square().mean()
        adam.zero_grad()
        loss.backward()
        adam.step()
    weights = {f"{seed}/{key}": value.detach() for key, value in module.state_dict().items()}
    scalers = {key: value for key, value in model.tensors.items() if "/" not in key}
    runs = [run for run in model.header["runs"] if run["seed"] == seed]
    return Trained({**model.header, "runs": runs}, scalers | weights)


def common_variables(target: Dataset, source: dict) -> tuple[list[str], dict[str, str]]:
    """The targets common to the simulation and the recording, and the reason for each of the
    simulation's that is left out."""
    recording_metadata, left_out = target.metadata, {}
    for variable in source["targets"]:
        if variable not in recording_metadata["targets"]:
            left_out[variable] = "not known in the recording, or the same in every frame"
        elif (
            variable in ("x", "y")
            and recording_metadata["position_frame"] != source["position_frame"]
        ):
            left_out[variable] = (
                f"the recording's places are in the {recording_metadata['position_frame']}'s frame"
            )
    return [v for v in source["targets"] if v not in left_out], left_out


@dataclass(frozen=True)
class Run:
    """A run of a method: the draw of the labels (-1: none or all), the model's seed (-1: no model),
    and the number of labelled frames."""

    method: str
    draw: int
    seed: int
    frames: int


@dataclass(frozen=True)
class Labels:
    """Labelled `rows` (n,) of a recording and their states `truth` (n, T); `columns`: the places of
    these T among a model's states, `force`: the indices of forces among the T."""

    rows: np.ndarray
    truth: np.ndarray
    columns: list[int]
    force: list[int]


def transferred(
    model: Trained,
    source: Split,
    target: Split,
    electrode_deg: list[float] | None,
    draws: Sequence[np.ndarray],
) -> pd.DataFrame:
    """Rows (RUNS) of the simulation's model on the recording's test part by every method that uses
    it: one for each run, variable and metric. A run is a seed of the model or, with labels, one of
    their `draws`, each an array of rows (n,), with the seeds in turn.

    What cannot be compared is a row with its reason in `left_out` and no value. Statistics of the
    recording are those of its training and validation frames, whose labels are not used.
    """
    simulation, recorded = source.dataset.metadata, target.dataset.metadata
    variables, missing = common_variables(target.dataset, simulation)
    table = [_omitted("", reason, variable) for variable, reason in missing.items()]
    try:
        changes = as_simulated(target.dataset, simulation, electrode_deg)
    except InputError as error:
        return pd.DataFrame([_omitted("", str(error))], columns=list(RUNS))
    if not variables:
        return pd.DataFrame(table, columns=list(RUNS))
    columns = [simulation["targets"].index(variable) for variable in variables]
    truth = _states(target.dataset, variables)
    test_rows, reference_rows = target.part == "test", target.part != "test"
    simulated = source.dataset.delta_V[source.part == "train"].astype(float)

    inputs = {
        ZERO_SHOT: changes,
        "z-score": z_scored(changes, changes[reference_rows], simulated),
        "CORAL": coral(changes, changes[reference_rows], simulated),
    }
    if recorded["unit"] != simulation["unit"]:
        del inputs[ZERO_SHOT]
        reason = f"changes are in {recorded['unit']}, the simulation's in {simulation['unit']}"
        table += [_omitted(method, reason) for method in (ZERO_SHOT, "affine", "isotonic")]
    states = {key: predict_seeds(model, value)[..., columns] for key, value in inputs.items()}

    all_columns = list(range(len(variables)))
    for seed_index, seed in enumerate(model.seeds()):
        for method, state in states.items():
            run, tested = Run(method, -1, seed, 0), state[seed_index][test_rows]
            table += _scored(run, truth[test_rows], tested, variables, all_columns)
    force = [i for i in all_columns if variables[i] == "F"]
    for draw, rows in enumerate(draws):
        seed_index = draw % len(model.seeds())
        zero_shot = states[ZERO_SHOT][seed_index] if ZERO_SHOT in states else None
        labels = Labels(rows, truth[rows], columns, force)
        for method, state, state_columns in _by_labels(
            model, seed_index, zero_shot, inputs["CORAL"], labels, test_rows
        ):
            run = Run(method, draw, model.seeds()[seed_index], len(rows))
            table += _scored(run, truth[test_rows], state, variables, state_columns)
    return pd.DataFrame(table, columns=list(RUNS))


def _by_labels(
    model: Trained,
    seed_index: int,
    zero_shot: np.ndarray | None,
    aligned: np.ndarray,
    labels: Labels,
    test_rows: np.ndarray,
) -> list[tuple[str, np.ndarray, list[int]]]:
    """Each method that uses labels, its states in `test_rows` and the columns of these it changes.

    zero_shot (N, T): states of the unchanged inputs, None without them; aligned (N, M): changes
    after CORAL.
    """
    all_columns, adapted_states = list(range(len(labels.columns))), []
    if zero_shot is not None:
        scale = model.tensors["state_scale"].numpy()[labels.columns]
        tested, labelled_states = zero_shot[test_rows], zero_shot[labels.rows]
        mapped = affine(tested, labelled_states, labels.truth, scale)
        adapted_states.append(("affine", mapped, all_columns))
        monotone = _with_isotonic(tested, labelled_states, labels.truth, labels.force)
        adapted_states.append(("isotonic", monotone, labels.force))
    seed = model.seeds()[seed_index]
    gain, shift = adapter(model, seed, aligned[labels.rows], labels.truth, labels.columns)
    adapted = predict_seeds(model, _adapted(model, aligned, gain, shift))
    state = adapted[seed_index][:, labels.columns]
    monotone = _with_isotonic(state[test_rows], state[labels.rows], labels.truth, labels.force)
    return [
        *adapted_states,
        ("CORAL + adapter", state[test_rows], all_columns),
        ("CORAL + adapter + isotonic", monotone, labels.force),
    ]


def references(
    trained: Trained,
    target: Dataset,
    part: np.ndarray,
    recipe: Recipe,
    seed: int,
) -> pd.DataFrame:
    """Rows (RUNS) of methods that use the recording alone, on its test part: the mean of the 5 %,
    the nearest of them, the model trained on them, and `trained`, on the whole training part.

    Of the labelled presses a fifth validates the training on the 5 %, which takes as many steps of
    Adam as the budget takes on the whole part; its seed changes with the draw.
    """
    variables, test_rows = target.metadata["targets"], part == "test"
    truth, all_columns = _states(target, variables), list(range(len(variables)))
    table = []
    for k, state in enumerate(predict_seeds(trained, target.delta_V[test_rows])):
        run = Run(TRAINED_ALL, -1, trained.seeds()[k], int((part != "test").sum()))
        table += _scored(run, truth[test_rows], state, variables, all_columns)
    name, training_frames = trained.header["model"], (part == "train").sum()
    for draw in range(DRAWS):
        labelled_rows = labelled(target.table, part, seed + draw)
        labels = truth[labelled_rows]
        mean = np.broadcast_to(labels.mean(axis=0), truth[test_rows].shape)
        neighbours = nearest_states(target.delta_V, part != "test", labelled_rows, labels)
        for method, state in ((CONSTANT, mean), (NEAREST, neighbours[test_rows])):
            run = Run(method, draw, -1, len(labelled_rows))
            table += _scored(run, truth[test_rows], state, variables, all_columns)
        run = Run(TRAINED_FEW, draw, seed + draw, len(labelled_rows))
        split = Split(target, part)
        rows = trained_on_labelled(split, labelled_rows, name, recipe, training_frames, run)
        table += rows
        if rows[0]["left_out"]:
            break
    return pd.DataFrame(table, columns=list(RUNS))


def trained_on_labelled(
    target: Split,
    labelled_rows: np.ndarray,
    model: str,
    recipe: Recipe,
    training_frames: int,
    run: Run,
) -> list[dict]:
    """Rows (RUNS) of a model trained on `labelled_rows` (n,) alone with the run's seed, on the test
    part, with as many steps of Adam as `training_frames` would take; one row with the reason where
    the labelled rows are too few."""
    dataset, test_rows = target.dataset, target.part == "test"
    part = labelled_parts(dataset.table, labelled_rows, run.seed)
    count = (part == "train").sum()
    budget = same_steps(recipe.budget, training_frames, count, recipe.optimiser)
    try:
        split = Split(dataset, part)
        trained = train.train_model(split, model, replace(recipe, budget=budget), run.seed)
    except InputError as error:
        return [_omitted(run.method, str(error))]
    (state,) = predict_seeds(trained, dataset.delta_V[test_rows])
    variables = dataset.metadata["targets"]
    truth = _states(dataset, variables)[test_rows]
    return _scored(run, truth, state, variables, list(range(len(variables))))


def nearest_states(
    delta_V: np.ndarray, reference_rows: np.ndarray, labelled_rows: np.ndarray, truth: np.ndarray
) -> np.ndarray:
    """States (N, T) of changes (N, M): the mean of the states of the NEIGHBOURS nearest of the
    `labelled_rows` (n,), with states `truth` (n, T), by the cosine distance; each channel relative
    to its root mean square over the `reference_rows` (N,)."""
    rms = np.sqrt(np.square(delta_V[reference_rows], dtype=float).mean(axis=0))
    scaled_change = delta_V / np.where(rms > 0, rms, 1.0)
    regressor = KNeighborsRegressor(min(NEIGHBOURS, len(labelled_rows)), metric="cosine")
    return regressor.fit(scaled_change[labelled_rows], truth).predict(scaled_change)


def labelled_parts(table: pd.DataFrame, labelled_rows: np.ndarray, seed: int) -> np.ndarray:
    """The part (N,) of each row: of the presses of the labelled rows a fifth, at least one, is
    "validation", the remainder "train"; rows without labels are "unused"."""
    press = presses(table, labelled_rows)
    shuffled_presses = np.random.default_rng([seed, 1]).permutation(press.max() + 1)
    is_validation = np.isin(
        press, shuffled_presses[: max(1, round(VALIDATION * len(shuffled_presses)))]
    )
    part = np.full(len(table), "unused", dtype="<U10")
    part[labelled_rows] = np.where(is_validation, "validation", "train")
    return part


def same_steps(
    budget: Budget, full_frames: int, labelled_frames: int, optimiser: Optimiser
) -> Budget:
    """The budget with more epochs, so that `labelled_frames` take as many steps of Adam as
    `full_frames` would."""
    trained_frames = min(full_frames, budget.samples or full_frames)
    stretch = np.ceil(trained_frames / optimiser.batch_size) / np.ceil(
        labelled_frames / optimiser.batch_size
    )
    return replace(budget, samples=None, epochs=round(budget.epochs * stretch))


def _states(target: Dataset, variables: list[str]) -> np.ndarray:
    """States (N, T) of the variables, in their order."""
    columns = [target.metadata["targets"].index(variable) for variable in variables]
    return target.states()[:, columns]


def _adapted(
    model: Trained, delta_V: np.ndarray, gain: np.ndarray, shift: np.ndarray
) -> np.ndarray:
    mean, scale = (model.tensors[f"voltage_{key}"].numpy() for key in ("mean", "scale"))
    return (gain * (delta_V - mean) / scale + shift) * scale + mean


def _with_isotonic(
    state: np.ndarray, labelled_predictions: np.ndarray, truth: np.ndarray, force: list[int]
) -> np.ndarray:
    state = state.copy()
    for i in force:
        state[:, i] = isotonic(state[:, i], labelled_predictions[:, i], truth[:, i])
    return state


def _scored(
    run: Run, truth: np.ndarray, state: np.ndarray, variables: list[str], columns: list[int]
) -> list[dict]:
    """Rows (RUNS) of a run's states (N, T), for each of the `columns` of T and each metric."""
    return [
        {
            "method": run.method,
            "draw": run.draw,
            "seed": run.seed,
            "labelled_frames": run.frames,
            "variable": variables[i],
            "metric": name,
            "value": metric(truth[:, i], state[:, i]),
            "left_out": "",
        }
        for i in columns
        for name, metric in METRICS.items()
    ]


def _omitted(method: str, reason: str, variable: str = "") -> dict:
    blank = {"draw": -1, "seed": -1, "labelled_frames": 0, "metric": "", "value": np.nan}
    return {"method": method, "variable": variable, **blank, "left_out": reason}
