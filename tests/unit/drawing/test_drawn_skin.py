"""`eitskin skin`: what it draws, what it prints, what it refuses."""

import json
import webbrowser
from xml.etree import ElementTree

import pytest
import yaml

from eitskin import cli
from eitskin.data import recording, stated

RECTANGLE = """
outline: {shape: rectangle, width_mm: 120, height_mm: 80}
electrode_s: [0.05, 0.2, 0.35, 0.6, 0.9]
radius_mm: null
electrode_deg: null
electrode_width_mm: 6
voltage: signed
"""
SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "skin.yaml").write_text(RECTANGLE, encoding="utf-8")
    return tmp_path


def drawing(file):
    """Texts, and counts of arrows and electrodes."""
    root = ElementTree.fromstring(file.read_text(encoding="utf-8"))
    arrows = [path for path in root.iter(f"{SVG}path") if path.get("class") == "drive"]
    (group,) = [group for group in root.iter(f"{SVG}g") if group.get("id") == "electrodes"]
    return [text.text for text in root.iter(f"{SVG}text")], len(arrows), len(group)


def test_a_statement_is_drawn_with_lengths_numbers_and_drives(folder, capsys):
    assert cli.main(["skin", "skin.yaml", "--drive", "adjacent"]) == 0
    texts, arrows, electrodes = drawing(folder / "skin-skin.svg")
    assert (arrows, electrodes) == (5, 5)
    assert {*"01234", "120", "80", "seen from the touched side"} <= {*texts}
    assert "120 x 80 mm, rim 400 mm long" in texts
    printed = yaml.safe_load(capsys.readouterr().out)
    assert printed["skin"]["outline"] == {"shape": "rectangle", "width_mm": 120, "height_mm": 80}
    assert "voltage" not in printed["skin"]


def test_what_it_prints_is_a_statement(folder, capsys):
    assert cli.main(["skin", "skin.yaml"]) == 0
    (folder / "again.yaml").write_text(capsys.readouterr().out, encoding="utf-8")
    assert stated.read("again.yaml").items() <= stated.read("skin.yaml").items()


def test_what_it_draws_is_a_drawing_of_the_same_skin(folder, capsys):
    assert cli.main(["skin", "skin.yaml", "--drive", "opposite", "--out", "a.svg"]) == 1
    assert "expected adjacent, opposite or skip-<n>" in capsys.readouterr().err
    assert cli.main(["skin", "skin.yaml", "--drive", "skip-1", "--out", "a.svg"]) == 0
    capsys.readouterr()
    assert cli.main(["skin", "a.svg", "--out", "b.svg", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert (answer["format"], answer["version"], answer["out"]) == ("eit-skin", 1, "b.svg")
    skin = answer["skin"]
    assert skin["outline"] == {"shape": "rectangle", "width_mm": 120.0, "height_mm": 80.0}
    places = [[-40, -40], [20, -40], [60, -20], [20, 40], [-60, 0]]
    for place, expected in zip(skin["electrode_xy_mm"], places, strict=True):
        assert place == pytest.approx(expected, abs=0.05)


def test_a_recording_says_its_drives(folder, make_recording, capsys):
    recording.write(make_recording(), "skin.parquet")
    assert cli.main(["skin", "skin.parquet"]) == 0
    texts, arrows, electrodes = drawing(folder / "skin-skin.svg")
    assert (arrows, electrodes) == (16, 16)
    assert any(text.startswith("disc, diameter") for text in texts)


def test_the_browser_opens_only_where_asked(folder, monkeypatch):
    opened = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    assert cli.main(["skin", "skin.yaml"]) == 0 and opened == []
    assert cli.main(["skin", "skin.yaml", "--view", "--out", "v.svg"]) == 0
    assert opened == [(folder / "v.svg").resolve().as_uri()]


@pytest.mark.parametrize(
    ("statement", "message"),
    [
        ("thickness_mm: 2", "skin.yaml: radius_mm: found nothing, expected radius_mm, or outline"),
        ("radius: 2", "skin.yaml: radius: found an unknown key"),
        (
            "outline: {shape: rectangle, width_mm: 9, height_mm: 9}\nelectrode_xy_mm: [[7, 0]]",
            "skin.yaml: skin.electrode_xy_mm: found electrode 0 2.5 mm beyond the rim",
        ),
        ("outline: a glove", "skin.yaml: skin.outline: found a glove"),
    ],
)
def test_a_statement_that_cannot_be_drawn_is_one_line(folder, statement, message, capsys):
    (folder / "skin.yaml").write_text(statement, encoding="utf-8")
    assert cli.main(["skin", "skin.yaml"]) == 1
    printed = capsys.readouterr()
    assert printed.err.startswith(message) and printed.err.count("\n") == 1
    assert not (folder / "skin-skin.svg").exists()


def test_another_kind_of_drawing_is_one_line(folder, capsys):
    (folder / "skin.dwg").write_bytes(b"AC1032")
    assert cli.main(["skin", "skin.dwg"]) == 1
    assert capsys.readouterr().err.startswith("skin.dwg: suffix: found .dwg, expected an SVG")


def test_a_file_is_not_written_over_itself(folder, capsys):
    assert cli.main(["skin", "skin.yaml", "--out", "skin.yaml"]) == 1
    assert "--out: found the file that is read" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words", [["--unit", "mm"], ["--mirrored"], ["--measure", "adjacent"], ["--unit", "px:0"]]
)
def test_options_that_say_nothing_are_wrong_usage(folder, words):
    with pytest.raises(SystemExit) as ended:
        cli.main(["skin", "skin.yaml", *words])
    assert ended.value.code == 2


def test_electrodes_inside_are_discs_where_they_are(folder):
    statement = "radius_mm: 40\nelectrode_width_mm: 5\nelectrode_xy_mm: [[40, 0], [-8, 6], [0, 0]]"
    (folder / "skin.yaml").write_text(statement, encoding="utf-8")
    assert cli.main(["skin", "skin.yaml"]) == 0
    drawn = (folder / "skin-skin.svg").read_text(encoding="utf-8")
    assert drawn.count('class="electrode"') == 1
    assert '<circle class="dot" cx="-8.0000" cy="-6.0000" r="2.5"/>' in drawn
    assert '<circle class="dot" cx="0.0000" cy="0.0000" r="2.5"/>' in drawn.replace(
        "-0.0000", "0.0000"
    )
