"""Training: one loop for every network, and the three stages of the physics-informed predictors
(§ II-C).

    1 autoencoder    E_v, D_v   V → z → V          equation 5
    2 regressor      g_φ        s → z              equation 6, its teacher E_v frozen
    3 predictor      f_θ        V → s              equation 4 + λ · equation 7 = equation 8

λ = 0 is the plain predictor; stage 3 takes any network; support vectors have a fit of their own.
Each loss is a mean squared error: the equations' squared norms over samples, divided by the number
of components (M channels, K latents, T targets), as in the authors' code, where λ = 0.03 was found.
With undivided norms the same λ is 0.03 · T / K = 0.0056.

Same input, same bytes: one thread, deterministic algorithms, a generator a seed. A file holds one
seed; `draw` is the seed of the samples, which all seeds of a model share.
"""

import contextlib
import math
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch
from torch import Tensor, nn

from eitskin.data.dataset import Dataset
from eitskin.errors import InputError
from eitskin.learn import gates, model_file, models, networks
from eitskin.learn.model_file import Trained
from eitskin.learn.networks import Autoencoder, Shape, StateToLatent, Svr
from eitskin.progress import patient

Loss = Callable[..., Tensor]  # (module, *batch) -> scalar


@dataclass(frozen=True)
class Optimiser:
    """Adam's settings: `weight_decay` is its L2 penalty, a step sees `batch_size` samples. The
    learning rate falls from `learning_rate` to 0 along a half-wave of a cosine, which ends with the
    last step (Loshchilov, Hutter, ICLR 2017), or stays as it is ("constant")."""

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
    """What a training may cost: `samples` at most (None: all; a quarter as many to validate on) and
    `epochs`, all of which are run. The weights of the best validation loss are kept; where nothing
    is `validated` those of the last epoch, trained on what was to validate on as well."""

    samples: int | None
    epochs: int
    validated: bool = True


@dataclass(frozen=True)
class Recipe:
    """How a model is trained: the weights of the force and of the latent loss (0: none), the hidden
    `widths` of a perceptron and, where its teachers are trained with it, `latent_dim` K of the
    autoencoder."""

    optimiser: Optimiser
    budget: Budget
    force_weight: float = 1.0
    lambda_latent: float = 0.0
    widths: Sequence[int] = networks.HIDDEN
    latent_dim: int | None = None

    @classmethod
    def of(cls, settings: dict, budget: Budget, latent_dim: int | None = None) -> "Recipe":
        """A recipe from plain values, the optimiser's in a dictionary of their own."""
        own = {**settings, "optimiser": Optimiser(**settings["optimiser"])}
        return cls(**own, budget=budget, latent_dim=latent_dim)


@dataclass
class Material:
    """Standardised voltages (n, M) and states (n, T) that are trained on, and of the validation
    part; `apart`: voltages that are trained on and not of the validation part; `scalers`: what made
    them (means and scales of what is trained on alone)."""

    train: tuple[Tensor, ...]
    validation: tuple[Tensor, ...]
    apart: Tensor
    scalers: dict[str, Tensor]


def standardise(value: Tensor, scalers: dict[str, Tensor], name: str) -> Tensor:
    """Float64 values (N, D) → float32, by the scalers' `<name>_mean` and `<name>_scale` (D,)."""
    return ((value - scalers[f"{name}_mean"]) / scalers[f"{name}_scale"]).float()


def prepare(dataset: Dataset, part: np.ndarray, budget: Budget, draw: int) -> Material:
    """Draw a budget's samples from the parts by the seed `draw`, standardise them; where nothing is
    validated, what is drawn to validate on is in both parts.

    A channel that never moves in training is scaled by the median channel, so that a move shows.
    """
    generator = np.random.default_rng(draw)
    rows = {}
    for name, share in ("train", 1.0), ("validation", 0.25):
        rows[name] = generator.permutation(np.flatnonzero(part == name))
        if budget.samples is not None:
            rows[name] = rows[name][: max(1, round(share * budget.samples))]
        rows[name].sort()
        if len(rows[name]) < 2:
            raise InputError(dataset.metadata["name"], f"part {name}", "under 2", "more samples")
    rows["apart"] = rows["train"]
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

    apart, _ = standardised("apart")
    return Material(standardised("train"), standardised("validation"), apart, scalers)


def deterministic() -> torch.device:
    """Make torch repeatable; returns the device: a GPU where there is one, else the CPU."""
    os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
    torch.set_num_threads(1)
    # What use_deterministic_algorithms does, without importing torch's compiler.
    torch.set_deterministic_debug_mode("error")
    return torch.device("cuda" if torch.cuda.is_available() else "cpu")


@contextlib.contextmanager
def without_subnormals() -> Iterator[None]:
    """Numbers under the least normal float32 count as 0, in all that this thread computes: weights
    that have decayed to there make an epoch three times as long."""
    torch.set_flush_denormal(True)
    try:
        yield
    finally:
        torch.set_flush_denormal(False)


def device_name() -> str:
    """What `deterministic` chose: the GPU's name, or "cpu"; written with every seed."""
    return torch.cuda.get_device_name() if torch.cuda.is_available() else "cpu"


@without_subnormals()
def fit(
    module: nn.Module,
    train: Sequence[Tensor],
    validation: Sequence[Tensor],
    loss: Loss,
    optimiser: Optimiser,
    budget: Budget,
    seed: int,
) -> list[list[float]]:
    """The loop, over all epochs of the budget. Leaves in `module` the weights of the best
    validation loss, or where nothing is validated the last; returns the training and the validation
    loss of each epoch. Raises InputError where a validation loss is not finite."""
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
    best, best_weights = float("inf"), {}
    for _ in patient(range(budget.epochs), f"epochs, seed {seed}"):
        module.train()
        total = torch.zeros((), device=train[0].device)
        order = torch.randperm(n_train, generator=generator).to(train[0].device)
        for rows in order.split(optimiser.batch_size):
            adam.param_groups[0]["lr"] = next(rates)
            value = loss(module, *(values[rows] for values in train))
            adam.zero_grad()
            value.backward()
            adam.step()
            total += value.detach() * len(rows)

        module.eval()
        with torch.no_grad():
            score = _mean_loss(loss, module, validation)
        if not math.isfinite(score):
            raise InputError(
                "training", f"seed {seed}", "a loss that is not finite", "a finite one"
            )
        history.append([total.item() / n_train, score])
        if budget.validated and score < best:
            best = score
            best_weights = {k: v.clone() for k, v in module.state_dict().items()}
    if budget.validated:
        module.load_state_dict(best_weights)
    return history


def learning_rates(optimiser: Optimiser, steps: int) -> Iterator[float]:
    """The learning rate of each step."""
    for step in range(steps):
        share = 0.5 * (1.0 + math.cos(math.pi * step / steps))
        yield optimiser.learning_rate * (share if optimiser.schedule == "cosine" else 1.0)


def _mean_loss(loss: Loss, module: nn.Module, samples: Sequence[Tensor]) -> float:
    """A loss over all samples, a bounded number of them at a time."""
    chunks = zip(*(values.split(networks.CHUNK) for values in samples), strict=True)
    total = sum(loss(module, *chunk).double() * len(chunk[0]) for chunk in chunks)
    return float(total) / len(samples[0])


def fit_svr(voltage: Tensor, state: Tensor, tube: Tube) -> Svr:
    """A support vector regression for each target on standardised voltages (n, M) and states
    (n, T). Nothing in it is drawn: same samples, same vectors."""
    from sklearn.svm import SVR  # here, as only this fit needs it

    v, s = voltage.double().cpu().numpy(), state.double().cpu().numpy()
    gamma = 1.0 / (v.shape[1] * v.var())
    dual, intercept = np.zeros((s.shape[1], len(v))), np.zeros(s.shape[1])
    for k, target in enumerate(s.T):
        fitted = SVR(C=tube.C, epsilon=tube.epsilon, gamma=gamma).fit(v, target)
        dual[k, fitted.support_] = fitted.dual_coef_[0]
        intercept[k] = fitted.intercept_[0]
    support = np.flatnonzero((dual != 0).any(axis=0))
    module = Svr(v.shape[1], s.shape[1])
    module.load_state_dict(
        {
            "support": voltage.cpu()[support],
            "dual": torch.from_numpy(dual[:, support]),
            "intercept": torch.from_numpy(intercept),
            "gamma": torch.tensor(gamma, dtype=torch.float64),
        }
    )
    return module.to(voltage.device)


def reconstruction(autoencoder: nn.Module, voltage: Tensor) -> Tensor:
    """Equation 5."""
    return (autoencoder(voltage) - voltage).square().mean()


def alignment(regressor: nn.Module, state: Tensor, latent: Tensor) -> Tensor:
    """Equation 6; equation 7 where the states are predicted."""
    return (regressor(state) - latent).square().mean()


def supervision(predicted: Tensor, state: Tensor, weight: Tensor) -> Tensor:
    """Equation 4; weight (T,) is w_F for the force and 1 for every other target."""
    return (weight * (predicted - state).square()).mean()


def train_autoencoder(
    dataset: Dataset,
    part: np.ndarray,
    output: str | Path,
    optimiser: Optimiser,
    budget: Budget,
    draw: int,
    seed: int,
    latent_dim: int,
) -> None:
    """Stage 1: write an autoencoder to `output`."""
    device = deterministic()
    material = prepare(dataset, part, budget, draw)
    train, validation = ([values[0].to(device)] for values in (material.train, material.validation))
    torch.manual_seed(seed)
    module = Autoencoder(train[0].shape[1], latent_dim).to(device)
    history = fit(module, train, validation, reconstruction, optimiser, budget, seed)
    header = _header(dataset, "autoencoder", optimiser, budget, {"latent_dim": latent_dim})
    _write(header, material, output, seed, module, history)


def train_regressor(
    dataset: Dataset,
    part: np.ndarray,
    autoencoder: str | Path,
    output: str | Path,
    optimiser: Optimiser,
    budget: Budget,
    draw: int,
    seed: int,
) -> None:
    """Stage 2: write a state-to-latent regressor to `output`, taught by the encoder of its seed.
    Raises InputError where the autoencoder saw other data or is of another seed."""
    device = deterministic()
    material = prepare(dataset, part, budget, draw)
    teacher = _teacher(autoencoder, material, seed)
    latent_dim = teacher.header["latent_dim"]
    (v, s), (v_check, s_check) = _moved(material, device)
    torch.manual_seed(seed)
    encoder = teacher.into(Autoencoder(v.shape[1], latent_dim), seed).encoder.to(device)
    module = StateToLatent(s.shape[1], latent_dim).to(device)
    train, validation = (s, encoder(v)), (s_check, encoder(v_check))
    history = fit(module, train, validation, alignment, optimiser, budget, seed)
    header = _header(dataset, "regressor", optimiser, budget, {"latent_dim": latent_dim})
    _write(header, material, output, seed, module, history)


def train_predictor(
    dataset: Dataset,
    part: np.ndarray,
    model: str,
    output: str | Path,
    recipe: Recipe,
    draw: int,
    seed: int,
    teachers: Sequence[str | Path] = (),
) -> None:
    """Stage 3: write a predictor, with the gates of `learn.gates`, to `output`.

    `teachers` are the autoencoder's file, where λ is not 0 or the model begins with an encoder, and
    the regressor's, where λ is not 0. Support vectors are fitted by the settings of `Tube`, and
    nothing of them is drawn but the samples. Raises InputError for an unknown model, and where
    teachers are missing, saw other data or are of another seed.
    """
    budget, lambda_latent = recipe.budget, recipe.lambda_latent
    device = deterministic()
    material = prepare(dataset, part, budget, draw)
    targets = dataset.metadata["targets"]
    settings: dict = {"force_weight": recipe.force_weight, "lambda_latent": lambda_latent}
    known = models.model(model)
    if known.support_vectors:
        settings = {}
    taught = [_teacher(path, material, seed) for path in teachers]
    if lambda_latent and len(taught) < 2:
        raise InputError(output, "teachers", "none", "an autoencoder and a regressor, as λ > 0")
    if taught:
        settings["latent_dim"] = taught[0].header["latent_dim"]
    if known.perceptron:
        settings["widths"] = list(recipe.widths)
    (v, s), (v_check, s_check) = _moved(material, device)
    weights = [recipe.force_weight if target == "F" else 1.0 for target in targets]
    weight = torch.tensor(weights, device=device)
    settings |= _set_gates(material, dataset.metadata.get("untouched"))
    fitted_by = Tube() if known.support_vectors else recipe.optimiser
    header = _header(dataset, model, fitted_by, budget, settings)

    torch.manual_seed(seed)
    module = networks.predictor(model, Shape.of(header, v.shape[1])).to(device)
    train, validation, regressor = [v, s], [v_check, s_check], None
    if known.encoder or lambda_latent:
        latent_dim = settings["latent_dim"]
        encoder = taught[0].into(Autoencoder(v.shape[1], latent_dim), seed).encoder.to(device)
    if known.encoder:
        assert isinstance(module.encoder, nn.Module)
        module.encoder.load_state_dict(encoder.state_dict())
    if lambda_latent:
        regressor = taught[1].into(StateToLatent(s.shape[1], latent_dim), seed).to(device)
        train, validation = [*train, encoder(v)], [*validation, encoder(v_check)]

    loss = _predictor_loss(weight, lambda_latent, regressor)
    if known.support_vectors:
        module = fit_svr(v, s, Tube())
        history = [[_mean_loss(loss, module, part) for part in (train, validation)]]
    else:
        history = fit(module, train, validation, loss, recipe.optimiser, budget, seed)
    _write(header, material, output, seed, module, history)


def _predictor_loss(weight: Tensor, lambda_latent: float, regressor: nn.Module | None) -> Loss:
    """Equation 8, of a network and voltages, states and, where λ is not 0, latents; weight (T,)."""

    def loss(module: nn.Module, voltage: Tensor, state: Tensor, *latent: Tensor) -> Tensor:
        predicted = module(voltage)
        value = supervision(predicted, state, weight)
        if regressor is not None:
            value = value + lambda_latent * alignment(regressor, predicted, *latent)
        return value

    return loss


def _set_gates(material: Material, untouched: dict | None) -> dict[str, dict]:
    """The numbers of the gates of `learn.gates` by their names, for a model's header; their tensors
    join the material's scalers."""
    scalers, numbers = material.scalers, {}
    raw = material.validation[0] * scalers["voltage_scale"] + scalers["voltage_mean"]
    for name, gate in (
        ("touch", gates.touch_gate(raw, scalers["voltage_scale"], untouched)),
        ("familiar", gates.familiar_gate(material.apart, material.validation[0])),
    ):
        numbers[name] = {k: v for k, v in gate.items() if not isinstance(v, Tensor)}
        scalers |= {f"{name}_{k}": v for k, v in gate.items() if isinstance(v, Tensor)}
    return numbers


def train_model(
    dataset: Dataset,
    part: np.ndarray,
    model: str,
    recipe: Recipe,
    seed: int,
) -> Trained:
    """A predictor after all of its stages, as `train_predictor` writes it, its samples drawn by the
    same seed, its teachers trained by its own optimiser and budget; no file is kept."""
    with TemporaryDirectory() as folder:
        encoder, regressor, output = (Path(folder, f"{k}.pt") for k in range(3))
        job, teachers = (recipe.optimiser, recipe.budget, seed, seed), []
        if recipe.lambda_latent or models.model(model).encoder:
            assert recipe.latent_dim is not None
            train_autoencoder(dataset, part, encoder, *job, recipe.latent_dim)
            teachers.append(encoder)
        if recipe.lambda_latent:
            train_regressor(dataset, part, encoder, regressor, *job)
            teachers.append(regressor)
        train_predictor(dataset, part, model, output, recipe, seed, seed, teachers)
        return model_file.read(output)


def _moved(material: Material, device: torch.device) -> list[list[Tensor]]:
    return [[v.to(device) for v in values] for values in (material.train, material.validation)]


def _header(
    dataset: Dataset, model: str, optimiser: Optimiser | Tube, budget: Budget, settings: dict
) -> dict:
    known = ("name", "origin", "configuration", "targets", "unit")
    if_given = ("voltage", "channels", "lost_channels")
    metadata = dataset.metadata
    return {
        "format": "eitskin-model",
        "version": 1,
        "model": model,
        "dataset": {key: metadata[key] for key in known}
        | {key: metadata[key] for key in if_given if key in metadata},
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
