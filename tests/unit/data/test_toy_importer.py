"""One file and one line are a format."""

import importlib

import pytest

from eitskin.configuration import schema
from eitskin.data import importers
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
    voltage = numbers(path, path.read_text().splitlines()[1:], len(channels))
    frames = frames_table(np.arange(len(voltage)), np.zeros(len(voltage), bool))
    metadata = describe(channels, even_angles(8), "a toy", "signed")
    return Recording(frames, voltage, None, None, metadata)
'''


@pytest.fixture
def toy(tmp_path, monkeypatch):
    """A file of the format, which is known by its module and its line."""
    (tmp_path / "toy_bench.py").write_text(TOY, encoding="utf-8")
    monkeypatch.setattr(importers, "__path__", [*importers.__path__, str(tmp_path)])
    module = importlib.import_module("eitskin.data.importers.toy_bench")
    monkeypatch.setitem(importers.FORMATS, "toy-bench", module)
    path = tmp_path / "bench.txt"
    path.write_text("TOY\n" + "\n".join([" ".join(["0.5"] * 40)] * 3), encoding="utf-8")
    return path


def test_it_is_told_by_its_content_and_by_its_name(toy):
    for format in (None, "toy-bench"):
        made = importers.load(toy, format)
        assert made.voltage.shape == (3, 40) and made.metadata["source"] == "a toy"


def test_what_is_wrong_in_it_is_refused(toy):
    toy.write_text("TOY\n1 2 3\n", encoding="utf-8")
    with pytest.raises(InputError, match="row 0: found 3 numbers, expected 40"):
        importers.load(toy)


def test_the_configuration_knows_it(toy):
    found = schema(ROOT / "workflow" / "schemas" / "config.schema.yaml")
    recordings = found["properties"]["recordings"]["additionalProperties"]["properties"]
    assert recordings["format"]["enum"][-1] == "toy-bench"
