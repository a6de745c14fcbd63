"""How Sphinx builds these pages: `python -m sphinx -W docs build/docs` from the root of the repository."""

from __future__ import annotations

import sys
from pathlib import Path

from sphinx.application import Sphinx

sys.path.insert(0, str(Path(__file__).parent))

import made

import hydrabeam_mpi

project = "hydrabeam_mpi"
author = "hydrabeam_mpi developers"
copyright = f"2026, {author}"
version = release = hydrabeam_mpi.__version__

extensions = [
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "sphinx.ext.viewcode",
    "sphinx-mathjax-offline",
]
exclude_patterns = ["build"]
html_theme = "sphinx_rtd_theme"
html_static_path = ["static"]
html_css_files = ["wide.css"]
html_theme_options = {"navigation_depth": 2, "collapse_navigation": False}
html_show_sourcelink = False
myst_enable_extensions = ["amsmath", "deflist", "dollarmath"]
myst_heading_anchors = 3
autodoc_typehints = "none"
autodoc_member_order = "bysource"
numpydoc_show_class_members = False


def setup(app: Sphinx) -> None:
    """Put what is made from the code into the pages before they are read."""
    app.connect("source-read", made.fill)
