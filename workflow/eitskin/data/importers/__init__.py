"""Other laboratories' files as recordings; one module for each format.

A format is a module of its name with `matches(path) -> bool`, by content, `load(path)`, which
returns a Recording, and, where that reads more than one file, `files(path) -> list[Path]`; FORMATS
lists all, and a module is imported when it is needed. `LEFT_OPEN` names the settings that its files
do not state and `load` takes (`order`, `drive`, `measure`, `array`, `frequency`); `PARTS` names
frames that are left out unless one is passed to `load` as `part`, of several frames with a number,
`NAME:3`; `accepts(path) -> bool` says of a file that no format matches whether it is one all the
same, or raises InputError that says what it lacks.
"""

from collections.abc import Iterable
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from types import ModuleType

from eitskin.data import recording
from eitskin.data.channel_order import in_order
from eitskin.data.importers.tables import first_line
from eitskin.data.recording import Recording
from eitskin.errors import InputError, imported, refused

OWN_FORMAT = "eit-recording"
SHOWN_BYTES = 32  # of an unknown file, in its refusal: within one line
REQUIRED_FUNCTIONS = "matches", "load"
FOREIGN = (  # mark at the beginning, ending of the name, what it is, what to bring instead
    (b"\xd0\xcf\x11\xe0", None, "an Excel workbook of before 2007", "the sheet saved as CSV"),
    (b"PK\x03\x04", ".ods", "an OpenDocument sheet", "the sheet saved as CSV"),
    (b"PK\x03\x04", None, "a zip archive", "the files in it"),
    (b"\x1f\x8b", None, "a file packed by gzip", "it unpacked"),
    (
        None,
        ".bin",
        "bytes, as Draeger's PulmoVista writes a .bin, which is not read",
        "a .mat of it (EIDORS: eidors_readdata, save -v7), or frames x channels as CSV or .npy",
    ),
)
FORMATS = (  # in the order in which a file's content is tried
    "matrix",  # by a description beside the file, whatever that is
    "logger-csv",
    "hydrogel-skin",
    "iirc-tank",
    "ktc-mat",
    "eidors-mat",  # any other of MATLAB
    "pyeidors-tank",
    "lct-tank",
    "patterned-skin",
    "sciospec-eit",
    "draeger-get",
)


def format_names() -> list[str]:
    """Names of all formats, the recording format first."""
    return [OWN_FORMAT, *FORMATS]


def modules() -> list[str]:
    """The modules of all formats."""
    return [_module(name) for name in FORMATS]


def _module(format: str) -> str:
    return f"{__name__}.{format.replace('-', '_')}"


def _format_module(format: str) -> ModuleType:
    """The module of a format; raises InputError where it is broken or lacks a function."""
    module = imported(_module(format))
    missing_functions = [name for name in REQUIRED_FUNCTIONS if not hasattr(module, name)]
    if missing_functions:
        missing_text = f"no {' and no '.join(missing_functions)}"
        raise InputError(module.__name__, "functions", missing_text, ", ".join(REQUIRED_FUNCTIONS))
    return module


def _unlisted() -> list[str]:
    """Modules with a format's functions that FORMATS does not list."""
    listed_names = {_module(format) for format in FORMATS}
    candidates = [f"{__name__}.{module_info.name}" for module_info in iter_modules(__path__)]
    modules = [imported(name) for name in candidates if name not in listed_names]
    return [
        module.__name__
        for module in modules
        if all(hasattr(module, needed) for needed in REQUIRED_FUNCTIONS)
    ]


def files(path: str | Path, format: str | None = None) -> list[Path]:
    """The files that `load` reads: the path, which may be a folder, then files inside or beside it.

    The path alone where it cannot be read yet.
    """
    path = Path(path)
    module = _reader(path, format)
    further_files = module.files(path) if module is not None and hasattr(module, "files") else []
    return list(dict.fromkeys([path, *further_files]))


def readers(path: str | Path, format: str | None = None) -> list[str]:
    """The modules by which `load` reads a path: one, or none for the recording format.

    None for a path that cannot be read yet: the workflow writes recordings in that format.
    """
    module = _reader(Path(path), format)
    return [] if module is None else [module.__name__]


def reader_files(modules: Iterable[str]) -> list[Path]:
    """The files of the project, other than modules, that `readers` read themselves."""
    return [file for name in modules for file in getattr(import_module(name), "FILES", ())]


def _reader(path: Path, format: str | None) -> ModuleType | None:
    """The module of a path's format; None for the recording format and where there is none."""
    try:
        format = format or _detect(path)
        return None if format == OWN_FORMAT else _format_module(format)
    except (InputError, OSError, ValueError):
        return None


def load(
    path: str | Path,
    format: str | None = None,
    order: str | None = None,
    drive: str | None = None,
    measure: str | None = None,
    part: str | None = None,
    array: str | None = None,
    frequency: float | None = None,
) -> Recording:
    """Read a recording of any known format, recognised by its content unless `format` names it.

    `order` is the readings' order, one of `channel_order.ORDERS`; `drive` and `measure` name the
    pairs where the format's files do not; `array` names one of several in a file, `frequency` one
    in Hz; `part` selects frames that the format leaves out, read as untouched. Raises InputError
    for a missing file, an unknown format, a file that breaks its format, a setting that the format
    states itself, and an unknown part.
    """
    path = Path(path)
    if format is not None and format not in format_names():
        raise InputError(path, "format", repr(format), f"one of {', '.join(format_names())}")
    if not path.exists():
        raise InputError(path, "file", "no such file", f"a recording: {', '.join(format_names())}")
    if format is None:
        format = _detect(path)
    module = None if format == OWN_FORMAT else _format_module(format)
    settings = {
        "order": order,
        "drive": drive,
        "measure": measure,
        "array": array,
        "frequency": frequency,
    }
    caller_settings = {key: value for key, value in settings.items() if value is not None}
    format_settings = {
        key: caller_settings[key]
        for key in getattr(module, "LEFT_OPEN", ())
        if key in caller_settings
    }
    if part is not None:
        parts = getattr(module, "PARTS", ())
        if part.partition(":")[0] not in parts:
            expected = f"one of {', '.join(parts)}" if parts else f"none: {format} has no parts"
            raise InputError(path, "part", repr(part), expected)
        format_settings["part"] = part
    for key in (key for key in caller_settings if key not in format_settings and key != "order"):
        expected = f"none: the format {format} states its own"
        raise InputError(path, f"setting {key}", repr(caller_settings[key]), expected)
    imported_recording = (
        recording.read(path) if module is None else _read(path, module, format, format_settings)
    )
    if order is not None and "order" not in format_settings:
        imported_recording = _in_order(path, imported_recording, order)
    if caller_settings:
        settings_text = ", ".join(f"{key} {value}" for key, value in caller_settings.items())
        imported_recording.metadata["source"] += f" (as told: {settings_text})"
    return imported_recording


def _read(
    path: Path, module: ModuleType, format: str, format_settings: dict[str, str | float]
) -> Recording:
    try:
        imported_recording = module.load(path, **format_settings)
    except OSError as error:
        file = error.filename or path
        raise refused(error, file, expected=f"one of the format {format}") from error
    except UnicodeDecodeError as error:
        byte = f"byte 0x{error.object[error.start]:02x}, no {error.encoding}"
        raise InputError(path, "file", byte, f"text of the format {format}") from error
    recording.validate(imported_recording, path)
    return imported_recording


def _in_order(path: Path, imported_recording: Recording, order: str) -> Recording:
    """The recording with its channel table in another order; the readings stay as they are."""
    channels = in_order(path, order, imported_recording.channels, imported_recording.n_electrodes)
    return replace(
        imported_recording, metadata=imported_recording.metadata | {"channels": channels.tolist()}
    )


def _detect(path: Path) -> str:
    if path.is_file():
        with path.open("rb") as stream:
            if stream.read(4) == b"PAR1":
                return OWN_FORMAT
    for name in FORMATS:
        if _matches(name, path):
            return name
    for name in FORMATS:
        module = _format_module(name)
        if hasattr(module, "accepts") and module.accepts(path):
            return name
    for mark, suffix, content, expected in FOREIGN:
        if path.is_file() and _is_foreign(path, mark, suffix):
            raise InputError(path, "format", content, expected)
    unlisted = "".join(f"; {name} has no line in FORMATS" for name in _unlisted())
    raise InputError(
        path, "format", _content_text(path), f"one of {', '.join(format_names())}{unlisted}"
    )


def _matches(format: str, path: Path) -> bool:
    try:
        return _format_module(format).matches(path)
    except UnicodeDecodeError:  # whoever takes every file for text
        return False


def _is_foreign(path: Path, mark: bytes | None, suffix: str | None) -> bool:
    """Whether a file is named so and begins with `mark`, or without one is no text."""
    with path.open("rb") as stream:
        head = stream.read(SHOWN_BYTES)
    is_named = suffix is None or path.suffix.lower() == suffix
    line = first_line(path)
    is_text = bool(line) and line.isprintable()
    return is_named and (head.startswith(mark) if mark else not is_text)


def _content_text(path: Path) -> str:
    """The content of a path of no known format, in words."""
    if not path.is_file():
        return "a folder with no files of a known format" if path.is_dir() else "no file"
    with path.open("rb") as stream:
        leading_bytes = stream.read(SHOWN_BYTES)
    if not leading_bytes:
        return "an empty file"
    line = first_line(path)
    if line.isprintable() and line:
        return f"text that begins {line[:SHOWN_BYTES]!r}"
    return f"bytes that begin {leading_bytes!r}"
