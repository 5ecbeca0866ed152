"""Reading YAML files that people write: a mapping without repeated keys."""

import re
from pathlib import Path

import yaml

from eitskin.errors import InputError, refused
from eitskin.schema import dotted
from eitskin.text_file import utf_8


def read(path: str | Path) -> dict:
    """The mapping of a YAML file.

    Raises InputError for a missing file, one that is no text, no YAML or no mapping, and for a
    repeated key in a mapping, of which YAML would keep the last value.
    """
    try:
        text = utf_8(path, Path(path).read_bytes(), "a YAML file in UTF-8")
    except OSError as error:
        raise refused(error, path, expected="a YAML file") from error
    try:
        loader = yaml.SafeLoader(text)
        document = loader.get_single_node()
        _refuse_repeated_keys(path, document)
        mapping = None if document is None else loader.construct_document(document)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        place = "file" if mark is None else f"line {mark.line + 1}, column {mark.column + 1}"
        raise InputError(
            path, place, *_found_and_expected(error.problem or error.context or "")
        ) from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise InputError(path, "file", " ".join(str(error).split()), "YAML") from error
    if not isinstance(mapping, dict):
        actual = "nothing" if mapping is None else f"a {type(mapping).__name__}"
        raise InputError(path, "file", actual, "a mapping, key: value")
    return mapping


def _found_and_expected(problem: str) -> tuple[str, str]:
    """The actual and the expected text of a problem that PyYAML reports."""
    if "\\t" in problem:
        return "a tab", "spaces"
    if re.search("<(block end|document start)>", problem):
        begins = re.search("found ('<block mapping start>'|'-'|'[?]')", problem)
        otherwise = "a line that is indented otherwise than those it belongs to"
        return otherwise if begins else "something behind the end of a value", "YAML"
    if problem.startswith("mapping values"):
        return "a second colon, or a line that is indented otherwise", "key: value"
    if match := re.fullmatch(r"expected (.+), but (?:got|found) (.+)", problem):
        return match[2].replace("'<stream end>'", "the end of the file"), match[1]
    return problem.removeprefix("but ").removeprefix("found "), "YAML"


def _refuse_repeated_keys(path: str | Path, document: yaml.Node | None) -> None:
    waiting: list[tuple[list, yaml.Node | None]] = [([], document)]
    visited = set()
    while waiting:
        place, node = waiting.pop(0)
        if id(node) in visited:
            continue
        visited.add(id(node))
        if isinstance(node, yaml.SequenceNode):
            waiting += [([*place, k], value) for k, value in enumerate(node.value)]
        if not isinstance(node, yaml.MappingNode):
            continue
        lines: dict[str, int] = {}
        for key, value in node.value:
            name, line = str(key.value), key.start_mark.line + 1
            if name in lines:
                actual = f"it in line {lines[name]} and again in line {line}"
                raise InputError(path, dotted([*place, name]), actual, "it once")
            lines[name] = line
            waiting.append(([*place, name], value))
