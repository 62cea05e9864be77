"""The start of a recipe: help and most refusals, before anything imports torch."""

import contextlib
import gc
import io
import os
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import hydra
from hydra import compose, initialize_config_dir
from hydra.errors import MissingConfigException
from omegaconf import DictConfig, OmegaConf

from dirl.cli.command_line import choose_command, config_dirs, parsed, prepare, register
from dirl.cli.refusals import check_values
from dirl.config.conf_schemas import SCHEMAS, command_meanings
from dirl.config.meanings import entries, explained
from dirl.config.places import CONF, RECIPES, command
from dirl.config.schemas import ConfigError
from dirl.config.values import typed
from dirl.runs.errors import end_at_once, one_line_exits

HELP = ("-h", "--help")
COMPLETION = ("-sc", "--shell-completion")
SHOWING = (*COMPLETION, *HELP, "--hydra-help", "-c", "--cfg", "-i", "--info", "--version")
"""Options by which Hydra shows something and runs nothing."""

EXTRAS = {"joblib": "sweeps", "optuna": "optuna", "ray": "ray", "submitit_local": "slurm", "submitit_slurm": "slurm"}
"""Of dirl, by the launcher or sweeper of Hydra that they bring."""

TEMPLATE = """{header}
{groups}
== Options: name=value ==
{options}
{footer}
"""


def start(recipe: str, text: str | None = None) -> str:
    """Check the command line of a recipe and write it in Hydra's form, or answer a request for help.

    A recipe calls it before its other imports. Options are checked against their types and bounds, and paths and names
    are looked up (`dirl.cli.refusals`); options of components and what is in the files are checked later. Until
    `run_main` no garbage is collected: the imports make several hundred thousand objects that stay.

    Args:
        recipe: a key of `RECIPES`.
        text: of ``--help`` for a recipe with several commands.

    Returns:
        The name of its configuration: ``train``, or the command of ``recipes/scenes.py``.

    Raises:
        SystemExit: help was asked for, or the command line is refused.
    """
    # Threads of OpenMP that wait for each other spin, and beside other processes they wait for most of the time
    # (docs/performance.md). Read when torch is imported, also by the processes that this one starts.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    end_at_once()
    register()
    with one_line_exits():
        arguments = sys.argv[1:]
        name = recipe
        if recipe == "scenes":
            name, arguments = choose_command(command_meanings(), arguments, _as_called(text or ""))
        config = configuration(recipe, name)
        options = prepare(SCHEMAS[name], arguments, CONF if config == "train" else None)
        if any(argument in SHOWING for argument in options):
            print(shown(config, options), end="")
            raise SystemExit(0)
        _check_values(config, options)
    sys.argv[1:] = options
    gc.disable()
    return name


def run_main(main: Callable[[], Any]) -> None:
    """Run a recipe's function, decorated by Hydra; a refusal, or an error of the machine, ends it with one line.

    Raises:
        SystemExit: see `dirl.runs.errors`.
    """
    os.environ.setdefault("HYDRA_FULL_ERROR", "1")  # else Hydra tells errors in many lines
    gc.freeze()  # what the imports made is not looked through again
    gc.enable()
    with one_line_exits():
        main()


def run_recipe(recipe: str, main: Callable[[Any], None], name: str = "") -> None:
    """Run a recipe's function, or that of its command ``name``, with the dataclass of its options; see `run_main`."""

    def job(composed: DictConfig) -> None:
        with one_line_exits():  # Hydra would say something of its own about an error
            main(checked(config, composed))

    config = configuration(recipe, name or recipe)
    run_main(_by_hydra(config, job))


def _by_hydra(config: str, job: Callable[[DictConfig], None]) -> Callable[[], Any]:
    folder, _, name = config.rpartition("/")
    return hydra.main(version_base="1.3", config_path=str(CONF / folder), config_name=name)(job)


def configuration(recipe: str, name: str) -> str:
    """The configuration of a recipe, or of one of its commands, as a path below `CONF` without ending."""
    return f"{recipe}/{name}" if (CONF / recipe / f"{name}.yaml").is_file() else name


def _check_values(config: str, options: Sequence[str]) -> None:
    """Check the composed values of a single run; those of a sweep are checked job by job."""
    if any(option.startswith(("--config-name", "-cn", "--config-path", "-cp")) for option in options):
        return
    composed = _compose(config, options)
    given = [(option, found) for option in options if (found := parsed(option))]
    if any(found.is_sweep_override() for _, found in given):
        return
    overrides = [option for option, found in given if not found.key_or_group.startswith("hydra")]
    checked(config, composed, overrides)


def checked(config: str, composed: DictConfig, overrides: Sequence[str] = ()) -> Any:
    """The options of a recipe, see `configuration`, as a dataclass.

    Raises:
        ValueError: one is missing or cannot be used; the message says why in one line.
    """
    for name in map(str, composed):
        if OmegaConf.is_missing(composed, name):
            raise ConfigError(f"{name} must be given: {entries(CONF / f'{config}.yaml')[name][1]}")
    options = typed(composed)
    check_values(Path(config).name, options, overrides)
    return options


def _compose(config: str, options: Sequence[str], **kwargs: Any) -> DictConfig:
    folder, _, name = config.rpartition("/")
    folders = ",".join(f"file://{path.resolve()}" for path in config_dirs(options))
    given = [option for option in options if (found := parsed(option)) and not found.is_sweep_override()]
    with initialize_config_dir(str(CONF / folder), version_base="1.3"):
        try:
            return compose(name, [*given, *([f"hydra.searchpath=[{folders}]"] if folders else [])], **kwargs)
        except MissingConfigException as error:
            missing = re.search(r"'hydra/(?:launcher|sweeper)/(\w+)'[.\s]", str(error))
            if missing is None or missing[1] not in EXTRAS:
                raise
            needs = f"'{missing[1]}', which is not installed: pip install 'dirl[{EXTRAS[missing[1]]}]'"
            raise ConfigError(f"{' '.join(options)}: needs Hydra's {needs}") from None


def shown(config: str, options: Sequence[str]) -> str:
    """The answer to ``--help``, ``--cfg job`` or a shell's completion."""
    return _as_called(_help(config, options) if any(one in HELP for one in options) else _ask_hydra(config, options))


def _as_called(text: str) -> str:
    """A text with the recipes as the user calls them."""
    for recipe, (file, _) in RECIPES.items():
        text = text.replace(f"python {file}", command(recipe))
    return text


def _help(config: str, options: Sequence[str]) -> str:
    """The text of Hydra's help, whose own form lists Hydra's groups too and takes a second."""
    composed = _compose(config, options, return_hydra_config=True)
    told = composed.hydra.help
    groups: dict[str, set[str]] = {}
    for folder in [CONF, *config_dirs(options)] if config == "train" else []:
        for file in folder.glob("*/*.yaml"):
            if file.parent.name not in RECIPES:
                groups.setdefault(file.parent.name, set()).add(file.stem)
    listed = "".join(f"{group}: {', '.join(sorted(choices))}\n" for group, choices in sorted(groups.items()))
    values = OmegaConf.to_yaml(OmegaConf.masked_copy(composed, [str(key) for key in composed if key != "hydra"]))
    listed = f"\n== Groups: group=choice ==\n{listed}" if listed else ""
    values = explained(values, _files(config, composed.hydra.runtime.choices, options))
    return TEMPLATE.format(header=told.header, groups=listed, options=values, footer=told.footer.rstrip())


def _files(config: str, choices: Mapping[str, str], options: Sequence[str]) -> list[Path]:
    """A configuration after the files of its groups that it does not choose, and before those that it chooses."""
    chosen = {group: name for group, name in choices.items() if not group.startswith("hydra")}
    groups = [folder / group for group in chosen for folder in [CONF, *config_dirs(options)]]
    files = [file for group in groups for file in sorted(group.glob("*.yaml"))]
    others = [file for file in files if file.stem != chosen[file.parent.name]]
    return [*others, CONF / f"{config}.yaml", *(file for file in files if file not in others)]


def _ask_hydra(config: str, options: Sequence[str]) -> str:
    sys.argv = [sys.argv[0], *options]
    told = io.StringIO()
    with contextlib.redirect_stdout(told), contextlib.suppress(SystemExit):
        _by_hydra(config, lambda _: None)()
    return told.getvalue()
