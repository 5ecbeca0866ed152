"""The rules that compare two recordings and write the page."""

import json

import pytest
import yaml

from eitskin import cli
from eitskin.data import recording
from small_skin import small_recording

GAIN = {"name": "drive-gain", "drives": [5], "parameters": {"gain": 1.05}}


@pytest.mark.long
def test_two_recordings_are_compared_as_by_the_command(fresh, tmp_path):
    house = fresh.copy(tmp_path / "house")
    files = {name: house.folder / f"{name}.parquet" for name in ("a", "b")}
    recording.write(small_recording(seed=1), files["a"])
    recording.write(small_recording(GAIN, seed=2), files["b"])
    named = {name: {"path": path.name} for name, path in files.items()}
    (house.folder / "skins.yaml").write_text(yaml.safe_dump({"recordings": named}))
    folder = "results/diagnosis/compare/a-vs-b"
    run = house.snakemake("skins.yaml", "--", f"{folder}/comparison.html")
    assert run.returncode == 0, run.stdout + run.stderr
    assert cli.main(["compare", *map(str, files.values()), "--out", str(tmp_path / "out")]) == 0
    for name in ("comparison.json", "comparison.html"):
        assert (house.folder / folder / name).read_text() == (tmp_path / "out" / name).read_text()
    (found,) = json.loads((tmp_path / "out" / "comparison.json").read_text())["difference"]["found"]
    assert (found["name"], found["drives"], found["named"]) == ("drive-gain", [5], True)
    run = house.snakemake("skins.yaml", "--", "results/diagnosis/compare/a-vs-a/comparison.json")
    assert run.returncode != 0
    assert "comparison: recordings: found a twice" in run.stdout + run.stderr
