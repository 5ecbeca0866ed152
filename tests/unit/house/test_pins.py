"""One set of pins: pyproject.toml, the conda environments and the lock agree."""

import ast
import contextlib
import os
import re
import subprocess
import sys
import tomllib
from importlib.metadata import PackageNotFoundError, packages_distributions, requires

import pytest

from eitskin.errors import InputError
from eitskin.pins import ROOT, environments, scripts_by_concern

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
BARE = """
import os, sys

class Absent:
    absent = set(os.environ["ABSENT"].split())
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in self.absent:
            raise ModuleNotFoundError(f"{name} is not in the environment", name=name)

sys.meta_path.insert(0, Absent())
"""
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
    file.write_text(text.replace('"scikit-learn==1.9.1",', ""))
    with pytest.raises(InputError, match="dependencies: found no scikit-learn, expected a pin"):
        environments(file)


def test_every_script_has_an_environment():
    scripts = {file.stem for file in (ROOT / "workflow" / "scripts").glob("*.py")}
    assert set().union(*scripts_by_concern().values()) == scripts


@pytest.mark.parametrize("concern", sorted(scripts_by_concern()))
def test_every_script_imports_in_its_own_environment(concern, tmp_path):
    """Packages that are not in the environment, nor needed by any in it, are not there, and
    Snakemake's own path is not searched."""
    pins = re.findall(
        r"^ {6}- (.*)==", environments(ROOT / "pyproject.toml")[concern], re.MULTILINE
    )
    present = with_requirements(pins)
    absent = [
        module
        for module, packages in packages_distributions().items()
        if not present & {normal(name) for name in packages} and module != "eitskin"
    ]
    imports = tmp_path / "imports.py"
    imports.write_text(BARE + "".join(map(statements, sorted(scripts_by_concern()[concern]))))
    environment = os.environ | {"PYTHONPATH": str(ROOT / "workflow"), "ABSENT": " ".join(absent)}
    run = subprocess.run(
        [sys.executable, str(imports)], env=environment, capture_output=True, text=True
    )
    assert run.returncode == 0, run.stderr


def statements(script: str) -> str:
    """The import statements of a script, wherever they stand."""
    text = (ROOT / "workflow" / "scripts" / f"{script}.py").read_text(encoding="utf-8")
    imports = (ast.Import, ast.ImportFrom)
    nodes = [node for node in ast.walk(ast.parse(text)) if isinstance(node, imports)]
    return "".join(f"{ast.unparse(node)}  # {script}\n" for node in nodes)


def normal(package: str) -> str:
    return re.sub(r"[-_.]+", "-", package).lower()


def with_requirements(packages: list[str]) -> set[str]:
    """Packages and all that they require, without their extras."""
    waiting, known = list(packages), set()
    while waiting:
        package = normal(waiting.pop())
        if package in known:
            continue
        known.add(package)
        with contextlib.suppress(PackageNotFoundError):  # one that only another system needs
            for requirement in requires(package) or ():
                if "extra ==" not in requirement:
                    waiting.append(re.match(r"[\w.-]+", requirement)[0])
    return known
