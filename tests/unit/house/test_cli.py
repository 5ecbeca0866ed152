import json
import shutil
import subprocess
import sys

import numpy as np
import pyarrow.parquet as pq
import pytest

from eitskin import cli
from eitskin.data import recording
from eitskin.data.channel_order import known_orders
from eitskin.data.check import check, text
from eitskin.diagnose import parts
from small_skin import small_recording, voltage


@pytest.fixture
def path(make_recording, tmp_path):
    path = tmp_path / "skin.parquet"
    recording.write(make_recording(), path)
    return path


def test_check_prints_and_ends_with_0(path, capsys):
    assert cli.main(["check", str(path)]) == 0
    assert capsys.readouterr().out == text(check(recording.read(path)))


def test_check_names_a_wrong_order_and_ends_with_2(make_recording, path, capsys):
    made = make_recording()
    name, order = next(
        item for item in known_orders(made.channels, 16).items() if item[0].endswith("own")
    )
    made.voltage = np.ascontiguousarray(made.voltage[:, order])
    recording.write(made, path)
    assert cli.main(["check", str(path)]) == cli.UNUSABLE == 2
    assert "wrong channel order: exchanging drive and measurement" in capsys.readouterr().out
    assert name in text(check(made))


@pytest.mark.parametrize("command", [["check"], ["import", "OUT"]])
def test_bad_input_is_one_line_on_stderr_and_1(path, tmp_path, capsys, command):
    path.write_bytes(path.read_bytes()[:-50])
    out = tmp_path / "out.parquet"
    rest = [str(out) if word == "OUT" else word for word in command[1:]]
    assert cli.main([command[0], str(path), *rest]) == 1
    printed = capsys.readouterr()
    assert printed.out == "" and printed.err.count("\n") == 1
    assert printed.err.startswith(f"{path}: file: found an end cut off")
    assert not out.exists()


def test_import_writes_a_recording(path, tmp_path):
    out = tmp_path / "new" / "copy.parquet"
    assert cli.main(["import", str(path), str(out), "--format", "eit-recording"]) == 0
    assert out.read_bytes() == path.read_bytes()
    assert [file.name for file in out.parent.iterdir()] == ["copy.parquet"]


def test_an_output_that_cannot_be_written_is_one_line(path, tmp_path, capsys):
    before = path.read_bytes()
    for out in (tmp_path, path / "below.parquet", tmp_path / ("long" * 100)):
        assert cli.main(["import", str(path), str(out)]) == 1
        printed = capsys.readouterr().err
        assert printed.count("\n") == 1 and printed.startswith(str(tmp_path))
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]


def test_the_module_runs_as_a_command(path):
    run = subprocess.run(
        [sys.executable, "-m", "eitskin.cli", "check", str(path.with_name("absent"))],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 1 and run.stdout == ""
    assert "no such file" in run.stderr and "Traceback" not in run.stderr


def test_diagnose_writes_everything_and_says_what_it_found(tmp_path, monkeypatch, capsys):
    recorded = small_recording(
        {"name": "measurement-gain", "measures": [2], "parameters": {"gain": 1.05}}, places=1
    )
    source, query, out = tmp_path / "skin.parquet", tmp_path / "query.parquet", tmp_path / "out"
    recording.write(recorded, source)
    asked = small_recording(places=1, seed=1)
    asked.voltage = None
    recording.write(asked, query)
    command = ["diagnose", str(source), "--query", str(query), "--out", str(out)]
    of_another = [
        out / "effects.yaml",
        out / "evidence" / "search.csv",
        out / "figures" / "last.svg",
    ]
    mine = out / "figures" / "mine.svg"
    for file in (*of_another, mine):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("of another recording", encoding="utf-8")

    def interrupt(*arguments, **settings):
        assert (out / "recording.parquet").is_file() and mine.is_file()
        assert not any(file.exists() for file in of_another)
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(parts, "diagnose", interrupt)
        assert cli.main(command) == cli.INTERRUPTED
    assert cli.main(command) == 0
    printed = capsys.readouterr()
    found = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    assert found["recording"] == "skin"
    assert found["effects"][0]["sentence"] in printed.out
    assert "noise" in printed.err
    assert (out / "report.html").is_file() and (out / "figures" / "electrodes.svg").is_file()
    predicted = pq.read_table(out / "predicted.parquet")
    assert predicted.num_rows == len(asked.frames)
    values = np.stack(predicted["voltage_V"].to_pylist())
    assert np.isfinite(values).all() and (np.stack(predicted["std_V"].to_pylist()) > 0).all()
    item = {"name": "measurement-gain", "measures": [2], "parameters": {"gain": 1.05}}
    truth = voltage(asked, [item])
    assert np.sqrt(np.mean((values - truth) ** 2)) < 1e-3 * np.median(np.abs(truth))


@pytest.mark.parametrize("command", ["diagnose", "compare"])
def test_a_query_in_a_recording_s_place_is_refused_before_anything_is_lost(
    tmp_path, capsys, command
):
    query, out = tmp_path / "query.parquet", tmp_path / "out"
    asked = small_recording(places=1)
    asked.voltage = None
    recording.write(asked, query)
    out.mkdir()
    (out / "report.html").write_text("of another recording", encoding="utf-8")
    files = [str(query)] * (2 if command == "compare" else 1)
    assert cli.main([command, *files, "--out", str(out)]) == 1
    printed = capsys.readouterr().err
    said = "column voltage_V: found nothing, expected voltages; this is a query\n"
    assert printed.endswith(said) and printed.count("\n") == 1 and "query" in printed.split(":")[0]
    if command == "diagnose":
        assert (out / "report.html").is_file()


def test_a_query_of_other_electrodes_is_refused(make_recording, path, tmp_path, capsys):
    query, out = tmp_path / "query.parquet", tmp_path / "out"
    asked = small_recording(places=1)
    asked.voltage = None
    recording.write(asked, query)
    assert cli.main(["diagnose", str(path), "--query", str(query), "--out", str(out)]) == 1
    printed = capsys.readouterr().err
    place = "skin.electrode_deg"
    assert printed == f"{query}: {place}: found 8 electrodes, expected the recording's 16\n"
    assert not out.exists()


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_shells_complete_commands_options_and_files(shell, capsys):
    with pytest.raises(SystemExit) as ended:
        cli.main(["--print-completion", shell])
    printed = capsys.readouterr().out
    assert not ended.value.code
    for word in ("check", "import", "diagnose", "compare", "resume", "--anyway", "--skin"):
        assert word in printed
    checked = shutil.which(shell)
    if checked:
        subprocess.run([checked, "-n"], input=printed, check=True, text=True)
