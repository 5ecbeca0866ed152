"""The description of a plain matrix in NAME.yaml beside it, and proposals where it is missing."""

import json
import re
from collections import Counter
from collections.abc import Sequence
from itertools import takewhile
from pathlib import Path

from eitskin import yaml_file
from eitskin.data.importers import named_columns
from eitskin.data.importers.protocol_search import common_protocol
from eitskin.data.recording import NOTE, check_reading
from eitskin.errors import InputError
from eitskin.physics.skin import MAX_ELECTRODES, is_number
from eitskin.yaml_number import hint

PROTOCOL = ("electrodes", "drive", "measurement")
DESCRIBING_KEYS = (
    *PROTOCOL,
    "order",
    "labels",
)  # of which a YAML file has one if it describes a matrix
CHOICE_KEYS = ("voltage", "unit", "values", "position_frame", "clock")
PLACED = ("x_mm", "y_mm", "force_N", "probe_mm", "depth_mm")
LABELS = ("time_s", "touch", *PLACED, "contact", "session", "temperature_C")
USUAL_NAMES = {  # names of columns that people give to labels
    "x_mm": "p_?x|x_?pos(ition)?|pos(ition)?_?x|tip_?x|x",
    "y_mm": "p_?y|y_?pos(ition)?|pos(ition)?_?y|tip_?y|y",
    "probe_mm": "(probe|tip|indenter)(_?(diameter|d|size))?|diameter",
    "depth_mm": "p_?z|z|indentation|z_?pos(ition)?",
    "force_N": "f_?z|f|load(_?cell)?|newtons?",
    "time_s": "t|seconds?|stamp|timestamp|elapsed",
}
WITH_UNIT = USUAL_NAMES | {"depth_mm": "indentation"}  # z may be a robot's height
LABEL_UNITS = {  # of a label's column, with what one of them is in the label's own unit
    "mm": {"mm": 1.0, "cm": 10.0, "m": 1e3, "um": 1e-3, "µm": 1e-3, "μm": 1e-3},
    "N": {"N": 1.0, "mN": 1e-3, "kN": 1e3},
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0},
}
NAME_IN_UNIT = re.compile(r"(?P<stem>.+?)[ _]*[ _([](?P<unit>[A-Za-zµμΩ]+)[)\]]?")
MIN_COMMON_LETTERS = (
    3  # letters that a column's name and its label's have in common, or the whole name
)
UNITS = {  # of tables, with the unit of recordings and what one of them is in it
    "V": ("V", 1.0),
    "ohm": ("ohm", 1.0),
    "Ω": ("ohm", 1.0),
    "mV": ("V", 1e-3),
    "uV": ("V", 1e-6),
    "µV": ("V", 1e-6),
    "μV": ("V", 1e-6),  # the Greek letter
    "mohm": ("ohm", 1e-3),
    "kohm": ("ohm", 1e3),
}
KEYS = (*PROTOCOL, "order", *CHOICE_KEYS, "rate_Hz", "frame_s", "skin", "labels", "source")


def description_path(path: Path) -> Path:
    """Where the description of a matrix lies."""
    return path.with_suffix(".yaml")


def labels_path(path: Path, labels: str) -> Path | None:
    """The file of labels that a description names: in the matrix's folder or below, else None.
    Whoever describes a matrix has no say in what else is read and quoted."""
    inside = Path(labels)
    return None if inside.is_absolute() or ".." in inside.parts else path.parent / inside


def read_mapping(path: Path) -> dict:
    """The mapping in the file beside a matrix; raises InputError for another content."""
    return yaml_file.read(description_path(path))


def read_description(path: Path) -> dict:
    """The description beside a matrix; raises InputError for unknown keys and invalid values."""
    file, description = description_path(path), read_mapping(path)
    for key in description:
        if key not in KEYS:
            raise InputError(file, f"key {key}", "an unknown key", f"one of {', '.join(KEYS)}")
    for key in ("drive", "order", "source"):
        if key in description and not isinstance(description[key], str):
            raise InputError(file, f"key {key}", repr(description[key]), "a word")
    description |= in_recordings_unit(description.get("unit"))
    if description.get("values") == "normalised":
        expected = (
            "difference: multiply each channel by the size of its untouched reading, which no "
            "simulation can replace"
        )
        raise InputError(file, "key values", "normalised", expected)
    check_reading(
        {key: description[key] for key in (*CHOICE_KEYS, "frame_s") if key in description}, file
    )
    n_electrodes = description.get("electrodes")
    if "electrodes" in description and (
        type(n_electrodes) is not int or not 4 <= n_electrodes <= MAX_ELECTRODES
    ):
        expected = f"a whole number, 4 to {MAX_ELECTRODES}"
        raise InputError(file, "key electrodes", repr(n_electrodes), expected)
    if "rate_Hz" in description and not (
        is_number(description["rate_Hz"]) and description["rate_Hz"] > 0
    ):
        raise InputError(
            file,
            "key rate_Hz",
            repr(description["rate_Hz"]),
            f"frames a second, more than 0{hint(description['rate_Hz'])}",
        )
    if not isinstance(description.get("skin", {}), dict):
        raise InputError(file, "key skin", repr(description["skin"]), "a mapping")
    return description


def in_recordings_unit(unit: object) -> dict:
    """The keys `unit` and `unit_size` that a table's unit means; none of a unit of no table."""
    meaning = UNITS.get(unit) if isinstance(unit, str) else None
    return {} if meaning is None else dict(zip(("unit", "unit_size"), meaning, strict=True))


def missing_description(
    path: Path, shape: tuple[int, int], names: Sequence[str] = ()
) -> InputError:
    """The refusal of a matrix without description, with a proposal in one line of YAML.

    `shape` is frames x readings; `names` are the columns', if any.
    """
    rows, width = shape
    unnamed = missing_labels(path, names)
    if unnamed is not None:
        return unnamed
    violation = f"no {description_path(path).name} that says what its {width} columns read"
    example_text = example(width)
    if example_text is not None:
        expected = (
            "it beside the file (or --format matrix with --drive and --measure), for example "
            f"{example_text}"
        )
        return InputError(path, "description", violation, expected)
    if not names and example(rows) is not None:
        expected = f"a frame a row; perhaps turned: its {rows} rows may be readings"
        return InputError(path, "matrix", f"{rows} rows of {width} numbers", expected)
    size = round((1 + (1 + 8 * width) ** 0.5) / 2)
    expected = (
        "it beside the file: {electrodes: N, measurement: [[source, sink, plus, minus], ...]}, "
        f"{width} channels in the columns' order"
    )
    if size * (size - 1) == 2 * width:
        expected += f" (one for every two of {size} electrodes is no four-electrode reading)"
    return InputError(path, "description", violation, expected)


def missing_labels(path: Path, names: Sequence[str]) -> InputError | None:
    """The refusal of a matrix with unlabelled columns beside its readings, with a proposal.

    Columns are no readings where their names differ, digits aside, from most names, and the
    remaining ones are as many as a common protocol's readings; else None.
    """
    name_stems = [re.sub(r"\d+", "", name) for name in names]
    usual_stem = Counter(name_stems).most_common(1)[0][0] if name_stems else ""
    odd_names = [name for name, kind in zip(names, name_stems, strict=True) if kind != usual_stem]
    example_text = example(len(names) - len(odd_names)) if odd_names else None
    usual_names = [name for name in names if name not in odd_names]
    if odd_names and named_columns.channels(usual_names) is not None:
        example_text = "{}"  # the names tell the channels
    if example_text is None:
        return None
    labels: dict[str, str] = {}
    for name in odd_names:
        labels[_probable_label(name, [label for label in LABELS if label not in labels])] = name
    guess = ", ".join(f"{_plain(label)}: {_plain(name)}" for label, name in labels.items())
    keys = f"{example_text[1:-1]}, " if example_text != "{}" else ""
    count = len(names) - len(odd_names)
    columns = f"columns {', '.join(odd_names)}"
    violation = f"{columns} beside {count} readings, and nothing that says what they are"
    expected = (
        f"their labels in {description_path(path).name}, in the units of the labels' names; "
        f"guessed, to be corrected: {{{keys}labels: {{{guess}}}}}"
    )
    return InputError(path, "columns", violation, expected)


def _plain(name: str) -> str:
    """A name as YAML reads it within braces."""
    return name if re.fullmatch(r"\w[\w ().?/-]*", name) else json.dumps(name, ensure_ascii=False)


def label_in_unit(name: str) -> tuple[str, float] | None:
    """The label that a column's name with a unit means, and what one of that unit is in the
    label's: `px [cm]` is x_mm, 10. None for a name that says no unit, or no label."""
    match = NAME_IN_UNIT.fullmatch(name.strip())
    if match is None:
        return None
    for label, names in WITH_UNIT.items():
        stem, _, unit = label.rpartition("_")
        factor = LABEL_UNITS[unit].get(match["unit"])
        if factor and re.fullmatch(f"{names}|{stem}", match["stem"], re.IGNORECASE):
            return label, factor
    return None


def label_of_unit(name: str) -> tuple[str, float] | None:
    """The label that only the unit of a column's name tells, seconds or newtons in brackets or
    alone, and what one of that unit is in the label's: `Kraft (mN)` is force_N, 0.001."""
    match = re.fullmatch(
        r"(?P<stem>.*?) *[([](?P<unit>[^()[\]]+)[)\]]|(?P<alone>\w+)", name.strip()
    )
    if match is None:
        return None
    unit = match["unit"] or match["alone"]
    for label in ("time_s", "force_N"):
        factor = LABEL_UNITS[label.rpartition("_")[2]].get(unit)
        if factor and match["alone"] != "min":  # the least value, as likely
            return label, factor
    return None


def unit_of(names: Sequence[str]) -> str | None:
    """The unit that all names of readings end with, of those that tables have."""
    matches = [NAME_IN_UNIT.fullmatch(name.strip()) for name in names]
    units = {match["unit"] if match else "" for match in matches}
    unit = units.pop() if len(units) == 1 else None
    return unit if unit in UNITS else None


def _probable_label(name: str, free_labels: list[str]) -> str:
    """The label that people mean by a column's name, else the one that begins as it does, else a
    note. Another length in mm is the probe's diameter."""
    for label in free_labels:
        if re.fullmatch(USUAL_NAMES.get(label, "(?!)"), name, re.IGNORECASE):
            return label
    match = NAME_IN_UNIT.fullmatch(name)
    if match and match["unit"] == "mm" and "probe_mm" in free_labels:
        return "probe_mm"
    nearest = max(free_labels, key=lambda label: _common_prefix_length(label, name), default="")
    is_near = _common_prefix_length(nearest, name) >= min(MIN_COMMON_LETTERS, len(name))
    return nearest if is_near else f"{NOTE}{name}"


def _common_prefix_length(label: str, name: str) -> int:
    """Number of letters with which both begin."""
    return sum(
        1
        for _ in takewhile(
            lambda letters: letters[0] == letters[1], zip(label, name.lower(), strict=False)
        )
    )


def example(width: int) -> str | None:
    """A description of frames of `width` readings by a common protocol; None where none fits."""
    protocol = common_protocol(width)
    if protocol is None:
        return None
    keys = ", ".join(f"{key}: {value}" for key, value in protocol.description.items())
    return f"{{{keys}}}"
