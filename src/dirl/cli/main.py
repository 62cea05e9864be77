"""The command ``dirl``, which runs the recipes from wherever the package is installed.

Nothing here imports torch, nor does `dirl.cli.start`: help and shell completion answer at once.
"""

import importlib.metadata
import os
import runpy
import sys
from collections.abc import Sequence
from pathlib import Path

from dirl.config.folders import HOME, RECIPES, VARIABLE

OTHERS = {
    "copy": "copy a recipe into a file of your own: dirl copy train my_train.py",
    "version": "versions, devices and built-in scenes, as a bug report needs them",
}

PACKAGES = ("dirl", "torch", "torchrl", "tensordict", "gymnasium", "hydra-core", "numpy", "h5py", "wandb")
"""Whose versions ``dirl version`` tells."""

HELP = """Target-driven visual navigation by deep imitation reinforcement learning.

    dirl train scene=bathroom_02
    dirl evaluate checkpoint=runs/dirl_bathroom_02/2026-01-31_12-00-00
    dirl copy train my_train.py

{commands}

dirl <command> --help tells the options of one. Shell completion: eval "$(dirl -sc install=bash)"
"""


def main() -> None:
    """Run the command that the command line names."""
    os.environ[VARIABLE] = "dirl"
    name, *arguments = sys.argv[1:] or ["--help"]
    if name in ("-sc", "--shell-completion"):
        complete([name, *arguments])
    elif name in ("-h", "--help", "help"):
        meanings = {name: meaning for name, (_, meaning) in RECIPES.items()} | OTHERS
        print(HELP.format(commands="\n".join(f"  {name:<10} {meaning}" for name, meaning in meanings.items())))
    elif name == "--version":
        print(importlib.metadata.version("dirl"))
    elif name == "version":
        versions()
    elif name == "copy":
        copy(arguments)
    elif name in RECIPES:
        run(name, arguments)
    else:
        from dirl.config.components import check_choice
        from dirl.runs.exits import one_line_exits

        with one_line_exits():
            check_choice(f"command '{name}'", name, [*RECIPES, *OTHERS])


def run(name: str, arguments: Sequence[str]) -> None:
    """Run a recipe as Python runs a script."""
    script = HOME / RECIPES[name][0]
    sys.argv = [str(script), *arguments]
    sys.path.insert(0, str(script.parent))
    runpy.run_path(str(script), run_name="__main__")


def complete(arguments: Sequence[str]) -> None:
    """Install shell completion, or answer the shell that has it: commands first, then a command's options."""
    before, *words = os.environ.get("COMP_LINE", "").split(" ")
    if not any(argument.startswith("query=") for argument in arguments):
        run("train", arguments)
    elif len(words) == 1:
        print(" ".join(name for name in [*RECIPES, *OTHERS] if name.startswith(words[0])))
    elif words and words[0] in RECIPES:
        if words[0] == "train":
            os.environ["COMP_LINE"] = " ".join([before, *words[1:]])  # as Hydra's script of one command has it
        run(words[0], arguments)


def versions() -> None:
    """Print installed packages, devices and built-in scenes, as a bug report needs them."""
    import platform

    print(f"Python {platform.python_version()} on {platform.platform()}, {os.cpu_count()} cores", flush=True)
    for package in PACKAGES:
        try:
            print(f"{package} {importlib.metadata.version(package)}")
        except importlib.metadata.PackageNotFoundError:
            print(f"{package} is not installed")

    import torch  # these take seconds

    from dirl.scenes import PUBLISHED_GOALS, load_scenes

    cuda = torch.cuda.get_device_name() if torch.cuda.is_available() else "none"
    print(f"\ndevice=cpu: {torch.get_num_threads()} threads\ndevice=cuda: {cuda}")
    print("\nbuilt-in scenes (source: rooms, synthetic):")
    for scene in load_scenes(list(PUBLISHED_GOALS)):
        print(f"  {scene.name}: {len(scene)} states, goals {', '.join(map(str, scene.goals))}")


def copy(arguments: Sequence[str]) -> None:
    """Copy a recipe, as ``dirl copy train my_train.py``; the copy runs anywhere, with the package's configuration."""
    copied = [name for name in RECIPES if name != "benchmark"]  # which times the loops of train.py
    if len(arguments) != 2 or arguments[0] not in copied:
        raise SystemExit(f"error: say which recipe to copy, and where to: dirl copy <{' | '.join(copied)}> my_copy.py")
    name, target = arguments[0], Path(arguments[1])
    if target.suffix != ".py":
        raise SystemExit(f"error: {target}: the name must end in .py")
    text = (HOME / RECIPES[name][0]).read_text(encoding="utf-8")
    try:
        with target.open("x", encoding="utf-8") as file:
            file.write(text.replace(f"python recipes/{name}.py", f"python {target}"))
    except FileExistsError:
        raise SystemExit(f"error: {target}: this file exists already; it is not overwritten") from None
    except OSError as error:
        raise SystemExit(f"error: {target}: {error.strerror}") from None
    print(f"copied: {target}; run it with: python {target}")


if __name__ == "__main__":
    main()
