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
ROWS = 8192  # of a row group, filled up with whole sessions


class Part(NamedTuple):
    """Samples (N rows) of whole sessions, one after another, with their untouched and touched
    frames (N, M) V."""

    table: pd.DataFrame
    untouched: np.ndarray
    touched: np.ndarray


class Stage:
    """A stage in a file: channels (M, 4), the largest force_N of all its samples, and its parts,
    one per row group, which are read on iteration.

    Raises InputError for a file that is no stage.
    """

    def __init__(self, path: str | Path):
        self._path = path
        schema, self._groups = parquet.layout(path)
        header = (schema.metadata or {}).get(KEY)
        if header is None:
            raise InputError(path, "schema", f"no key {KEY.decode()}", "a stage's metadata")
        values = json.loads(header)
        self.channels, self.force_max_N = np.array(values["channels"]), values["force_max_N"]

    def __len__(self) -> int:
        return self._groups

    def __iter__(self) -> Iterator[Part]:
        return map(_part, parquet.groups(self._path))

    def joined(self) -> Part:
        """All samples as one part."""
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
    """Yield every session of a table sorted by session, and its rows."""
    session = table["session"].to_numpy()
    edges = [0, *(np.flatnonzero(np.diff(session)) + 1).tolist(), len(session)]
    for start, stop in pairwise(edges):
        yield int(session[start]), slice(start, stop)


def _grouped(parts: Iterable[Part]) -> Iterator[Part]:
    group: list[Part] = []
    for part in parts:
        group.append(part)
        if sum(len(member.table) for member in group) >= ROWS:
            yield _joined(group)
            group = []
    if group:
        yield _joined(group)


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
