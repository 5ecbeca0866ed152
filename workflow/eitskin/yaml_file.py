"""Reading a YAML file that a person wrote: a mapping in which no key stands twice."""

import re
from pathlib import Path

import yaml

from eitskin.errors import InputError, refused
from eitskin.schema import dotted
from eitskin.text_file import utf_8


def read(path: str | Path) -> dict:
    """The mapping of a YAML file.

    Raises InputError for a file that is not there or is no text, what is no YAML or no mapping, and
    a key that stands twice in a mapping, of which YAML would keep the last.
    """
    try:
        text = utf_8(path, Path(path).read_bytes(), "a YAML file in UTF-8")
    except OSError as error:
        raise refused(error, path, expected="a YAML file") from error
    try:
        loader = yaml.SafeLoader(text)
        document = loader.get_single_node()
        _refuse_repeated_keys(path, document)
        found = None if document is None else loader.construct_document(document)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        place = "file" if mark is None else f"line {mark.line + 1}, column {mark.column + 1}"
        raise InputError(path, place, *_said(error.problem or error.context or "")) from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise InputError(path, "file", " ".join(str(error).split()), "YAML") from error
    if not isinstance(found, dict):
        said = "nothing" if found is None else f"a {type(found).__name__}"
        raise InputError(path, "file", said, "a mapping, key: value")
    return found


def _said(problem: str) -> tuple[str, str]:
    """What PyYAML found, and what was expected, of its problem."""
    if "\\t" in problem:
        return "a tab", "spaces"
    if re.search("<(block end|document start)>", problem):
        begins = re.search("found ('<block mapping start>'|'-'|'[?]')", problem)
        otherwise = "a line that is indented otherwise than those it belongs to"
        return otherwise if begins else "something behind the end of a value", "YAML"
    if problem.startswith("mapping values"):
        return "a second colon, or a line that is indented otherwise", "key: value"
    if met := re.fullmatch(r"expected (.+), but (?:got|found) (.+)", problem):
        return met[2].replace("'<stream end>'", "the end of the file"), met[1]
    return problem.removeprefix("but ").removeprefix("found "), "YAML"


def _refuse_repeated_keys(path: str | Path, document: yaml.Node | None) -> None:
    waiting: list[tuple[list, yaml.Node | None]] = [([], document)]
    seen = set()
    while waiting:
        place, node = waiting.pop(0)
        if id(node) in seen:
            continue
        seen.add(id(node))
        if isinstance(node, yaml.SequenceNode):
            waiting += [([*place, k], value) for k, value in enumerate(node.value)]
        if not isinstance(node, yaml.MappingNode):
            continue
        lines: dict[str, int] = {}
        for key, value in node.value:
            name, line = str(key.value), key.start_mark.line + 1
            if name in lines:
                found = f"it in line {lines[name]} and again in line {line}"
                raise InputError(path, dotted([*place, name]), found, "it once")
            lines[name] = line
            waiting.append(([*place, name], value))
