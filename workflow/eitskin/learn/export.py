"""A trained predictor as one file that needs no torch: its gates and networks as traced, and the
intervals of its errors on the validation part."""

import numpy as np
import torch
from scipy.special import ndtri
from torch import Tensor, nn

from eitskin.data.baseline import upper_limit
from eitskin.data.dataset import Dataset
from eitskin.errors import InputError
from eitskin.exported.channels import STRENGTHS, Channels, precisions, strength, strength_edges
from eitskin.exported.electrodes import Electrodes, channels_using
from eitskin.exported.file import Exported
from eitskin.exported.graph import Graph
from eitskin.exported.predictor import Predictor
from eitskin.learn import gates, networks, predict, without_electrodes
from eitskin.learn.model_file import Trained
from eitskin.learn.trace import traced
from eitskin.learn.train import standardise

LEVEL = 0.9  # coverage of an interval over validation touches
MIN_TOUCHES = 20  # validation touches in a class of strength: the least with a 90 % limit in them
WIDENING_SAMPLES = 400  # validation touches with channels removed: the limit's quantile to 1.5 %
PAIR_STRIDE = 8  # every touch lacks one in eight pairs of electrodes: enough, an eighth of the time
MISSING_SHARE = 0.1  # of all channels at most, for the widening
LOST_QUANTILE = 0.999  # share of validation touches in which no electrode is called lost
WEAKEST_QUANTILE = 0.99  # share of training touches with larger changes than the weakest
FRAMES = 2  # of the traced example: more than one, so that their number stays free


class States(nn.Module):
    """Changes (B, M) float64 → states (B, T), the mean over a model's seeds."""

    def __init__(self, model: Trained):
        super().__init__()
        name, tensors = model.header["model"], model.tensors
        shape = networks.Shape.from_header(model.header, len(tensors["voltage_mean"]))
        seeds = model.seeds()
        modules = [model.load_into(networks.predictor(name, shape), seed) for seed in seeds]
        self.networks = nn.ModuleList(modules)
        self.scalers = {key: value for key, value in tensors.items() if "/" not in key}

    def forward(self, change: Tensor) -> Tensor:
        voltage = standardise(change, self.scalers, "voltage")
        states = [predict.unstandardised(net(voltage), self.scalers) for net in self.networks]
        return torch.stack(states).mean(dim=0)


class Activity(nn.Module):
    """Changes (B, M) → `gates.activity` (B,)."""

    def __init__(self, model: Trained):
        super().__init__()
        self.scale = model.tensors["touch_scale"]

    def forward(self, change: Tensor) -> Tensor:
        return gates.activity(change, self.scale)


class Strangeness(nn.Module):
    """Changes (B, M) → `gates.strangeness`, residual (B,) and distance (B,)."""

    def __init__(self, model: Trained):
        super().__init__()
        self.tensors = model.tensors

    def forward(self, change: Tensor) -> tuple[Tensor, Tensor]:
        subspace = [self.tensors[f"familiar_{key}"] for key in ("axes", "variances", "references")]
        return gates.strangeness(standardise(change, self.tensors, "voltage"), *subspace)


def export(
    model: Trained,
    dataset: Dataset,
    part: np.ndarray,
    skin: dict | None,
    epochs: int,
    untouched: np.ndarray | None = None,
) -> Exported:
    """The content of a file for a predictor of one or more seeds.

    dataset, part (N,): those it was trained on. The channels' precision is of the training part,
    the intervals are of the validation part, split conformal within each class of strength (Vovk
    2012, Conditional validity of inductive conformal predictors). skin: the nominal one, as
    `Skin.metadata`; epochs: of the perceptron without electrodes; untouched (M,): the readings of
    the untouched skin, where known. Raises InputError for another dataset, a budget that trains on
    the validation part, too few samples in a class of strength, and a network that cannot be
    traced.
    """
    _check(model, dataset, part)
    dataset_header = model.header["dataset"]
    training_mask, validation_rows = part == "train", np.flatnonzero(part == "validation")
    scale, table = model.tensors["voltage_scale"].numpy(), np.array(dataset_header["channels"])
    change, states = dataset.delta_V.astype(float), dataset.states()
    scaled_change = change / scale
    edges = strength_edges(scaled_change[training_mask])
    channels = Channels(precisions(scaled_change[training_mask], edges), edges)
    perceptron = without_electrodes.train(
        (change[training_mask], states[training_mask]),
        channels,
        table,
        {key: value for key, value in model.tensors.items() if "/" not in key},
        epochs,
        model.seeds()[0],
    )
    graphs, arrays = _graphs(model, perceptron, change[:FRAMES], int(table.max()) + 1)
    arrays |= {
        "scale": scale,
        "touch_scale": model.tensors["touch_scale"].numpy(),
        "precision": channels.precision,
    }
    if untouched is not None:
        arrays["untouched"] = untouched
    strength_class = np.searchsorted(edges, strength(scaled_change[validation_rows]))
    predicted = predict.predict_seeds(model, dataset.delta_V[validation_rows]).mean(axis=0)
    half = _by_strength(np.abs(predicted - states[validation_rows]), strength_class)
    header = {
        "format": "eitskin-predictor",
        "version": 1,
        "model": model.header["model"],
        "seeds": model.seeds(),
        "dataset": dataset_header,
        "skin": skin,
        "touch": model.header["touch"],
        "familiar": model.header["familiar"],
        "intervals": {
            "level": LEVEL,
            "edges": edges.tolist(),
            "half": half.tolist(),
            "half_without": np.zeros((2, *half.shape)).tolist(),
            "widening": np.zeros(half.shape[1]).tolist(),
        },
        "lost": _lost(channels, table, scaled_change[validation_rows], strength_class),
        "trained": _trained(model, dataset.delta_V[training_mask], states[training_mask]),
    }
    exported = Exported(header, graphs, arrays)
    predictor = Predictor(exported)
    header["intervals"] |= {
        "half_without": _half_without(predictor, dataset, validation_rows, table),
        "widening": _widening(predictor, dataset, validation_rows).tolist(),
    }
    return exported


def _check(model: Trained, dataset: Dataset, part: np.ndarray) -> None:
    """Raise InputError for another dataset than the model's, or parts that are too small."""
    dataset_header = model.header["dataset"]
    if dataset_header["name"] != dataset.metadata["name"] or "channels" not in dataset_header:
        content = (
            dataset.metadata["name"] if "channels" in dataset_header else "no table of channels"
        )
        raise InputError(
            "export", "dataset", content, f"{dataset_header['name']}, with its channels"
        )
    if not model.header["budget"]["validated"]:
        expected = "true, as intervals are calibrated on what was not trained on"
        raise InputError(dataset_header["name"], "budget, validated", "false", expected)
    min_samples = STRENGTHS * MIN_TOUCHES
    for name in ("train", "validation"):
        if (content := int((part == name).sum())) < min_samples:
            expected = f"{min_samples} samples or more: a larger --samples, or budget"
            raise InputError(dataset_header["name"], f"part {name}", content, expected)


def _graphs(
    model: Trained, perceptron: nn.Module, change: np.ndarray, electrodes: int
) -> tuple[dict[str, Graph], dict[str, np.ndarray]]:
    """A predictor's gates and networks traced on changes (FRAMES, M), and their arrays."""
    example = torch.from_numpy(change)
    lost_indicator = torch.zeros(FRAMES, electrodes, dtype=torch.float64)
    graphs: dict[str, Graph] = {}
    arrays: dict[str, np.ndarray] = {}
    for name, module, frames in (
        ("activity", Activity(model), example),
        ("strangeness", Strangeness(model), example[:1]),
        ("states", States(model), example),
        ("without", perceptron, torch.cat([example, lost_indicator], dim=1)),
    ):
        graphs[name], module_arrays = traced(module, frames, f"{name}/")
        arrays |= module_arrays
    return graphs, arrays


def _trained(model: Trained, change: np.ndarray, states: np.ndarray) -> dict:
    """Of the training changes (n, M) and states (n, T): the activity of the weakest, and the range
    of the states."""
    active = gates.activity(torch.from_numpy(change), model.tensors["touch_scale"]).numpy()
    return {
        "weakest": -upper_limit(-active, WEAKEST_QUANTILE),
        "range": [states.min(axis=0).tolist(), states.max(axis=0).tolist()],
    }


def _by_strength(error: np.ndarray, strength_class: np.ndarray) -> np.ndarray:
    """(K, T): the LEVEL limit of errors (n, T) in each class of strength (n,).

    Raises InputError for a class of fewer than MIN_TOUCHES.
    """
    if (
        smallest_class := int(np.bincount(strength_class, minlength=STRENGTHS).min())
    ) < MIN_TOUCHES:
        content = f"{smallest_class} in a class of strength"
        expected = f"{MIN_TOUCHES} touches or more in each"
        raise InputError("export", "part validation", content, expected)
    return np.array(
        [_limits(error[strength_class == number], LEVEL) for number in range(STRENGTHS)]
    )


def _half_without(
    predictor: Predictor, dataset: Dataset, validation_rows: np.ndarray, table: np.ndarray
) -> list:
    """[2][K][T]: `_by_strength` with one lost electrode and with two, over every set of lost
    electrodes."""
    change = dataset.delta_V[validation_rows].astype(float)
    truth = dataset.states()[validation_rows]
    errors_and_classes: list[tuple[list, list]] = [([], []), ([], [])]
    sets = without_electrodes.electrode_sets(int(table.max()) + 1)
    for number, lost_electrodes in enumerate(sets):
        rows = (
            slice(None)
            if len(lost_electrodes) == 1
            else slice(number % PAIR_STRIDE, None, PAIR_STRIDE)
        )
        missing_channels = np.flatnonzero(channels_using(table, lost_electrodes))
        filled = predictor.channels.filled_together(
            change[rows] / predictor.scale, missing_channels
        )
        measured = np.delete(filled, missing_channels, axis=1)
        state = predictor.states_without(filled * predictor.scale, lost_electrodes)
        errors, strength_class = errors_and_classes[len(lost_electrodes) - 1]
        errors.append(np.abs(state - truth[rows]))
        strength_class.append(np.searchsorted(predictor.channels.edges, strength(measured)))
    return [
        _by_strength(np.concatenate(errors), np.concatenate(strength_class)).tolist()
        for errors, strength_class in errors_and_classes
    ]


def _limits(error: np.ndarray, level: float) -> np.ndarray:
    """(T,): the split-conformal limits of errors (n, T) at probability `level`."""
    return np.array([upper_limit(target_error, level) for target_error in error.T])


def _lost(channels: Channels, table: np.ndarray, z: np.ndarray, strength_class: np.ndarray) -> dict:
    """The LOST_QUANTILE limits over validation touches z (n, M), by class of strength: `single`, of
    the largest `Electrodes.channel_distances`, `electrode`, of the largest `electrode_distances`.
    """
    electrodes = Electrodes(channels, table)
    distances = [
        electrodes.largest_distances(change, class_number)
        for change, class_number in zip(z, strength_class, strict=True)
    ]
    channel_distances, electrode_distances = np.array(distances).T
    return {
        name: [
            upper_limit(values[strength_class == class_number], LOST_QUANTILE)
            for class_number in range(STRENGTHS)
        ]
        for name, values in (("single", channel_distances), ("electrode", electrode_distances))
    }


def _widening(predictor: Predictor, dataset: Dataset, validation_rows: np.ndarray) -> np.ndarray:
    """(T,): the factor κ of the spread u due to missing channels, such that intervals of frames
    without up to a tenth of the channels keep their coverage.

    κ is the split-conformal limit over validation touches of the least factor with
    e² ≤ h² + (κ u)², where e is the error and h the half width with all channels; it is at least
    the Gaussian's.
    """
    checked_rows = validation_rows[
        np.linspace(
            0, len(validation_rows) - 1, min(WIDENING_SAMPLES, len(validation_rows))
        ).astype(int)
    ]
    truth, factors, rng = dataset.states(), [], np.random.default_rng(0)
    size = len(predictor.scale)
    for row in checked_rows:
        change = dataset.delta_V[row].astype(float)
        change[rng.choice(size, 1 + rng.integers(int(MISSING_SHARE * size)), replace=False)] = (
            np.nan
        )
        filled, missing = predictor.filled(change)
        state, spread = predictor.propagated(filled, missing)
        excess = (state - truth[row]) ** 2 - predictor.half[missing.class_number] ** 2
        factors.append(np.sqrt(excess.clip(min=0.0)) / spread)
    return np.maximum(_limits(np.array(factors), LEVEL), ndtri(0.5 + 0.5 * LEVEL))
