"""Where the recipes and their configuration are, and how the user calls a recipe."""

import os
import sys
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1]

HOME = PACKAGE if (PACKAGE / "recipes").is_dir() else PACKAGE.parents[1]
"""The folder of ``recipes`` and ``conf``: the package itself in a wheel, else the repository."""

CONF = HOME / "conf"

VARIABLE = "DIRL_COMMAND"
"""Of the environment, so that the jobs of a sweep know it too: set where the command ``dirl`` was used."""


RECIPES = {
    "train": ("recipes/train.py", "train an agent to find its goals"),
    "evaluate": ("recipes/evaluate.py", "evaluate trained weights"),
    "scenes": ("recipes/scenes.py", "take, build, convert, encode and check scenes"),
    "report": ("recipes/report.py", "write a table or figure of the paper from finished runs"),
    "map": ("recipes/map.py", "make a map of a first-person video"),
    "go": ("recipes/go.py", "find the way to a photo by such a map"),
    "benchmark": ("recipes/benchmark.py", "measure the speed of training and evaluation on this machine"),
}
"""The file of each recipe below `HOME`, and what it does."""


def command(name: str, *, running: bool = False) -> str:
    """Return how the user calls a recipe, ``dirl train`` or ``python recipes/train.py``, to say what to run next.

    The program that is ``running`` now may be a copy under another name.
    """
    if VARIABLE in os.environ:
        return f"dirl {name}"
    script = sys.argv[0] if running and sys.argv[0].endswith(".py") and not os.path.isabs(sys.argv[0]) else None
    return f"python {script or RECIPES[name][0]}"
