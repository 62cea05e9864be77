"""Help and shell completion: what options a recipe has, with values and meanings; without its imports."""

import contextlib
import io
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NoReturn

import hydra
from omegaconf import OmegaConf

from dirl.cli.parsing import compose_training
from dirl.config.folders import CONF, RECIPES, VARIABLE, command
from dirl.config.schemas import TrainConfig, comments, meanings, option_types


def show_commands(text: str, schemas: Mapping[str, type]) -> NoReturn:
    """Print the commands of a recipe, and end."""
    lines = [f"  {name:<10} {(schema.__doc__ or '').splitlines()[0]}" for name, schema in schemas.items()]
    _end(f"{text.strip()}\n\n" + "\n".join(lines) + "\n\n<command> --help tells the options of one.\n")


def complete(schema: type | Mapping[str, type]) -> NoReturn:
    """Print what the last word of the shell's line may become, and end."""
    *before, last = os.environ["COMP_LINE"].split(" ")
    if isinstance(schema, Mapping) and len(before) > 2:  # dirl scenes <command>
        schema = schema.get(before[2], {})
    names = list(schema) if isinstance(schema, Mapping) else [f"{name}=" for name in option_types(schema)]
    _end(" ".join(name for name in names if name.startswith(last)) + "\n")


def show(text: str, schema: type | None, arguments: Sequence[str]) -> NoReturn:
    """Print the help of a recipe or of a command, or what another flag of Hydra shows of a training, and end."""
    if schema is not None:
        values = OmegaConf.to_container(OmegaConf.structured(schema), enum_to_str=True)
        _end(f"{_unindented(text)}\n\n== Options: name=value ==\n{explained(values, meanings(schema))}")
    if not {"-h", "--help"} & set(arguments):
        _end(_ask_hydra(arguments))
    given = [argument for argument in arguments if not argument.startswith("-")]
    composed = compose_training(given, return_hydra_config=True)
    choices = composed.hydra.runtime.choices
    explanations = meanings(TrainConfig)
    for group in choices:
        file = CONF / group / f"{choices[group]}.yaml"
        if file.is_file() and group != "hydra":
            explanations |= {f"{group}.{name}": meaning for name, meaning in comments(file).items()}
    groups = [folder for folder in sorted(CONF.iterdir()) if folder.is_dir() and folder.name != "hydra"]
    listed = [f"{group.name}: {', '.join(sorted(file.stem for file in group.glob('*.yaml')))}\n" for group in groups]
    values = OmegaConf.to_container(
        OmegaConf.masked_copy(composed, [str(key) for key in composed if key != "hydra"]),
        resolve=False,
        enum_to_str=True,
    )
    options = f"== Options: name=value ==\n{explained(values, explanations)}"
    _end(f"{_unindented(text)}\n\n== Groups: group=choice ==\n{''.join(listed)}\n{options}")


def explained(values: Any, text: Mapping[str, str]) -> str:
    """Return nested values as lines of YAML, each with what it means beside it."""
    return "".join(f"{line:<36}  # {text[name]}\n" if text.get(name) else f"{line}\n" for line, name in _lines(values))


def _lines(values: Mapping[str, object], name: str = "", indent: str = "") -> Iterator[tuple[str, str]]:
    """Yield each line of nested values as YAML, with its option's dotted name."""
    for key, value in values.items():
        full = f"{name}.{key}" if name else key
        if isinstance(value, Mapping) and value:
            yield f"{indent}{key}:", full
            yield from _lines(value, full, f"{indent}  ")
        else:
            yield f"{indent}{key}: {shown(value)}", full


def shown(value: object) -> str:
    """Return a value as it is written on a command line."""
    if isinstance(value, list):
        return f"[{', '.join(map(shown, value))}]"
    return "null" if value is None else str(value).lower() if isinstance(value, bool) else str(value)


def _ask_hydra(arguments: Sequence[str]) -> str:
    """Return what Hydra prints for a flag that shows something."""
    sys.argv = ["dirl" if VARIABLE in os.environ else sys.argv[0], *arguments]  # what a shell's script completes
    output = io.StringIO()
    main = hydra.main(version_base="1.3", config_path=str(CONF), config_name="train")(lambda _: None)
    with contextlib.redirect_stdout(output), contextlib.suppress(SystemExit):
        main()
    return output.getvalue()


def _unindented(text: str) -> str:
    return "\n".join(line.removeprefix("    ") for line in text.strip().splitlines())


def _end(text: str) -> NoReturn:
    """Print a text with the recipes as the user calls them, and end."""
    for recipe, (file, _) in RECIPES.items():
        text = text.replace(f"python {file}", command(recipe))
    print(text, end="")
    raise SystemExit(0)
