"""Screenshots of the README's picture, the front page of the documentation and the report of the
sample: `python -m manual.screenshots docs/screenshots`.

It builds the documentation and diagnoses the sample in a temporary folder.
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
WIDTH, HEIGHT = 1200, 900  # px: a laptop's window


def screenshot_pages(folder: Path) -> dict[str, tuple[Path, int]]:
    """The pages by name, built in a folder, and the height of each in px."""
    html_folder, diagnosis_folder = folder / "documentation", folder / "sample"
    tree = folder / "doctrees"
    python = sys.executable
    commands: tuple[list[str | Path], ...] = (
        [python, "-m", "sphinx", "-q", "-b", "html", "-d", tree, ROOT / "docs", html_folder],
        [
            *(python, "-m", "eitskin.cli", "diagnose", SAMPLE / "recording.parquet"),
            *("--query", SAMPLE / "query.parquet", "--out", diagnosis_folder),
        ],
    )
    for command in commands:
        subprocess.run(command, check=True)
    return {
        "readme_picture": (SAMPLE / "picture.svg", HEIGHT),
        "docs_front_page": (html_folder / "index.html", HEIGHT),
        "sample_report": (diagnosis_folder / "report.html", HEIGHT),
    }


def photograph(browser: "Browser", page: Path, height: int) -> bytes:
    """The first `height` px of a page as PNG; a picture in full."""
    tab = browser.new_page(viewport={"width": WIDTH, "height": height})
    tab.set_default_timeout(PATIENCE_MS)
    tab.goto(page.resolve().as_uri())
    root = tab.locator(":root")
    image = root.screenshot() if page.suffix == ".svg" else tab.screenshot()
    tab.close()
    return image


def write(target_folder: Path) -> None:
    """Write NAME.png of every page into a folder. Raises InputError as `chromium` does, and without
    Sphinx."""
    if importlib.util.find_spec("sphinx") is None:
        raise InputError("python", "sphinx", "not installed", "it, from .[docs]")
    with tempfile.TemporaryDirectory() as folder, chromium() as browser:
        target_folder.mkdir(parents=True, exist_ok=True)
        for name, (page, height) in screenshot_pages(Path(folder)).items():
            with atomic_path(target_folder / f"{name}.png") as path:
                path.write_bytes(photograph(browser, page, height))


def run(arguments: list[str]) -> int:
    """Run the command; returns its exit code."""
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
