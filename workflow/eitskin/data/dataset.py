"""Training sets: the changes of the readings by touches, and the touches' states."""

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa

from eitskin.data import parquet
from eitskin.data.baseline import changes, sessions, untouched_noise
from eitskin.data.places import places
from eitskin.data.recording import Recording
from eitskin.errors import InputError

TARGETS = {"x": "x_mm", "y": "y_mm", "F": "force_N", "depth": "depth_mm"}
UNITS = {"x": "mm", "y": "mm", "F": "N", "depth": "mm"}
INTEGERS = ("sample", "session", "place")
NUMBERS = ("x_mm", "y_mm", "force_N", "probe_mm", "depth_mm")
KEYS = ("format", "version", "name", "origin", "configuration", "targets", "unit")
SCHEMA_KEY = b"eitskin-dataset"

LOST_SHARE = 0.1  # of the touched frames: a channel lost in more is dropped, else the frames are


@dataclass
class Dataset:
    """`table` (N rows: sample, session, place, x_mm ...), `delta_V` (N, M) float32 in
    `metadata["unit"]`, and `metadata`: name, origin ("simulated" or a citation), configuration,
    targets and, from a recording, what was left out and the noise of its untouched frames.
    """

    table: pd.DataFrame
    delta_V: np.ndarray
    metadata: dict

    def states(self) -> np.ndarray:
        """The targets (N, T) float64 in mm, mm, N, mm, in the order of `metadata["targets"]`."""
        columns = [TARGETS[target] for target in self.metadata["targets"]]
        return self.table[columns].to_numpy(float)


def no_training(recorded: Recording) -> tuple[str, str, str] | None:
    """Why no estimator of touches is trained on a simulator of a recording, as place, what is there
    and what is expected; None where one is."""
    metadata = recorded.metadata
    if metadata["values"] == "difference":
        return "values", "difference", "absolute, with untouched frames"
    if metadata["position_frame"] != "skin":
        return "position_frame", metadata["position_frame"], "skin: an estimator's places"
    if not recorded.frames["touch"].any():
        return "column touch", "no touched frame", "touches, to be imitated"
    return None


def check_compatibility(recorded: Recording, trained_on: dict, file: str | Path) -> list[int]:
    """Check that a recording's channels, unit and kind of voltage are those of a data set.

    `trained_on` is the data set's metadata. Returns the rows of the recording's channel table that
    the data set has dropped; raises InputError naming `file` for another recording.
    """
    lost_channels: list[int] = trained_on.get("lost_channels", [])
    channels = np.delete(recorded.channels, lost_channels, axis=0).tolist()
    for place, recorded_value in (
        ("channels", channels),
        ("unit", recorded.metadata["unit"]),
        ("voltage", recorded.metadata["voltage"]),
    ):
        if place in trained_on and recorded_value != trained_on[place]:
            recorded_text = (
                f"{len(recorded_value)} others" if place == "channels" else repr(recorded_value)
            )
            raise InputError(
                file, place, recorded_text, f"those of {trained_on['name']}, trained on"
            )
    return lost_channels


def validate(dataset: Dataset, file: str | Path) -> None:
    """Raise InputError naming `file` unless columns, types, targets and metadata are in order."""
    metadata, table, delta_V = dataset.metadata, dataset.table, dataset.delta_V
    for key in KEYS:
        if key not in metadata:
            raise InputError(file, f"metadata.{key}", "nothing", f"the keys {', '.join(KEYS)}")
    if (metadata["format"], metadata["version"]) != ("eitskin-dataset", 1):
        violation = f"{metadata['format']!r}, {metadata['version']!r}"
        raise InputError(file, "metadata.format, version", violation, "'eitskin-dataset', 1")
    targets = metadata["targets"]
    if not targets or targets != [target for target in TARGETS if target in targets]:
        raise InputError(file, "metadata.targets", targets, f"some of {list(TARGETS)}, in order")
    if list(table.columns) != [*INTEGERS, *NUMBERS]:
        raise InputError(file, "columns", list(table.columns), f"{[*INTEGERS, *NUMBERS]}")
    for column in table.columns:
        dtype = "int64" if column in INTEGERS else "float64"
        if table[column].dtype != dtype:
            raise InputError(file, f"column {column}", table[column].dtype, dtype)
    if len(table) == 0:
        raise InputError(file, "rows", "none", "at least one sample")
    if (np.diff(table["sample"]) <= 0).any():
        raise InputError(file, "column sample", "repeats or a fall", "numbers that increase")
    if delta_V.dtype != np.float32 or delta_V.ndim != 2 or len(delta_V) != len(table):
        violation = f"{delta_V.dtype} {delta_V.shape}"
        raise InputError(file, "column delta_V", violation, f"float32 ({len(table)}, channels)")
    target_columns = [(TARGETS[target], table[TARGETS[target]].to_numpy()) for target in targets]
    for column, values in [*target_columns, ("delta_V", delta_V.sum(axis=1))]:
        if not np.isfinite(values).all():
            row = int(np.flatnonzero(~np.isfinite(values))[0])
            raise InputError(file, f"column {column}, row {row}", "no number", "a finite number")


def write(dataset: Dataset, path: str | Path) -> None:
    """Write a valid dataset to `path`, atomically; equal datasets give equal bytes."""
    write_parts([(dataset.table, dataset.delta_V)], dataset.metadata, path)


def write_parts(
    parts: Iterable[tuple[pd.DataFrame, np.ndarray]], metadata: dict, path: str | Path
) -> None:
    """Write a data set as `write` does, from parts (table, delta_V), each as a row group."""

    def tables() -> Iterator[pa.Table]:
        last_sample = -1
        for table, delta_V in parts:
            validate(Dataset(table, delta_V, metadata), path)
            if table["sample"].iloc[0] <= last_sample:
                raise InputError(path, "column sample", "a fall", "numbers that increase")
            last_sample = table["sample"].iloc[-1]
            stored = pa.Table.from_pandas(table, preserve_index=False)
            yield stored.append_column("delta_V", parquet.lists(delta_V))

    header = json.dumps(metadata, sort_keys=True, allow_nan=False)
    parquet.write_groups(path, tables(), {SCHEMA_KEY: header})


def read(path: str | Path) -> Dataset:
    """Read and validate a dataset; raises InputError."""
    table = parquet.read(path)
    header = (table.schema.metadata or {}).get(SCHEMA_KEY)
    if header is None:
        raise InputError(path, "schema", "no key eitskin-dataset", "a dataset's metadata")
    kind = table.schema.field("delta_V").type if "delta_V" in table.column_names else None
    if kind is None or not pa.types.is_fixed_size_list(kind):
        raise InputError(path, "column delta_V", kind, "fixed_size_list<float32>")
    if kind.value_type != pa.float32() or table["delta_V"].null_count:
        raise InputError(path, "column delta_V", f"{kind} or nulls", "float32 without nulls")
    dataset = Dataset(
        parquet.frame(table.drop_columns(["delta_V"]), ignore_metadata=True),
        parquet.listed(table["delta_V"]),
        json.loads(header),
    )
    validate(dataset, path)
    return dataset


def from_recording(recording: Recording, name: str) -> Dataset:
    """The touched frames of a recording, each as its change against the untouched skin.

    A channel lost in more than LOST_SHARE of the touched frames is dropped (`lost_channels`, rows
    of the recording's table); a touched frame that still lacks a reading, or has several touches,
    is left out and counted (`frames_left_out`). Targets are those of x, y, F, depth that are known
    in every frame and vary. `sample` is the recording's frame number.

    Raises InputError naming `name` where no sample or no target remains.
    """
    difference = changes(recording, name)
    touched = recording.frames["touch"].to_numpy(bool)
    if not touched.any():
        raise InputError(name, "column touch", "no touched frame", "at least one")
    is_lost = (~np.isfinite(difference[touched])).mean(axis=0) > LOST_SHARE
    if is_lost.all():
        raise InputError(name, "column voltage_V", "every channel lost", "at least one channel")
    difference = difference[:, ~is_lost]
    is_complete = np.isfinite(difference).all(axis=1)
    is_single_touch = np.array(
        [len(t or []) <= 1 for t in recording.touches or [[]] * len(touched)]
    )
    is_sample = touched & is_complete & is_single_touch
    if not is_sample.any():
        raise InputError(name, "column voltage_V", "no whole frame of one touch", "at least one")

    frames = recording.frames[is_sample].reset_index(drop=True)
    columns = {column: frames[column].to_numpy(float) for column in NUMBERS}
    targets = _targets(columns, name)
    place, place_rule = places(np.column_stack([columns["x_mm"], columns["y_mm"]]))
    table = pd.DataFrame(
        {
            "sample": recording.frames["frame"].to_numpy(np.int64)[is_sample],
            "session": sessions(recording.frames)[is_sample],
            "place": place,
            **columns,
        }
    )
    source = recording.metadata["source"]
    metadata = {
        "format": "eitskin-dataset",
        "version": 1,
        "name": name,
        "origin": "simulated" if source == "simulation" else source,
        "configuration": "",
        "targets": targets,
        "unit": recording.metadata["unit"],
        "voltage": recording.metadata["voltage"],
        "position_frame": recording.metadata["position_frame"],
        "channels": recording.channels[~is_lost].tolist(),
        "lost_channels": np.flatnonzero(is_lost).tolist(),
        "frames_left_out": {
            "reading lost": int((touched & ~is_complete).sum()),
            "several touches": int((touched & is_complete & ~is_single_touch).sum()),
        },
        "places": place_rule,
        "untouched": untouched_noise(difference[~touched]),
    }
    return Dataset(table, difference[is_sample].astype(np.float32), metadata)


def _targets(columns: dict[str, np.ndarray], name: str) -> list[str]:
    """Those of TARGETS that are known in every frame and vary.

    Raises InputError naming `name` where there is none, and for a touch without a place.
    """
    targets = [
        target
        for target, column in TARGETS.items()
        if np.isfinite(columns[column]).all() and np.ptp(columns[column]) > 0
    ]
    if not targets:
        raise InputError(name, "x, y, force and depth", "none known that varies", "at least one")
    if not np.isfinite(columns["x_mm"] + columns["y_mm"]).all():
        raise InputError(name, "columns x_mm, y_mm", "a touch without place", "a number")
    return targets
