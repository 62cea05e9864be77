"""The pages of all options, from the types and meanings in `dirl.config` and the recipes, and the values in conf/."""

import importlib
import sys
from dataclasses import fields, is_dataclass
from enum import EnumMeta
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin

import yaml
from omegaconf import OmegaConf

from dirl.cli.help import shown
from dirl.config.components import GROUPS, TARGET, class_parameters, find_class
from dirl.config.files import leaves
from dirl.config.schemas import MISSING, Schedule, TrainConfig, Weight, comments, meanings, option_types

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "recipes"))

CHOICES = ("system", "preset", "goal_view", "source", "logger")
"""The folders of conf/ that hold files to choose from, besides those of components."""

COMPONENTS = (
    "observation",
    "encoder",
    "memory",
    "episodic_memory",
    "recogniser",
    "heads",
    "policy",
    "expert",
    "objective",
    "losses",
    "optimiser",
)
"""The folders of conf/ whose files name a class and its options."""

RECIPES = ("evaluate", "report", "map", "go", "benchmark")
"""The recipes whose options are in one dataclass each."""

DEFAULTS = ("source/rooms", "objective/a2c", "system/dirl", "logger/csv")
"""Chosen where nothing is said, besides preset/fast, which has a word of its own in the table."""

WORDS = {str: "text", int: "integer", float: "number", bool: "true / false", Any: "text or list", type(None): "null"}

ROWS = "```{rst-class} rows\n```\n"
"""Before a table: narrow screens show it as a list, see _static/site.css."""

INTRODUCTION = """\
An option is given as `name=value` behind the recipe: `python recipes/train.py scene=all encoder.width=256`. Where a
value follows the word *fast* or *paper*, the preset of that name sets it (`preset=paper`; `fast` is the default); both
can be overridden one by one. These pages are written by `docs/options.py` from the types in `src/dirl` and the values
in `conf/` when the site is built: besides the options of `recipes/train.py` below those of its
[components](configuration_components.md), of [the other recipes](configuration_recipes.md), and of
[`recipes/scenes.py`](configuration_scenes.md).
"""


COMPONENTS_TEXT = """\
A component is a class with its options: `encoder=siamese` chooses a file of `conf/encoder`, `encoder.width=256` sets
an option of its class, and `encoder._target_=my_package.MyEncoder` names another class. An option that the class takes
and the file does not list is given in the same way. Types and bounds are those of the class's constructor.
"""

MEANINGS = {
    "entropy_coeff": "weight of the entropy bonus",
    "critic_coeff": "weight of the critic's loss",
    "loss_critic_type": "the critic's error: `l2`, `l1` or `smooth_l1`",
    "reduction": "of the losses over the frames of an update",
}
"""What options mean whose value, an interpolation, leaves no room for a comment."""


def words(kind: Any) -> str:
    """The type of an option for people."""
    if isinstance(kind, EnumMeta):
        return " / ".join(kind)
    if kind in WORDS:
        return WORDS[kind]
    if kind in (Schedule, Weight):
        return "number, or from the first frame to the last"
    inside = get_args(kind)
    return " or ".join(map(words, inside)) if type(None) in inside else "list"


def groups(schema: type) -> dict[str, tuple[str, dict[str, str]]]:
    """What each group of a schema is, and the types of its options by dotted name; "" holds those of no group."""
    found: dict[str, tuple[str, dict[str, str]]] = {"": ("", {})}
    types = option_types(schema)
    for option in fields(schema):
        kind: Any = option.default_factory
        if is_dataclass(kind):
            inside = {
                f"{option.name}.{field.name}": words(types[f"{option.name}.{field.name}"]) for field in fields(kind)
            }
            found[option.name] = ((kind.__doc__ or "").rstrip("."), inside)
        else:
            if option.name not in GROUPS:
                found[""][1][option.name] = words(types[option.name])
    return found


def table(options: dict[str, str], values: dict[str, dict[str, Any]], meaning: dict[str, str]) -> list[str]:
    """A Markdown table, a row an option, with values under a word to tell them by ("" for plain ones)."""
    lines = [ROWS, "| option | value | meaning |", "|---|---|---|"]
    for name, kind in options.items():
        here = [f"{word} `{shown(of_word[name])}`".strip() for word, of_word in values.items() if name in of_word]
        told = all(choice in meaning[name] for choice in kind.split(" / "))  # a meaning that lists the choices
        cells = [f"`{name}`" if told else f"`{name}` <small>{kind}</small>", "<br>".join(here), meaning[name]]
        lines.append("| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |")
    return [*lines, ""]


def file_values(file: Path) -> dict[str, Any]:
    """The values that a file of conf/ sets, by dotted name; those of a group by that of the group."""
    text = file.read_text()
    values = yaml.safe_load(text) or {}
    found = leaves({key: value for key, value in values.items() if key not in ("defaults", "hydra")})
    for name in [name.removesuffix(".start") for name in found if name.endswith(".start")]:
        found[name] = f"{{start:{found[f'{name}.start']},end:{found[f'{name}.end']}}}"
    in_group = file.parent.name != "conf" and "@package _global_" not in text
    return {f"{file.parent.name}.{name}": value for name, value in found.items()} if in_group else found


def choices(conf: Path) -> list[str]:
    """A Markdown table of the files to choose from, but for the presets, and what each sets."""
    lines = [ROWS, "| choice | sets |", "|---|---|"]
    for group in CHOICES:
        for file in sorted((conf / group).glob("*.yaml")):
            if group != "preset":
                values = [f"`{name}={shown(value)}`" for name, value in file_values(file).items()]
                lines.append(f"| `{group}={file.stem}` | {', '.join(values)} |")
    return [*lines, ""]


def component_tables(conf: Path) -> list[str]:
    """What there is to choose from for each component, with the options of its class."""
    lines = []
    for group in COMPONENTS:
        lines += [f"## {group}", ""]
        for file in sorted((conf / group).glob("*.yaml")):
            head = [line[2:] for line in file.read_text().splitlines() if line.startswith("# ") and "@" not in line]
            values = yaml.safe_load(file.read_text())
            named = values.get("losses", {}) if group == "objective" else values if group == "losses" else {"": values}
            target = next((options[TARGET] for options in named.values()), None)
            lines += [f"`{group}={file.stem}`" + (f", `{target}`. " if target else ". ") + " ".join(head), ""]
            for name, options in named.items():
                lines += component_rows(file, group, name, options)
    return lines


def component_rows(file: Path, group: str, name: str, options: dict[str, Any]) -> list[str]:
    """The options of one component: those that its file sets, then the others of its class."""
    target = options[TARGET]
    if target is None:
        return []
    full = f"losses.{name}" if name else group
    kinds = {name: kind for name, (kind, _) in class_parameters(find_class(full, target)).items()}
    told = comments(file)
    lines = []
    for option, value in options.items():
        if option != TARGET:
            kind = "number" if option == "weight" else annotated(kinds.get(option, Any))
            cells = [f"`{full}.{option}` <small>{kind}</small>", f"`{shown(value)}`"]
            lines.append("| " + " | ".join([*cells, told.get(option) or MEANINGS.get(option, "")]) + " |")
    return [ROWS, "| option | value | meaning |", "|---|---|---|", *lines, ""] if lines else []


def annotated(kind: Any) -> str:
    """A type from a constructor's signature, with its bounds."""
    plain, *bounds = get_args(kind) if get_origin(kind) is Annotated else (kind,)
    kinds = [one for one in get_args(plain) if one in WORDS] or [plain]
    text = " or ".join(WORDS.get(one, "text or list") for one in kinds)
    return ", ".join([text, *map(str, bounds)])


def recipe_table(schema: type) -> list[str]:
    """The table of the options of a recipe, or of a command."""
    kinds = option_types(schema)
    plain = {name: words(kind) for name, kind in kinds.items() if not is_dataclass(kind)}
    values = leaves(OmegaConf.to_container(OmegaConf.structured(schema), enum_to_str=True))
    given = {name: value for name, value in values.items() if value != MISSING}
    return table(plain, {"": given}, meanings(schema))


def write_pages(conf: Path, folder: Path) -> None:
    """Write the pages that would change: of a training, of its components, of the other recipes, of scenes.py."""
    common = [conf / "train.yaml", *(conf / f"{name}.yaml" for name in DEFAULTS)]
    files = {"": common, "fast": [conf / "preset/fast.yaml"], "paper": [conf / "preset/paper.yaml"]}
    values = {word: {k: v for file in of_word for k, v in file_values(file).items()} for word, of_word in files.items()}
    training = ["# Every option", "", INTRODUCTION]
    for group, (meaning, options) in groups(TrainConfig).items():
        if group:
            meaning = meaning[0].lower() + meaning[1:]
            training += [f"## {group}" if meaning == f"the {group}" else f"## {group}: {meaning}", ""]
        training += table(options, values, meanings(TrainConfig))
    training += ["## What a choice sets", "", *choices(conf)]
    others = ["# Options of the other recipes", ""]
    for recipe in RECIPES:
        others += [f"## recipes/{recipe}.py", "", *recipe_table(importlib.import_module(recipe).Options)]
    scenes = ["# Options of recipes/scenes.py", ""]
    for command, schema in importlib.import_module("scenes").OPTIONS.items():
        scenes += [f"## {command}", "", *recipe_table(schema)]
    pages = {
        "configuration": training,
        "configuration_components": ["# Options of components", "", COMPONENTS_TEXT, *component_tables(conf)],
        "configuration_recipes": others,
        "configuration_scenes": scenes,
    }
    for name, lines in pages.items():
        page, text = folder / f"{name}.md", "\n".join(lines)
        if not page.exists() or page.read_text() != text:
            page.write_text(text)
