"""Pictures of what a visitor sees, as a browser shows it: the README's picture, the front page of
the documentation, the report of the sample: `python -m manual.screenshots docs/screenshots`.

It builds the documentation and diagnoses the sample, in a folder that it removes.
"""

import importlib.util
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from eitskin.atomic import atomic_path
from eitskin.errors import InputError
from manual.browser import PATIENCE_MS, chromium

if TYPE_CHECKING:
    from playwright.sync_api import Browser

ROOT = Path(__file__).parents[2]
SAMPLE = ROOT / "docs" / "sample"
WIDTH, HEIGHT = 1200, 900  # px: as much as a laptop shows at once
TALL = 1750  # px of the report: the answer, where, and the course of the misfit


def made(folder: Path) -> dict[str, tuple[Path, int]]:
    """What is shown by name: the page, built in a folder, and the px of it that are shown."""
    built, said = folder / "documentation", folder / "sample"
    tree = folder / "doctrees"
    python = sys.executable
    commands: tuple[list[str | Path], ...] = (
        [python, "-m", "sphinx", "-q", "-b", "html", "-d", tree, ROOT / "docs", built],
        [
            *(python, "-m", "eitskin.cli", "diagnose", SAMPLE / "recording.parquet"),
            *("--query", SAMPLE / "query.parquet", "--out", said),
        ],
    )
    for command in commands:
        subprocess.run(command, check=True)
    return {
        "readme_picture": (SAMPLE / "picture.svg", HEIGHT),
        "docs_front_page": (built / "index.html", HEIGHT),
        "sample_report": (said / "report.html", TALL),
    }


def photograph(browser: "Browser", page: Path, height: int) -> bytes:
    """The first `height` px of a page as PNG; of a picture, all of it."""
    shown = browser.new_page(viewport={"width": WIDTH, "height": height})
    shown.set_default_timeout(PATIENCE_MS)
    shown.goto(page.resolve().as_uri())
    root = shown.locator(":root")
    image = root.screenshot() if page.suffix == ".svg" else shown.screenshot()
    shown.close()
    return image


def write(out: Path) -> None:
    """Write NAME.png of everything that is shown into a folder. Raises InputError as `chromium`
    does, and where Sphinx is not installed."""
    if importlib.util.find_spec("sphinx") is None:
        raise InputError("python", "sphinx", "not installed", "it, from .[docs]")
    with tempfile.TemporaryDirectory() as folder, chromium() as browser:
        out.mkdir(parents=True, exist_ok=True)
        for name, (page, height) in made(Path(folder)).items():
            with atomic_path(out / f"{name}.png") as path:
                path.write_bytes(photograph(browser, page, height))


def run(arguments: list[str]) -> int:
    """The command; its exit code."""
    if len(arguments) != 1:
        print("usage: python -m manual.screenshots FOLDER", file=sys.stderr)
        return 2
    try:
        write(Path(arguments[0]))
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(run(sys.argv[1:]))
