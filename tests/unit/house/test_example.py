"""The examples of the pages run and give what their comments say."""

import re
from pathlib import Path

import numpy as np

from eitskin.diagnose.verdict.record import read_query

ROOT = Path(__file__).parents[3]


def ran(page: str) -> dict:
    """The names that the examples of a page leave behind, run one after the other."""
    path, names = ROOT / "docs" / page, {}
    for code in re.findall(r"```python\n(.*?)```", path.read_text(encoding="utf-8"), re.DOTALL):
        exec(compile(code, str(path), "exec"), names)
    return names


def test_a_skin_is_simulated():
    names = ran("physics.md")
    assert names["channels"].shape == (208, 4)
    assert names["untouched"].shape == names["by_angle"].shape == (208,)
    assert names["change"].shape == (50, 208)
    assert np.abs(names["change"][0]).max() == 0 < np.abs(names["change"][1]).min()
    assert names["changes"].shape == (16, 2, 5, 208)


def test_a_query_is_written_that_a_diagnosis_reads(tmp_path, monkeypatch):
    (tmp_path / "docs").symlink_to(ROOT / "docs")
    monkeypatch.chdir(tmp_path)
    names = ran("recordings.md")
    query = read_query("query.parquet", names["recorded"])
    assert query.frames["x_mm"].tolist() == [0.0, 10.0, 20.0] and query.voltage is None
