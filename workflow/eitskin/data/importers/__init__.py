"""Other laboratories' files as recordings; one module a format.

A format is a module of its name with `matches(path) -> bool`, by content, `load(path) -> Recording`
and, where that reads more than one file, `files(path) -> list[Path]`; FORMATS has a line for each,
which is loaded when it is asked for.
`LEFT_OPEN` names the settings that its files do not state and `load` takes (`order`, `drive`,
`measure`); `PARTS` the names of frames that it leaves out unless `load` is given one as `part`, of
several frames with a number, `NAME:3`; `refusal(path) -> InputError | None` says what a file lacks
to be one of the format.
"""

from dataclasses import replace
from pathlib import Path
from pkgutil import iter_modules
from types import ModuleType

from eitskin.data import recording
from eitskin.data.channel_order import in_order
from eitskin.data.importers.tables import first_line
from eitskin.data.recording import Recording
from eitskin.errors import InputError, imported, refused

OWN_FORMAT = "eit-recording"
HEAD = 32  # of an unknown file, that its refusal repeats
NEEDED = "matches", "load"
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


def known() -> list[str]:
    """Names of the formats, our own first."""
    return [OWN_FORMAT, *FORMATS]


def modules() -> list[str]:
    """The modules of all formats."""
    return [_module(name) for name in FORMATS]


def _module(format: str) -> str:
    return f"{__name__}.{format.replace('-', '_')}"


def _loaded(format: str) -> ModuleType:
    """The module of a format; InputError where it cannot be imported or lacks a function."""
    module = imported(_module(format))
    missing = [one for one in NEEDED if not hasattr(module, one)]
    if missing:
        without = f"no {' and no '.join(missing)}"
        raise InputError(module.__name__, "functions", without, ", ".join(NEEDED))
    return module


def _unlisted() -> list[str]:
    """Modules that could be formats, and have no line in FORMATS."""
    names = {_module(format) for format in FORMATS}
    others = [f"{__name__}.{found.name}" for found in iter_modules(__path__)]
    modules = [imported(name) for name in others if name not in names]
    return [one.__name__ for one in modules if all(hasattr(one, needed) for needed in NEEDED)]


def files(path: str | Path, format: str | None = None) -> list[Path]:
    """What `load` reads: the path itself, which may be a folder, then files inside or beside it.
    Of a path that nothing can be read from yet, itself alone."""
    path = Path(path)
    module = _reader(path, format)
    more = module.files(path) if module is not None and hasattr(module, "files") else []
    return list(dict.fromkeys([path, *more]))


def readers(path: str | Path, format: str | None = None) -> list[str]:
    """The modules by which `load` reads a path: one; none of our own format, as of a path that
    nothing can be read from yet: the workflow makes recordings in our own."""
    module = _reader(Path(path), format)
    return [] if module is None else [module.__name__]


def _reader(path: Path, format: str | None) -> ModuleType | None:
    """The module of the format of a path; None of our own, and where it has none."""
    try:
        format = format or _detect(path)
        return None if format == OWN_FORMAT else _loaded(format)
    except (InputError, OSError, ValueError):
        return None


def load(
    path: str | Path,
    format: str | None = None,
    order: str | None = None,
    drive: str | None = None,
    measure: str | None = None,
    part: str | None = None,
) -> Recording:
    """Read a recording of any known format, told by its content unless `format` names it.

    `order` takes its readings as standing in that one of `channel_order.ORDERS`; `drive` and
    `measure` name the pairs where the format's files do not; `part` takes frames alone that the
    format leaves out, as if nobody touched. Raises InputError for a file that is not there, of no
    known format or not as its format has it, for a setting that the format states itself and for a
    part that it has not.
    """
    path = Path(path)
    if format is not None and format not in known():
        raise InputError(path, "format", repr(format), f"one of {', '.join(known())}")
    if not path.exists():
        raise InputError(path, "file", "no such file", f"a recording: {', '.join(known())}")
    if format is None:
        format = _detect(path)
    module = None if format == OWN_FORMAT else _loaded(format)
    settings = {"order": order, "drive": drive, "measure": measure}
    given = {key: value for key, value in settings.items() if value is not None}
    taken = {key: given[key] for key in getattr(module, "LEFT_OPEN", ()) if key in given}
    if part is not None:
        parts = getattr(module, "PARTS", ())
        if part.partition(":")[0] not in parts:
            expected = f"one of {', '.join(parts)}" if parts else f"none: {format} has no parts"
            raise InputError(path, "part", repr(part), expected)
        taken["part"] = part
    for key in (key for key in given if key not in taken and key != "order"):
        expected = f"none: the format {format} states its own"
        raise InputError(path, f"setting {key}", repr(given[key]), expected)
    found = recording.read(path) if module is None else _read(path, module, format, taken)
    if order is not None and "order" not in taken:
        found = _in_order(path, found, order)
    if given:
        told = ", ".join(f"{key} {value}" for key, value in given.items())
        found.metadata["source"] += f" (as told: {told})"
    return found


def _read(path: Path, module: ModuleType, format: str, taken: dict[str, str]) -> Recording:
    try:
        found = module.load(path, **taken)
    except OSError as error:
        file = error.filename or path
        raise refused(error, file, expected=f"one of the format {format}") from error
    except UnicodeDecodeError as error:
        byte = f"byte 0x{error.object[error.start]:02x}, no {error.encoding}"
        raise InputError(path, "file", byte, f"text of the format {format}") from error
    recording.validate(found, path)
    return found


def _in_order(path: Path, imported: Recording, order: str) -> Recording:
    """The recording, its readings taken as standing in another order: they stay as they are read,
    one after the other, and the channels change."""
    channels = in_order(path, order, imported.channels, imported.n_electrodes)
    return replace(imported, metadata=imported.metadata | {"channels": channels.tolist()})


def _detect(path: Path) -> str:
    if path.is_file():
        with path.open("rb") as stream:
            if stream.read(4) == b"PAR1":
                return OWN_FORMAT
    for name in FORMATS:
        if _matches(name, path):
            return name
    for module in map(_loaded, FORMATS):
        refusal = module.refusal(path) if hasattr(module, "refusal") else None
        if refusal is not None:
            raise refusal
    unlisted = "".join(f"; {name} has no line in FORMATS" for name in _unlisted())
    raise InputError(path, "format", _said_of(path), f"one of {', '.join(known())}{unlisted}")


def _matches(format: str, path: Path) -> bool:
    try:
        return _loaded(format).matches(path)
    except UnicodeDecodeError:  # whoever takes every file for text
        return False


def _said_of(path: Path) -> str:
    """What a person sees of a path that is of no known format."""
    if not path.is_file():
        return "a folder with no files of a known format" if path.is_dir() else "no file"
    with path.open("rb") as stream:
        head = stream.read(HEAD)
    if not head:
        return "an empty file"
    line = first_line(path)
    if line.isprintable() and line:
        return f"text that begins {line[:HEAD]!r}"
    return f"bytes that begin {head!r}"
