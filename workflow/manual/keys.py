"""The keys of the configuration as a page, from its schema and the values in config.yaml."""

from pathlib import Path

import yaml

ROOT = Path(__file__).parents[2]
SCHEMA = ROOT / "workflow" / "schemas" / "config.schema.yaml"
DEFAULTS = ROOT / "config.yaml"
MAX_DEFAULT = 60  # characters of a default: longer ones would widen the column

HEAD = """# The configuration

Written by `python -m manual` from `workflow/schemas/config.schema.yaml` and `config.yaml`. A key
that is not here is refused, with those that are, the nearest first. Snakemake lays
`--configfile FILE` and `--config KEY=VALUE` over `config.yaml`; within `{}` on a command line it
reads numbers as text, so that they belong into a file. Before targets that follow stands `--`.

| key | value | here | what it is |
|---|---|---|---|
"""


def page() -> str:
    """The page in Markdown."""
    schema = yaml.safe_load(SCHEMA.read_text(encoding="utf-8"))
    defaults = yaml.safe_load(DEFAULTS.read_text(encoding="utf-8"))
    rows = _rows(schema, schema, defaults, "")
    return HEAD + "\n".join(rows) + "\n"


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
    kinds = subschema.get("type", "")
    return " or ".join(kinds) if isinstance(kinds, list) else kinds


def _default_text(value: object) -> str:
    if value is None or isinstance(value, dict):
        return ""
    text = yaml.safe_dump(value, default_flow_style=True, width=10_000).removesuffix("...\n")
    text = text.strip().replace("|", "\\|")
    return f"`{text}`" if len(text) < MAX_DEFAULT else "a list"
