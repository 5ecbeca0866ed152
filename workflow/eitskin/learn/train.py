"""Training: one loop for every network, and the three stages of the physics-informed predictors
(§ II-C).

    1 autoencoder    E_v, D_v   V → z → V          equation 5
    2 regressor      g_φ        s → z              equation 6, its teacher E_v frozen
    3 predictor      f_θ        V → s              equation 4 + λ · equation 7 = equation 8

λ = 0 is the plain predictor; stage 3 takes any network; support vectors have a fit of their own.
Each loss is a mean squared error: the equations' squared norms over samples, divided by the number
of components (M channels, K latents, T targets), as in the authors' code, where λ = 0.03 was found.
With undivided norms the same λ is 0.03 · T / K = 0.0056.

Equal input gives equal bytes: one thread, deterministic algorithms, one generator for each seed. A
file holds one seed of a model; all seeds share the samples.
"""

import contextlib
import math
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from eitskin.data.dataset import Dataset
from eitskin.errors import InputError
from eitskin.learn import gates, model_file, models, networks
from eitskin.learn.model_file import Trained
from eitskin.learn.networks import Shape
from eitskin.progress import patient

Loss = Callable[..., Tensor]  # (module, *batch) -> scalar


@dataclass(frozen=True)
class Split:
    """A data set and the `part` (N,) of each of its rows: "train", "validation" or "test"."""

    dataset: Dataset
    part: np.ndarray


@dataclass(frozen=True)
class Seeds:
    """The seeds of a training: of the `draw` of samples, which a model's teachers share, and of the
    `network`'s weights and batches."""

    draw: int
    network: int


@dataclass(frozen=True)
class Optimiser:
    """Adam's settings, with `weight_decay` as its L2 penalty and `batch_size` samples a step. The
    learning rate falls from `learning_rate` to 0 along a half-wave of a cosine over all steps
    (Loshchilov, Hutter, ICLR 2017), or is "constant"."""

    learning_rate: float = 1e-3
    weight_decay: float = 1e-4
    batch_size: int = 128
    schedule: str = "cosine"


@dataclass(frozen=True)
class Tube:
    """Support vector regression's settings, scikit-learn's defaults, as the paper names none: the
    penalty `C`, and `epsilon`, in standard deviations of a target, below which an error is free.
    The kernel's gamma is scikit-learn's too, 1 / (M · variance of the standardised voltages)."""

    C: float = 1.0
    epsilon: float = 0.1


@dataclass(frozen=True)
class Budget:
    """The size of a training: `samples` at most (None: all), a quarter as many for validation, and
    the number of `epochs`. Where it is `validated`, the weights of the best validation loss are
    kept; otherwise those of the last epoch, trained on the validation samples as well."""

    samples: int | None
    epochs: int
    validated: bool = True


@dataclass(frozen=True)
class Recipe:
    """The settings of a training: the weights of the force and of the latent loss (0: none), the
    hidden `widths` of a perceptron and, where its teachers are trained with it, `latent_dim` K of
    the autoencoder."""

    optimiser: Optimiser
    budget: Budget
    force_weight: float = 1.0
    lambda_latent: float = 0.0
    widths: Sequence[int] = networks.HIDDEN
    latent_dim: int | None = None

    @classmethod
    def from_settings(
        cls, settings: dict, budget: Budget, latent_dim: int | None = None
    ) -> "Recipe":
        """A recipe from the configuration's values, the optimiser's nested."""
        values = {**settings, "optimiser": Optimiser(**settings["optimiser"])}
        return cls(**values, budget=budget, latent_dim=latent_dim)


@dataclass
class Material:
    """Standardised voltages (n, M) and states (n, T) for training and for validation;
    `unvalidated_voltage`: the training voltages that are not of the validation part; `scalers`:
    means and scales of the training samples."""

    train: tuple[Tensor, ...]
    validation: tuple[Tensor, ...]
    unvalidated_voltage: Tensor
    scalers: dict[str, Tensor]


def standardise(value: Tensor, scalers: dict[str, Tensor], name: str) -> Tensor:
    """Float64 values (N, D) → float32, by the scalers' `<name>_mean` and `<name>_scale` (D,)."""
    return ((value - scalers[f"{name}_mean"]) / scalers[f"{name}_scale"]).float()


def prepare(split: Split, budget: Budget, draw: int) -> Material:
    """Standardised samples of a budget, drawn from the parts with the seed `draw`; without
    validation the samples drawn for it are in both parts.

    A channel that is constant in training is scaled by the median channel, so that a change of it
    shows. Raises InputError for a part of fewer than two samples, and for a constant target.
    """
    dataset, part = split.dataset, split.part
    generator = np.random.default_rng(draw)
    rows = {}
    for name, share in ("train", 1.0), ("validation", 0.25):
        rows[name] = generator.permutation(np.flatnonzero(part == name))
        if budget.samples is not None:
            rows[name] = rows[name][: max(1, round(share * budget.samples))]
        rows[name].sort()
        if len(rows[name]) < 2:
            raise InputError(dataset.metadata["name"], f"part {name}", "under 2", "more samples")
    rows["unvalidated"] = rows["train"]
    if not budget.validated:
        rows["train"] = np.sort(np.concatenate([rows["train"], rows["validation"]]))
    values = {"voltage": dataset.delta_V.astype(np.float64), "state": dataset.states()}
    scalers = {}
    for name, value in values.items():
        scale = value[rows["train"]].std(axis=0)
        if name == "voltage":
            scale[scale <= 1e-9 * scale.max()] = np.median(scale)
        if not (scale > 0).all():
            raise InputError(dataset.metadata["name"], f"training {name}", "no spread", "some")
        scalers[f"{name}_mean"] = torch.from_numpy(value[rows["train"]].mean(axis=0))
        scalers[f"{name}_scale"] = torch.from_numpy(scale)

    def standardised(part: str) -> tuple[Tensor, ...]:
        return tuple(
            standardise(torch.from_numpy(value[rows[part]]), scalers, name)
            for name, value in values.items()
        )

    unvalidated_voltage, _ = standardised("unvalidated")
    return Material(standardised("train"), standardised("validation"), unvalidated_voltage, scalers)


def deterministic() -> torch.device:
    """Make torch deterministic and return the device: a GPU if available, else the CPU."""
    os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
    torch.set_num_threads(1)
    # What use_deterministic_algorithms does, without importing torch's compiler.
    torch.set_deterministic_debug_mode("error")
    return torch.device("cuda" if torch.cuda.is_available() else "cpu")


@contextlib.contextmanager
def without_subnormals() -> Iterator[None]:
    """Flush numbers below the smallest normal float32 to 0 in this thread: weights that have
    decayed to there make an epoch three times as long."""
    torch.set_flush_denormal(True)
    try:
        yield
    finally:
        torch.set_flush_denormal(False)


def device_name() -> str:
    """The name of the device of `deterministic`: the GPU's, or "cpu"; written with every seed."""
    return torch.cuda.get_device_name() if torch.cuda.is_available() else "cpu"


@without_subnormals()
def fit(
    module: nn.Module,
    parts: tuple[Sequence[Tensor], Sequence[Tensor]],
    loss: Loss,
    optimiser: Optimiser,
    budget: Budget,
    seed: int,
) -> list[list[float]]:
    """Train `module` on the tensors of the training and validation `parts`; returns the training
    and the validation loss of each epoch.

    Leaves in `module` the weights of the best validation loss, without validation those of the last
    epoch. Raises InputError where a validation loss is not finite.
    """
    train, validation = parts
    adam = torch.optim.Adam(
        module.parameters(),
        lr=optimiser.learning_rate,
        weight_decay=optimiser.weight_decay,
        fused=True,
    )
    generator = torch.Generator().manual_seed(seed)
    n_train = len(train[0])
    steps = budget.epochs * math.ceil(n_train / optimiser.batch_size)
    rates = learning_rates(optimiser, steps)
    history: list[list[float]] = []
    best_score, best_weights = float("inf"), {}
    for _ in patient(range(budget.epochs), f"epochs, seed {seed}"):
        module.train()
        total = torch.zeros((), device=train[0].device)
        order = torch.randperm(n_train, generator=generator).to(train[0].device)
        for rows in order.split(optimiser.batch_size):
            adam.param_groups[0]["lr"] = next(rates)
            batch_loss = loss(module, *(values[rows] for values in train))
            adam.zero_grad()
            batch_loss.backward()
            adam.step()
            total += batch_loss.detach() * len(rows)

        module.eval()
        with torch.no_grad():
            score = _mean_loss(loss, module, validation)
        if not math.isfinite(score):
            raise InputError(
                "training", f"seed {seed}", "a loss that is not finite", "a finite one"
            )
        history.append([total.item() / n_train, score])
        if budget.validated and score < best_score:
            best_score = score
            best_weights = {k: v.clone() for k, v in module.state_dict().items()}
    if budget.validated:
        module.load_state_dict(best_weights)
    return history


def learning_rates(optimiser: Optimiser, steps: int) -> Iterator[float]:
    """The learning rate of each of the steps."""
    for step in range(steps):
        share = 0.5 * (1.0 + math.cos(math.pi * step / steps))
        yield optimiser.learning_rate * (share if optimiser.schedule == "cosine" else 1.0)


def _mean_loss(loss: Loss, module: nn.Module, samples: Sequence[Tensor]) -> float:
    """Mean loss over all samples, evaluated in chunks."""
    chunks = zip(*(values.split(networks.CHUNK) for values in samples), strict=True)
    total = sum(loss(module, *chunk).double() * len(chunk[0]) for chunk in chunks)
    return float(total) / len(samples[0])


def reconstruction(autoencoder: nn.Module, voltage: Tensor) -> Tensor:
    """Equation 5: mean squared error of the autoencoder's voltages (B, M)."""
    return (autoencoder(voltage) - voltage).square().mean()


def alignment(regressor: nn.Module, state: Tensor, latent: Tensor) -> Tensor:
    """Equation 6, of states (B, T) and latents (B, K); equation 7 if the states are predicted."""
    return (regressor(state) - latent).square().mean()


def supervision(predicted: Tensor, state: Tensor, weight: Tensor) -> Tensor:
    """Equation 4; weight (T,) is w_F for the force and 1 for every other target."""
    return (weight * (predicted - state).square()).mean()


def train_autoencoder(
    split: Split,
    output: str | Path,
    optimiser: Optimiser,
    budget: Budget,
    seeds: Seeds,
    latent_dim: int,
) -> None:
    """Stage 1: write an autoencoder to `output`."""
    device = deterministic()
    material = prepare(split, budget, seeds.draw)
    train, validation = ([values[0].to(device)] for values in (material.train, material.validation))
    torch.manual_seed(seeds.network)
    module = models.TEACHERS["autoencoder"].make(train[0].shape[1], latent_dim).to(device)
    history = fit(module, (train, validation), reconstruction, optimiser, budget, seeds.network)
    header = _header(split.dataset, "autoencoder", optimiser, budget, {"latent_dim": latent_dim})
    _write(header, material, output, seeds.network, module, history)


def train_regressor(
    split: Split,
    autoencoder: str | Path,
    output: str | Path,
    optimiser: Optimiser,
    budget: Budget,
    seeds: Seeds,
) -> None:
    """Stage 2: write a state-to-latent regressor to `output`, taught by the encoder of its seed.
    Raises InputError where the autoencoder was trained on other samples or with another seed."""
    device = deterministic()
    material, seed = prepare(split, budget, seeds.draw), seeds.network
    teacher = _teacher(autoencoder, material, seed)
    latent_dim = teacher.header["latent_dim"]
    (voltage, state), (validation_voltage, validation_state) = _on_device(material, device)
    torch.manual_seed(seed)
    encoder = _network(teacher, "autoencoder", voltage.shape[1], seed).encoder.to(device)
    module = models.TEACHERS["regressor"].make(state.shape[1], latent_dim).to(device)
    train, validation = (state, encoder(voltage)), (validation_state, encoder(validation_voltage))
    history = fit(module, (train, validation), alignment, optimiser, budget, seed)
    header = _header(split.dataset, "regressor", optimiser, budget, {"latent_dim": latent_dim})
    _write(header, material, output, seed, module, history)


def train_predictor(
    split: Split,
    model: str,
    output: str | Path,
    recipe: Recipe,
    seeds: Seeds,
    teachers: Sequence[str | Path] = (),
) -> None:
    """Stage 3: write a predictor, with the gates of `learn.gates`, to `output`.

    `teachers` are the autoencoder's file, where λ is not 0 or the model begins with an encoder, and
    the regressor's, where λ is not 0. Support vectors are fitted with the settings of `Tube`.
    Raises InputError for an unknown model, and for teachers that are missing, were trained on other
    samples or with another seed.
    """
    budget, lambda_latent = recipe.budget, recipe.lambda_latent
    dataset, seed, device = split.dataset, seeds.network, deterministic()
    material = prepare(split, budget, seeds.draw)
    targets = dataset.metadata["targets"]
    settings: dict = {"force_weight": recipe.force_weight, "lambda_latent": lambda_latent}
    model_row = models.model(model)
    if model_row.support_vectors:
        settings = {}
    teacher_models = [_teacher(path, material, seed) for path in teachers]
    if lambda_latent and len(teacher_models) < 2:
        raise InputError(output, "teachers", "none", "an autoencoder and a regressor, as λ > 0")
    if teacher_models:
        settings["latent_dim"] = teacher_models[0].header["latent_dim"]
    if model_row.perceptron:
        settings["widths"] = list(recipe.widths)
    (v, s), (v_check, s_check) = _on_device(material, device)
    weights = [recipe.force_weight if target == "F" else 1.0 for target in targets]
    weight = torch.tensor(weights, device=device)
    settings |= _set_gates(material, dataset.metadata.get("untouched"))
    fit_settings = Tube() if model_row.support_vectors else recipe.optimiser
    header = _header(dataset, model, fit_settings, budget, settings)

    torch.manual_seed(seed)
    module: Any = networks.predictor(model, Shape.from_header(header, v.shape[1])).to(device)
    train, validation, regressor = [v, s], [v_check, s_check], None
    if model_row.encoder or lambda_latent:
        encoder = _network(teacher_models[0], "autoencoder", v.shape[1], seed).encoder.to(device)
    if model_row.encoder:
        module.encoder.load_state_dict(encoder.state_dict())
    if lambda_latent:
        regressor = _network(teacher_models[1], "regressor", s.shape[1], seed).to(device)
        train, validation = [*train, encoder(v)], [*validation, encoder(v_check)]

    loss = _predictor_loss(weight, lambda_latent, regressor)
    if model_row.support_vectors:
        module.fit(v, s, **asdict(fit_settings))
        history = [[_mean_loss(loss, module, part) for part in (train, validation)]]
    else:
        history = fit(module, (train, validation), loss, recipe.optimiser, budget, seed)
    _write(header, material, output, seed, module, history)


def _predictor_loss(weight: Tensor, lambda_latent: float, regressor: nn.Module | None) -> Loss:
    """Equation 8 as a function of a network, voltages, states and, where λ is not 0, latents."""

    def loss(module: nn.Module, voltage: Tensor, state: Tensor, *latent: Tensor) -> Tensor:
        predicted = module(voltage)
        value = supervision(predicted, state, weight)
        if regressor is not None:
            value = value + lambda_latent * alignment(regressor, predicted, *latent)
        return value

    return loss


def _set_gates(material: Material, untouched: dict | None) -> dict[str, dict]:
    """The numbers of the gates of `learn.gates` by name, for a model's header; adds their tensors
    to the material's scalers."""
    scalers, numbers = material.scalers, {}
    raw = material.validation[0] * scalers["voltage_scale"] + scalers["voltage_mean"]
    for name, gate in (
        ("touch", gates.touch_gate(raw, scalers["voltage_scale"], untouched)),
        ("familiar", gates.familiar_gate(material.unvalidated_voltage, material.validation[0])),
    ):
        numbers[name] = {k: v for k, v in gate.items() if not isinstance(v, Tensor)}
        scalers |= {f"{name}_{k}": v for k, v in gate.items() if isinstance(v, Tensor)}
    return numbers


def train_model(split: Split, model: str, recipe: Recipe, seed: int) -> Trained:
    """A predictor after all of its stages, as written by `train_predictor`; the samples are drawn
    with the same seed, teachers are trained with the same optimiser and budget."""
    with TemporaryDirectory() as folder:
        encoder, regressor, output = (Path(folder, f"{k}.pt") for k in range(3))
        seeds, teachers = Seeds(seed, seed), []
        job = (recipe.optimiser, recipe.budget, seeds)
        if recipe.lambda_latent or models.model(model).encoder:
            assert recipe.latent_dim is not None
            train_autoencoder(split, encoder, *job, recipe.latent_dim)
            teachers.append(encoder)
        if recipe.lambda_latent:
            train_regressor(split, encoder, regressor, *job)
            teachers.append(regressor)
        train_predictor(split, model, output, recipe, seeds, teachers)
        return model_file.read(output)


def _on_device(material: Material, device: torch.device) -> list[list[Tensor]]:
    return [
        [tensor.to(device) for tensor in values] for values in (material.train, material.validation)
    ]


def _header(
    dataset: Dataset, model: str, optimiser: Optimiser | Tube, budget: Budget, settings: dict
) -> dict:
    required_keys = ("name", "origin", "configuration", "targets", "unit")
    optional_keys = ("voltage", "channels", "lost_channels")
    metadata = dataset.metadata
    return {
        "format": "eitskin-model",
        "version": 1,
        "model": model,
        "dataset": {key: metadata[key] for key in required_keys}
        | {key: metadata[key] for key in optional_keys if key in metadata},
        "optimiser": asdict(optimiser),
        "budget": asdict(budget),
        **settings,
    }


def _teacher(path: str | Path, material: Material, seed: int) -> Trained:
    teacher = model_file.read(path)
    for key in ("voltage_mean", "voltage_scale", "state_mean", "state_scale"):
        if not torch.equal(teacher.tensors[key], material.scalers[key]):
            raise InputError(path, key, "other values", "a teacher trained on the same samples")
    if seed not in teacher.seeds():
        raise InputError(path, "seeds", teacher.seeds(), f"{seed}, the pupil's")
    return teacher


def _network(teacher: Trained, name: str, n_inputs: int, seed: int) -> Any:
    """The network of a teacher, one of models.TEACHERS, with the weights of a seed, frozen."""
    network = models.TEACHERS[name].make(n_inputs, teacher.header["latent_dim"])
    return teacher.load_into(network, seed)


def _write(
    header: dict,
    material: Material,
    output: str | Path,
    seed: int,
    module: nn.Module,
    history: list[list[float]],
) -> None:
    weights = {f"{seed}/{key}": value for key, value in module.state_dict().items()}
    run = {"seed": seed, "device": device_name(), "history": history}
    header = {**header, "trained_samples": len(material.train[0]), "runs": [run]}
    model_file.write(Trained(header, material.scalers | weights), output)
