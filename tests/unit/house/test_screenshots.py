"""The pictures of what a visitor sees: there, small, and linked; the command that makes them names
each."""

from pathlib import Path

import pytest

from manual import browser, screenshots

ROOT = Path(__file__).parents[3]
FOLDER = ROOT / "docs" / "screenshots"
MOST_BYTES = 300_000
NAMES = ("readme_picture", "docs_front_page", "sample_report")


@pytest.mark.parametrize("name", NAMES)
def test_each_is_a_small_picture_that_a_page_shows(name):
    image = FOLDER / f"{name}.png"
    assert image.read_bytes().startswith(b"\x89PNG")
    assert image.stat().st_size < MOST_BYTES
    pages = [path.read_text(encoding="utf-8") for path in (ROOT / "docs").rglob("*.md")]
    assert any(f"screenshots/{name}.png" in page for page in pages)


@pytest.fixture
def find_spec(monkeypatch):
    """What finds Sphinx, as if it were installed or not, `found`."""

    def find_spec_(found):
        monkeypatch.setattr(screenshots.importlib.util, "find_spec", lambda name: found)

    return find_spec_


def test_without_sphinx_one_line_says_so(find_spec, tmp_path, capsys):
    find_spec(None)
    assert screenshots.run([str(tmp_path / "out")]) == 2
    told = "python: sphinx: found not installed, expected it, from .[docs]"
    assert capsys.readouterr().err.strip() == told
    assert not (tmp_path / "out").exists()


def test_without_chromium_one_line_says_so(find_spec, monkeypatch, tmp_path, capsys):
    find_spec("there")
    monkeypatch.setattr(browser.shutil, "which", lambda name: None)
    assert screenshots.run([str(tmp_path / "out")]) == 2
    assert "PATH: chromium: found no such program, expected one of" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
