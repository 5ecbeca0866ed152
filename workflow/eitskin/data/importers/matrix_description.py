"""What is said of a plain matrix in NAME.yaml beside it, and what to write where nothing is."""

import re
from collections import Counter
from collections.abc import Sequence
from itertools import takewhile
from pathlib import Path

from eitskin import yaml_file
from eitskin.data.importers import bare_vectors
from eitskin.data.recording import NOTE, check_reading
from eitskin.errors import InputError
from eitskin.physics.skin import is_number

PROTOCOL = ("electrodes", "drive", "measurement")
TELLING = (*PROTOCOL, "order", "labels")  # of which a YAML file has one if it describes a matrix
AS_CHOSEN = ("voltage", "unit", "values", "position_frame", "clock")
PLACED = ("x_mm", "y_mm", "force_N", "probe_mm", "depth_mm")
LABELS = ("time_s", "touch", *PLACED, "contact", "session", "temperature_C")
ALIKE = 3  # letters that a column's name and its label's have in common, or the whole name
KEYS = (*PROTOCOL, "order", *AS_CHOSEN, "rate_Hz", "frame_s", "skin", "labels", "source")


def beside(path: Path) -> Path:
    """Where the description of a matrix stands."""
    return path.with_suffix(".yaml")


def mapping(path: Path) -> dict:
    """What stands beside a matrix; raises InputError for what is no mapping."""
    return yaml_file.read(beside(path))


def described(path: Path) -> dict:
    """The description beside a matrix; raises InputError for what is no mapping, for keys that are
    not known and for values of another kind."""
    file, said = beside(path), mapping(path)
    for key in said:
        if key not in KEYS:
            raise InputError(file, f"key {key}", "an unknown key", f"one of {', '.join(KEYS)}")
    for key in ("drive", "order", "source"):
        if key in said and not isinstance(said[key], str):
            raise InputError(file, f"key {key}", repr(said[key]), "a word")
    check_reading({key: said[key] for key in (*AS_CHOSEN, "frame_s") if key in said}, file)
    number = said.get("electrodes")
    if "electrodes" in said and (type(number) is not int or number < 4):
        raise InputError(file, "key electrodes", repr(number), "a whole number, 4 or more")
    if "rate_Hz" in said and not (is_number(said["rate_Hz"]) and said["rate_Hz"] > 0):
        raise InputError(file, "key rate_Hz", repr(said["rate_Hz"]), "frames a second, more than 0")
    if not isinstance(said.get("skin", {}), dict):
        raise InputError(file, "key skin", repr(said["skin"]), "a mapping")
    return said


def undescribed(path: Path, shape: tuple[int, int], names: Sequence[str] = ()) -> InputError:
    """What to write beside a matrix of `shape`, frames x readings, as one line of YAML; names: of
    its columns, where it has them."""
    rows, width = shape
    unnamed = unlabelled(path, names)
    if unnamed is not None:
        return unnamed
    found = f"no {beside(path).name} that says what its {width} columns read"
    copied = example(path, width)
    if copied is not None:
        expected = (
            "it beside the file (or --format matrix with --drive and --measure), for example "
            f"{copied}"
        )
        return InputError(path, "description", found, expected)
    if example(path, rows) is not None:
        expected = f"a frame a row: its {rows} rows look like readings, its columns like frames"
        return InputError(path, "matrix", f"{rows} rows of {width} numbers", expected)
    size = round((1 + (1 + 8 * width) ** 0.5) / 2)
    expected = (
        "it beside the file: {electrodes: N, measurement: [[source, sink, plus, minus], ...]}, "
        f"{width} channels in the columns' order"
    )
    if size * (size - 1) == 2 * width:
        expected += f" (one for every two of {size} electrodes is no four-electrode reading)"
    return InputError(path, "description", found, expected)


def unlabelled(path: Path, names: Sequence[str]) -> InputError | None:
    """Which labels to name, where some columns' names are unlike the others' but for digits, and
    the others are as many as a common protocol has readings; None elsewhere."""
    kinds = [re.sub(r"\d+", "", name) for name in names]
    usual = Counter(kinds).most_common(1)[0][0] if kinds else ""
    odd = [name for name, kind in zip(names, kinds, strict=True) if kind != usual]
    described = example(path, len(names) - len(odd)) if odd else None
    if described is None:
        return None
    labels: dict[str, str] = {}
    for name in odd:
        free = [label for label in LABELS if label not in labels]
        nearest = max(free, key=lambda label: _alike(label, name), default="")
        enough = _alike(nearest, name) >= min(ALIKE, len(name))
        labels[nearest if enough else f"{NOTE}{name}"] = name
    told = ", ".join(f"{label}: {name}" for label, name in labels.items())
    count = len(names) - len(odd)
    found = f"columns {', '.join(odd)} beside {count} readings, and nothing that says what they are"
    expected = (
        f"their labels in {beside(path).name}, in the units of the labels' names; guessed, to be "
        f"corrected: {described[:-1]}, labels: {{{told}}}}}"
    )
    return InputError(path, "columns", found, expected)


def _alike(label: str, name: str) -> int:
    """Letters with which both begin."""
    return sum(
        1 for _ in takewhile(lambda two: two[0] == two[1], zip(label, name.lower(), strict=False))
    )


def example(path: Path, width: int) -> str | None:
    """A description of frames of as many numbers as a common protocol has; None for others."""
    for drive in ("adjacent", "opposite"):
        try:
            layout = bare_vectors.stepped(path, width, drive, "adjacent")
        except InputError:
            continue
        return f"{{electrodes: {layout.n_electrodes}, drive: {drive}, measurement: adjacent}}"
    return None
