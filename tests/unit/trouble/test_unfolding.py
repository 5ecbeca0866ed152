"""Small files that unfold to far more than readings could are refused before they are unfolded."""

import zipfile

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io
import scipy.sparse

from eitskin import unfolding
from eitskin.data import importers, parquet
from eitskin.errors import InputError

ZEROS = np.zeros((5000, 208))
SHEET = (
    '<worksheet xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"><sheetData>'
    + '<row><c r="XFD1"><v>0</v></c></row>' * 300
    + "</sheetData></worksheet>"
)


def npz(path):
    np.savez_compressed(path, ref=ZEROS)


def mat(path):
    scipy.io.savemat(path, {"vh": ZEROS}, do_compression=True)


def sparse_mat(path):
    scipy.io.savemat(path, {"vh": scipy.sparse.csc_matrix((100_000, 100_000))})


def table(path):
    pq.write_table(pa.table({"voltage_V": parquet.lists(ZEROS)}), path)


def workbook(path):
    """A sheet of few cells, the last column's."""
    openpyxl = pytest.importorskip("openpyxl")
    openpyxl.Workbook().save(path)
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in parts.items():
            archive.writestr(name, SHEET if name.endswith("sheet1.xml") else content)


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("a.npz", npz),
        ("a.mat", mat),
        ("b.mat", sparse_mat),
        ("a.parquet", table),
        ("a.xlsx", workbook),
    ],
)
def test_it_is_refused_in_a_sentence(name, write, tmp_path, monkeypatch):
    monkeypatch.setattr(unfolding, "LEAST_BYTES", 1 << 20)
    write(tmp_path / name)
    with pytest.raises(InputError, match=r"bytes that unfold to .* or more, expected at most 100"):
        importers.load(tmp_path / name)
