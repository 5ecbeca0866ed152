"""Sphinx configuration: `make docs` builds the pages of this folder, without the network."""

project = "eitskin"
author = "eitskin authors"
extensions = ["myst_parser"]
root_doc = "index"
html_theme = "furo"
html_title = "eitskin"
exclude_patterns = ["sample"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
