"""Parquet files are read whole, by one thread, or refused."""

import subprocess
import sys

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from eitskin.data import parquet
from eitskin.errors import InputError

COUNTED = """
import os, sys
from eitskin.data import parquet, dataset, recording, splits
before = len(os.listdir("/proc/self/task"))
table = parquet.read(sys.argv[1])
parquet.frame(table)
print(len(table), len(os.listdir("/proc/self/task")) - before)
"""


@pytest.fixture
def written(tmp_path):
    columns = {f"column {k}": list(range(1000)) for k in range(20)}
    pq.write_table(pa.table(columns), tmp_path / "table.parquet")
    return tmp_path / "table.parquet"


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="threads are counted in /proc")
def test_no_thread_is_started_that_could_abort_the_end_of_a_process(written):
    process = subprocess.run(
        [sys.executable, "-c", COUNTED, written], capture_output=True, text=True, check=True
    )
    assert process.stdout.split() == ["1000", "0"]


def test_columns_are_read_in_the_order_asked_for(written):
    assert parquet.read(written, ["column 7", "column 3"]).column_names == ["column 7", "column 3"]


@pytest.mark.parametrize(
    ("change", "columns", "place", "violation"),
    [
        (lambda content: content, ["column 20"], "column column 20", "nothing"),
        (lambda content: b"frame,time_s\n", None, "file", "b'fram' at its beginning"),
        (lambda content: content[:-10], None, "file", "an end cut off"),
    ],
)
def test_what_cannot_be_read_is_refused(written, change, columns, place, violation):
    written.write_bytes(change(written.read_bytes()))
    with pytest.raises(InputError) as refused:
        parquet.read(written, columns)
    assert (refused.value.place, refused.value.actual) == (place, violation)


def test_readings_have_no_dictionary(tmp_path):
    table = pa.table({"session": [1, 1, 1], "voltage_V": parquet.lists(np.eye(3))})
    parquet.write_groups(tmp_path / "set.parquet", [table], {})
    columns = pq.ParquetFile(tmp_path / "set.parquet").metadata.row_group(0)
    has_dictionary = [columns.column(k).has_dictionary_page for k in range(2)]
    assert has_dictionary == [True, False]
    assert parquet.read(tmp_path / "set.parquet").equals(table)


def test_a_folder_and_nothing_are_refused(tmp_path):
    for path, violation in ((tmp_path, "a folder"), (tmp_path / "none.parquet", "no such file")):
        with pytest.raises(InputError, match=violation):
            parquet.read(path)
