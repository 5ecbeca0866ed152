"""Write the pages of `docs` that are made from the code: `python -m manual`."""

from pathlib import Path

from eitskin.atomic import atomic_path
from manual import catalogue, gates, keys

DOCS = Path(__file__).parents[2] / "docs"
PAGES = {
    "effects.md": catalogue.page,
    "gates.md": gates.page,
    "configuration.md": keys.page,
}

if __name__ == "__main__":
    for name, page in PAGES.items():
        with atomic_path(DOCS / name) as path:
            path.write_text(page(), encoding="utf-8")
