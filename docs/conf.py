"""Sphinx settings."""

project = "DeepKoCo"
author = "The DeepKoCo developers"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
html_theme = "furo"
exclude_patterns = ["_build"]
myst_heading_anchors = 3
