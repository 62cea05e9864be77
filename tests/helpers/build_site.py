"""`sphinx-build` as a program for `commands.start_recipe`, without half of the work, at which no test looks.

The comments of other packages' modules are not read, the tree of all pages stands beside the front page alone, and
the search finds that page alone.
"""

import sys

import furo
from sphinx.builders.html import StandaloneHTMLBuilder as Builder
from sphinx.cmd.build import main
from sphinx.errors import PycodeError
from sphinx.pycode import ModuleAnalyzer

read, tree, index = ModuleAnalyzer.for_module, furo._compute_navigation_tree, Builder.index_page


def read_ours(module):
    """Read the comments of a module of dirl."""
    if module.partition(".")[0] != "dirl":
        raise PycodeError(f"{module} is not of dirl")
    return read(module)


if __name__ == "__main__":
    ModuleAnalyzer.for_module = read_ours
    furo._compute_navigation_tree = lambda context: tree(context) if context["pagename"] == "index" else ""
    Builder.index_page = lambda self, page, *content: index(self, page, *content) if page == "index" else None
    sys.exit(main(sys.argv[1:]))
