"""Why a product of the workflow is as it is: what made it, from what, what has changed since."""

import json
from collections.abc import Iterator
from pathlib import Path

from eitskin import fingerprint, provenance
from eitskin.errors import InputError


def chain(file: str | Path) -> list[dict]:
    """What led to a product, itself first: each step a mapping of `product`, `depth` (steps from
    the file), `rule`, `parameters`, `inputs` and `changed`, a sentence for all that is other now.

    A product that several need is in the list once. What no rule makes has neither rule nor
    parameters. Raises InputError for a file without a record.
    """
    folder, product = _place(Path(file))
    records = provenance.records(folder)
    if product not in records:
        expected = "a product of the workflow whose job has finished"
        raise InputError(file, "file", f"no record in {folder / provenance.RECORDS}", expected)
    return list(_steps(folder, records, product, None, 0, set()))


def _place(file: Path) -> tuple[Path, str]:
    """The folder in which the workflow ran that made a file, and its path from there."""
    path = file.absolute()
    for folder in path.parents:
        if (folder / provenance.RECORDS).is_dir():
            return folder, str(path.relative_to(folder))
    expected = "a product of the workflow, beside its records"
    raise InputError(file, "file", f"no folder above it with {provenance.RECORDS}", expected)


def _steps(
    folder: Path,
    records: dict[str, Path],
    product: str,
    digest: str | None,
    depth: int,
    visited: set[str],
) -> Iterator[dict]:
    """The steps that lead to a product, whose digest was `digest` when it was used."""
    if product in visited:
        return
    visited.add(product)
    if product not in records:
        actual = provenance.digest_of_file(folder / product)
        changed = [] if actual == digest else ["other bytes, or none"]
        yield {"product": product, "depth": depth, "changed": changed}
        return
    record = records[product]
    text = record.read_text(encoding="utf-8")
    content = json.loads(text)
    changed = [*_changes(folder, record, content)]
    if not (folder / product).exists():
        changed.append("it is missing")
    if digest not in (None, provenance.digest(text)):
        changed.append("made anew since it was used")
    yield {
        "product": product,
        "depth": depth,
        **{key: content[key] for key in ("rule", "parameters")},
        "inputs": list(content["inputs"]),
        "changed": changed,
    }
    for path, inner in content["inputs"].items():
        yield from _steps(folder, records, path, inner, depth + 1, visited)


def _changes(folder: Path, record: Path, content: dict) -> Iterator[str]:
    """What is other than a record says: code as it is now, parameters and inputs as of the last
    plan."""
    code = folder / provenance.RECORDS / provenance.CODE / f"{content['code']}.json"
    if code.exists():
        for name, digest in json.loads(code.read_text(encoding="utf-8")).items():
            if fingerprint.digest_of(name) != digest:
                yield f"code: {name}"
    planned = folder / str(record.relative_to(folder)).replace(
        provenance.RECORDS, provenance.PLANNED
    )
    if not planned.exists():
        return
    plan = provenance.planned_content(planned)
    for key in sorted(content["parameters"].keys() | plan["parameters"].keys()):
        old, new = (document["parameters"].get(key) for document in (content, plan))
        if old != new:
            yield f"{key}: {json.dumps(old)}, now {json.dumps(new)}"
    for path in sorted(content["inputs"].keys() ^ plan["inputs"].keys()):
        yield f"input: {'no more' if path in content['inputs'] else 'now also'} {path}"
