"""``python -m dirl`` is the command ``dirl``; without arguments ``dirl version``, as a bug report needs it."""

import sys

from dirl.cli.main import main

if __name__ == "__main__":
    sys.argv[1:] = sys.argv[1:] or ["version"]
    main()
