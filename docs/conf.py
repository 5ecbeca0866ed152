"""Sphinx configuration: `make docs` builds the pages of this folder, without the network."""

from manual import pictures

project = "eitskin"
author = "eitskin authors"
extensions = ["myst_parser", "sphinx.ext.autodoc"]
autodoc_member_order = "bysource"
root_doc = "index"
html_theme = "furo"
html_title = "eitskin"
html_show_copyright = False  # the licence is in the README
exclude_patterns = ["sample"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3


def draw_pictures(app):
    """Draw what every effect changes, for the page of the catalogue."""
    pictures.write(app.srcdir / "pictures")


def setup(app):
    app.connect("builder-inited", draw_pictures)
