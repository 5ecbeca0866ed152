import numpy as np
import pytest
import yaml

from eitskin import cli
from eitskin.data import recording, stated
from eitskin.data.check import check
from eitskin.errors import InputError


@pytest.fixture
def bare(make_recording):
    """A recording whose file says nothing of the skin but its electrodes' angles."""
    skin_recording = make_recording()
    skin_recording.metadata["skin"] |= dict.fromkeys(
        set(skin_recording.metadata["skin"]) - {"electrode_deg"}
    )
    return skin_recording


def test_what_is_stated_replaces_what_the_file_says(bare):
    statement = {"radius_mm": 100, "thickness_mm": 60, "source_reference": "sink-grounded"}
    stated_recording = stated.apply(statement, bare)
    assert stated_recording.skin.radius_mm == 100 and stated_recording.skin.thickness_mm == 60
    assert stated_recording.metadata["source_reference"] == "sink-grounded"
    assert stated_recording.metadata["source"].endswith(
        "its owner states radius_mm, thickness_mm, source_reference"
    )
    assert stated_recording.skin.current_A is None and bare.skin.radius_mm is None
    assert stated.apply({"thickness_mm": None}, stated_recording).skin.thickness_mm is None


def test_every_key_of_the_format_may_be_stated(make_recording):
    skin_recording = make_recording()
    for key in stated.KEYS:
        value = {**skin_recording.metadata["skin"], **skin_recording.metadata}.get(key)
        stated.refuse({key: value})


@pytest.mark.parametrize(
    ("text", "place", "violation"),
    [
        ("radius: 100", "radius", "an unknown key"),
        ("radius_mm: -1", "radius_mm", "-1"),
        ("radius_mm: .inf", "radius_mm", "inf"),
        ("radius_mm: 2026-01-01", "radius_mm", "datetime.date"),
        ("radius_mm: 1\nradius_mm: 2", "radius_mm", "it in line 1 and again in line 2"),
        ("unit: mV", "unit", '"mV"'),
        ("frame_s: 0", "frame_s", "0"),
        ("electrode_deg: [0, 0]", "electrode_deg", "two equal angles"),
        ("- radius_mm", "file", "a list"),
        ("", "file", "nothing"),
        ("radius_mm: [1", "line 1, column 14", "expected"),
        ("radius_mm: \t1\n\tx: 2", "line", "found"),
    ],
)
def test_a_wrong_statement_is_one_line(tmp_path, text, place, violation):
    path = tmp_path / "skin.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as refused:
        stated.read(path)
    assert str(refused.value).startswith(f"{path}: {place}")
    assert violation in str(refused.value) and "\n" not in str(refused.value)


def test_bytes_that_are_no_text_are_refused(tmp_path):
    path = tmp_path / "skin.yaml"
    path.write_bytes("radius_mm: 100".encode("utf-16"))
    with pytest.raises(InputError, match="found UTF-16, expected a YAML file in UTF-8"):
        stated.read(path)


def test_fewer_angles_than_electrodes_are_refused(bare):
    with pytest.raises(InputError, match="8 angles, expected 16 or more"):
        stated.apply({"electrode_deg": list(np.arange(8) * 45.0)}, bare, "skin.yaml")


def test_touches_must_meet_the_skin_that_is_stated(bare):
    with pytest.raises(InputError, match=r"^skin.yaml: beside columns x_mm, y_mm"):
        stated.apply({"radius_mm": 1.0}, bare, "skin.yaml")


def test_the_check_says_what_is_believed(bare):
    stated_recording = stated.apply({"radius_mm": 100, "current_A": 0.001}, bare)
    (finding,) = check(stated_recording).of_topic("skin")
    sentence = finding.sentence.replace("\N{NO-BREAK SPACE}", " ")
    assert "believed: radius 100 mm, current 1 mA, 16 electrodes in even steps" in sentence
    assert "not known, so calibrated: thickness, conductivity" in sentence
    assert "height" not in sentence


def test_commands_take_the_skin_from_a_file(bare, tmp_path, capsys):
    source, skin, output_path = (
        tmp_path / name for name in ("a.parquet", "skin.yaml", "b.parquet")
    )
    recording.write(bare, source)
    skin.write_text(yaml.safe_dump({"radius_mm": 123.0}), encoding="utf-8")
    assert cli.main(["import", str(source), str(output_path), "--skin", str(skin)]) == 0
    assert recording.read(output_path).skin.radius_mm == 123.0
    assert cli.main(["check", str(source), "--skin", str(skin)]) == 0
    printed = capsys.readouterr().out
    assert "radius 123 mm" in printed and "\N{NO-BREAK SPACE}" not in printed
    skin.write_text("radius_cm: 12", encoding="utf-8")
    assert cli.main(["check", str(source), "--skin", str(skin)]) == 1
    assert capsys.readouterr().err.startswith(f"{skin}: radius_cm: found an unknown key")


@pytest.mark.parametrize("command", ["import", "diagnose"])
def test_what_is_unusable_goes_no_further(make_recording, tmp_path, capsys, command):
    skin_recording = make_recording()
    skin_recording.voltage = -skin_recording.voltage
    source, output_path = tmp_path / "a.parquet", tmp_path / "out"
    recording.write(skin_recording, source)
    arguments = [
        command,
        str(source),
        *(["--out"] if command == "diagnose" else []),
        str(output_path),
    ]
    assert cli.main(arguments) == cli.UNUSABLE
    printed = capsys.readouterr()
    assert printed.out == "" and f"{source}: polarity: wrong channel table" in printed.err
    assert "--anyway" in printed.err and not output_path.exists()


def test_anyway_goes_on(make_recording, tmp_path):
    skin_recording = make_recording()
    skin_recording.voltage = -skin_recording.voltage
    source, output_path = tmp_path / "a.parquet", tmp_path / "b.parquet"
    recording.write(skin_recording, source)
    assert cli.main(["import", str(source), str(output_path), "--anyway"]) == 0
    assert np.array_equal(recording.read(output_path).voltage, skin_recording.voltage)
