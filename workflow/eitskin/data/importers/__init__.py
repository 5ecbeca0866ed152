"""Other laboratories' files as recordings; one module a format.

A format is a module of its name with `matches(path) -> bool`, by content, `load(path) -> Recording`
and, where that reads more than one file, `files(path) -> list[Path]`; FORMATS has a line for each.
"""

from importlib import import_module
from pathlib import Path

from eitskin.data import recording
from eitskin.data.recording import Recording
from eitskin.errors import InputError

OWN_FORMAT = "eit-recording"
FORMATS = {
    name: import_module(f"{__name__}.{name.replace('-', '_')}")
    for name in (  # in the order in which a file's content is tried
        "logger-csv",
        "hydrogel-skin",
        "iirc-tank",
        "pyeidors-tank",
        "lct-tank",
        "patterned-skin",
    )
}


def known() -> list[str]:
    """Names of the formats, our own first."""
    return [OWN_FORMAT, *FORMATS]


def modules() -> list[str]:
    """The modules of all formats."""
    return [module.__name__ for module in FORMATS.values()]


def files(path: str | Path, format: str | None = None) -> list[Path]:
    """What `load` reads: the path itself, which may be a folder, then files inside or beside it.
    Of a path that nothing can be read from yet, itself alone."""
    path = Path(path)
    try:
        module = FORMATS.get(format or _detect(path))
    except (InputError, OSError, ValueError):
        module = None
    more = module.files(path) if hasattr(module, "files") else []
    return list(dict.fromkeys([path, *more]))


def load(path: str | Path, format: str | None = None) -> Recording:
    """Read a recording of any known format, told by its content unless `format` names it.

    Raises InputError for a file that is not there, of no known format or not as its format has it.
    """
    path = Path(path)
    if format is not None and format not in known():
        raise InputError(path, "format", repr(format), f"one of {', '.join(known())}")
    if not path.exists():
        raise InputError(path, "file", "no such file", f"a recording: {', '.join(known())}")
    if format is None:
        format = _detect(path)
    if format == OWN_FORMAT:
        return recording.read(path)
    try:
        imported = FORMATS[format].load(path)
    except OSError as error:
        raise InputError(path, "file", error.strerror, f"one of the format {format}") from error
    except UnicodeDecodeError as error:
        raise InputError(path, "file", "bytes that are no text", f"the format {format}") from error
    recording.validate(imported, path)
    return imported


def _detect(path: Path) -> str:
    if path.is_file():
        with path.open("rb") as stream:
            if stream.read(4) == b"PAR1":
                return OWN_FORMAT
    for name, module in FORMATS.items():
        if module.matches(path):
            return name
    raise InputError(path, "format", "none that is known", f"one of {', '.join(known())}")
