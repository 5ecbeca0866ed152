"""The folder of a diagnosis, read and checked: diagnosis.json and the evidence beside it."""

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.compute as pc

from eitskin.data import parquet, recording
from eitskin.diagnose.verdict.validation import validate
from eitskin.errors import InputError

NUMBER, TEXT, FLAG = "numbers", "texts", "true or false"
ATLAS = {
    "statistic": TEXT,
    "site": TEXT,
    "value": NUMBER,
    "dof": NUMBER,
    "p": NUMBER,
    "q": NUMBER,
    "sentence": TEXT,
}
TABLES = {
    "atlas_before": ATLAS,
    "atlas_after": ATLAS,
    "rivals": {
        "effect": TEXT,
        "instead": TEXT,
        "chi2_per_dof": NUMBER,
        "elpd_difference": NUMBER,
        "gap": NUMBER,
    },
    "identifiability": {
        "name": TEXT,
        "snr": NUMBER,
        "nearest": TEXT,
        "gap": NUMBER,
        "observable": FLAG,
        "experiment": TEXT,
    },
    "search": {
        "step": NUMBER,
        "action": TEXT,
        "effect": TEXT,
        "sites": TEXT,
        "chi2": NUMBER,
        "log_evidence": NUMBER,
        "p_value": NUMBER,
    },
}
FRAME_ARRAYS = ("held_out", "time_s", "touch", "x_mm", "y_mm", "force_N", "probe_mm", "press")


@dataclass(frozen=True)
class Evidence:
    """A diagnosis of N frames of M channels, and what it rests on.

    diagnosis: diagnosis.json; before, after (N, M): recording minus simulation in noise units, NaN
    where lost; noise_V (M,), noise_dof, noise_source: the noise and how it was found; channels
    (M, 4); frames: held_out (put aside before anything was looked at), time_s, touch, x_mm, y_mm
    (of the skin), force_N, probe_mm, press, one row a frame; held_out_channels (M,): channels put
    aside in place of frames; changes (E, M): what each effect changes, in noise units, in the frame
    in which it changes most, changed_frame (E,) its row; none of either in folders of an earlier
    version; tables by name, columns as in TABLES, NaN or "" where there is none;
    experiment: sentence and pairs; predicted: time_s and the median std_V and |v| of a query, or
    None; recording: the recording diagnosed; hashes: SHA-256 by file name.
    """

    diagnosis: dict
    before: np.ndarray
    after: np.ndarray
    noise_V: np.ndarray
    noise_dof: float
    noise_source: str
    channels: np.ndarray
    frames: pd.DataFrame
    held_out_channels: np.ndarray
    changes: np.ndarray
    changed_frame: np.ndarray
    tables: dict[str, pd.DataFrame]
    experiment: dict
    predicted: pd.DataFrame | None
    recording: recording.Recording
    hashes: dict[str, str]


def read(
    folder: str | Path,
    recording_path: str | Path,
    schema: str | Path,
    predicted: str | Path | None = None,
) -> Evidence:
    """Read the folder of a diagnosis, the recording that it is of and what it predicted of a query,
    where there was one.

    Raises InputError naming the file, the key or column, what was found and what was expected.
    """
    folder = Path(folder)
    inside = folder / "evidence"
    result = _json(folder / "diagnosis.json")
    validate(result, schema, folder / "diagnosis.json")
    experiment = _json(inside / "experiment.json")
    _check_experiment(experiment, inside / "experiment.json")
    tables = {name: _table(inside / f"{name}.csv", columns) for name, columns in TABLES.items()}
    taken = [Path(recording_path), folder / "diagnosis.json", folder / "effects.yaml"]
    taken += [] if predicted is None else [Path(predicted)]
    taken += [inside / "residuals.npz", *(inside / f"{name}.csv" for name in TABLES)]
    taken.append(inside / "experiment.json")
    return Evidence(
        diagnosis=result,
        **_residuals(inside / "residuals.npz"),
        tables=tables,
        experiment=experiment,
        predicted=None if predicted is None else _predicted(Path(predicted)),
        recording=recording.read(recording_path),
        hashes={path.name: _sha256(path) for path in taken},
    )


def _json(path: Path) -> dict:
    try:
        return json.loads(_there(path).read_text(encoding="utf-8"))
    except ValueError as error:
        raise InputError(path, "file", str(error), "JSON") from error


def _there(path: Path) -> Path:
    if not path.is_file():
        raise InputError(path, "file", "no such file", "one that the diagnosis wrote")
    return path


def _sha256(path: Path) -> str:
    return hashlib.sha256(_there(path).read_bytes()).hexdigest()


def _residuals(path: Path) -> dict:
    """The fields of Evidence that residuals.npz holds."""
    with np.load(_there(path), allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    shape = arrays["before"].shape if "before" in arrays else (0, 0)
    arrays.setdefault("held_out_channels", np.zeros(shape[1], bool))
    arrays.setdefault("changes", np.zeros((0, shape[1])))
    arrays.setdefault("changed_frame", np.zeros(0, int))
    expected = {"before": shape, "after": shape, "noise_V": shape[1:], "channels": (*shape[1:], 4)}
    expected |= {"noise_source": (), "noise_dof": (), "held_out_channels": shape[1:]}
    expected |= {"changes": (len(arrays["changed_frame"]), shape[1])}
    expected |= dict.fromkeys(FRAME_ARRAYS, shape[:1])
    for name, size in expected.items():
        if name not in arrays:
            raise InputError(path, name, "nothing", "an array")
        if arrays[name].shape != size:
            raise InputError(path, name, f"shape {arrays[name].shape}", f"{size}")
    frames = pd.DataFrame({name: arrays[name] for name in FRAME_ARRAYS})
    return {
        "before": arrays["before"],
        "after": arrays["after"],
        "noise_V": arrays["noise_V"],
        "noise_dof": float(arrays["noise_dof"]),
        "noise_source": str(arrays["noise_source"]),
        "channels": arrays["channels"],
        "frames": frames.astype({"held_out": bool}),
        "held_out_channels": arrays["held_out_channels"].astype(bool),
        "changes": arrays["changes"],
        "changed_frame": arrays["changed_frame"],
    }


def _table(path: Path, columns: dict[str, str]) -> pd.DataFrame:
    texts = [name for name, kind in columns.items() if kind != NUMBER]
    table = pd.read_csv(_there(path), dtype=dict.fromkeys(texts, str))
    if list(table) != list(columns):
        raise InputError(path, "columns", ", ".join(table), ", ".join(columns))
    for name, kind in columns.items():
        if kind == NUMBER:
            table[name] = _numbers(path, table[name])
            continue
        table[name] = table[name].fillna("")
        if kind == FLAG:
            for row, value in enumerate(table[name]):
                if value not in ("True", "False"):
                    raise InputError(path, f"column {name}, row {row}", repr(value), "True, False")
            table[name] = table[name] == "True"
    return table


def _numbers(path: Path, column: pd.Series) -> pd.Series:
    numbers = pd.to_numeric(column, errors="coerce").astype(float)
    wrong = np.flatnonzero(numbers.isna() & column.notna())
    if wrong.size:
        place = f"column {column.name}, row {wrong[0]}"
        raise InputError(path, place, repr(column[wrong[0]]), "a number, or nothing")
    return numbers


def _check_experiment(experiment: dict, path: Path) -> None:
    if not isinstance(experiment, dict) or set(experiment) != {"sentence", "pairs"}:
        raise InputError(path, "file", experiment, "the keys sentence and pairs")
    keys = {"a", "b", "gap_now", "gap_then", "recipe"}
    for k, pair in enumerate(experiment["pairs"]):
        if set(pair) != keys:
            raise InputError(path, f"pairs[{k}]", sorted(pair), f"the keys {sorted(keys)}")


def _predicted(path: Path) -> pd.DataFrame:
    """One row a frame: time_s, the median |v| and the median of its standard deviation, V."""
    table = parquet.read(path, ["time_s", "voltage_V", "std_V"])
    columns = {"time_s": table["time_s"].to_numpy()}
    for name in ("voltage_V", "std_V"):
        flat = pc.list_flatten(table[name].combine_chunks()).to_numpy(zero_copy_only=False)
        size = np.abs(flat.reshape(table.num_rows, -1))
        columns[name] = np.nanmedian(size, axis=1)
    return pd.DataFrame(columns)
