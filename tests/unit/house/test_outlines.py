"""Skins that are no disc, as their owners meet the answer: one sentence, whatever command."""

import json
from dataclasses import replace

import numpy as np
import pytest

from eitskin import cli
from eitskin.data import check, recording, stated
from eitskin.diagnose import diagnosis
from eitskin.diagnose.fitting.simulator import beliefs
from eitskin.errors import InputError
from eitskin.physics.geometry import Geometry

RECTANGLE = "outline: [[-60, -40], [60, -40], [60, 40], [-60, 40]]\n"
FOUND = {
    RECTANGLE: "outline: found a rectangle of 120 x 80 mm, as a bare list, expected a disc",
    "outline: a glove\n": "outline: found a glove, expected a disc",
}
WAY_OUT = "`eitskin check` and `eitskin compare CONTROL LATER` work all the same"


@pytest.fixture
def path(make_recording, tmp_path):
    path = tmp_path / "skin.parquet"
    recording.write(make_recording(), path)
    return path


@pytest.fixture(params=FOUND)
def said(request, tmp_path):
    """A statement of the skin, and what is found in it."""
    file = tmp_path / "skin.yaml"
    file.write_text(request.param)
    return file, FOUND[request.param]


@pytest.mark.parametrize("command", ["diagnose", "import"])
def test_what_simulates_or_goes_before_it_ends_with_one_sentence(
    path, said, tmp_path, capsys, command
):
    file, found = said
    out = tmp_path / "out"
    target = ["--out", str(out)] if command == "diagnose" else [str(out)]
    assert cli.main([command, str(path), *target, "--skin", str(file)]) == cli.UNUSABLE
    printed = capsys.readouterr()
    assert printed.out == "" and printed.err.count("\n") == 1
    assert printed.err.startswith(f"{file}: skin.{found}") and WAY_OUT in printed.err
    assert '{"corners_mm": …}' in printed.err
    assert not out.exists()


@pytest.mark.parametrize("command", ["diagnose", "import"])
def test_it_is_told_to_programs_and_an_earlier_answer_goes(path, said, tmp_path, capsys, command):
    file, _ = said
    out = tmp_path / "out"
    out.mkdir()
    earlier = out / "diagnosis.json"
    earlier.write_text("{}")
    target = out if command == "diagnose" else out / "skin.parquet"
    words = ["--out", str(target)] if command == "diagnose" else [str(target)]
    words = [command, str(path), *words, "--skin", str(file), "--json"]
    assert cli.main(words) == cli.UNUSABLE
    answer = json.loads(capsys.readouterr().out)
    assert answer["format"] == "eit-refusal" and answer["place"].startswith("skin.")
    assert earlier.exists() == (command == "import")


def test_electrodes_on_a_rim_whose_radius_nobody_knows_are_simulated(make_recording):
    """What is calibrated begins elsewhere, and the places were judged by themselves."""
    recorded = make_recording()
    skin = recorded.metadata["skin"]
    rim = skin["radius_mm"] * np.exp(1j * np.radians(skin["electrode_deg"]))
    places = np.column_stack([rim.real, rim.imag]).tolist()
    recorded.metadata["skin"] = skin | {"radius_mm": None, "electrode_xy_mm": places}
    believed, free = beliefs(recorded)
    assert "radius_mm" in {item.name for item in free}
    for radius in (0.5 * believed.radius_mm, believed.radius_mm, 2.0 * believed.radius_mm):
        Geometry.from_skin(replace(believed, radius_mm=radius))


def test_an_import_goes_on_anyway_and_its_diagnosis_says_the_same(path, said, tmp_path):
    file, found = said
    out = tmp_path / "out.parquet"
    assert cli.main(["import", str(path), str(out), "--skin", str(file), "--anyway"]) == 0
    with pytest.raises(InputError, match=f"skin.{found}"):
        diagnosis.diagnose(recording.read(out))
    assert cli.main(["diagnose", str(out), "--anyway"]) == cli.UNUSABLE


def test_a_check_warns(path, said, capsys):
    file, _ = said
    assert cli.main(["check", str(path), "--skin", str(file)]) == 0
    printed = capsys.readouterr().out
    assert "What to look at:\n  outline: skin.outline says: " in printed and WAY_OUT in printed
    assert cli.main(["check", str(path)]) == 0
    assert "outline" not in capsys.readouterr().out


def test_sessions_are_compared_whatever_the_outline(path, said, tmp_path, capsys):
    file, _ = said
    out = tmp_path / "comparison"
    command = ["compare", str(path), str(path), "--skin", str(file), "--out", str(out)]
    assert cli.main(command) == 0
    assert (out / "comparison.json").is_file()


def test_electrodes_inside_the_skin_are_told(make_recording):
    made = make_recording()
    radius, angles = made.skin.radius_mm, np.radians(made.skin.electrode_deg)
    on = radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    told = stated.apply({"electrode_xy_mm": on.tolist()}, made)
    assert np.allclose(told.skin.electrode_deg, made.skin.electrode_deg)
    assert not check.check(told).of_topic("outline")
    on[2] *= 0.5
    inside = stated.apply({"electrode_xy_mm": on.tolist()}, made)
    assert inside.skin.electrode_deg is None and not check.check(inside).of_topic("outline")
    assert any(
        "16 electrodes, 1 of them inside" in f.sentence for f in check.check(inside).findings
    )
    on[2] *= 3.0
    beyond = stated.apply({"electrode_xy_mm": on.tolist()}, made)
    (warning,) = check.check(beyond).of_topic("outline")
    assert warning.severity == check.WARNING
    assert "electrode 2 of 16 off the rim, at 150 % of the radius" in warning.sentence
    with pytest.raises(InputError, match="electrode 2 of 16 off the rim"):
        diagnosis.diagnose(beyond)
