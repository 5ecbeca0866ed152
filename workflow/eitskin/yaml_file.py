"""Reading YAML files that people write: a mapping without repeated keys, as large as it looks.

An alias (`*name`) stands for a value that is written once and may hold aliases itself: a few
hundred bytes can stand for more than any memory holds. What stands in a file is therefore measured
before anything is made of it.
"""

import re
from pathlib import Path

import yaml

from eitskin.errors import InputError, refused
from eitskin.schema import dotted
from eitskin.text_file import utf_8

MAX_BYTES = 4 << 20  # channels and gains of 256 electrodes take a third of it
MAX_ALIASED = 1 << 20  # characters that aliases may stand for, beside those of the file
MAX_DEPTH = 100  # values within values
MAX_DIGITS = 3500  # of a number, also in base 16: Python writes no whole number of more than 4300
DEPTH = f"at most {MAX_DEPTH} values within one another"
UNPAIRED = re.compile("[\ud800-\udfff]")
NUMBERS = ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")


def read(path: str | Path) -> dict:
    """The mapping of a YAML file.

    Raises InputError for a missing file, one that is no text, no YAML or no mapping, for a
    repeated key in a mapping, of which YAML would keep the last value, and for more than
    MAX_BYTES, MAX_ALIASED, MAX_DEPTH or MAX_DIGITS.
    """
    try:
        with Path(path).open("rb") as stream:
            content = stream.read(MAX_BYTES + 1)
    except OSError as error:
        raise refused(error, path, expected="a YAML file") from error
    if len(content) > MAX_BYTES:
        limit = f"{MAX_BYTES >> 20} MiB"
        raise InputError(path, "file", f"more than {limit}", f"a YAML file of at most {limit}")
    text = utf_8(path, content, "a YAML file in UTF-8")
    try:
        loader = yaml.SafeLoader(text)
        document = loader.get_single_node()
        if document is not None:
            _measured(path, document, len(text) + MAX_ALIASED, {})
        _refuse_repeated_keys(path, document)
        mapping = None if document is None else loader.construct_document(document)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        place = "file" if mark is None else f"line {mark.line + 1}, column {mark.column + 1}"
        raise InputError(
            path, place, *_found_and_expected(error.problem or error.context or "")
        ) from error
    except RecursionError as error:
        raise InputError(path, "file", "values within values without end", DEPTH) from error
    except (AttributeError, LookupError) as error:  # of PyYAML's, for !!bool maybe
        raise InputError(path, "file", "a value that its tag does not allow", "YAML") from error
    except (yaml.YAMLError, ValueError, OverflowError) as error:
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


def _measured(
    path: str | Path, node: yaml.Node, limit: int, known: dict[int, tuple[int, int]], depth: int = 0
) -> tuple[int, int]:
    """Characters that a node stands for, aliases written out, and how deep it is; `known` holds
    those of nodes that were measured. Raises InputError for more than `limit` characters."""
    place = f"line {node.start_mark.line + 1}"
    size, height = 1, 1
    if isinstance(node, yaml.ScalarNode):
        size += len(node.value)
        if node.tag in NUMBERS and size > MAX_DIGITS:
            actual = f"a number of {len(node.value)} characters"
            raise InputError(path, place, actual, f"one of at most {MAX_DIGITS}")
        if UNPAIRED.search(node.value):
            raise InputError(path, place, "half a character, \\ud800 to \\udfff", "text in UTF-8")
    else:
        for part in _parts(node):
            if id(part) not in known:
                if depth == MAX_DEPTH:
                    raise InputError(path, place, "values within values without end", DEPTH)
                known[id(part)] = _measured(path, part, limit, known, depth + 1)
            part_size, part_height = known[id(part)]
            size, height = size + part_size, max(height, part_height + 1)
    if depth + height > MAX_DEPTH:
        raise InputError(path, place, "values within values without end", DEPTH)
    if size > limit:
        actual = f"aliases that stand for more than {MAX_ALIASED} characters"
        raise InputError(path, place, actual, "values that are written out")
    return size, height


def _parts(node: yaml.Node) -> list[yaml.Node]:
    """The values in a list, or the keys and values of a mapping."""
    if isinstance(node, yaml.MappingNode):
        return [part for pair in node.value for part in pair]
    return node.value


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
