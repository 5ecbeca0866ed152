"""`eitskin train`: from the folder of a diagnosis to an estimator that `eitskin stream` takes.

The estimator is trained on the corrected simulator, which is pressed as the recording was, at other
places. A card holds its errors beside those of models that were trained alike on the calibrated
belief and, where a configuration is given, on its perturbations.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd

from eitskin.data import baseline, dataset, recording
from eitskin.data.check.usable import usable
from eitskin.data.dataset import Dataset
from eitskin.data.recording import Recording
from eitskin.errors import InputError
from eitskin.estimators.sets import source_set
from eitskin.exported import file as exported_file
from eitskin.exported.file import Exported
from eitskin.learn import export, model_file, train, transfer
from eitskin.learn.metrics import interval, mae
from eitskin.learn.model_file import Trained
from eitskin.learn.predict import predict_seeds
from eitskin.learn.train import Budget, Optimiser, Recipe, Seeds, Split
from eitskin.physics.skin import Skin
from eitskin.quantities import counted, decimal
from eitskin.simulate.imitation import PressPrior
from eitskin.simulators import Simulator

MODEL = "mlp"
CORRECTED, BELIEF, PERTURBED = "corrected simulator", "belief", "belief, perturbed"
ASIDE, OTHER, FRESH = "labels put aside", "labels of the target", "fresh touches, corrected"
LABELS = (5, 20, 100)  # frames
DRAWS = 3  # of the labels
LEARNING_RATE = 2e-3  # of the configuration
FRESH_SEED = 1000  # added to the seed of a set
FORCES = {"mean_N": 3.0, "sd_N": 2.0, "max_N": 10.0}  # where none was measured: the paper's range
PROBE_MM = 10.0  # where the probe is unknown: the paper's middle one


@dataclass(frozen=True)
class Plan:
    """How an estimator is trained: samples of a set, epochs, seeds of the weights, the first of
    them `seed`, and of the networks without an electrode `spare_epochs`. Raises InputError for a
    count below 1."""

    samples: int = 20000
    epochs: int = 40
    seeds: int = 3
    seed: int = 1
    spare_epochs: int = 6

    def __post_init__(self) -> None:
        for key in ("samples", "epochs", "seeds", "spare_epochs"):
            if getattr(self, key) < 1:
                raise InputError("training", key, str(getattr(self, key)), "1 or more")

    @property
    def recipe(self) -> Recipe:
        """The settings of a training: of `mlp` in the configuration."""
        return Recipe(Optimiser(LEARNING_RATE), Budget(None, self.epochs))


@dataclass(frozen=True)
class TestSet:
    """Changes (N, M) with states (N, T) of the `targets`, and what they are of."""

    name: str
    delta_V: np.ndarray
    states: np.ndarray
    targets: list[str]


@dataclass(frozen=True)
class Estimator:
    """A trained estimator, as `eitskin stream` takes it, and its card (`COLUMNS`)."""

    exported: Exported
    card: pd.DataFrame

    def write(self, folder: str | Path) -> list[Path]:
        """Write estimator.npz and card.csv into a folder; their paths."""
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        paths = [folder / "estimator.npz", folder / "card.csv"]
        exported_file.write(self.exported, paths[0])
        self.card.to_csv(paths[1], index=False)
        return paths


COLUMNS = ("tested on", "trained on", "labels", "target", "mae", "low", "high", "runs", "frames")


def trained(
    folder: str | Path,
    target: Recording | None = None,
    perturbations: list[dict] | None = None,
    plan: Plan | None = None,
) -> Estimator:
    """An estimator for the skin of a diagnosis in `folder`, and its card.

    target: another recording of the skin by the same channels, whose labels test the estimator; by
    default the frames that the diagnosis put aside. perturbations: effects of a configuration, such
    as the paper's. Raises InputError for another folder, a recording without touches at known
    places of the skin, one of differences, and a target of another board or frame.
    """
    plan = plan or Plan()
    folder = Path(folder)
    recorded, _ = usable(recording.read(folder / "recording.parquet"))
    corrected = Simulator.read(folder)
    prior = PressPrior(FORCES, PROBE_MM)
    simulators = {CORRECTED: corrected, BELIEF: Simulator.calibrated(recorded)}
    if perturbations is not None:
        believed = simulators[BELIEF]
        simulators[PERTURBED] = replace(believed, effects=perturbations, drawn=True)
    job = (recorded, plan.samples, plan.seed, prior)
    splits = {name: source_set(item, *job, name, True) for name, item in simulators.items()}
    models = {name: _of_seeds(split, plan) for name, split in splits.items()}
    tests, labelled = _tests(recorded, folder, target, splits[CORRECTED].dataset)
    fresh_job = (recorded, plan.samples // 4, plan.seed + FRESH_SEED, prior)
    fresh = source_set(corrected, *fresh_job, FRESH, True).dataset
    tests.append(TestSet(FRESH, fresh.delta_V, fresh.states(), fresh.metadata["targets"]))
    rows = [row for test in tests for name in models for row in _rows(test, name, models[name])]
    if labelled is not None:
        rows += _by_labels(tests[0], labelled, splits[CORRECTED], models[CORRECTED], plan)
    level = baseline.level(recorded, splits[CORRECTED].dataset.metadata["lost_channels"])
    split = splits[CORRECTED]
    skin = Skin.metadata(corrected.skin)
    exported = export.export(
        models[CORRECTED], split.dataset, split.part, skin, plan.spare_epochs, level
    )
    return Estimator(exported, pd.DataFrame(rows, columns=list(COLUMNS)))


def _of_seeds(split: Split, plan: Plan) -> Trained:
    """A model of all seeds, of one set."""
    with TemporaryDirectory() as folder:
        paths = [Path(folder, f"{number}.pt") for number in range(plan.seeds)]
        for number, path in enumerate(paths):
            seeds = Seeds(plan.seed, plan.seed + number)
            train.train_predictor(split, MODEL, path, plan.recipe, seeds)
        return model_file.read_seeds(paths)


def _tests(
    recorded: Recording, folder: Path, target: Recording | None, source: Dataset
) -> tuple[list[TestSet], TestSet | None]:
    """What is tested on labels, and labels beside it, none of whose frames are tested."""
    if target is None:
        path = folder / "evidence" / "residuals.npz"
        try:
            with np.load(path) as arrays:
                aside_s = arrays["time_s"][arrays["last"].astype(bool)]
        except (OSError, KeyError, ValueError) as error:
            raise InputError(path, "file", type(error).__name__, "a diagnosis' evidence") from error
        name, tested = ASIDE, recorded
    else:
        dataset.check_compatibility(target, source.metadata, "target")
        if target.metadata["position_frame"] != "skin":
            actual = target.metadata["position_frame"]
            raise InputError("target", "position_frame", actual, "skin, as trained on")
        name, tested, aside_s = OTHER, usable(target)[0], np.zeros(0)
    labelled = dataset.from_recording(tested, name)
    common = [key for key in source.metadata["targets"] if key in labelled.metadata["targets"]]
    columns = [labelled.metadata["targets"].index(key) for key in common]
    if labelled.metadata["channels"] != source.metadata["channels"]:
        actual = f"{len(labelled.metadata['channels'])} channels without lost ones"
        raise InputError("target", "channels", actual, f"{len(source.metadata['channels'])}")
    states = labelled.states()[:, columns]
    if target is None:
        frame = tested.frames["frame"].to_numpy()
        time_of = dict(zip(frame.tolist(), tested.frames["time_s"], strict=True))
        time_s = np.array([time_of[sample] for sample in labelled.table["sample"]])
        is_aside = np.isin(time_s, aside_s)
    else:
        place = labelled.table["place"].to_numpy()
        is_aside = np.isin(place, np.unique(place)[::2])
    parts = [
        TestSet(name, labelled.delta_V[rows], states[rows], common)
        for rows in (is_aside, ~is_aside)
    ]
    return [part for part in parts[:1] if len(part.states)], (
        parts[1] if is_aside.any() and not is_aside.all() else None
    )


def _rows(test: TestSet, name: str, model: Trained) -> Iterator[tuple]:
    """The rows of a model on a test, a run a seed."""
    columns = _columns(model, test.targets)
    states = predict_seeds(model, test.delta_V)[..., columns]
    yield from _summaries(test, name, 0, states)


def _columns(model: Trained, targets: list[str]) -> list[int]:
    return [model.header["dataset"]["targets"].index(key) for key in targets]


def _summaries(test: TestSet, name: str, labels: int, states: np.ndarray) -> Iterator[tuple]:
    """A row a target of states (R, N, T) of R runs."""
    for column, key in enumerate(test.targets):
        errors = np.array([mae(test.states[:, column], run[:, column]) for run in states])
        low, high = interval(errors)
        yield (
            *(test.name, name, labels, key, errors.mean(), low, high),
            *(len(errors), len(test.states)),
        )


def _by_labels(
    test: TestSet, labelled: TestSet, source: Split, model: Trained, plan: Plan
) -> Iterator[tuple]:
    """Rows with few labels: affine and fine-tuned after training on the corrected simulator, and
    the mean of the nearest labels (`transfer.NEIGHBOURS`), without any simulator."""
    columns, seed = _columns(model, test.targets), model.seeds()[0]
    scale = model.tensors["state_scale"].numpy()[columns]
    zero_shot = [predict_seeds(model, part.delta_V)[0][:, columns] for part in (test, labelled)]
    for count in LABELS:
        if count > len(labelled.states):
            continue
        runs: dict[str, list] = {"affine": [], "fine-tuned": [], "nearest label, no simulator": []}
        for draw in range(DRAWS):
            rng = np.random.default_rng([plan.seed, draw])
            rows = rng.permutation(len(labelled.states))[:count]
            truth, change = labelled.states[rows], labelled.delta_V[rows].astype(float)
            runs["affine"].append(transfer.affine(zero_shot[0], zero_shot[1][rows], truth, scale))
            fine_tuned = transfer.fine_tuned(model, seed, change, truth, columns)
            runs["fine-tuned"].append(predict_seeds(fine_tuned, test.delta_V)[0][:, columns])
            stacked = np.concatenate([change, test.delta_V])
            nearest = transfer.nearest_states(
                stacked, np.arange(len(stacked)) >= 0, np.arange(count), truth
            )
            runs["nearest label, no simulator"].append(nearest[count:])
        for name, states in runs.items():
            yield from _summaries(test, name, count, np.array(states))


def sentences(card: pd.DataFrame) -> list[str]:
    """The card in words: a line of every model and test."""
    lines = []
    keys = ["tested on", "trained on", "labels"]
    for (tested, name, labels), group in card.groupby(keys, sort=False):
        texts = []
        for row in group.to_dict("records"):
            unit = dataset.UNITS[row["target"]]
            ends = " to ".join(decimal(max(0.0, row[key]), 2) for key in ("low", "high"))
            bounds = f" (95 %: {ends})" if row["runs"] > 1 else ""
            texts.append(f"{row['target']} {row['mae']:.2f}{bounds} {unit}")
        runs = group["runs"].iloc[0]
        model = f"{labels} labels, {name}" if labels else str(name)
        spread = counted(runs, "draw" if labels else "seed")
        if runs == 1:
            spread = "one seed: no interval"
        frames = group["frames"].iloc[0]
        lines.append(f"{tested}, {frames} frames: {model}: off by {', '.join(texts)}; {spread}")
    return lines
