# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Settings of the documentation site: `python3 -m sphinx -W doc site`."""

import sys
from pathlib import Path

import mp_pca_planner

sys.path.insert(0, str(Path(__file__).resolve().parent))

import reference
from docutils.nodes import SkipNode
from docutils.utils.math.latex2mathml import tex2mathml

project = "mp_pca_planner"
author = "mp_pca_planner developers"
project_copyright = f"2026 {author}"
release = mp_pca_planner.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.intersphinx",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
]
myst_enable_extensions = ["deflist", "dollarmath"]
myst_heading_anchors = 3
autodoc_typehints = "none"  # docstrings hold them, with shapes and units
autodoc_member_order = "bysource"
napoleon_use_rtype = False
# Attributes are one list above the methods, and several may share a line.
napoleon_custom_sections = [("Attributes", "params_style")]
# Docstrings name classes and parameters in plain code style.
default_role = "code"
suppress_warnings = ["ref.python"]

html_theme = "furo"
html_math_renderer = "mathml"
html_title = "mp_pca_planner"
html_static_path = ["style"]
html_css_files = ["site.css"]
exclude_patterns = ["_build"]


def setup(app):
    """Write the generated pages; render equations as MathML, without network."""
    reference.write_pages(Path(app.srcdir) / "reference")
    inline, block = render(as_block=False), render(as_block=True)
    app.add_html_math_renderer("mathml", (inline, None), (block, None))


def render(*, as_block):
    """A function that writes an equation into the page of a translator."""

    def visit(translator, node):
        translator.body.append(tex2mathml(node.astext(), as_block=as_block))
        raise SkipNode

    return visit
