"""Conda environments, envs/*.yaml: what the scripts of their rules import, at the pins of
pyproject.toml. `python -m eitskin.pins` writes them."""

import re
import sys
import tomllib
from functools import cache
from pathlib import Path

from eitskin.atomic import atomic_path
from eitskin.errors import InputError
from eitskin.fingerprint import HOUSE, imported_names

ROOT = Path(__file__).parents[2]
RULE = re.compile(  # its environment and its script
    r'"\.\./\.\./envs/(?P<concern>\w+)\.yaml"'
    r"(?:(?!\n *rule ).)*?"
    r'"\.\./scripts/(?P<script>\w+)\.py"',
    re.DOTALL,
)
BY_NAME = {  # modules that load others, or start a process of them, without an import statement
    "eitskin.effects": "eitskin.effects.",
    "eitskin.learn.models": "eitskin.learn.networks",
    "eitskin.data.importers": "eitskin.data.importers.",
    "eitskin.capture.robot": "eitskin.capture.robot_worker",
}
PACKAGES = {  # of modules that are not called as their packages
    "yaml": "pyyaml",
    "serial": "pyserial",
    "skfem": "scikit-fem",
    "sklearn": "scikit-learn",
    "rtde_control": "ur-rtde",
    "rtde_receive": "ur-rtde",
}


def scripts_by_concern() -> dict[str, set[str]]:
    """Names of the scripts whose rules have each conda environment."""
    scripts: dict[str, set[str]] = {}
    for file in sorted((HOUSE / "rules").glob("*.smk")):
        for rule in RULE.finditer(file.read_text(encoding="utf-8")):
            scripts.setdefault(rule["concern"], set()).add(rule["script"])
    return scripts


def environments(pyproject: str | Path) -> dict[str, str]:
    """Text of each conda environment file by concern.

    Raises InputError for a package that scripts import and `pyproject` does not pin.
    """
    project = tomllib.loads(Path(pyproject).read_text(encoding="utf-8"))["project"]
    pins = sum(project["optional-dependencies"].values(), project["dependencies"])
    pin_of_package = {pin.partition("==")[0]: pin for pin in pins}
    texts = {}
    for concern, scripts in sorted(scripts_by_concern().items()):
        packages = set().union(*map(imported_packages, scripts))
        for package in packages - pin_of_package.keys():
            expected = f"a pin: scripts of envs/{concern}.yaml import it"
            raise InputError(pyproject, "dependencies", f"no {package}", expected)
        concern_pins = [pin_of_package[package] for package in sorted(packages)]
        texts[concern] = _conda(concern, project["requires-python"], concern_pins)
    return texts


def imported_packages(script: str) -> set[str]:
    """Packages that scripts/`script`.py and all modules of the workflow that it reaches import."""
    waiting, visited, packages = [HOUSE / "scripts" / f"{script}.py"], set(), set()
    while waiting:
        file = waiting.pop()
        if file in visited:
            continue
        visited.add(file)
        for name in imported_names(file):
            waiting += _files(name)
            module = name.partition(".")[0]
            if not (HOUSE / module).is_dir() and module not in sys.stdlib_module_names:
                packages.add(PACKAGES.get(module, module.replace("_", "-")))
    return packages


def _files(name: str) -> list[Path]:
    """Files of a module of the workflow, of its packages, and of what it loads by name; none for
    any other name."""
    modules = _modules()
    parts = name.split(".")
    names = [".".join(parts[: k + 1]) for k in range(len(parts))]
    prefixes = tuple(BY_NAME[name] for name in names if name in BY_NAME and name in modules)
    names += [module for module in modules if module.startswith(prefixes)]
    return [modules[name] for name in names if name in modules]


@cache
def _modules() -> dict[str, Path]:
    """Files by module name; a package's is its `__init__`."""
    files = sorted(HOUSE.glob("*/**/*.py"))
    return {
        ".".join(file.relative_to(HOUSE).with_suffix("").parts).removesuffix(".__init__"): file
        for file in files
    }


def _conda(concern: str, python: str, pins: list[str]) -> str:
    lines = [
        "# Written by `python -m eitskin.pins` from pyproject.toml; edit that.",
        f"name: eitskin-{concern}",
        "channels:",
        "  - conda-forge",
        "  - nodefaults",
        "dependencies:",
        f"  - python {python}",
        "  - pip",
        "  - pip:",
        *(f"      - {pin}" for pin in pins),
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Write envs/<concern>.yaml for every concern."""
    for concern, text in environments(ROOT / "pyproject.toml").items():
        path = ROOT / "envs" / f"{concern}.yaml"
        with atomic_path(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
        print(path)


if __name__ == "__main__":
    main()
