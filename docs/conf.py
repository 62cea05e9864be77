"""The documentation site: `sphinx-build -W --keep-going -b html docs docs/_build`. Needs no network."""

import gc
import importlib.metadata
import inspect
import sys
import tomllib
from itertools import zip_longest
from pathlib import Path
from typing import get_origin
from urllib.request import urlopen

from bs4 import BeautifulSoup  # which comes with furo
from docutils import nodes
from latex2mathml.converter import convert
from sphinx.transforms import SphinxTransform
from sphinx.util.inspect import stringify_signature

gc.set_threshold(100_000, 20, 100)  # trees of millions of nodes stay: looking through them takes a sixth of the time
HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "examples")]  # the demo draws a building
from demo import build as build_demo  # noqa: E402
from options import write_pages  # noqa: E402

project = "dirl"
author = "The dirl authors"
project_copyright = "the dirl authors, MIT licence"
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.intersphinx",
    "sphinx_copybutton",
    "sphinx_design",
]
myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 3
default_role = "py:obj"  # a name in single backticks is a link where it is known, else code
autodoc_default_options = {"members": True, "show-inheritance": True}
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
maximum_signature_line_length = 80
exclude_patterns = ["_build", "_cache", "_demo", "results"]  # reports, which other pages include
# `sphinx-build -b linkcheck docs docs/_build` asks other hosts, so it is run by hand; its output.txt lists every
# external link. The tests check links and anchors within the site.
linkcheck_timeout, linkcheck_retries, linkcheck_workers = 15, 2, 4
linkcheck_anchors = False  # many hosts make anchors by JavaScript
linkcheck_allowed_redirects = {r"https://doi\.org/.*": r"https://.*"}
html_theme = "furo"
html_title = f"dirl {importlib.metadata.version('dirl')}"
html_favicon = "_static/favicon.svg"
repository = tomllib.loads((HERE.parent / "pyproject.toml").read_text())["project"]["urls"].get("Repository")
if repository and "example.org" not in repository:  # links to the repository, and to the source of each page
    html_theme_options = {"source_repository": repository, "source_branch": "main", "source_directory": "docs/"}
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_use_index = False  # of twenty screens; the search finds the same
html_math_renderer = "mathml"  # written into the pages: MathJax would come from another host

PHONE = 44
"""Characters that a table has room for on a phone."""

MANUALS = {
    "torchrl": "https://docs.pytorch.org/rl/stable/",
    "tensordict": "https://docs.pytorch.org/tensordict/stable/",
    "torch": "https://docs.pytorch.org/docs/stable/",
    "gymnasium": "https://gymnasium.farama.org/",
    "numpy": "https://numpy.org/doc/stable/",
    "python": "https://docs.python.org/3/",
}


def inventories(folder: Path) -> dict[str, tuple[str, str]]:
    """The manuals that can be linked to from here; without a network none, and the site lacks those links."""
    folder.mkdir(parents=True, exist_ok=True)
    found = {}
    for name, address in MANUALS.items():
        file = folder / f"{name}.inv"
        if not file.exists():
            try:
                with urlopen(f"{address}objects.inv", timeout=3) as answer:
                    inventory = answer.read()
            except OSError:
                break  # no network: do not wait for the others
            if not inventory.startswith(b"# Sphinx inventory"):  # as from a network that asks for a login first
                break
            file.write_bytes(inventory)
        found[name] = (address, str(file))
    return found


intersphinx_mapping = inventories(HERE / "_cache" / "inventories")


def _inline(translator, node):
    translator.body.append(convert(node.astext()))
    raise nodes.SkipNode


def _block(translator, node):
    equation, _, number = node.astext().partition(r"\tag")
    number = f"<span>({number.strip('{}')})</span>" if number else ""
    translator.body.append(f'<div class="equation">{convert(equation, display="block")}{number}</div>')
    raise nodes.SkipNode


def public_name(cls):
    """The name that users import a class by, which manuals list: ``torch.nn.Module``, not ``torch.nn.modules...``."""
    cls = get_origin(cls) or cls
    parts = cls.__module__.split(".")
    prefixes = (".".join(parts[:length]) for length in range(1, len(parts) + 1))
    found = (name for name in prefixes if getattr(sys.modules.get(name), cls.__name__, None) is cls)
    module = next(found, cls.__module__)  # some classes are members of none, e.g. those made in a function
    return cls.__name__ if module == "builtins" else f"{module}.{cls.__name__}"


def _bases(app, name, obj, options, bases):
    bases[:] = [f":py:class:`{public_name(base)}`" for base in bases]


def _signature(app, what, name, obj, options, signature, returned):
    """TorchRL's metaclasses hide what their classes are made with."""
    if what == "class" and signature == "(*args, **kwargs)":
        hidden = inspect.signature(obj.__init__)
        parameters = [parameter for name, parameter in hidden.parameters.items() if name != "self"]
        signature = stringify_signature(hidden.replace(parameters=parameters), unqualified_typehints=True)
        return signature.removesuffix(" -> None"), returned
    return None


class VectorFigures(SphinxTransform):
    """Shows a figure as SVG where a report has written one beside the PNG that it names."""

    default_priority = 200  # before images are collected

    def apply(self, **_):
        """Replace the addresses of such images."""
        for image in self.document.findall(nodes.image):
            vector = Path(image["uri"]).with_suffix(".svg")
            if (HERE / vector).is_file():
                image["uri"] = str(vector)


def write_demo(app, folder, page):
    """Build the live demo beside the pages, and the page that leads to it; where that is not possible it says why."""
    try:
        if app.tags.has("without_demo"):
            raise RuntimeError("it was asked for without")
        pages = build_demo(folder, HERE / "_cache" / "demo")
        links = [f'<a href="demo/{file.name}">{file.stem.removeprefix("viewer_")}</a>' for file in pages]
        where = f"```{{raw}} html\n<p><b>Open it</b>: {', '.join(links)}</p>\n```"
        app.tags.add("demo")
    except RuntimeError as error:
        print(f"the site has no live demo: {error}")
        where = f"*This copy of the site was built without the demo: {error}.*"
    text = (HERE / "_demo" / "page.md").read_text().replace("{{ where }}", where)
    if not page.exists() or page.read_text() != text:
        page.write_text(text)


def stack_tables(app, pagename, templatename, context, doctree):
    """Give the cells of a table that is wider than a phone their headings, under which site.css stacks them there."""
    if "<table" not in context.get("body", ""):
        return
    soup = BeautifulSoup(context["body"], "html.parser")
    for table in soup.find_all("table", class_="docutils"):
        cells = [row.find_all(["th", "td"]) for row in table.find_all("tr")]
        rows = [[cell.get_text().replace("\n", " ").strip(" ") for cell in row] for row in cells]
        columns = zip_longest(*rows, fillvalue="")
        longest = [max(max(map(len, text.split(" ")), default=0) for text in column) for column in columns]
        if "rows" in table["class"] or not table.thead or sum(longest) + 2 * len(longest) < PHONE:
            continue
        table["class"].append("stacked")
        if max(len(text) for row in rows[1:] for text in row[1:]) > PHONE:
            table["class"].append("sentences")
        for row in table.tbody.find_all("tr"):
            for heading, cell in zip(rows[0], row.find_all(["th", "td"]), strict=False):
                if cell.get_text(strip=True):
                    cell["data-heading"] = heading
    context["body"] = str(soup)


def setup(app):
    """Write the page of options, render equations as MathML, show SVG, name classes as manuals do, stack tables."""
    app.connect("html-page-context", stack_tables)
    app.add_transform(VectorFigures)
    app.connect("autodoc-process-bases", _bases)
    app.connect("autodoc-process-signature", _signature)
    write_pages(HERE.parent / "conf", HERE)
    write_demo(app, Path(app.outdir) / "demo", HERE / "demo.md")
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
