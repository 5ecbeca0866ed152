"""What is said of a plain matrix in NAME.yaml beside it, and what to write where nothing is."""

from pathlib import Path

from eitskin import yaml_file
from eitskin.data.importers import bare_vectors
from eitskin.data.recording import check_reading
from eitskin.errors import InputError
from eitskin.physics.skin import is_number

PROTOCOL = ("electrodes", "drive", "measurement")
TELLING = (*PROTOCOL, "order", "labels")  # of which a YAML file has one if it describes a matrix
AS_CHOSEN = ("voltage", "unit", "values", "position_frame", "clock")
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


def undescribed(path: Path, shape: tuple[int, int]) -> InputError:
    """What to write beside a matrix of `shape`, frames x readings, as one line of YAML."""
    rows, width = shape
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


def example(path: Path, width: int) -> str | None:
    """A description of frames of as many numbers as a common protocol has; None for others."""
    for drive in ("adjacent", "opposite"):
        try:
            layout = bare_vectors.stepped(path, width, drive, "adjacent")
        except InputError:
            continue
        return f"{{electrodes: {layout.n_electrodes}, drive: {drive}, measurement: adjacent}}"
    return None
