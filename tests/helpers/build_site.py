"""`sphinx-build` as a program for `commands.start_recipe`."""

import sys

from sphinx.cmd.build import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
