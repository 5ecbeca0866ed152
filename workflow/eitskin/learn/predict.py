"""Apply a trained model to frames: contact state, touch or not, and whether to abstain."""

from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import torch
from torch import Tensor

from eitskin.atomic import atomic_path
from eitskin.data.baseline import changes
from eitskin.data.dataset import TARGETS, Dataset, check_compatibility
from eitskin.data.recording import Recording
from eitskin.errors import InputError
from eitskin.learn import gates, networks
from eitskin.learn.model_file import Trained
from eitskin.learn.train import deterministic, standardise


def predict_seeds(model: Trained, delta_V: np.ndarray) -> np.ndarray:
    """States (S, N, T) of each seed's predictor, in mm, mm, N, mm; NaN where a reading is lost.

    `delta_V` (N, M): changes against the untouched skin, in the unit of the training set. Raises
    InputError for another number of channels, and for a model that is no predictor.
    """
    n_channels = len(model.tensors["voltage_mean"])
    if delta_V.ndim != 2 or delta_V.shape[1] != n_channels:
        raise InputError("frames", "delta_V", delta_V.shape, f"(frames, {n_channels})")
    device = deterministic()
    name, shape = model.header["model"], networks.Shape.from_header(model.header, n_channels)
    raw = torch.from_numpy(np.asarray(delta_V, dtype=np.float64))
    voltage = standardise(raw, model.tensors, "voltage").to(device)
    states = []
    for seed in model.seeds():
        module = model.load_into(networks.predictor(name, shape), seed).to(device)
        states.append(unstandardised(networks.in_chunks(module, voltage).cpu(), model.tensors))
    return torch.stack(states).numpy()


def unstandardised(state: Tensor, scalers: dict[str, Tensor]) -> Tensor:
    """Float64 states (N, T) in the units of the targets, from standardised ones."""
    return state.double() * scalers["state_scale"] + scalers["state_mean"]


def judge(model: Trained, delta_V: np.ndarray) -> pd.DataFrame:
    """Columns `touch` and `abstain` (bool) of frames (N, M), by the gates in the model file.

    `abstain`: the frame is unlike those of the training set, or a reading is lost, and its state is
    unreliable. The two are independent: models are trained on touches alone, and an untouched frame
    may be like them or not.
    """
    raw = torch.from_numpy(np.asarray(delta_V, dtype=np.float64))
    tensors, familiar = model.tensors, model.header["familiar"]
    residual, distance = gates.strangeness(
        standardise(raw, tensors, "voltage"),
        tensors["familiar_axes"],
        tensors["familiar_variances"],
        tensors["familiar_references"],
    )
    is_familiar = (distance <= familiar["limit_distance"]) & (
        residual <= familiar["limit_residual"]
    )
    touch = gates.activity(raw, tensors["touch_scale"]) > model.header["touch"]["threshold"]
    return pd.DataFrame({"touch": touch.numpy(), "abstain": ~is_familiar.numpy()})


def predict(model: Trained, delta_V: np.ndarray) -> pd.DataFrame:
    """One row for each frame of (N, M): the targets' columns (mean over the seeds), `touch`,
    `abstain`."""
    states = predict_seeds(model, delta_V).mean(axis=0)
    columns = [TARGETS[target] for target in model.header["dataset"]["targets"]]
    return pd.concat([pd.DataFrame(states, columns=columns), judge(model, delta_V)], axis=1)


def predict_part(
    model: Trained, dataset: Dataset, part: np.ndarray, name: str = "test"
) -> pd.DataFrame:
    """Predictions of a dataset's part `name`: sample, seed, target columns, `touch`, `abstain`."""
    rows = part == name
    delta_V = dataset.delta_V[rows]
    columns = [TARGETS[target] for target in dataset.metadata["targets"]]
    gate = judge(model, delta_V)
    tables = []
    for seed, states in zip(model.seeds(), predict_seeds(model, delta_V), strict=True):
        table = pd.DataFrame(states, columns=columns)
        table.insert(0, "sample", dataset.table["sample"].to_numpy()[rows])
        table.insert(1, "seed", seed)
        tables.append(pd.concat([table, gate], axis=1))
    return pd.concat(tables, ignore_index=True)


def predict_recording(model: Trained, recording: Recording, name: str) -> pd.DataFrame:
    """Predictions for every frame of a recording: `frame`, `time_s`, then the columns of `predict`,
    from the changes of `baseline.changes`.

    Raises InputError where the recording's channels, unit or kind of voltage are not the model's.
    """
    lost = check_compatibility(recording, model.header["dataset"], name)
    delta_V = np.delete(changes(recording, name), lost, axis=1)
    clock = recording.frames[["frame", "time_s"]].reset_index(drop=True)
    return pd.concat([clock, predict(model, delta_V)], axis=1)


def write(predictions: pd.DataFrame, path: str | Path) -> None:
    """Write predictions to a Parquet file, atomically; equal ones give equal bytes."""
    table = pa.Table.from_pandas(predictions, preserve_index=False).replace_schema_metadata()
    with atomic_path(path) as temporary:
        pq.write_table(table, temporary)
