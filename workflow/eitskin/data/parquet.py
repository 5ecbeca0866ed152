"""Tables of Parquet files, read completely or by row groups; columns of lists of equal length."""

import contextlib
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from eitskin import unfolding
from eitskin.atomic import atomic_path
from eitskin.errors import InputError

BATCH_ROWS, BUFFER_BYTES = 4096, 1 << 20  # of readings, some megabytes; of a file, at once


def frame(table: pa.Table, **options: Any) -> pd.DataFrame:
    """A table as a pandas data frame, converted by the calling thread; options of `to_pandas`."""
    return table.to_pandas(use_threads=False, **options)


def read(path: str | Path, columns: Sequence[str] | None = None) -> pa.Table:
    """The table of a Parquet file, or its `columns` in their order.

    Raises InputError for another file, a damaged one, and a missing column.
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


def batches(path: str | Path, column: str) -> Iterator[pa.Array]:
    """A column of a Parquet file, BATCH_ROWS rows after another; raises InputError as `read`."""
    with _opened(path) as file:
        for batch in file.iter_batches(BATCH_ROWS, columns=[column], use_threads=False):
            yield batch.column(0)


def write_groups(path: str | Path, tables: Iterable[pa.Table], metadata: dict[bytes, str]) -> None:
    """Write tables of one schema as a row group each, atomically; raises InputError for none."""
    remaining_tables = iter(tables)
    first_table = next(remaining_tables, None)
    if first_table is None:
        raise InputError(path, "rows", "none", "at least one")
    schema = first_table.replace_schema_metadata(metadata).schema
    # Readings hardly repeat: a dictionary of them takes time and room.
    dictionary_columns = [f.name for f in schema if not pa.types.is_fixed_size_list(f.type)]
    with (
        atomic_path(path) as temporary,
        pq.ParquetWriter(temporary, schema, use_dictionary=dictionary_columns) as writer,
    ):
        for table in chain([first_table], remaining_tables):
            writer.write_table(table, row_group_size=len(table))


@contextlib.contextmanager
def _opened(path: str | Path) -> Iterator[pq.ParquetFile]:
    """An open Parquet file, read by the calling thread alone and without `pre_buffer`.

    A process that ends while Arrow's threads still start is aborted
    (github.com/apache/arrow/issues/34314), and its output is lost.
    """
    path = Path(path)
    if not path.is_file():
        file_kind = "a folder" if path.is_dir() else "no such file"
        raise InputError(path, "file", file_kind, "a Parquet file")
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
            pq.ParquetFile(
                stream, page_checksum_verification=True, pre_buffer=False, buffer_size=BUFFER_BYTES
            ) as file,
        ):
            unfolding.refuse(path, _unfolded_bytes(file.metadata))
            yield file
    except (OSError, pa.ArrowException) as error:
        reason = str(error).splitlines()[0]
        raise InputError(
            path, "file", f"damaged data ({reason})", "a whole Parquet file"
        ) from error


def _unfolded_bytes(metadata: pq.FileMetaData) -> int:
    """Bytes of the columns' pages, or of their values where these are encoded still shorter."""
    numbers = product(range(metadata.num_row_groups), range(metadata.num_columns))
    columns = (metadata.row_group(group).column(number) for group, number in numbers)
    return sum(max(column.total_uncompressed_size, 8 * column.num_values) for column in columns)


def lists(values: np.ndarray) -> pa.FixedSizeListArray:
    """A column of N lists of M numbers from `values` (N, M)."""
    flat = pa.array(np.ascontiguousarray(values).ravel())
    return pa.FixedSizeListArray.from_arrays(flat, values.shape[1])


def listed(column: pa.ChunkedArray) -> np.ndarray:
    """The values (N, M), read-only, of a column of lists without nulls, the inverse of `lists`."""
    flat = column.combine_chunks().flatten().to_numpy(zero_copy_only=False)
    return flat.reshape(len(column), column.type.list_size)
