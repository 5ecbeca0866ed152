"""One set of pins: pyproject.toml, the conda environments and the lock agree."""

import ast
import re
import sys
import tomllib
from importlib.metadata import packages_distributions

import pytest

from eitskin.pins import ROOT, environments

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
PINS = sum(PROJECT["optional-dependencies"].values(), PROJECT["dependencies"])


def test_the_conda_files_are_those_that_pins_writes():
    written = {f.stem: f.read_text(encoding="utf-8") for f in (ROOT / "envs").glob("*.yaml")}
    assert written == environments(ROOT / "pyproject.toml")


def test_every_conda_pin_is_one_of_the_project():
    for text in environments(ROOT / "pyproject.toml").values():
        pins = re.findall(r"^ {6}- (.*)$", text, re.MULTILINE)
        assert pins
        assert set(pins) <= set(PINS)


def test_every_pin_is_exact_and_in_the_lock():
    lines = (ROOT / "envs" / "requirements.lock").read_text(encoding="utf-8").splitlines()
    normal = {re.sub(r"[-_.]+", "-", line).lower() for line in lines}
    for pin in PINS:
        assert re.fullmatch(r"[A-Za-z0-9-]+==[0-9.]+", pin)
        assert re.sub(r"[-_.]+", "-", pin).lower() in normal


def test_what_the_command_imports_is_declared():
    files = (ROOT / "workflow" / "eitskin").rglob("*.py")
    nodes = [node for file in files for node in ast.walk(ast.parse(file.read_text("utf-8")))]
    names = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    names |= {node.module for node in nodes if isinstance(node, ast.ImportFrom) and node.module}
    modules = {name.partition(".")[0] for name in names} - sys.stdlib_module_names
    modules -= {"eitskin", "rtde_control", "rtde_receive"}  # ur-rtde does not say what it installs
    declared = {re.sub(r"[-_.]+", "-", pin.partition("==")[0]).lower() for pin in PINS}
    for module in modules:
        packages = packages_distributions()[module]
        assert {re.sub(r"[-_.]+", "-", name).lower() for name in packages} & declared, module


def test_the_lock_is_portable():
    lines = (ROOT / "envs" / "requirements.lock").read_text(encoding="utf-8").splitlines()
    for line in lines[1:]:
        assert re.fullmatch(r"[A-Za-z0-9_.-]+==[0-9][0-9A-Za-z.]*", line)


def test_a_package_without_a_pin_is_refused(tmp_path):
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    file = tmp_path / "pyproject.toml"
    file.write_text(text.replace('learning = ["numpy"', 'learning = ["gmsh"'))
    with pytest.raises(KeyError, match="gmsh"):
        environments(file)
