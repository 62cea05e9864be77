"""The documentation site: `sphinx-build -W --keep-going -b html docs docs/_build`. Needs no network."""

import sys
from pathlib import Path

from docutils import nodes
from latex2mathml.converter import convert

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))
from options import write_page  # noqa: E402

project = "dirl"
author = "The dirl authors"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_enable_extensions = ["dollarmath"]
default_role = "code"
autodoc_member_order = "bysource"
autodoc_typehints = "none"
exclude_patterns = ["_build"]
html_theme = "furo"
html_math_renderer = "mathml"  # written into the pages: MathJax would come from another host


def _inline(translator, node):
    translator.body.append(convert(node.astext()))
    raise nodes.SkipNode


def _block(translator, node):
    translator.body.append(convert(node.astext(), display="block"))
    raise nodes.SkipNode


def setup(app):
    """Write the page of options, and render equations as MathML."""
    write_page(HERE.parent / "conf", HERE / "configuration.md")
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
