"""Training sets: what a touch changes in the voltages, and the contact state that belongs to it."""

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

LOST_SHARE = 0.1  # a channel lost in more of the touched frames than this is dropped


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


def fits(recorded: Recording, trained_on: dict, file: str | Path) -> list[int]:
    """The channels of a recording that a data set, by its metadata `trained_on`, has lost. Raises
    InputError naming `file` where its channels, unit or kind of voltage are not the data set's."""
    lost: list[int] = trained_on.get("lost_channels", [])
    channels = np.delete(recorded.channels, lost, axis=0).tolist()
    for place, found in (
        ("channels", channels),
        ("unit", recorded.metadata["unit"]),
        ("voltage", recorded.metadata["voltage"]),
    ):
        if place in trained_on and found != trained_on[place]:
            told = f"{len(found)} others" if place == "channels" else repr(found)
            raise InputError(file, place, told, f"those of {trained_on['name']}, trained on")
    return lost


def validate(dataset: Dataset, file: str | Path) -> None:
    """Raise InputError naming `file` unless columns, types, targets and metadata are in order."""
    metadata, table, delta_V = dataset.metadata, dataset.table, dataset.delta_V
    for key in KEYS:
        if key not in metadata:
            raise InputError(file, f"metadata.{key}", "nothing", f"the keys {', '.join(KEYS)}")
    if (metadata["format"], metadata["version"]) != ("eitskin-dataset", 1):
        found = f"{metadata['format']!r}, {metadata['version']!r}"
        raise InputError(file, "metadata.format, version", found, "'eitskin-dataset', 1")
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
        found = f"{delta_V.dtype} {delta_V.shape}"
        raise InputError(file, "column delta_V", found, f"float32 ({len(table)}, channels)")
    where = [(TARGETS[target], table[TARGETS[target]].to_numpy()) for target in targets]
    for column, values in [*where, ("delta_V", delta_V.sum(axis=1))]:
        if not np.isfinite(values).all():
            row = int(np.flatnonzero(~np.isfinite(values))[0])
            raise InputError(file, f"column {column}, row {row}", "no number", "a finite number")


def write(dataset: Dataset, path: str | Path) -> None:
    """Write a valid dataset to `path`, atomically; equal datasets give equal bytes."""
    write_parts([(dataset.table, dataset.delta_V)], dataset.metadata, path)


def write_parts(
    parts: Iterable[tuple[pd.DataFrame, np.ndarray]], metadata: dict, path: str | Path
) -> None:
    """As `write`, of a dataset that comes part by part, table and delta_V of each: a row group of
    the file each."""

    def tables() -> Iterator[pa.Table]:
        last = -1
        for table, delta_V in parts:
            validate(Dataset(table, delta_V, metadata), path)
            if table["sample"].iloc[0] <= last:
                raise InputError(path, "column sample", "a fall", "numbers that increase")
            last = table["sample"].iloc[-1]
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

    A channel lost in more than a tenth of the touched frames is dropped (`lost_channels`, indices
    into the recording's table); a touched frame that still lacks a reading, or that holds several
    touches, is left out and counted (`frames_left_out`). Targets are those of x, y, F, depth that
    are known in every frame and vary. `sample` is the recording's frame number.

    Raises InputError where nothing remains to learn from or to be learned.
    """
    difference = changes(recording, name)
    touched = recording.frames["touch"].to_numpy(bool)
    if not touched.any():
        raise InputError(name, "column touch", "no touched frame", "at least one")
    lost = (~np.isfinite(difference[touched])).mean(axis=0) > LOST_SHARE
    if lost.all():
        raise InputError(name, "column voltage_V", "every channel lost", "at least one channel")
    difference = difference[:, ~lost]
    whole = np.isfinite(difference).all(axis=1)
    single = np.array([len(t or []) <= 1 for t in recording.touches or [[]] * len(touched)])
    kept = touched & whole & single
    if not kept.any():
        raise InputError(name, "column voltage_V", "no whole frame of one touch", "at least one")

    frames = recording.frames[kept].reset_index(drop=True)
    columns = {column: frames[column].to_numpy(float) for column in NUMBERS}
    targets = _targets(columns, name)
    place, place_rule = places(np.column_stack([columns["x_mm"], columns["y_mm"]]))
    table = pd.DataFrame(
        {
            "sample": recording.frames["frame"].to_numpy(np.int64)[kept],
            "session": sessions(recording.frames)[kept],
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
        "channels": recording.channels[~lost].tolist(),
        "lost_channels": np.flatnonzero(lost).tolist(),
        "frames_left_out": {
            "reading lost": int((touched & ~whole).sum()),
            "several touches": int((touched & whole & ~single).sum()),
        },
        "places": place_rule,
        "untouched": untouched_noise(difference[~touched]),
    }
    return Dataset(table, difference[kept].astype(np.float32), metadata)


def _targets(columns: dict[str, np.ndarray], name: str) -> list[str]:
    """Those of TARGETS that are known in every frame and vary. Raises InputError, with `name` as
    its file, for none, and for a touch whose place is not known."""
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
