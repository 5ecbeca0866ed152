"""A trained predictor as one file that needs no torch: its gates and networks as traced, and what
validation says of its errors."""

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

LEVEL = 0.9  # of an interval: the share of validation touches that it holds
LEAST = 20  # validation touches in a class of strength
CHECKED = 400  # validation touches, each with some channels taken away
PAIRED = 8  # of the pairs of electrodes every touch lacks one in so many
TAKEN = 0.1  # of all channels, at most
RARE = 0.999  # share of validation touches in which no electrode is called lost
WEAKEST = 0.99  # share of the touches trained on that are larger changes than the weakest
FRAMES = 2  # of an example that is traced


class States(nn.Module):
    """Changes (B, M) float64 → states (B, T), the mean over a model's seeds."""

    def __init__(self, model: Trained):
        super().__init__()
        name, tensors = model.header["model"], model.tensors
        shape = networks.Shape.of(model.header, len(tensors["voltage_mean"]))
        seeds = model.seeds()
        made = [model.into(networks.predictor(name, shape), seed) for seed in seeds]
        self.networks = nn.ModuleList(made)
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
        held = [self.tensors[f"familiar_{key}"] for key in ("axes", "variances", "references")]
        return gates.strangeness(standardise(change, self.tensors, "voltage"), *held)


def export(
    model: Trained,
    dataset: Dataset,
    part: np.ndarray,
    skin: dict | None,
    epochs: int,
    untouched: np.ndarray | None = None,
) -> Exported:
    """A predictor of one or more seeds as a file's content.

    `part` (N,) of the dataset it was trained on: the channels' precision is of what was trained on,
    the intervals are of the validation part, split conformal within each class of strength (Vovk
    2012, Conditional validity of inductive conformal predictors). skin: what is believed of it, as
    `Skin.metadata`; epochs: of the perceptron that does without electrodes; untouched
    (M,): the untouched skin's readings, where they are known. Raises InputError for another
    dataset, a budget that trains on the validation part as well, too few samples in a class of
    strength, and a network that cannot be traced.
    """
    _refuse(model, dataset, part)
    told = model.header["dataset"]
    trained_on, tested = part == "train", np.flatnonzero(part == "validation")
    scale, table = model.tensors["voltage_scale"].numpy(), np.array(told["channels"])
    change, states = dataset.delta_V.astype(float), dataset.states()
    z = change / scale
    edges = strength_edges(z[trained_on])
    channels = Channels(precisions(z[trained_on], edges), edges)
    without = without_electrodes.train(
        change[trained_on],
        states[trained_on],
        channels,
        table,
        {key: value for key, value in model.tensors.items() if "/" not in key},
        epochs,
        model.seeds()[0],
    )
    graphs, arrays = _graphs(model, without, change[:FRAMES], int(table.max()) + 1)
    arrays |= {
        "scale": scale,
        "touch_scale": model.tensors["touch_scale"].numpy(),
        "precision": channels.precision,
    }
    if untouched is not None:
        arrays["untouched"] = untouched
    strong = np.searchsorted(edges, strength(z[tested]))
    predicted = predict.predict_seeds(model, dataset.delta_V[tested]).mean(axis=0)
    half = _by_strength(np.abs(predicted - states[tested]), strong)
    header = {
        "format": "eitskin-predictor",
        "version": 1,
        "model": model.header["model"],
        "seeds": model.seeds(),
        "dataset": told,
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
        "lost": _lost(channels, table, z[tested], strong),
        "trained": _trained(model, dataset.delta_V[trained_on], states[trained_on]),
    }
    made = Exported(header, graphs, arrays)
    predictor = Predictor(made)
    header["intervals"] |= {
        "half_without": _half_without(predictor, dataset, tested, table),
        "widening": _widening(predictor, dataset, tested).tolist(),
    }
    return made


def _refuse(model: Trained, dataset: Dataset, part: np.ndarray) -> None:
    """Raises InputError where a model is of another dataset, or its parts do not serve."""
    told = model.header["dataset"]
    if told["name"] != dataset.metadata["name"] or "channels" not in told:
        found = dataset.metadata["name"] if "channels" in told else "no table of channels"
        raise InputError("export", "dataset", found, f"{told['name']}, with its channels")
    if not model.header["budget"]["validated"]:
        expected = "true, as intervals are calibrated on what was not trained on"
        raise InputError(told["name"], "budget, validated", "false", expected)
    least = STRENGTHS * LEAST
    for name in ("train", "validation"):
        if (found := int((part == name).sum())) < least:
            raise InputError(told["name"], f"part {name}", found, f"{least} samples or more")


def _graphs(
    model: Trained, without: nn.Module, change: np.ndarray, electrodes: int
) -> tuple[dict[str, Graph], dict[str, np.ndarray]]:
    """A predictor's gates and networks as traced on a few changes (FRAMES, M), and what they
    hold."""
    example = torch.from_numpy(change)
    which = torch.zeros(FRAMES, electrodes, dtype=torch.float64)
    graphs: dict[str, Graph] = {}
    arrays: dict[str, np.ndarray] = {}
    for name, module, frames in (
        ("activity", Activity(model), example),
        ("strangeness", Strangeness(model), example[:1]),
        ("states", States(model), example),
        ("without", without, torch.cat([example, which], dim=1)),
    ):
        graphs[name], held = traced(module, frames, f"{name}/")
        arrays |= held
    return graphs, arrays


def _trained(model: Trained, change: np.ndarray, states: np.ndarray) -> dict:
    """What a predictor was trained on, changes (n, M) and states (n, T): the weakest of them, as of
    `gates.activity`, and the states' range."""
    active = gates.activity(torch.from_numpy(change), model.tensors["touch_scale"]).numpy()
    return {
        "weakest": -upper_limit(-active, WEAKEST),
        "range": [states.min(axis=0).tolist(), states.max(axis=0).tolist()],
    }


def _by_strength(error: np.ndarray, strong: np.ndarray) -> np.ndarray:
    """(K, T): what errors (n, T) stay below with probability LEVEL, by class of strength (n,).

    Raises InputError for a class without LEAST of them.
    """
    if (fewest := int(np.bincount(strong, minlength=STRENGTHS).min())) < LEAST:
        found, expected = f"{fewest} in a class of strength", f"{LEAST} touches or more in each"
        raise InputError("export", "part validation", found, expected)
    return np.array([_limits(error[strong == number], LEVEL) for number in range(STRENGTHS)])


def _half_without(
    predictor: Predictor, dataset: Dataset, tested: np.ndarray, table: np.ndarray
) -> list:
    """[2][K][T]: as `_by_strength` of all channels, where one electrode is lost and where two are.
    Each touch lacks every set of them in turn."""
    change, truth = dataset.delta_V[tested].astype(float), dataset.states()[tested]
    found: list[tuple[list, list]] = [([], []), ([], [])]
    sets = without_electrodes.sets_of(int(table.max()) + 1)
    for number, lost in enumerate(sets):
        rows = slice(None) if len(lost) == 1 else slice(number % PAIRED, None, PAIRED)
        gone = np.flatnonzero(channels_using(table, lost))
        z = predictor.channels.filled_together(change[rows] / predictor.scale, gone)
        left = np.delete(z, gone, axis=1)
        state = predictor.states_without(z * predictor.scale, lost)
        errors, strong = found[len(lost) - 1]
        errors.append(np.abs(state - truth[rows]))
        strong.append(np.searchsorted(predictor.channels.edges, strength(left)))
    return [
        _by_strength(np.concatenate(errors), np.concatenate(strong)).tolist()
        for errors, strong in found
    ]


def _limits(error: np.ndarray, level: float) -> np.ndarray:
    """(T,): what errors (n, T) stay below with probability `level`."""
    return np.array([upper_limit(one, level) for one in error.T])


def _lost(channels: Channels, table: np.ndarray, z: np.ndarray, strong: np.ndarray) -> dict:
    """What validation touches z (n, M) reach at most, by their class of strength: `single`, the
    squared distance of the oddest channel from what the others say, and `electrode`, a channel's
    share of the oddest electrode's."""
    electrodes = Electrodes(channels, table)
    odd = [electrodes.largest_distances(one, number) for one, number in zip(z, strong, strict=True)]
    single, electrode = np.array(odd).T
    return {
        name: [upper_limit(values[strong == number], RARE) for number in range(STRENGTHS)]
        for name, values in (("single", single), ("electrode", electrode))
    }


def _widening(predictor: Predictor, dataset: Dataset, tested: np.ndarray) -> np.ndarray:
    """(T,): by what the spread of what missing channels may be is multiplied, so that intervals of
    frames that lack up to a tenth of the channels hold their share of the truth.

    Of an error e, half a width h with all channels and the spread u, the least factor κ with
    e² ≤ h² + (κ u)²; its split-conformal limit over validation touches, a Gaussian's at least.
    """
    chosen = tested[np.linspace(0, len(tested) - 1, min(CHECKED, len(tested))).astype(int)]
    truth, factors, draw = dataset.states(), [], np.random.default_rng(0)
    size = len(predictor.scale)
    for row in chosen:
        change = dataset.delta_V[row].astype(float)
        change[draw.choice(size, 1 + draw.integers(int(TAKEN * size)), replace=False)] = np.nan
        whole, missing = predictor.filled(change)
        state, spread = predictor.propagated(whole, missing)
        over = (state - truth[row]) ** 2 - predictor.half[missing.class_number] ** 2
        factors.append(np.sqrt(over.clip(min=0.0)) / spread)
    return np.maximum(_limits(np.array(factors), LEVEL), ndtri(0.5 + 0.5 * LEVEL))
