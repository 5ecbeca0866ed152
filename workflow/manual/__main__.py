"""Write the pages of `docs` that are made from the code, and in all pages the passages that show
rows: `python -m manual`."""

from eitskin.atomic import atomic_path
from manual import catalogue, gates, glossary, keys
from manual.passages import filled
from manual.rows import DOCS, ROOT

SHOWING_ROWS = (ROOT / "README.md", *sorted(DOCS.rglob("*.md")))
PAGES = {
    "effects.md": catalogue.page,
    "gates.md": gates.page,
    "glossary.md": glossary.page,
    "configuration.md": keys.configuration,
    "board.md": keys.board_file,
}

if __name__ == "__main__":
    for name, page in PAGES.items():
        with atomic_path(DOCS / name) as path:
            path.write_text(page(), encoding="utf-8")
    for file in SHOWING_ROWS:
        text = file.read_text(encoding="utf-8")
        if (filled_text := filled(text)) != text:
            with atomic_path(file) as path:
                path.write_text(filled_text, encoding="utf-8")
