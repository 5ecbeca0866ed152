"""One file and one line are a format."""

import sys

import pytest

from eitskin.configuration import schema
from eitskin.data import importers, recording
from eitskin.errors import InputError
from eitskin.pins import ROOT

TOY = '''
"""Untouched frames of a bench with eight electrodes, a frame a line after the word TOY."""

import numpy as np

from eitskin.data.importers.description import describe
from eitskin.physics.geometry import even_angles
from eitskin.data.importers.tables import first_line, numbers
from eitskin.data.recording import Recording, frames_table
from eitskin.physics.protocol import channel_table


def matches(path):
    """Whether the first line says so."""
    return first_line(path) == "TOY"


def load(path):
    """The frames, whose times nobody wrote down."""
    channels = channel_table(8)
    voltage = numbers(path, path.read_text().splitlines(), len(channels), 1)
    frames = frames_table(np.arange(len(voltage)), np.zeros(len(voltage), bool))
    metadata = describe(channels, even_angles(8), "a toy", "signed")
    return Recording(frames, voltage, None, None, metadata)
'''


MODULE = "eitskin.data.importers.toy_bench"


@pytest.fixture
def toy(tmp_path, monkeypatch):
    """A file of the format, which is known by its module and its line."""
    (tmp_path / "toy_bench.py").write_text(TOY, encoding="utf-8")
    monkeypatch.setattr(importers, "__path__", [*importers.__path__, str(tmp_path)])
    monkeypatch.setattr(importers, "FORMATS", (*importers.FORMATS, "toy-bench"))
    path = tmp_path / "bench.txt"
    path.write_text("TOY\n" + "\n".join([" ".join(["0.5"] * 40)] * 3), encoding="utf-8")
    yield path
    sys.modules.pop(MODULE, None)


def test_it_is_told_by_its_content_and_by_its_name(toy):
    for format in (None, "toy-bench"):
        imported_recording = importers.load(toy, format)
        assert (
            imported_recording.voltage.shape == (3, 40)
            and imported_recording.metadata["source"] == "a toy"
        )


def test_what_is_wrong_in_it_is_refused(toy):
    toy.write_text("TOY\n1 2 3\n", encoding="utf-8")
    with pytest.raises(InputError, match="line 2: found 3 numbers, expected 40"):
        importers.load(toy)
    toy.write_bytes(b"TOY\n1 2 \xff\n")
    with pytest.raises(InputError, match="file: found byte 0xff, no utf-8, expected text of the f"):
        importers.load(toy)


def test_the_configuration_knows_it(toy):
    schema_formats = schema(ROOT / "workflow" / "schemas" / "config.schema.yaml")
    recordings = schema_formats["properties"]["recordings"]["additionalProperties"]["properties"]
    assert recordings["format"]["enum"][-1] == "toy-bench"


@pytest.mark.parametrize(
    ("text", "instead", "message"),
    [
        ("def load(", "def load((", r"toy_bench\.py: line \d+: found .*, expected Python"),
        ("def load(", "def read(", "toy_bench: functions: found no load, expected matches, load"),
    ],
)
def test_one_that_is_broken_is_one_line_and_keeps_no_other_from_being_read(
    toy, make_recording, text, instead, message
):
    (toy.parent / "toy_bench.py").write_text(TOY.replace(text, instead), encoding="utf-8")
    for format in (None, "toy-bench"):
        with pytest.raises(InputError, match=message) as caught:
            importers.load(toy, format)
        assert "\n" not in str(caught.value)
    recording.write(make_recording(), toy.with_name("skin.parquet"))
    assert importers.load(toy.with_name("skin.parquet")).metadata["source"] == "simulation"


def test_one_that_takes_every_file_for_text_keeps_no_other_from_being_told(toy, monkeypatch):
    text = TOY.replace("first_line(path)", 'path.read_text(encoding="utf-8")')
    (toy.parent / "toy_bench.py").write_text(text, encoding="utf-8")
    toy.write_bytes(bytes(range(128, 256)))
    with pytest.raises(InputError, match="format: found bytes that begin"):
        importers.load(toy)


def test_one_without_a_line_is_told(toy, monkeypatch):
    monkeypatch.setattr(importers, "FORMATS", importers.FORMATS[:-1])
    with pytest.raises(InputError, match=f"draeger-get; {MODULE} has no line in FORMATS$"):
        importers.load(toy)
