"""Imports go downward only: every part of the house uses what stands below it, nothing else."""

import ast
import graphlib
from functools import cache
from pathlib import Path

import pytest

from eitskin.effects import EFFECTS

HOUSE = Path(__file__).parents[3] / "workflow"
FLOORS = (  # from the ground up; what stands on one floor does not know each other
    {"callable_package", "errors", "plotting"},
    {"progress", "quantities", "yaml_number"},
    {"atomic", "cores", "text_file", "unfolding"},
    {"fingerprint"},
    {"figure_files", "pins", "physics", "provenance"},
    {"schema", "effects", "skin_layout", "why"},
    {"yaml_file"},
    {"data"},
    {"simulate"},
    {"exported"},
    {"learn"},
    {"configuration"},
    {"limit"},
    {"diagnose"},
    {"paper"},
    {"capture"},
    {"stream"},
    {"answer_folder", "answers", "drawing", "peers", "simulators"},
    {"estimators", "scripting"},
    {"cli"},
)
BESIDE = {  # what uses the tool, and what each may use of the others
    "benchmark": {"witness"},
    "loop": {"witness"},
    "manual": {"proof", "witness"},
    "proof": {"witness"},
    "rigsim": set(),
    "witness": set(),
}
ONLY = {  # what knows even less of the tool than its floor would allow
    "eitskin.plotting": set(),
    "witness": {
        "eitskin.atomic",
        "eitskin.errors",
        "eitskin.data.recording",
        "eitskin.physics.protocol",
        # As an owner states a rim.
        "eitskin.physics.outline",
        "eitskin.physics.rim_curve",
        "eitskin.physics.skin",
    },
}


@cache
def modules() -> dict[str, Path]:
    """Files by module name; a package's is its `__init__`."""
    found = {}
    for package in ("eitskin", *BESIDE):
        for file in (HOUSE / package).rglob("*.py"):
            parts = file.relative_to(HOUSE).with_suffix("").parts
            found[".".join(parts).removesuffix(".__init__")] = file
    return found


@cache
def imports(name: str) -> frozenset[str]:
    """The modules of the house that one imports, inside functions as well."""
    found = set()
    for node in ast.walk(ast.parse(modules()[name].read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name}: a relative import"
            inside = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= inside if inside & modules().keys() else {node.module}
    return frozenset(found & modules().keys())


def floor(name: str) -> int:
    """Where a module of the tool stands."""
    part = name.split(".")[1]
    found = [k for k, parts in enumerate(FLOORS) if part in parts]
    assert found, f"{name} stands on no floor"
    return found[0]


def test_every_part_has_its_place():
    packages = {file.parent.name for file in HOUSE.glob("*/__init__.py")}
    assert packages == {"eitskin", *BESIDE}
    assert all(floor(name) >= 0 for name in modules() if "." in name and name.startswith("eitskin"))


@pytest.mark.parametrize("part", sorted(set().union(*FLOORS)))
def test_imports_go_downward(part):
    for name in modules():
        if name.split(".")[:2] != ["eitskin", part]:
            continue
        for other in imports(name) - {"eitskin"}:
            assert other.startswith("eitskin."), f"{name} imports {other}, which uses the tool"
            inside = other.split(".")[1] == part
            assert inside or floor(other) < floor(name), f"{name} imports {other}"


@pytest.mark.parametrize("package", sorted(BESIDE))
def test_what_uses_the_tool_knows_few_others(package):
    allowed = {"eitskin", package} | BESIDE[package]
    for name in modules():
        if name.split(".")[0] == package:
            for other in imports(name):
                assert other.split(".")[0] in allowed, f"{name} imports {other}"


def test_a_diagnosis_does_not_know_its_report():
    pages = ("eitskin.diagnose.report", "eitskin.diagnose.compare.page")
    for name in modules():
        if name.startswith("eitskin.diagnose") and not name.startswith(pages):
            for other in imports(name):
                assert not other.startswith("eitskin.diagnose.report"), f"{name} imports {other}"


ROOMS = (  # of `diagnose`, from the ground up; rooms on one floor do not know each other
    {"noise"},
    {"fitting"},
    {"search"},
    {"verdict"},
    {"diagnosis", "files", "report"},
    {"compare"},
    {"parts"},
)


def test_rooms_of_a_diagnosis_know_those_below():
    level = {room: k for k, rooms in enumerate(ROOMS) for room in rooms}
    for name in modules():
        if name.startswith("eitskin.diagnose."):
            room = name.split(".")[2]
            for other in imports(name):
                below = other.split(".")[2:3] if other.startswith("eitskin.diagnose.") else []
                if below and below != [room]:
                    assert level[below[0]] < level[room], f"{name} imports {other}"


@pytest.mark.parametrize("owner", sorted(ONLY))
def test_some_know_next_to_nothing(owner):
    for name in modules():
        if name == owner or name.startswith(f"{owner}."):
            known = {other for other in imports(name) if other.split(".")[0] == "eitskin"}
            assert known <= ONLY[owner], f"{name} imports {known - ONLY[owner]}"


def test_nothing_goes_round_in_a_circle():
    graph = {name: imports(name) - {name} for name in modules()}
    graphlib.TopologicalSorter(graph).prepare()


def test_no_generic_module_knows_a_single_effect():
    """An effect is one file: what others need of it is a hook that any effect may have."""
    single = {type(effect).__module__ for effect in EFFECTS.values()}
    for name in modules():
        if name.startswith("eitskin.") and not name.startswith("eitskin.effects"):
            assert not imports(name) & single, f"{name} imports {imports(name) & single}"
