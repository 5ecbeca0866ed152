"""The diagnosis through the workflow's own rules: what it needs, what it writes, what is made of
that."""

import json
import re
import shutil

import numpy as np
import pyarrow.parquet as pq
import pytest

from eitskin.data import recording

pytestmark = pytest.mark.xdist_group("finished")

FOLDER = "results/diagnosis/simulated-twin"
REPORT = f"{FOLDER}/report.html"
BROUGHT = "results/diagnosis/brought"


@pytest.fixture
def house(finished, tmp_path):
    """A finished workflow to edit."""
    return finished.copy(tmp_path / "house")


def table(run):
    """Rows of --detailed-summary by output file."""
    assert run.returncode == 0, run.stderr
    header, *lines = [line.split("\t") for line in run.stdout.splitlines() if line]
    return {line[0]: dict(zip(header, line, strict=True)) for line in lines}


def test_the_twin_s_diagnosis_names_what_was_hidden(finished):
    said = json.loads((finished.folder / FOLDER / "diagnosis.json").read_text(encoding="utf-8"))
    assert said["recording"] == "simulated-twin" and said["verdict"] == "explained"
    (effect,) = said["effects"]
    assert (effect["name"], effect["electrodes"]) == ("contact-impedance", [3])
    ratio = effect["parameters"]["ratio"]
    assert 1.5 < ratio["low"] < ratio["high"] < 2.5
    html = (finished.folder / FOLDER / "report.html").read_text(encoding="utf-8")
    assert effect["sentence"] in re.sub(r"</?span[^>]*>", "", html)
    assert not (finished.folder / FOLDER / "predicted.parquet").exists()
    with np.load(finished.folder / FOLDER / "evidence" / "residuals.npz") as file:
        (change,), channels = file["changes"], file["channels"]
    assert 3 in channels[np.nanargmax(np.abs(change))] and "What it changes in a" in html


def files(row):
    """The files that a product is made of, without the plan of its provenance."""
    names = row["input-file(s)"].split(",")
    return {name for name in names if not name.startswith(".snakemake/provenance/")}


def test_a_diagnosis_is_made_of_the_recording_its_check_and_the_schema_alone(finished):
    rows = table(finished.snakemake("--detailed-summary", "--", REPORT))
    inputs = files(rows[f"{FOLDER}/diagnosis.json"])
    recorded = "results/recordings/simulated-twin.parquet"
    checked = "results/recordings/simulated-twin.check.txt"
    assert inputs == {recorded, checked, "workflow/eitskin/diagnose/diagnosis.schema.yaml"}
    assert files(rows[checked]) == {recorded}
    for file, row in rows.items():
        if file.startswith(FOLDER):
            for name in files(row):
                assert name in inputs or name.startswith(FOLDER), (file, name)
    assert files(rows[recorded]) == {"results/twin/simulated-twin.parquet"}


@pytest.mark.long
def test_a_recording_with_a_query_is_diagnosed_and_the_query_predicted(house, tmp_path):
    source = house.folder / "results" / "recordings" / "simulated-twin.parquet"
    shutil.copy(source, tmp_path / "brought.parquet")
    asked = recording.read(source)
    truth, asked.voltage = asked.voltage, None
    recording.write(asked, tmp_path / "query.parquet")
    (house.folder / "more.yaml").write_text(
        f"recordings: {{brought: {{path: {tmp_path}/brought.parquet,"
        f" query: {tmp_path}/query.parquet}}}}\n"
    )
    run = house.snakemake("more.yaml", "--", f"{BROUGHT}/report.html", cores=1)
    assert run.returncode == 0, run.stdout + run.stderr
    predicted = pq.read_table(house.folder / BROUGHT / "predicted.parquet")
    values = np.stack(predicted["voltage_V"].to_pylist())
    said = json.loads((house.folder / BROUGHT / "diagnosis.json").read_text(encoding="utf-8"))
    rms = np.sqrt(np.mean((values - truth) ** 2))
    assert 0.9 < rms / said["noise_V"] < 1.1
    twin = json.loads((house.folder / FOLDER / "diagnosis.json").read_text(encoding="utf-8"))
    assert said | {"recording": ""} == twin | {"recording": ""}


@pytest.mark.long
def test_the_workflow_simulates_from_effects_yaml_without_a_change(house):
    recorded = recording.read(house.folder / "results" / "recordings" / "simulated-twin.parquet")
    target = "results/twin/simulated-twin.parquet"
    sets = "results/datasets/simulated-corrected-simulated-twin.parquet"
    shutil.copy(house.folder / FOLDER / "effects.yaml", house.folder / "effects.yaml")
    run = house.snakemake("effects.yaml", "--", target, sets)
    assert run.returncode == 0, run.stdout + run.stderr
    again = recording.read(house.folder / target)
    said = json.loads((house.folder / FOLDER / "diagnosis.json").read_text(encoding="utf-8"))
    rms = np.sqrt(np.mean((again.voltage - recorded.voltage) ** 2))
    assert rms < 1.5 * said["noise_V"]
    assert pq.read_metadata(house.folder / sets).num_rows == 6 * 2 * 8
