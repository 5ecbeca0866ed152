"""The folder of a diagnosis, read and checked: diagnosis.json and the evidence beside it."""

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.compute as pc

from eitskin.data import parquet, recording
from eitskin.diagnose.verdict.refusals import BY_NAME
from eitskin.diagnose.verdict.validation import validate
from eitskin.diagnose.verdict.words import UNITS
from eitskin.errors import InputError

NUMBER, TEXT, FLAG = "numbers", "texts", "true or false"
ATLAS = {
    "statistic": TEXT,
    "site": TEXT,
    "value": NUMBER,
    "dof": NUMBER,
    "p": NUMBER,
    "q": NUMBER,
    "free_p": NUMBER,
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
    "decisions": {
        "round": NUMBER,
        "name": TEXT,
        "kind": TEXT,
        "sites": TEXT,
        "gate": TEXT,
        "value": NUMBER,
        "admitted": FLAG,
        "beside": TEXT,
        "place": TEXT,
        "detail": TEXT,
    },
}
OPTIONAL_TABLES = ("decisions",)  # that folders of earlier versions lack
FRAME_ARRAYS = ("last", "time_s", "touch", "x_mm", "y_mm", "force_N", "probe_mm", "press")


@dataclass(frozen=True)
class Evidence:
    """A diagnosis of N frames of M channels with E effects, and what it rests on.

    diagnosis: the content of diagnosis.json; residual_before, residual_after (N, M): recording
    minus simulation over the noise's sd, NaN where a reading is lost; noise_sd_V (M,), noise_dof,
    noise_source: sd of a reading's noise, its degrees of freedom, and from what it was estimated;
    channels (M, 4): electrodes; frames: last (put aside), time_s, touch, x_mm, y_mm (of the skin),
    force_N, probe_mm, press, one row a frame; last_channels (M,): True for channels put aside in
    place of frames; last_before_V, last_after_V (N, M): recording minus simulation of what was put
    aside, NaN elsewhere, and throughout in folders of earlier versions; effect_changes (E, M): what
    each effect changes, over the noise's sd, in the frame in which it changes most, change_frames
    (E,): the row of that frame, both empty in folders of earlier versions; tables: by name, columns
    as in TABLES, NaN or "" where a cell is empty, without those of OPTIONAL_TABLES that the folder
    lacks; experiment: sentence and pairs;
    prediction: time_s and the medians of std_V and |voltage_V| of each frame of a query, or None;
    recording: the recording diagnosed; file_hashes: SHA-256 by file name.
    """

    diagnosis: dict
    residual_before: np.ndarray
    residual_after: np.ndarray
    noise_sd_V: np.ndarray
    noise_dof: float
    noise_source: str
    channels: np.ndarray
    frames: pd.DataFrame
    last_channels: np.ndarray
    last_before_V: np.ndarray
    last_after_V: np.ndarray
    effect_changes: np.ndarray
    change_frames: np.ndarray
    tables: dict[str, pd.DataFrame]
    experiment: dict
    prediction: pd.DataFrame | None
    recording: recording.Recording
    file_hashes: dict[str, str]

    @property
    def has_last(self) -> bool:
        """Whether readings were put aside, that no decision read."""
        return bool(self.frames["last"].any() or self.last_channels.any())

    @property
    def has_rig_errors(self) -> bool:
        """Whether errors of the rig are part of the noise."""
        components = self.diagnosis.get("noise", {}).get("components", [])
        return any(component["sd"] > 0.0 for component in components)

    @property
    def reading_unit(self) -> str:
        """The unit of the readings, as text."""
        return UNITS[self.recording.metadata["unit"]]


def file_paths(folder: str | Path) -> list[Path]:
    """The files of a diagnosis in its folder that `read` reads, without recording and
    prediction."""
    evidence_folder = Path(folder) / "evidence"
    tables = [evidence_folder / f"{name}.csv" for name in TABLES]
    arrays = [evidence_folder / "residuals.npz", *tables, evidence_folder / "experiment.json"]
    return [Path(folder) / "diagnosis.json", Path(folder) / "effects.yaml", *arrays]


def read(
    folder: str | Path,
    recording_path: str | Path,
    schema: str | Path,
    prediction_path: str | Path | None = None,
) -> Evidence:
    """Read the folder of a diagnosis, the recording that it is of, and predicted.parquet where the
    diagnosis was given a query.

    Raises InputError with the file, the key or column, what it holds and what was expected.
    """
    folder = Path(folder)
    evidence_folder = folder / "evidence"
    diagnosis = _json(folder / "diagnosis.json")
    validate(diagnosis, schema, folder / "diagnosis.json")
    experiment = _json(evidence_folder / "experiment.json")
    _check_experiment(experiment, evidence_folder / "experiment.json")
    table_paths = {name: evidence_folder / f"{name}.csv" for name in TABLES}
    for name in OPTIONAL_TABLES:
        if not table_paths[name].is_file():
            del table_paths[name]
    tables = {name: _table(path, TABLES[name]) for name, path in table_paths.items()}
    if "decisions" in tables:
        _check_gates(tables["decisions"], table_paths["decisions"])
    paths = [Path(recording_path), folder / "diagnosis.json", folder / "effects.yaml"]
    paths += [] if prediction_path is None else [Path(prediction_path)]
    paths += [evidence_folder / "residuals.npz", *table_paths.values()]
    paths.append(evidence_folder / "experiment.json")
    return Evidence(
        diagnosis=diagnosis,
        **_residuals(evidence_folder / "residuals.npz"),
        tables=tables,
        experiment=experiment,
        prediction=None if prediction_path is None else _prediction(Path(prediction_path)),
        recording=recording.read(recording_path),
        file_hashes={path.name: _sha256(path) for path in paths},
    )


def _json(path: Path) -> dict:
    try:
        return json.loads(_existing(path).read_text(encoding="utf-8"))
    except ValueError as error:
        raise InputError(path, "file", str(error), "JSON") from error


def _existing(path: Path) -> Path:
    if not path.is_file():
        raise InputError(path, "file", "no such file", "one that the diagnosis wrote")
    return path


def _sha256(path: Path) -> str:
    return hashlib.sha256(_existing(path).read_bytes()).hexdigest()


def _residuals(path: Path) -> dict:
    """The fields of Evidence that residuals.npz holds."""
    with np.load(_existing(path), allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    shape = arrays["before"].shape if "before" in arrays else (0, 0)
    for new, old in (("last", "held_out"), ("last_channels", "held_out_channels")):
        if old in arrays:  # of earlier versions
            arrays.setdefault(new, arrays[old])
    arrays.setdefault("last_channels", np.zeros(shape[1], bool))
    for name in ("last_before_V", "last_after_V"):
        arrays.setdefault(name, np.full(shape, np.nan))
    arrays.setdefault("changes", np.zeros((0, shape[1])))
    arrays.setdefault("changed_frame", np.zeros(0, int))
    shapes = {"before": shape, "after": shape, "noise_V": shape[1:], "channels": (*shape[1:], 4)}
    shapes |= {"noise_source": (), "noise_dof": (), "last_channels": shape[1:]}
    shapes |= {"last_before_V": shape, "last_after_V": shape}
    shapes |= {"changes": (len(arrays["changed_frame"]), shape[1])}
    shapes |= dict.fromkeys(FRAME_ARRAYS, shape[:1])
    for name, expected_shape in shapes.items():
        if name not in arrays:
            raise InputError(path, name, "nothing", "an array")
        if arrays[name].shape != expected_shape:
            raise InputError(path, name, f"shape {arrays[name].shape}", f"{expected_shape}")
    frames = pd.DataFrame({name: arrays[name] for name in FRAME_ARRAYS})
    return {
        "residual_before": arrays["before"],
        "residual_after": arrays["after"],
        "noise_sd_V": arrays["noise_V"],
        "noise_dof": float(arrays["noise_dof"]),
        "noise_source": str(arrays["noise_source"]),
        "channels": arrays["channels"],
        "frames": frames.astype({"last": bool}),
        "last_channels": arrays["last_channels"].astype(bool),
        "last_before_V": arrays["last_before_V"],
        "last_after_V": arrays["last_after_V"],
        "effect_changes": arrays["changes"],
        "change_frames": arrays["changed_frame"],
    }


def _table(path: Path, column_kinds: dict[str, str]) -> pd.DataFrame:
    """A CSV file with these columns; empty cells are NaN in columns of numbers, else ""."""
    text_columns = [column_name for column_name, kind in column_kinds.items() if kind != NUMBER]
    table = pd.read_csv(_existing(path), dtype=dict.fromkeys(text_columns, str))
    if list(table) != list(column_kinds):
        raise InputError(path, "columns", ", ".join(table), ", ".join(column_kinds))
    for column_name, kind in column_kinds.items():
        if kind == NUMBER:
            table[column_name] = _numbers(path, table[column_name])
            continue
        table[column_name] = table[column_name].fillna("")
        if kind == FLAG:
            for row, cell in enumerate(table[column_name]):
                if cell not in ("True", "False"):
                    raise InputError(
                        path, f"column {column_name}, row {row}", repr(cell), "True, False"
                    )
            table[column_name] = table[column_name] == "True"
    return table


def _numbers(path: Path, column: pd.Series) -> pd.Series:
    """A column as float64; raises InputError for a cell that is neither a number nor empty."""
    numbers = pd.to_numeric(column, errors="coerce").astype(float)
    text_rows = np.flatnonzero(numbers.isna() & column.notna())
    if text_rows.size:
        place = f"column {column.name}, row {text_rows[0]}"
        raise InputError(path, place, repr(column[text_rows[0]]), "a number, or nothing")
    return numbers


def _check_gates(decisions: pd.DataFrame, path: Path) -> None:
    """Raise InputError for a decision at a gate that this version does not have."""
    for row, name in enumerate(decisions["gate"]):
        if name not in BY_NAME:
            expected = f"a gate: {', '.join(BY_NAME)}"
            raise InputError(path, f"column gate, row {row}", repr(name), expected)


def _check_experiment(experiment: dict, path: Path) -> None:
    if not isinstance(experiment, dict) or set(experiment) != {"sentence", "pairs"}:
        raise InputError(path, "file", experiment, "the keys sentence and pairs")
    keys = {"a", "b", "gap_now", "gap_then", "recipe"}
    for k, pair in enumerate(experiment["pairs"]):
        if set(pair) != keys:
            raise InputError(path, f"pairs[{k}]", sorted(pair), f"the keys {sorted(keys)}")


def _prediction(path: Path) -> pd.DataFrame:
    """One row a frame: time_s, the medians over the channels of |voltage_V| and of its sd std_V."""
    table = parquet.read(path, ["time_s", "voltage_V", "std_V"])
    columns = {"time_s": table["time_s"].to_numpy()}
    for name in ("voltage_V", "std_V"):
        flat = pc.list_flatten(table[name].combine_chunks()).to_numpy(zero_copy_only=False)
        magnitude = np.abs(flat.reshape(table.num_rows, -1))
        columns[name] = np.nanmedian(magnitude, axis=1)
    return pd.DataFrame(columns)
