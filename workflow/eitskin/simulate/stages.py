"""Files of the stages of a simulated set: Parquet, one row a sample, in row groups of whole
sessions. A set of any size is read and written a group at a time.

A row has sample, session, place, x_mm, y_mm, force_N, probe_mm and, as float32 V, the touched frame
and the untouched frame that belongs to it.
"""

import json
from collections.abc import Iterable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import pyarrow as pa

from eitskin.data import parquet
from eitskin.errors import InputError

KEY = b"eitskin-stage"
READINGS = ("untouched_V", "touched_V")
ROWS = 8192  # of a group, or as many more as the last session has


class Part(NamedTuple):
    """Samples (N rows) of whole sessions, one after another, with their untouched and touched
    frames (N, M) V."""

    table: pd.DataFrame
    untouched: np.ndarray
    touched: np.ndarray


class Stage:
    """A stage that lies in a file: channels (M, 4), the largest force_N of all its samples, and its
    parts, a row group each, which are read when they are asked for.

    Raises InputError for a file that is no stage.
    """

    def __init__(self, path: str | Path):
        self._path = path
        schema, self._groups = parquet.layout(path)
        header = (schema.metadata or {}).get(KEY)
        if header is None:
            raise InputError(path, "schema", f"no key {KEY.decode()}", "a stage's metadata")
        told = json.loads(header)
        self.channels, self.force_max_N = np.array(told["channels"]), told["force_max_N"]

    def __len__(self) -> int:
        return self._groups

    def __iter__(self) -> Iterator[Part]:
        return map(_part, parquet.groups(self._path))

    def whole(self) -> Part:
        """All samples at once."""
        return _part(parquet.read(self._path))


def write(
    path: str | Path, parts: Iterable[Part], channels: np.ndarray, force_max_N: float
) -> None:
    """Write the parts to `path`, atomically, as a stage of `channels` (M, 4)."""
    header = {"channels": channels.tolist(), "force_max_N": float(force_max_N)}
    header["origin"] = "simulated"
    tables = (_stored(part) for part in _grouped(parts))
    parquet.write_groups(path, tables, {KEY: json.dumps(header)})


def sessions(table: pd.DataFrame) -> Iterator[tuple[int, slice]]:
    """Each session of a table whose sessions lie one after another, and its rows."""
    own = table["session"].to_numpy()
    edges = [0, *(np.flatnonzero(np.diff(own)) + 1).tolist(), len(own)]
    for first, after in pairwise(edges):
        yield int(own[first]), slice(first, after)


def _grouped(parts: Iterable[Part]) -> Iterator[Part]:
    held: list[Part] = []
    for part in parts:
        held.append(part)
        if sum(len(one.table) for one in held) >= ROWS:
            yield _joined(held)
            held = []
    if held:
        yield _joined(held)


def _joined(parts: list[Part]) -> Part:
    tables, untouched, touched = zip(*parts, strict=True)
    table = pd.concat(tables, ignore_index=True)
    return Part(table, np.concatenate(untouched), np.concatenate(touched))


def _stored(part: Part) -> pa.Table:
    stored = pa.Table.from_pandas(part.table, preserve_index=False)
    for name, values in zip(READINGS, part[1:], strict=True):
        stored = stored.append_column(name, parquet.lists(np.asarray(values, np.float32)))
    return stored


def _part(stored: pa.Table) -> Part:
    untouched, touched = (parquet.listed(stored[name]).copy() for name in READINGS)
    samples = stored.drop_columns(list(READINGS))
    return Part(parquet.frame(samples, ignore_metadata=True), untouched, touched)
