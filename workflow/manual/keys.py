"""The keys of the configuration and of a board as pages, from their schemas and example values."""

from pathlib import Path

import yaml

from eitskin.data import board

ROOT = Path(__file__).parents[2]
SCHEMA = ROOT / "workflow" / "schemas" / "config.schema.yaml"
DEFAULTS = ROOT / "config.yaml"
MAX_DEFAULT = 60  # characters of a default: longer ones would widen the column

HEAD = """# The configuration

Written by `python -m manual` from `workflow/schemas/config.schema.yaml` and `config.yaml`. A key
that is not here is refused, with those that are, the nearest first. Snakemake lays
`--configfile FILE` and `--config KEY=VALUE` over `config.yaml`; within `{}` on a command line it
reads numbers as text, so that they belong into a file. Before targets that follow stands `--`.

"""
BOARD_HEAD = f"""# A board's file

Written by `python -m manual` from `workflow/eitskin/data/board.schema.yaml`; *here* is the board
`{{name}}`. Boards by name are `workflow/eitskin/data/boards/NAME.yaml`:
{", ".join(f"`{name}`" for name in board.NAMES)}. `rig.board.profile` and `eitskin stream --board`
take a name or the path of a file of your own; [a new board](tutorials/a_new_board.md) makes one.
Without `driven` nothing is printed of pairs that touch a driven electrode; with `zero` a 0, which
is demanded, with `ignored` anything. `range`, `step` and `ceiling` are as printed; `factor` (1)
times a printed number is a reading in `unit` (V). `begin` and `end` may hold conversions of printf,
%d, %x, %.3f, for numbers that are passed over: a counter, a time, a checksum, unverified.

"""
TABLE_HEAD = "| key | value | here | what it is |\n|---|---|---|---|\n"
EXAMPLE = "circular-16"


def configuration() -> str:
    """The page of the configuration's keys in Markdown."""
    return HEAD + _table(SCHEMA, DEFAULTS)


def board_file() -> str:
    """The page of a board's keys in Markdown."""
    return BOARD_HEAD.format(name=EXAMPLE) + _table(
        board.SCHEMA, board.FOLDER / f"{EXAMPLE}{board.SUFFIX}"
    )


def _table(schema_path: Path, values_path: Path) -> str:
    """All keys of a schema, with the values of a file."""
    schema = yaml.safe_load(schema_path.read_text(encoding="utf-8"))
    values = yaml.safe_load(values_path.read_text(encoding="utf-8"))
    return TABLE_HEAD + "\n".join(_rows(schema, schema, values, "")) + "\n"


def _rows(schema: dict, schema_root: dict, values: object, prefix: str) -> list[str]:
    """The rows of all keys below a path, and of the values of a mapping by name, as NAME."""
    rows = []
    for key, subschema in schema.get("properties", {}).items():
        value = values.get(key) if isinstance(values, dict) else None
        rows += _row(f"{prefix}{key}", subschema, schema_root, value)
    if isinstance(schema.get("additionalProperties"), dict):
        rows += _row(f"{prefix}NAME", schema["additionalProperties"], schema_root, None)
    return rows


def _row(path: str, subschema: dict, schema_root: dict, value: object) -> list[str]:
    description = subschema.get("description", "")
    subschema = {
        **_dereferenced(subschema, schema_root),
        **({"description": description} if description else {}),
    }
    description = subschema.get("description", "")
    row = f"| `{path}` | {_kind(subschema)} | {_default_text(value)} | {description} |"
    return [row.replace(" |v| ", " \\|v\\| "), *_rows(subschema, schema_root, value, f"{path}.")]


def _dereferenced(subschema: dict, schema_root: dict) -> dict:
    """A subschema with references within the file followed."""
    while subschema.get("$ref", "").startswith("#/"):
        target = schema_root
        for name in subschema["$ref"][2:].split("/"):
            target = target[name]
        subschema = target
    return subschema


def _kind(subschema: dict) -> str:
    """The type of a value in words."""
    if "$ref" in subschema:
        return f"as `{subschema['$ref']}` says"
    if "enum" in subschema:
        return ", ".join(f"`{choice}`" for choice in subschema["enum"])
    if "anyOf" in subschema:
        return " or ".join(_kind(choice) for choice in subschema["anyOf"])
    kinds = subschema.get("type", "")
    return " or ".join(kinds) if isinstance(kinds, list) else kinds


def _default_text(value: object) -> str:
    if value is None or isinstance(value, dict):
        return ""
    text = yaml.safe_dump(value, default_flow_style=True, width=10_000).removesuffix("...\n")
    text = text.strip().replace("|", "\\|")
    return f"`{text}`" if len(text) < MAX_DEFAULT else "a list"
