"""Wrong input stops the workflow with one line, before any work."""

import subprocess
import sys

import numpy as np
import pytest

from eitskin.data import recording
from eitskin.data.importers.description import describe
from eitskin.data.recording import Recording, frames_table
from eitskin.physics.geometry import even_angles
from eitskin.physics.protocol import channel_table

pytestmark = pytest.mark.xdist_group("refusals")


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ("sed: 2\n", "wrong.yaml: sed: found an unknown key, expected one of"),
        ("seed: 1.5\n", "wrong.yaml: seed: found 1.5, expected a whole number"),
        (
            "configurations: {authors: {noise: 2e-2}}\n",
            "wrong.yaml: configurations.authors.noise: found '2e-2', expected a finite number "
            "(YAML reads 2e-2 as text; write 2.0e-2)",
        ),
        (
            "recordings: {my-skin: {path: captures/my-skin.parquet}}\n",
            "wrong.yaml: recordings.my-skin.path: found no file 'captures/my-skin.parquet', "
            "expected a recording's path",
        ),
        (
            "twin: {skin: {electrode_width_mm: 40.0}}\n",
            "wrong.yaml: twin.skin.electrode_width_mm: found two that overlap, expected each",
        ),
    ],
)
def test_a_wrong_configuration(fresh, tmp_path, config, message):
    house = fresh.copy(tmp_path / "house")
    (house.folder / "wrong.yaml").write_text(config)
    run = house.forked("wrong.yaml")
    assert run.returncode != 0
    lines = run.stderr.splitlines()
    assert len([line for line in lines if message in line]) == 1
    assert "Traceback" not in run.stderr + run.stdout
    assert [line for line in lines if "found" in line and "expected" in line] == lines[-1:]
    assert not (house.folder / "results").exists()


def test_a_broken_effect_is_told_by_file_and_line(fresh, tmp_path):
    house = fresh.copy(tmp_path / "house")
    file = house.folder / "workflow" / "eitskin" / "effects" / "mine.py"
    file.write_text("import numpy as np\n\n\ndef voltage(:\n")
    run = house.snakemake()
    assert run.returncode != 0
    assert run.stderr.splitlines()[-1] == f"{file}: line 4: found invalid syntax, expected Python"
    assert "Traceback" not in run.stderr and "File " not in run.stderr
    assert not (house.folder / "results").exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"seed: [1\n", "config.yaml: line 2, column 1: found the end of the file, exp"),
        (b"# f\xfcr\nseed: 1\n", "config.yaml: line 1: found byte 0xfc, no UTF-8, expected a YAML"),
        (b"__use_yte__: true\n", "config.yaml: __use_yte__: found a template, which runs code"),
    ],
)
def test_the_file_of_defaults_is_refused_by_line(fresh, tmp_path, text, message):
    house = fresh.copy(tmp_path / "house")
    (house.folder / "config.yaml").write_bytes(text)
    run = house.forked()
    assert run.returncode != 0
    assert run.stderr.splitlines()[-1].startswith(message)
    assert "Traceback" not in run.stderr and "Snakefile" not in run.stderr
    assert not (house.folder / "results").exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("models: [mlp\nseed: 1\n", "more.yaml: line 2, column 5: found ':', expected ',' or ']'"),
        (None, "more.yaml: file: found No such file or directory, expected a YAML file"),
    ],
)
def test_a_further_file_is_refused_by_line_before_snakemake_reads_it(tmp_path, text, message):
    if text is not None:
        (tmp_path / "more.yaml").write_text(text)
    read = subprocess.run(
        [sys.executable, "-m", "eitskin.configuration", "more.yaml"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert read.returncode == 1 and read.stderr == f"{message}\n"


@pytest.mark.long
def test_a_damaged_recording_leaves_nothing_half_written(fresh, tmp_path):
    house = fresh.copy(tmp_path / "house")
    (house.folder / "broken.parquet").write_bytes(b"PAR1 and no more")
    config = "recordings: {my-skin: {path: broken.parquet, format: eit-recording}}\n"
    (house.folder / "extra.yaml").write_text(config)
    target = "results/recordings/my-skin.check.txt"
    run = house.snakemake("extra.yaml", "--", target)
    assert run.returncode != 0
    log = (house.folder / "logs" / "import_recording" / "my-skin.log").read_text()
    assert log.startswith("broken.parquet: ")
    assert len(log.splitlines()) == 1
    assert log.strip() in run.stderr
    assert "Traceback" not in run.stderr
    assert [f for f in (house.folder / "results").rglob("*") if f.is_file()] == []


def test_nothing_is_learned_from_a_recording_that_the_check_calls_unusable(fresh, tmp_path):
    house = fresh.copy(tmp_path / "house")
    touch = np.tile([False, True], 30)
    frames = frames_table(np.arange(60.0), touch, np.arange(60.0), 0.0, 1.0 + np.arange(60.0))
    metadata = describe(channel_table(16), even_angles(16), "a citation", "signed")
    noise = np.random.default_rng(0).normal(size=(60, 208))
    made = Recording(frames, noise, None, None, metadata)
    recording.write(made, house.folder / "noise.parquet")
    (house.folder / "extra.yaml").write_text("recordings: {my-skin: {path: noise.parquet}}\n")
    run = house.snakemake("extra.yaml", "--", "results/datasets/my-skin.parquet")
    assert run.returncode != 0
    message = "results/recordings/my-skin.parquet: check, order: found exchanging drive and"
    assert any(line.startswith(message) for line in run.stderr.splitlines())
    assert "Traceback" not in run.stderr
    log = (house.folder / "logs" / "check" / "my-skin.log").read_text()
    assert log.startswith(message) and log.endswith("Not usable as it stands.\n")
    results = house.folder / "results"
    written = {file.relative_to(results).parts[0] for file in results.rglob("*") if file.is_file()}
    assert written == {"recordings", "provenance"}
    assert [file.name for file in (results / "recordings").iterdir()] == ["my-skin.parquet"]
    assert not (house.folder / "results" / "datasets" / "my-skin.parquet").exists()
