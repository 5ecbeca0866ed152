"""Conda environments, envs/*.yaml, from the pins in pyproject.toml: `python -m eitskin.pins`."""

import tomllib
from pathlib import Path

from eitskin.atomic import atomic_path

ROOT = Path(__file__).parents[2]


def environments(pyproject: str | Path) -> dict[str, str]:
    """Text of each conda environment file by concern.

    `[tool.eitskin.environments]` lists the packages of a concern; their versions are the pins of
    the project and its extras. Raises KeyError for a package that is not pinned there.
    """
    project = tomllib.loads(Path(pyproject).read_text(encoding="utf-8"))
    extras = project["project"]["optional-dependencies"].values()
    pins = sum(extras, project["project"]["dependencies"])
    version = {name: pin for pin in pins for name in [pin.partition("==")[0]]}
    python = project["project"]["requires-python"]
    return {
        concern: _conda(concern, python, [version[name] for name in packages])
        for concern, packages in project["tool"]["eitskin"]["environments"].items()
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
