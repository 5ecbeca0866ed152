"""Tables of Parquet files: read whole, or a row group at a time, or refused in one line; columns
that hold a list a row."""

import contextlib
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from eitskin.atomic import atomic_path
from eitskin.errors import InputError


def frame(table: pa.Table, **options: Any) -> pd.DataFrame:
    """A table as pandas has it, made by the calling thread alone; options as of `to_pandas`."""
    return table.to_pandas(use_threads=False, **options)


def read(path: str | Path, columns: Sequence[str] | None = None) -> pa.Table:
    """The table of a Parquet file; where `columns` are given these alone, in their order.

    Raises InputError for what is no Parquet file, for a damaged one and for a column that is not
    there.
    """
    with _opened(path) as file:
        for name in columns or ():
            if name not in file.schema_arrow.names:
                raise InputError(path, f"column {name}", "nothing", "it in the table")
        return file.read(columns, use_threads=False)


def layout(path: str | Path) -> tuple[pa.Schema, int]:
    """Schema and number of row groups of a Parquet file; raises InputError as `read`."""
    with _opened(path) as file:
        return file.schema_arrow, file.num_row_groups


def groups(path: str | Path) -> Iterator[pa.Table]:
    """The row groups of a Parquet file, one after another; raises InputError as `read`."""
    with _opened(path) as file:
        for number in range(file.num_row_groups):
            yield file.read_row_group(number, use_threads=False)


def write_groups(path: str | Path, tables: Iterable[pa.Table], metadata: dict[bytes, str]) -> None:
    """Write tables of one schema as a row group each, atomically; raises InputError for none."""
    following = iter(tables)
    first = next(following, None)
    if first is None:
        raise InputError(path, "rows", "none", "at least one")
    schema = first.replace_schema_metadata(metadata).schema
    # Readings hardly repeat: a dictionary of them takes time and room.
    repeated = [f.name for f in schema if not pa.types.is_fixed_size_list(f.type)]
    with (
        atomic_path(path) as temporary,
        pq.ParquetWriter(temporary, schema, use_dictionary=repeated) as writer,
    ):
        for table in chain([first], following):
            writer.write_table(table, row_group_size=len(table))


@contextlib.contextmanager
def _opened(path: str | Path) -> Iterator[pq.ParquetFile]:
    """The calling thread alone reads, nothing ahead of time (`pre_buffer`): a process that ends
    while Arrow's threads still start is aborted (github.com/apache/arrow/issues/34314), its output
    with it."""
    path = Path(path)
    if not path.is_file():
        found = "a folder" if path.is_dir() else "no such file"
        raise InputError(path, "file", found, "a Parquet file")
    with path.open("rb") as stream:
        head = stream.read(4)
        stream.seek(max(0, path.stat().st_size - 4))
        tail = stream.read(4)
    if head != b"PAR1":
        raise InputError(path, "file", f"{head!r} at its beginning", "a Parquet file (PAR1)")
    if tail != b"PAR1":
        raise InputError(path, "file", "an end cut off", "a whole Parquet file")
    try:
        # ParquetFile, not read_table: folders named like key=value add no columns.
        with (
            path.open("rb") as stream,
            pq.ParquetFile(stream, page_checksum_verification=True, pre_buffer=False) as file,
        ):
            yield file
    except (OSError, pa.ArrowException) as error:
        reason = str(error).splitlines()[0]
        raise InputError(
            path, "file", f"damaged data ({reason})", "a whole Parquet file"
        ) from error


def lists(values: np.ndarray) -> pa.FixedSizeListArray:
    """A column of lists of M numbers, one a row, of `values` (N, M)."""
    flat = pa.array(np.ascontiguousarray(values).ravel())
    return pa.FixedSizeListArray.from_arrays(flat, values.shape[1])


def listed(column: pa.ChunkedArray) -> np.ndarray:
    """(N, M), read-only: a column as of `lists`, without nulls."""
    flat = column.combine_chunks().flatten().to_numpy(zero_copy_only=False)
    return flat.reshape(len(column), column.type.list_size)
