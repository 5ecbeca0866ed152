"""Broken recordings of every format, one a row."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import sample_files as sound
from broken_input import Broken
from eitskin.data import recording

HERE = Path()

ALIASED = [f"&a{k} [{', '.join([f'*a{k - 1}'] * 10)}]" for k in range(1, 10)]
BOMB = f"[&a0 [x], {', '.join(ALIASED)}]"
MERGED_BOMB = "m0: &m0 {x: 1}\n" + "".join(
    f"m{k}: &m{k} {{<<: [{', '.join([f'*m{k - 1}'] * 10)}]}}\n" for k in range(1, 10)
)


def check(path: Path, *words: str) -> list[str]:
    return ["check", str(path), *words]


def text(name: str, content: str | bytes, *words: str) -> Callable:
    """A file of that content."""

    def make() -> list[str]:
        path = HERE / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return check(path, *words)

    return make


def lines(sample: Callable, change: Callable[[list[str]], object], *words: str) -> Callable:
    """A sound file of text whose list of lines is changed; a folder's last file."""

    def make() -> list[str]:
        path = sample(HERE)
        file = sorted(path.glob("*"))[-1] if path.is_dir() else path
        found = file.read_text(encoding="utf-8-sig").splitlines()
        found = change(found) or found
        file.write_text("\n".join(found) + "\n")
        return check(path, *words)

    return make


def content(sample: Callable, change: Callable[[bytes], bytes], *words: str) -> Callable:
    """A sound file whose bytes are changed."""

    def make() -> list[str]:
        path = sample(HERE)
        path.write_bytes(change(path.read_bytes()))
        return check(path, *words)

    return make


def arrays(sample: Callable, **changes: object) -> Callable:
    """A MATLAB file of a format with other arrays."""
    return lambda: check(sample(HERE, **changes))


def put(row: int, column: int, cell: str, separator: str = ",") -> Callable:
    """Lines with another cell."""

    def change(found: list[str]) -> None:
        cells = found[row].split(separator)
        cells[column] = cell
        found[row] = separator.join(cells)

    return change


def drop(row: int) -> Callable:
    """Lines without one."""
    return lambda found: found[:row] + found[row + 1 :]


def swap(old: str, new: str) -> Callable:
    """Lines with another text, where it first stands."""
    return lambda found: "\n".join(found).replace(old, new, 1).split("\n")


def described(change: Callable[[str], str] | str | bytes, *words: str) -> Callable:
    """A sound matrix with another description."""

    def make() -> list[str]:
        path = sound.matrix(HERE)
        beside = path.with_suffix(".yaml")
        if isinstance(change, bytes):
            beside.write_bytes(change)
        else:
            beside.write_text(change if isinstance(change, str) else change(beside.read_text()))
        return check(path, *words)

    return make


def described_as(old: str, new: str) -> Callable:
    return described(lambda said: said.replace(old, new))


def stated(skin: str | bytes) -> Callable:
    """A sound recording of which its owner states something broken."""

    def make() -> list[str]:
        path = sound.parquet(HERE)
        Path("skin.yaml").write_bytes(skin.encode() if isinstance(skin, str) else skin)
        return check(path, "--skin", "skin.yaml")

    return make


def table(change: Callable[[pa.Table], pa.Table]) -> Callable:
    """A Parquet file whose table is changed, its metadata kept."""

    def make() -> list[str]:
        path = sound.parquet(HERE)
        found = pq.read_table(path)
        pq.write_table(change(found).replace_schema_metadata(found.schema.metadata), path)
        return check(path)

    return make


def column(name: str, values: list, kind: pa.DataType | None = None) -> Callable:
    """A Parquet file with other values in a column, or with another column."""

    def change(found: pa.Table) -> pa.Table:
        made = pa.array(values, kind)
        if name not in found.column_names:
            return found.append_column(name, made)
        return found.set_column(found.column_names.index(name), name, made)

    return table(change)


def reading(row: int, value: object) -> Callable:
    """A Parquet file with another first reading in a row."""

    def change(found: pa.Table) -> pa.Table:
        voltage = found["voltage_V"].to_pylist()
        voltage[row][0] = value
        made = pa.array(voltage, found.schema.field("voltage_V").type)
        return found.set_column(found.column_names.index("voltage_V"), "voltage_V", made)

    return table(change)


def metadata(change: Callable[[dict], object] | bytes) -> Callable:
    """A Parquet file with other metadata."""

    def make() -> list[str]:
        path = sound.parquet(HERE)
        found = pq.read_table(path)
        said = json.loads(found.schema.metadata[recording.SCHEMA_KEY])
        if not isinstance(change, bytes):
            change(said)
        told = change if isinstance(change, bytes) else json.dumps(said).encode()
        pq.write_table(found.replace_schema_metadata({recording.SCHEMA_KEY: told}), path)
        return check(path)

    return make


def key(*place_and_value: object) -> Callable:
    """Metadata with another value at a place."""
    *place, name, value = place_and_value

    def change(said: dict) -> None:
        for part in place:
            said = said[part]
        said[name] = value

    return metadata(change)


READINGS = ",".join(map(str, np.arange(40) + 0.5))
ANY_FILE = [
    Broken("absent", lambda: check(HERE / "absent"), "absent | file | no such file | recording"),
    Broken("empty", text("empty", ""), "empty | format | an empty file | one of eit-rec"),
    Broken("words", text("a.txt", "dear diary\n"), "a.txt | format | 'dear diary' | one of eit"),
    Broken("bytes", text("a.bin", bytes(range(128, 256))), "a.bin | format | bytes | a .mat of it"),
    Broken("zeros", text("a.dat", bytes(400)), "a.dat | format | bytes | one of eit"),
    Broken("folder", lambda: check(HERE), ". | format | a folder | one of eit-rec"),
    Broken(
        "unknown format",
        lambda: check(sound.parquet(HERE), "--format", "csv"),
        "skin.parquet | format | 'csv' | one of eit-recording, matrix",
    ),
    Broken(
        "unknown order",
        lambda: check(sound.parquet(HERE), "--order", "random"),
        "skin.parquet | order | 'random' | one of",
    ),
    Broken(
        "a drive where the format has its own",
        lambda: check(sound.parquet(HERE), "--drive", "adjacent"),
        "skin.parquet | setting drive | 'adjacent' | states its own",
    ),
    Broken(
        "a part of what has none",
        lambda: ["compare", sound.parquet(HERE), HERE / "skin.parquet", "--part", "target"],
        "skin.parquet | part | 'target' | none: eit-recording has no parts",
    ),
    Broken(
        "wrong format",
        lambda: check(sound.pyeidors(HERE), "--format", "logger-csv"),
        "tank.csv | column contact_idx | nothing | eit_0",
    ),
]
OWN = [
    Broken(
        "cut",
        content(sound.parquet, lambda all: all[:-50]),
        "skin.parquet | file | cut off | whole",
    ),
    Broken(
        "cut in half",
        content(sound.parquet, lambda all: all[: len(all) // 2]),
        "skin.parquet | file | cut off | whole Parquet",
    ),
    Broken(
        "a head alone", text("a.parquet", b"PAR1"), "a.parquet | file | damaged | whole Parquet"
    ),
    Broken(
        "not Parquet",
        content(sound.parquet, lambda all: b"RAP1" + all[4:], "--format", "eit-recording"),
        "skin.parquet | file | at its beginning | PAR1",
    ),
    Broken(
        "a byte turned",
        content(sound.parquet, lambda all: all[:300] + bytes([all[300] ^ 255]) + all[301:]),
        "skin.parquet | file | damaged data | whole Parquet",
    ),
    Broken("no metadata", metadata(b""), "skin.parquet | schema key eit | no JSON | JSON"),
    Broken(
        "metadata that are no JSON",
        metadata(b"{'a': 1}"),
        "skin.parquet | schema key eit | no JSON | JSON",
    ),
    Broken(
        "metadata that are a list",
        metadata(b"[]"),
        "skin.parquet | schema key eit | list | a JSON object",
    ),
    Broken(
        "metadata in deep brackets",
        metadata(b"[" * 100000),
        "skin.parquet | schema key eit | no JSON | JSON",
    ),
    Broken(
        "another format",
        key("format", "csv"),
        'skin.parquet | key format | "csv" | "eit-recording"',
    ),
    Broken("another version", key("version", 2), "skin.parquet | key version | 2 | 1"),
    Broken("a version that is a text", key("version", "1"), 'skin.parquet | key version | "1" | 1'),
    Broken(
        "an unknown key",
        key("colour", "red"),
        "skin.parquet | key colour | an unknown key | one of",
    ),
    Broken("an unknown unit", key("unit", "mV"), 'skin.parquet | key unit | "mV" | "V" or "ohm"'),
    Broken("no source", key("source", ""), 'skin.parquet | key source | "" | where the recording'),
    Broken(
        "no time for a frame", key("frame_s", 0), "skin.parquet | key frame_s | 0 | more than 0 s"
    ),
    Broken(
        "frames longer than their steps",
        key("frame_s", 9.0),
        "skin.parquet | key frame_s | 9.0 | at most 0.5 s",
    ),
    Broken(
        "a key missing",
        metadata(lambda said: said.pop("voltage")),
        "skin.parquet | key voltage | nothing | it among",
    ),
    Broken(
        "no channels", key("channels", []), "skin.parquet | key channels | [] | a list of channels"
    ),
    Broken(
        "a channel of three",
        key("channels", 0, [0, 1, 2]),
        "skin.parquet | key channels, row 0 | [0, 1, 2] | source, sink",
    ),
    Broken(
        "half an electrode",
        key("channels", 3, 0, 0.5),
        "skin.parquet | key channels, row 3 | 0.5 | whole numbers",
    ),
    Broken(
        "an electrode that is not there",
        key("channels", 2, 3, 8),
        "skin.parquet | row 2 | electrode 8 of 8 | electrodes 0 to 7",
    ),
    Broken(
        "a pair with itself",
        key("channels", 1, [0, 0, 2, 3]),
        "skin.parquet | row 1 | a pair with itself | two electrodes",
    ),
    Broken(
        "one channel less",
        metadata(lambda said: said["channels"].pop()),
        "skin.parquet | column voltage_V | fixed_size_list | [39]",
    ),
    Broken(
        "an unknown key of the skin",
        key("skin", "size_mm", 3),
        "skin.parquet | skin.size_mm | an unknown key | one of",
    ),
    Broken(
        "a skin of no size",
        key("skin", "radius_mm", 0),
        "skin.parquet | skin.radius_mm | 0 | more than 0",
    ),
    Broken(
        "electrodes that overlap",
        key("skin", "electrode_width_mm", 70.0),
        "skin.parquet | skin.electrode_width_mm | two that overlap | an arc",
    ),
    Broken(
        "two electrodes at one angle",
        key("skin", "electrode_deg", [0.0, 360.0, 3, 4, 5, 6, 7, 8]),
        "skin.parquet | skin.electrode_deg | two equal | one an electrode",
    ),
    Broken(
        "a column missing",
        table(lambda found: found.drop_columns("depth_mm")),
        "skin.parquet | column depth_mm | nothing | it among",
    ),
    Broken(
        "a column too many",
        column("colour", ["red"] * 5),
        "skin.parquet | column colour | an unknown column | one of",
    ),
    Broken(
        "a column twice",
        table(lambda found: found.append_column("x_mm", found["x_mm"])),
        "skin.parquet | column x_mm | 2 of them | one",
    ),
    Broken(
        "whole numbers for seconds",
        column("time_s", [0, 1, 2, 3, 4]),
        "skin.parquet | column time_s | int64 | double",
    ),
    Broken(
        "numbers for touches",
        column("touch", [0, 0, 1, 1, 1]),
        "skin.parquet | column touch | int64 | bool",
    ),
    Broken(
        "words for forces",
        column("force_N", ["a"] * 5),
        "skin.parquet | column force_N | string | double",
    ),
    Broken(
        "readings in float32",
        column("voltage_V", [[0.5] * 40] * 5, pa.list_(pa.float32(), 40)),
        "skin.parquet | column voltage_V | float | double",
    ),
    Broken(
        "readings of another width",
        column("voltage_V", [[0.5] * 39] * 5, pa.list_(pa.float64(), 39)),
        "skin.parquet | column voltage_V | [39] | [40]",
    ),
    Broken(
        "readings in lists",
        column("voltage_V", [[0.5] * 40] * 5),
        "skin.parquet | column voltage_V | list | fixed_size_list",
    ),
    Broken(
        "a reading that is null",
        reading(1, None),
        "skin.parquet | column voltage_V, row 1 | null | NaN if lost",
    ),
    Broken(
        "a reading whose square is infinite",
        reading(3, 1e200),
        "skin.parquet | column voltage_V, row 3 | 1e+200 in channel 0 | finite, 1e+50 at most",
    ),
    Broken(
        "an infinite reading",
        reading(3, np.inf),
        "skin.parquet | column voltage_V, row 3 | inf in channel 0 | finite",
    ),
    Broken(
        "a magnitude below 0",
        key("voltage", "magnitude"),
        "skin.parquet | column voltage_V, row 0 | - | magnitudes, 0 or more",
    ),
    Broken(
        "every reading lost",
        column("voltage_V", [[np.nan] * 40] * 5, pa.list_(pa.float64(), 40)),
        "skin.parquet | column voltage_V | every channel lost | some",
    ),
    Broken(
        "no frame",
        table(lambda found: found.slice(0, 0)),
        "skin.parquet | rows | none | one a frame",
    ),
    Broken(
        "a frame skipped",
        column("frame", [0, 1, 3, 4, 5]),
        "skin.parquet | column frame, row 2 | 3 | 0, 1, 2",
    ),
    Broken(
        "a clock that goes back",
        column("time_s", [0.0, 0.5, 0.25, 1.5, 2.0]),
        "skin.parquet | column time_s, row 2 | 0.25 | more than 0.5",
    ),
    Broken(
        "a clock that stands still",
        column("time_s", [0.0, 0.5, 0.5, 1.5, 2.0]),
        "skin.parquet | column time_s, row 2 | 0.5 | strictly increasing",
    ),
    Broken(
        "a clock that begins before 0",
        column("time_s", [-1.0, 0.5, 1.0, 1.5, 2.0]),
        "skin.parquet | column time_s, row 0 | -1.0 | seconds",
    ),
    Broken(
        "a time that is null",
        column("time_s", [0.0, None, 1.0, 1.5, 2.0]),
        "skin.parquet | column time_s, row 1 | null | double",
    ),
    Broken(
        "nobody lets go",
        column("touch", [True] * 5),
        "skin.parquet | column x_mm, row 0 | nan | centre",
    ),
    Broken(
        "a touch at no place",
        column("x_mm", [None, None, None, 1.0, 1.0]),
        "skin.parquet | column x_mm, row 2 | nan | centre",
    ),
    Broken(
        "a place without touch",
        column("x_mm", [1.0] * 5),
        "skin.parquet | column x_mm, row 0 | 1.0 | null where touch",
    ),
    Broken(
        "a force below 0",
        column("force_N", [0.0, 0.0, -1.0, 3.0, 5.0]),
        "skin.parquet | column force_N, row 2 | -1.0 | 0 N or more",
    ),
    Broken(
        "an infinite force",
        column("force_N", [0.0, 0.0, np.inf, 3.0, 5.0]),
        "skin.parquet | column force_N, row 2 | inf | 0 N or more",
    ),
    Broken(
        "a force without touch",
        column("force_N", [2.0, 0.0, 1.0, 3.0, 5.0]),
        "skin.parquet | column force_N, row 0 | 2.0 | 0 where touch",
    ),
    Broken(
        "a probe of no size",
        column("probe_mm", [None, None, 0.0, 8.0, 8.0]),
        "skin.parquet | column probe_mm, row 2 | 0.0 | more than 0",
    ),
    Broken(
        "a depth below 0",
        column("depth_mm", [None, None, -1.0, None, None], pa.float64()),
        "skin.parquet | column depth_mm, row 2 | -1.0 | 0 mm or more",
    ),
    Broken(
        "below absolute zero",
        column("temperature_C", [-300.0] * 5),
        "skin.parquet | column temperature_C, row 0 | -300.0 | -273.15",
    ),
    Broken(
        "a touch beside the skin",
        column("x_mm", [None, None, 900.0, 900.0, 900.0]),
        "skin.parquet | columns x_mm, y_mm, row 2 | a touch 900 | must meet",
    ),
    Broken(
        "a touch of no press",
        column("contact", [None, None, None, 1, 1], pa.int64()),
        "skin.parquet | column contact, row 2 | nan | the press",
    ),
    Broken(
        "a press number of 1.5",
        column("contact", [None, None, 1.5, 1.5, 1.5]),
        "skin.parquet | column contact | double | int64",
    ),
]
MATRIX = [
    Broken(
        "no description",
        text("a.csv", f"{READINGS}\n"),
        "a.csv | description | no a.yaml | drive: adjacent",
    ),
    Broken(
        "no description, semicolons",
        text("a.csv", READINGS.replace(",", ";")),
        "a.csv | description | no a.yaml | drive: adjacent",
    ),
    Broken(
        "no description, UTF-16",
        text("a.csv", READINGS.encode("utf-16")),
        "a.csv | description | no a.yaml | electrodes: 8",
    ),
    Broken(
        "UTF-16 without its mark",
        text("a.csv", READINGS.encode("utf-16-le")),
        "a.csv | file | bytes of 0, as UTF-16 | UTF-8",
    ),
    Broken(
        "half of UTF-16",
        text("a.csv", READINGS.encode("utf-16")[:-1]),
        "a.csv | byte | cut off | UTF-16",
    ),
    Broken(
        "Latin-1 below the names",
        text("a.csv", f"{READINGS}\n# f\xfcr\n".encode("latin-1")),
        "a.csv | line 2 | byte 0xfc | UTF-8",
    ),
    Broken(
        "names alone",
        text("a.csv", ",".join(f"v{k}" for k in range(40))),
        "a.csv | file | no row below | a row a frame",
    ),
    Broken(
        "columns counted",
        text("a.csv", ",".join(map(str, range(40))) + f"\n{READINGS}\n"),
        "a.csv | line 1 | the columns' numbers | readings",
    ),
    Broken(
        "comments alone",
        text("a.csv", "# nothing\n\n"),
        "a.csv | file | no line of cells | a row a frame",
    ),
    Broken(
        "a word",
        lines(sound.matrix, put(1, 5, "open")),
        "frames.csv | line 2, column 5 | 'open' | a number",
    ),
    Broken(
        "infinity",
        lines(sound.matrix, put(2, 7, "inf")),
        "frames.csv | line 3, column 7 | 'inf' | a number",
    ),
    Broken(
        "1e999",
        lines(sound.matrix, put(2, 7, "1e999")),
        "frames.csv | line 3, column 7 | '1e999' | a number",
    ),
    Broken(
        "a cell too many",
        lines(sound.matrix, put(1, 5, "1,2")),
        "frames.csv | line 2 | 42 cells | 41",
    ),
    Broken(
        "a line cut",
        lines(sound.matrix, lambda all: [*all[:2], all[2][:60]]),
        "frames.csv | line 3 | cells | 41",
    ),
    Broken(
        "points and commas",
        lines(
            sound.matrix,
            lambda all: [
                all[0].replace(",", ";"),
                *(line.replace(",", ";").replace(".", ",") for line in all[1:]),
            ],
        ),
        "frames.csv | line 1 | both | decimal points or",
    ),
    Broken(
        "a clock that goes back in a matrix",
        lines(sound.matrix, put(2, 0, "0.1")),
        "frames.csv | time_s, row 2 | 0.1 | time goes on",
    ),
    Broken(
        "a time that was lost",
        lines(sound.matrix, put(1, 0, "")),
        "frames.csv | time_s | nan | time goes on",
    ),
    Broken(
        "a description in Latin-1",
        described("# f\xfcr\n".encode("latin-1")),
        "frames.yaml | line 1 | byte 0xfc | UTF-8",
    ),
    Broken(
        "a description in UTF-16",
        described("electrodes: 8\n".encode("utf-16")),
        "frames.yaml | line 1 | UTF-16 | UTF-8",
    ),
    Broken(
        "a description that is no YAML",
        described("electrodes: [8\n"),
        "frames.yaml | line 2, column 1 | the end of the file | ',' or ']'",
    ),
    Broken(
        "tabs in a description",
        described("skin:\n\tradius_mm: 3\n"),
        "frames.yaml | line 2, column 1 | a tab | spaces",
    ),
    Broken(
        "a description that is a list",
        described("- 8\n"),
        "frames.yaml | file | a list | a mapping",
    ),
    Broken(
        "an empty description",
        described("", "--format", "matrix"),
        "frames.yaml | file | nothing | a mapping",
    ),
    Broken(
        "a key twice",
        described_as("drive: adjacent", "drive: adjacent\ndrive: opposite"),
        "frames.yaml | drive | line 2 and again in line 3 | it once",
    ),
    Broken(
        "an unknown key of a description",
        described_as("labels:", "colour: red\nlabels:"),
        "frames.yaml | key colour | an unknown key | one of",
    ),
    Broken(
        "code in a description",
        described("electrodes: !!python/object/apply:os.system [touch ran]\n"),
        "frames.yaml | line 1, column 13 | could not determine a constructor | YAML",
    ),
    Broken(
        "an alias to nothing",
        described("electrodes: *eight\n"),
        "frames.yaml | line 1, column 13 | undefined alias | YAML",
    ),
    Broken(
        "electrodes in halves",
        described_as("electrodes: 8", "electrodes: 8.5"),
        "frames.yaml | key electrodes | 8.5 | a whole number",
    ),
    Broken(
        "three electrodes",
        described_as("electrodes: 8", "electrodes: 3"),
        "frames.yaml | key electrodes | 3 | 4 to 1024",
    ),
    Broken(
        "twenty thousand electrodes",
        described_as("electrodes: 8", "electrodes: 20000"),
        "frames.yaml | key electrodes | 20000 | 4 to 1024",
    ),
    Broken(
        "aliases that stand for 10^9 values",
        described_as("electrodes: 8", f"electrodes: {BOMB}"),
        "frames.yaml | line 1 | aliases that stand for more than | written out",
    ),
    Broken(
        "merged mappings that stand for 10^9 keys",
        described(MERGED_BOMB),
        "frames.yaml | line 7 | aliases that stand for more than | written out",
    ),
    Broken(
        "a list within itself",
        described("electrodes: &a [*a]\n"),
        "frames.yaml | line 1 | values within values without end | at most 100",
    ),
    Broken(
        "a tag that the value contradicts",
        described("electrodes: !!bool eight\n"),
        "frames.yaml | file | a value that its tag does not allow | YAML",
    ),
    Broken(
        "half a surrogate pair",
        described('source: "\\ud800"\n'),
        "frames.yaml | line 1 | half a character | text in UTF-8",
    ),
    Broken(
        "a key that a terminal obeys",
        stated('"\\e[2Jradius": 80.0\n'),
        "skin.yaml | \\x1b[2Jradius | an unknown key | one of",
    ),
    Broken(
        "another number of electrodes",
        described_as("electrodes: 8", "electrodes: 16"),
        "frames.csv | numbers a frame | 40 | 208",
    ),
    Broken(
        "an unknown drive",
        described_as("drive: adjacent", "drive: sideways"),
        "frames.csv | drive, measure | 'sideways' | adjacent, opposite or skip-<n>",
    ),
    Broken(
        "a drive of digits",
        described_as("drive: adjacent", "drive: skip-" + "9" * 5000),
        "frames.csv | drive, measure | 'skip-999 | adjacent, opposite or skip-<n>",
    ),
    Broken(
        "a drive that is a number",
        described_as("drive: adjacent", "drive: 1"),
        "frames.yaml | key drive | 1 | a word",
    ),
    Broken(
        "no measurement",
        described_as("measurement: adjacent\n", ""),
        "frames.csv | description | no frames.yaml | drive: adjacent",
    ),
    Broken(
        "a rate of 0",
        described_as("labels: {time_s: 0}", "rate_Hz: 0"),
        "frames.yaml | key rate_Hz | 0 | more than 0",
    ),
    Broken(
        "a rate beside times",
        described_as("labels:", "rate_Hz: 2.0\nlabels:"),
        "frames.yaml | key rate_Hz | it beside time_s | one of both",
    ),
    Broken(
        "a label of no column",
        described_as("time_s: 0", "time_s: 99"),
        "frames.yaml | key labels.time_s | 99 | 0 to 40",
    ),
    Broken(
        "an unknown label",
        described_as("time_s: 0", "when: 0"),
        "frames.yaml | key labels.when | an unknown label | time_s",
    ),
    Broken(
        "a file of labels that is not there",
        described_as("{time_s: 0}", "absent.csv"),
        "frames.yaml | key labels | no file 'absent.csv' | a file beside it",
    ),
    Broken(
        "a file of labels elsewhere",
        described_as("{time_s: 0}", "../labels.csv"),
        "frames.yaml | key labels | a path elsewhere, '../labels.csv' | a file beside it",
    ),
    Broken(
        "a file of labels that is any file of the machine",
        described_as("{time_s: 0}", "/etc/passwd"),
        "frames.yaml | key labels | a path elsewhere, '/etc/passwd' | a file beside it",
    ),
    Broken(
        "a skin that is a number",
        described_as("labels:", "skin: 80\nlabels:"),
        "frames.yaml | key skin | 80 | a mapping",
    ),
    Broken(
        "objects in an array",
        lambda: check(
            sound.numpy_matrix(HERE, lambda path, _: np.save(path, np.array([{}, 1], dtype=object)))
        ),
        "frames.npy | file | objects | arrays of numbers",
    ),
    Broken(
        "an array cut",
        content(sound.numpy_matrix, lambda all: all[:-9]),
        "frames.npy | file | damaged or cut | arrays of numbers",
    ),
    Broken(
        "an archive cut",
        content(sound.numpy_archive, lambda all: all[:-30]),
        "frames.npz | file | damaged or cut | arrays of numbers",
    ),
    Broken(
        "two arrays",
        lambda: check(
            sound.numpy_matrix(HERE, lambda path, one: np.savez(path, a=one, b=one), "frames.npz")
        ),
        "frames.npz | arrays | a (3, 41), b (3, 41) | --array NAME",
    ),
]
STATED = [
    Broken(
        "a skin's file that is not there",
        lambda: check(sound.parquet(HERE), "--skin", "absent.yaml"),
        "absent.yaml | file | No such file | a YAML file",
    ),
    Broken(
        "a skin's file that is a folder",
        lambda: check(sound.parquet(HERE), "--skin", "."),
        ". | file | Is a directory | a YAML file",
    ),
    Broken(
        "a skin in Latin-1",
        stated("radius_mm: 80.0 # f\xfcr\n".encode("latin-1")),
        "skin.yaml | line 1 | byte 0xfc | UTF-8",
    ),
    Broken(
        "a skin in UTF-16",
        stated("radius_mm: 80.0\n".encode("utf-16")),
        "skin.yaml | line 1 | UTF-16 | UTF-8",
    ),
    Broken(
        "a skin that is no YAML",
        stated("radius_mm: 80.0\nthickness_mm: {3\n"),
        "skin.yaml | line 3, column 1 | the end of the file | ',' or '}'",
    ),
    Broken(
        "a skin with a control character",
        stated(b"radius_mm: \x07\n"),
        "skin.yaml | file | special characters | YAML",
    ),
    Broken(
        "a key of the skin twice",
        stated("radius_mm: 80.0\nradius_mm: 81.0\n"),
        "skin.yaml | radius_mm | line 1 and again in line 2 | it once",
    ),
    Broken(
        "an unknown key of a statement",
        stated("radius: 80.0\n"),
        "skin.yaml | radius | an unknown key | radius_mm",
    ),
    Broken(
        "a radius in words",
        stated("radius_mm: eighty\n"),
        "skin.yaml | radius_mm | 'eighty' | a finite number",
    ),
    Broken("a radius of 0", stated("radius_mm: 0\n"), "skin.yaml | radius_mm | 0 | more than 0"),
    Broken(
        "a radius beyond numbers",
        stated("radius_mm: .inf\n"),
        "skin.yaml | radius_mm | inf | a finite number",
    ),
    Broken(
        "a radius of 5000 digits",
        stated(f"radius_mm: {'9' * 5000}\n"),
        "skin.yaml | line 1 | a number of 5000 characters | at most 3500",
    ),
    Broken(
        "a radius of 10^9 values",
        stated(f"radius_mm: {BOMB}\n"),
        "skin.yaml | line 1 | aliases that stand for more than | written out",
    ),
    Broken(
        "more than 4 MiB of YAML",
        stated("#" * (4 << 20) + "\nradius_mm: 80.0\n"),
        "skin.yaml | file | more than 4 MiB | at most 4 MiB",
    ),
    Broken(
        "angles of 2000 electrodes",
        stated(f"electrode_deg: {[0.1 * k for k in range(2000)]}\n"),
        "skin.yaml | electrode_deg | 2000 angles | at most 1024",
    ),
    Broken(
        "five angles for eight electrodes",
        stated("electrode_deg: [0.0, 45.0, 90.0, 135.0, 180.0]\n"),
        "skin.yaml | electrode_deg | 5 angles | 8 or more",
    ),
    Broken("an unknown unit stated", stated("unit: mV\n"), 'skin.yaml | unit | "mV" | "V" or'),
    Broken(
        "a skin smaller than its touches",
        stated("radius_mm: 2.0\n"),
        "skin.yaml | columns x_mm, y_mm, row 2 | a touch | must meet",
    ),
    Broken(
        "frames longer than their steps, stated",
        stated("frame_s: 3.0\n"),
        "skin.yaml | key frame_s | 3.0 | at most 0.5 s",
    ),
]
LOGGER = [
    Broken(
        "a contact of 1.5",
        lines(sound.logger, put(4, 0, "1.5")),
        "press.csv | line 5, column contact_idx | 1.5 | a whole number",
    ),
    Broken(
        "a contact of 1e30",
        lines(sound.logger, put(4, 0, "1e30")),
        "press.csv | line 5, column contact_idx | 1e+30 | a whole number",
    ),
    Broken(
        "a contact of -1",
        lines(sound.logger, put(4, 0, "-1")),
        "press.csv | line 5, column contact_idx | -1.0 | 0 to",
    ),
    Broken(
        "a contact in words",
        lines(sound.logger, put(4, 0, "three")),
        "press.csv | line 5, column contact_idx | 'three' | a number",
    ),
    Broken(
        "a contact that was lost",
        lines(sound.logger, put(4, 0, "")),
        "press.csv | column contact, row 3 | nan | the press",
    ),
    Broken(
        "a force in words",
        lines(sound.logger, put(4, 4, "strong")),
        "press.csv | line 5, column force_n | 'strong' | a number",
    ),
    Broken(
        "an infinite reading of the logger",
        lines(sound.logger, put(4, 10, "inf")),
        "press.csv | line 5, column eit_4 | 'inf' | a number",
    ),
    Broken(
        "a clock that goes back in the logger",
        lines(sound.logger, put(4, 5, "4000")),
        "press.csv | line 5, column t_eit | 4000 | each run of the logger by itself",
    ),
    Broken(
        "a live reading at a driven electrode",
        lines(sound.logger, put(4, 6, "0.3")),
        "press.csv | line 5, column eit_0 | 0.3 | touches drive 0",
    ),
    Broken(
        "a column of the logger missing",
        lines(sound.logger, swap("eit_255", "eit_256")),
        "press.csv | column eit_255 | nothing | eit_0",
    ),
    Broken(
        "a row of the logger too long",
        lines(sound.logger, put(4, 0, "3,3")),
        "press.csv | file | Expected 262 fields | the logger's CSV",
    ),
    Broken(
        "no row",
        lines(sound.logger, lambda all: all[:1]),
        "press.csv | rows | none of use | under 0.05 N",
    ),
    Broken(
        "nobody lets go of the logger",
        lines(sound.logger, lambda all: [all[0], *all[3:]]),
        "press.csv | column touch | true in all 3 | untouched frame",
    ),
    Broken(
        "a contact of 1.5 between semicolons",
        lines(
            sound.logger,
            lambda all: [
                line.replace(",", ";") for line in [*all[:4], "1.5" + all[4][1:], *all[5:]]
            ],
        ),
        "press.csv | line 5, column contact_idx | 1.5 | a whole number",
    ),
    Broken(
        "a contact of 1.5 in UTF-16",
        content(
            sound.logger,
            lambda all: (
                all.replace(b"\n3,0.02,-0.03,0.003", b"\n1.5,0.02,-0.03,0.003")
                .decode()
                .encode("utf-16")
            ),
        ),
        "press.csv | line 5, column contact_idx | 1.5 | a whole number",
    ),
    Broken(
        "Latin-1 in the logger",
        content(sound.logger, lambda all: all + b"\xfc\n"),
        "press.csv | line 7 | byte 0xfc | UTF-8",
    ),
]
MATLAB = [
    Broken(
        "a MATLAB file cut",
        content(sound.hydrogel, lambda all: all[:-40]),
        "ohmc.mat | file | damaged or cut | MATLAB 7.2",
    ),
    Broken(
        "a MATLAB file's head",
        content(sound.eidors, lambda all: all[:100]),
        "vh.mat | file | damaged or cut | MATLAB 7.2",
    ),
    Broken(
        "a type that there is not",
        content(sound.eidors, lambda all: all[:176] + b"\x08" + all[177:]),
        "vh.mat | file | damaged or cut | MATLAB 7.2",
    ),
    Broken(
        "MATLAB 7.3",
        text("a.mat", b"MATLAB 7.3 MAT-file".ljust(512) + b"\x89HDF\r\n\x1a\n" + bytes(90)),
        "a.mat | file | MATLAB 7.3 | save(name, ..., '-v7')",
    ),
    Broken(
        "MATLAB 7.3, by name",
        text("a.mat", b"MATLAB 7.3 MAT-file".ljust(600), "--format", "hydrogel-skin"),
        "a.mat | file | MATLAB 7.3 | save(name, ..., '-v7')",
    ),
    Broken(
        "HDF5", text("a.h5", b"\x89HDF\r\n\x1a\n" + bytes(90)), "a.h5 | file | HDF5 | MATLAB 7.2"
    ),
    Broken(
        "words named .mat",
        text("a.mat", "no MATLAB\n"),
        "a.mat | file | no MATLAB file | MATLAB 7.2",
    ),
    Broken(
        "no numbers",
        arrays(sound.eidors, name="skin"),
        "vh.mat | arrays | no array of numbers | 208 or 256",
    ),
    Broken(
        "207 rows",
        arrays(sound.eidors, vh=np.ones((207, 1))),
        "vh.mat | arrays | vh (207, 1) | 208 or 256",
    ),
    Broken(
        "two arrays that fit",
        arrays(sound.eidors, a=np.ones((208, 1)), b=np.ones((208, 2))),
        "vh.mat | arrays | a (208, 1), b (208, 2) | reference",
    ),
    Broken(
        "no positions",
        arrays(sound.hydrogel, positions=["a"]),
        "ohmc.mat | arrays | responseups | one array of",
    ),
    Broken(
        "positions in a plane",
        arrays(sound.hydrogel, positions=np.zeros((3, 2))),
        "ohmc.mat | positions | (3, 2) | x, y, depth",
    ),
    Broken(
        "a press less",
        arrays(sound.hydrogel, responsedowns=np.ones((2, 32))),
        "ohmc.mat | responses | (2, 32) pressed | alike",
    ),
    Broken(
        "30 channels",
        arrays(sound.hydrogel, responseups=np.ones((3, 30)), responsedowns=np.ones((3, 30))),
        "ohmc.mat | responses | 30 channels | n (n - 4)",
    ),
    Broken(
        "complex presses",
        arrays(sound.hydrogel, responseups=1j * np.ones((3, 32))),
        "ohmc.mat | responseups | complex numbers | real",
    ),
    Broken(
        "infinite presses",
        arrays(sound.hydrogel, responseups=np.full((3, 32), np.inf)),
        "ohmc.mat | column voltage_V, row 0 | inf | finite",
    ),
    Broken(
        "a smaller tank",
        arrays(sound.iirc, v_reference=np.ones((208, 1))),
        "iirc.mat | v_reference | (208, 1) | (256, 1)",
    ),
    Broken(
        "a frame of the rod that is not there",
        lambda: ["compare", sound.iirc(HERE), HERE / "iirc.mat", "--part", "v_rotate:7"],
        "iirc.mat | part | 'v_rotate:7' | v_rotate:0 to v_rotate:1",
    ),
    Broken(
        "voltages of other injections",
        arrays(sound.ktc, Uelref=np.ones((55, 1))),
        "ref.mat | Uelref | (55, 1) | 56 rows",
    ),
    Broken(
        "complex voltages",
        arrays(sound.ktc, Uelref=1j * np.ones((56, 1))),
        "ref.mat | Uelref | complex | real",
    ),
    Broken(
        "an injection at three electrodes",
        arrays(
            sound.ktc,
            Injref=np.eye(8) - np.roll(np.eye(8), 1, axis=0) + np.roll(np.eye(8), 2, axis=0),
        ),
        "ref.mat | Injref, column 0 | 3 electrodes | two",
    ),
    Broken(
        "electrodes that differ",
        arrays(sound.ktc, Mpat=np.eye(9)[:, :7]),
        "ref.mat | Mpat | 8 electrodes in Injref, 9 in Mpat | as many",
    ),
    Broken(
        "objects alone",
        lambda: check(sound.ktc(HERE, Uelref=["none"], Uel=np.ones((56, 1)))),
        "ref.mat | arrays | Uel alone | Uelref",
    ),
]
OTHERS = [
    Broken("a reading less", lines(sound.pyeidors, drop(3)), "tank.csv | rows | 207 | 208"),
    Broken(
        "a word in the tank",
        lines(sound.pyeidors, put(2, 1, "x")),
        "tank.csv | line 3, column 1 | 'x' | a number",
    ),
    Broken(
        "three numbers", lines(sound.pyeidors, put(2, 1, "1,2")), "tank.csv | line 3 | 5 cells | 4"
    ),
    Broken(
        "a reading less between semicolons",
        lines(sound.pyeidors, lambda all: [line.replace(",", ";") for line in all[1:]]),
        "tank.csv | rows | 207 | 208",
    ),
    Broken(
        "an unknown part",
        lambda: ["compare", sound.pyeidors(HERE), HERE / "tank.csv", "--part", "rod"],
        "tank.csv | part | 'rod' | target",
    ),
    Broken(
        "no partner",
        lambda: (
            path := sound.patterned(HERE),
            Path("out_a.csv").unlink(),
            check(path, "--format", "patterned-skin"),
        )[-1],
        "out_a.csv | file | no such file | the partner of inp_a.csv",
    ),
    Broken(
        "a press less in one file",
        lines(sound.patterned, drop(1)),
        "out_a.csv | rows | 3 | 2 as in inp_a.csv",
    ),
    Broken(
        "a word among changes",
        lines(sound.patterned, put(1, 4, "x")),
        "inp_a.csv | line 2, column 4 | 'x' | a number",
    ),
    Broken(
        "a name of neither",
        lambda: (
            sound.patterned(HERE).rename("a.csv"),
            check(Path("a.csv"), "--format", "patterned-skin"),
        )[-1],
        "a.csv | file name | a.csv | inp_<name>",
    ),
    Broken(
        "no #Start",
        lines(sound.lct, drop(2)),
        "water_1.txt | header | no line #Start | #Start before",
    ),
    Broken("a row less", lines(sound.lct, drop(9)), "water_1.txt | rows after #Start | 208 | 209"),
    Broken(
        "a word among rows",
        lines(sound.lct, put(9, 1, "x", " ")),
        "water_1.txt | line 10 | 'x' | numbers",
    ),
    Broken(
        "a date of another order",
        lines(sound.lct, swap("16/07", "07/16")),
        "water_1.txt | header, #Date | 07/16/2004 | dd/mm/yyyy",
    ),
    Broken(
        "two frames at one time",
        lines(sound.lct_folder, swap(":32", ":31")),
        "water | column time_s, row 1 | 0.0 | strictly increasing",
    ),
    Broken(
        "two states in a folder",
        lambda: (
            path := sound.lct_folder(HERE),
            (path / "water_2.txt").rename(path / "oil_2.txt"),
            check(path),
        )[-1],
        "water | folder | ['oil', 'water'] | repeats of one",
    ),
    Broken(
        "a line less",
        lines(sound.sciospec, drop(12)),
        "setup_00001.eit | lines | 15 lines | whole injections of 2",
    ),
    Broken(
        "a header of 99 lines",
        lines(sound.sciospec, put(0, 0, "99")),
        "setup_00001.eit | line 1 | '99' | how many lines",
    ),
    Broken(
        "a date in words",
        lines(sound.sciospec, swap("2023.01.05.", "today")),
        "setup_00001.eit | header, date | 'today | yyyy.mm.dd.",
    ),
    Broken(
        "an amplitude in words",
        lines(sound.sciospec, swap("0.001", "much")),
        "setup_00001.eit | header, amplitude | 'much' | a number",
    ),
    Broken(
        "no frequency",
        lines(sound.sciospec, put(7, 0, "0")),
        "setup_00001.eit | header, number of frequencies | 0 | 1 or more",
    ),
    Broken(
        "a drive with itself",
        lines(sound.sciospec, swap("1 2", "1 1")),
        "setup_00001.eit | injection 0 | [1, 1] | two electrodes",
    ),
    Broken(
        "an electrode beyond the ring",
        lines(sound.sciospec, swap("1 2", "1 99")),
        "setup_00001.eit | injections | electrode 99 | electrodes among",
    ),
    Broken(
        "a number less",
        lines(sound.sciospec, lambda all: [*all[:14], all[14].partition("\t")[2], *all[15:]]),
        "setup_00001.eit | line 15 | 15 numbers | 16",
    ),
    Broken(
        "a clock that goes back between frames",
        lines(sound.sciospec_folder, swap(":12.000", ":10.000")),
        "setup_00002.eit | header, date | 14:36:10 | one after that of setup_00001.eit",
    ),
    Broken(
        "another setup in a folder",
        lines(sound.sciospec_folder, swap("0.001", "0.002")),
        "setup_00002.eit | setup | another | that of setup_00001.eit",
    ),
    Broken(
        "another maker's .eit",
        text("a.eit", b"\x33\x00\x00\x00**FileVersion" + bytes(300)),
        "a.eit | line 1 | Draeger, Carefusion | header",
    ),
    Broken(
        "Latin-1 in a frame",
        content(sound.sciospec, lambda all: all + b"\xfc"),
        "setup_00001.eit | line 28 | byte 0xfc | UTF-8",
    ),
    Broken(
        "a breath cut",
        content(sound.draeger, lambda all: all[:-4]),
        "breath.get | file | 1660 bytes | whole frames",
    ),
    Broken("an empty .get", text("a.get", b""), "a.get | file | 0 bytes | whole frames"),
    Broken("text named .get", text("a.get", "a" * 1024), "a.get | file | text | float32"),
    Broken(
        "Draeger's text alone",
        text("a.get", b"---Draeger EIT-Software---\r\n"),
        "a.get | header | no end | two empty lines",
    ),
    Broken(
        "readings that are no numbers",
        content(sound.draeger, lambda all: b"\x00\x00\x80\x7f" + all[4:]),
        "breath.get | column voltage_V, row 0 | inf | finite",
    ),
]
ROWS = [*ANY_FILE, *OWN, *MATRIX, *STATED, *LOGGER, *MATLAB, *OTHERS]


@pytest.mark.parametrize("broken", ROWS, ids=lambda row: row.name)
def test_a_broken_recording_is_refused_in_one_line(broken, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    broken.refuse(lambda: capsys.readouterr())


def test_no_row_stands_twice():
    assert len({row.name for row in ROWS}) == len(ROWS)
