"""The keys of the configuration as a page, from its schema and the values in config.yaml."""

from pathlib import Path

import yaml

ROOT = Path(__file__).parents[2]
SCHEMA = ROOT / "workflow" / "schemas" / "config.schema.yaml"
DEFAULTS = ROOT / "config.yaml"
MOST_SHOWN = 60  # characters of a default

HEAD = """# The configuration

Written by `python -m manual` from `workflow/schemas/config.schema.yaml` and `config.yaml`. A key
that is not here is refused, with those that are, the nearest first. Snakemake lays
`--configfile FILE` and `--config KEY=VALUE` over `config.yaml`; within `{}` on a command line it
reads numbers as text, so that they belong into a file. Before targets that follow stands `--`.

| key | value | here | what it is |
|---|---|---|---|
"""


def page() -> str:
    """The page as Markdown."""
    schema = yaml.safe_load(SCHEMA.read_text(encoding="utf-8"))
    defaults = yaml.safe_load(DEFAULTS.read_text(encoding="utf-8"))
    rows = _rows(schema, schema, defaults, "")
    return HEAD + "\n".join(rows) + "\n"


def _rows(schema: dict, whole: dict, given: object, above: str) -> list[str]:
    """Of every key below a place, and of what a name stands for once."""
    found = []
    for key, part in schema.get("properties", {}).items():
        value = given.get(key) if isinstance(given, dict) else None
        found += _row(f"{above}{key}", part, whole, value)
    if isinstance(schema.get("additionalProperties"), dict):
        found += _row(f"{above}NAME", schema["additionalProperties"], whole, None)
    return found


def _row(place: str, part: dict, whole: dict, value: object) -> list[str]:
    said = part.get("description", "")
    part = {**_resolved(part, whole), **({"description": said} if said else {})}
    row = f"| `{place}` | {_kind(part)} | {_shown(value)} | {part.get('description', '')} |"
    return [row.replace(" |v| ", " \\|v\\| "), *_rows(part, whole, value, f"{place}.")]


def _resolved(part: dict, whole: dict) -> dict:
    """A part of the schema, references within the file followed."""
    while part.get("$ref", "").startswith("#/"):
        target = whole
        for name in part["$ref"][2:].split("/"):
            target = target[name]
        part = target
    return part


def _kind(part: dict) -> str:
    """What a value may be, in words."""
    if "$ref" in part:
        return f"as `{part['$ref']}` says"
    if "enum" in part:
        return ", ".join(f"`{one}`" for one in part["enum"])
    kinds = part.get("type", "")
    return " or ".join(kinds) if isinstance(kinds, list) else kinds


def _shown(value: object) -> str:
    if value is None or isinstance(value, dict):
        return ""
    text = yaml.safe_dump(value, default_flow_style=True, width=10_000).removesuffix("...\n")
    text = text.strip().replace("|", "\\|")
    return f"`{text}`" if len(text) < MOST_SHOWN else "a list"
