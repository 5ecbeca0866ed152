"""What edits of a finished run make again, as edits.yaml has it, and the table of it in
CONTRIBUTING.md: `python tests/workflow/edits.py` writes that."""

from collections.abc import Iterable, Mapping, Set
from fnmatch import fnmatchcase
from pathlib import Path

import yaml

HERE = Path(__file__).parent
PAGE = HERE.parents[1] / "CONTRIBUTING.md"
BEGIN, END = "<!-- edits: tests/workflow/edits.yaml -->", "<!-- end of edits -->"
HEAD = ["you want to change", "file", "its tests", "jobs that run again"]
STATEMENT = "\nUNUSED = 1\n"

EDITS = yaml.safe_load((HERE / "edits.yaml").read_text(encoding="utf-8"))


def replacements(edit: dict) -> list[tuple]:
    """The texts to replace in files of a house, for an edit of a value or of code."""
    if isinstance(edit["edit"], str):
        return [(f"workflow/{edit['edit']}", None, STATEMENT)]
    return [tuple(edit["edit"])]


def named(names: Iterable[str]) -> list[str]:
    """Rules and patterns, with those of `sets` in place of their names."""
    return [one for name in names for one in EDITS["sets"].get(name, [name])]


def dependents(
    edit: dict, files: Iterable[str], rules: Mapping[str, str], inputs: Mapping[str, Set[str]]
) -> set[str]:
    """Of all `files` those that an edit makes again; rules and inputs: of the files that are there,
    by path."""
    files = set(files)
    found: set[str] = set()
    for name in named(edit["users"]):
        used = {
            file
            for file in files
            if rules.get(file) == name or fnmatchcase(file, f"results/{name}")
        }
        assert used, f"{edit['edit']}: nothing is {name}"
        found |= used
    while more := {file for file in files - found if inputs.get(file, set()) & found}:
        found |= more
    return found


def cell(edit: dict) -> str:
    """The last column of an edit's line."""
    rules = [name if name in EDITS["sets"] else f"`{name}`" for name in edit["again"]]
    return "; ".join(filter(None, [", ".join(rules) or "none", edit.get("besides")]))


def table() -> str:
    """The table in Markdown, and what its sets of rules are."""
    edits = [edit for edit in [*EDITS["code"], *EDITS["values"]] if "row" in edit]
    rows = [[*edit["row"], cell(edit)] for edit in edits]
    rows += [[*edit["row"], edit["again"]] for edit in EDITS["besides"]]
    lines = [f"| {' | '.join(cells)} |" for cells in [HEAD, ["---"] * 4, *rows]]
    sets = [
        f"{name}: {', '.join(f'`{rule}`' for rule in rules)}"
        for name, rules in EDITS["sets"].items()
    ]
    return "\n".join([*lines, "", f"{'; '.join(sets)}."])


def page(text: str) -> str:
    """CONTRIBUTING.md with its table as edits.yaml has it."""
    head, _, tail = text.partition(BEGIN)
    return f"{head}{BEGIN}\n\n{table()}\n\n{END}{tail.partition(END)[2]}"


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
