"""The rules that compare recordings, and the sessions of one."""

import json

import pytest
import yaml

from eitskin.data import recording
from eitskin.diagnose.comparison.compare import parts
from skin_sessions import CONTACT, recorded


@pytest.mark.long
def test_sessions_and_recordings_are_compared(fresh, tmp_path):
    house = fresh.copy(tmp_path / "house")
    whole = recorded([[], [CONTACT]], presses=3)
    files = {"week": whole, **parts(whole)}
    for name, each in files.items():
        recording.write(each, house.folder / f"{name}.parquet")
    named = {name: {"path": f"{name}.parquet"} for name in files}
    (house.folder / "skins.yaml").write_text(yaml.safe_dump({"recordings": named}))
    folder = "results/diagnosis"
    wanted = [f"{folder}/week/sessions.json", f"{folder}/compare/a-vs-b/comparison.json"]
    run = house.snakemake("skins.yaml", "--", *wanted)
    assert run.returncode == 0, run.stdout + run.stderr
    sessions, compared = (json.loads((house.folder / path).read_text()) for path in wanted)
    assert sessions["parts"] == ["session a", "session b"] and compared["parts"] == ["a", "b"]
    for said in (sessions, compared):
        (row,) = [row for row in said["tested"] if row["changed"]]
        assert (row["name"], row["electrodes"]) == ("contact-impedance", [3])
    run = house.snakemake("skins.yaml", "--", f"{folder}/a/sessions.json")
    assert run.returncode != 0
    assert "column session: found 1 in all" in run.stdout + run.stderr
