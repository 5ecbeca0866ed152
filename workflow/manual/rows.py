"""Rows of measurements that are in the repository, which the passages of `manual.passages` show."""

import json
import tarfile
from functools import cache
from pathlib import Path

import pandas as pd

from proof.blocks import sort_of
from proof.claims import Rows
from proof.score import SCORED

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


def trials(block: str) -> Rows:
    """The rows of a block of the calibration in the order of their files' names, `kind` without
    what the rig adds."""
    rows = []
    with tarfile.open(DOCS / "calibration" / block / "trials.tar.xz") as archive:
        for member in sorted(archive.getmembers(), key=lambda member: member.name):
            file = archive.extractfile(member)
            if file is not None and member.name.endswith(".json"):
                row = json.load(file)
                rows.append({**row, "kind": row["kind"].partition("+")[0]})
    return rows


@cache
def summary(block: str) -> pd.DataFrame:
    """The lines (`claims.SUMMARY`) of a block's score."""
    return summary_of(block, trials(block))


def summary_of(block: str, rows: Rows) -> pd.DataFrame:
    """The lines of the score of some rows of a block."""
    tables, _ = SCORED[sort_of(block)](rows)
    return tables["summary"]


def claim(block: str, of: str, what: str) -> dict:
    """A line of `summary`."""
    lines = summary(block)
    (line,) = lines[(lines["of"] == of) & (lines["what"] == what)].to_dict("records")
    return line


def paper(name: str) -> pd.DataFrame:
    """A table of docs/paper. A column `each` is text, and a configuration that is empty too."""
    table = pd.read_csv(DOCS / "paper" / f"{name}.csv", dtype={"each": str})
    if "configuration" in table:
        table["configuration"] = table["configuration"].fillna("")
    return table


@cache
def bench(name: str) -> dict[tuple[str, str], dict]:
    """The rows of a bench by name and by what stands beside."""
    text = (ROOT / "benchmarks" / f"{name}.json").read_text(encoding="utf-8")
    return {(row["name"], row["peer_name"]): row for row in json.loads(text)}


def page_table(page: str, first_cells: tuple[str, ...]) -> list[dict[str, str]]:
    """The lines of the tables of a page of `docs` whose head begins with some cells, by column. Of
    a page that a command wrote, a line a recording, a case or a claim."""
    lines, head = [], None
    for text in (DOCS / page).read_text(encoding="utf-8").splitlines():
        cells = tuple(cell.strip() for cell in text.strip("|").split("|"))
        if not text.startswith("|"):
            head = None
        elif cells[: len(first_cells)] == first_cells:
            head = cells
        elif head is not None and not text.startswith("|---"):
            lines.append(dict(zip(head, cells, strict=True)))
    return lines
