"""Values of options: checked against their types and bounds, and told in words."""

import difflib
from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from dirl.config.options import option_types
from dirl.config.schemas import ConfigError

if TYPE_CHECKING:
    from pydantic import ValidationError


def typed(config: DictConfig) -> Any:
    """Return the dataclass of a composed configuration.

    Raises:
        ConfigError: a value is missing, of the wrong type, or outside its limits.
    """
    try:
        made = OmegaConf.to_object(config)
        for name, value in config.items():
            if isinstance(value, DictConfig) and OmegaConf.get_type(value) is dict:  # plain, also what is interpolated
                setattr(made, str(name), OmegaConf.to_container(value, resolve=True, enum_to_str=True))
    except OmegaConfBaseException as error:
        raise ConfigError(f"{error.full_key or 'an option'}: {str(error).splitlines()[0]}") from None
    scene = OmegaConf.select(config, "scene")
    for one in scene if OmegaConf.is_list(scene) else [scene]:
        if one is not None and not isinstance(one, str):
            raise ConfigError(f"scene={scene}: must be a name, a path, or a list of them")
    kinds = option_types(type(made), bounds=True)
    for name, value in leaves(OmegaConf.to_container(config, resolve=True)).items():
        if type(value) in (int, float):  # of other values OmegaConf has checked the types
            check_value(name, value, kinds.get(name, int | float))
    return made


def check_choice(told: str, given: str, choices: Collection[str], prefix: str = "") -> None:
    """Raise `ConfigError` unless there is such a choice; ``told`` is what there is not."""
    if given not in choices:
        near = difflib.get_close_matches(given, choices, n=1)
        hint = f"did you mean {prefix}{near[0]}?" if near else f"choose from {', '.join(choices) or 'none'}"
        raise ConfigError(f"there is no {told}; {hint}")


def names(option: str, value: object) -> list[str]:
    """Return the names that an option gives, one or a list of them; `ConfigError` if it gives something else."""
    given = value if isinstance(value, list) else [value]
    if not given or not all(isinstance(one, str | int) and not isinstance(one, bool) for one in given):
        raise ConfigError(f"{option}={value}: must be the name of a file or a folder, or a list of them")
    return [str(one) for one in given]


def plain(config: object) -> dict[str, Any]:
    """Return a typed configuration as nested values, without ``out``, ``resume`` and ``trust`` of its start."""
    values: Any = OmegaConf.to_container(OmegaConf.structured(config), resolve=True, enum_to_str=True)
    return {**values, "out": None, "resume": None, "trust": None}


def leaves(config: Any, prefix: str = "") -> dict[str, Any]:
    """Return the values of a nested configuration by dotted name; goals and lists are values."""
    found: dict[str, Any] = {}
    for name, value in config.items():
        inside = isinstance(value, Mapping) and name != "goals"
        found |= leaves(value, f"{prefix}{name}.") if inside else {f"{prefix}{name}": value}
    return found


def check_value(name: str, value: object, annotation: Any) -> None:
    """Check one plain value against an annotation by pydantic, which takes it as JSON: true is no number.

    Raises:
        ConfigError: it does not fit.
    """
    from pydantic import PydanticUserError, TypeAdapter, ValidationError  # late: help does without
    from pydantic_core import to_json

    rules: Any = {"strict": True, "allow_inf_nan": False, "arbitrary_types_allowed": True}
    try:
        TypeAdapter(annotation, config=rules).validate_json(
            to_json(value, inf_nan_mode="constants", serialize_unknown=True)
        )
    except PydanticUserError:  # the annotation has a name that is only imported for type checkers
        return
    except ValidationError as error:
        raise ConfigError(f"{name}={'null' if value is None else value}: {first_error(error)}") from None


def first_error(error: "ValidationError") -> str:
    """Return the first error of a validation in one line: where in the value it is, and what must be there."""
    first = error.errors(include_url=False, include_input=False)[0]
    if first["type"] == "needs_python_object":
        return "must be an object of Python, which no option can be"
    where = "".join(f"[{part}]: " if isinstance(part, int) else f"{part}: " for part in first["loc"])
    what = first["msg"].replace("Input should", "must").replace("Field required", "is missing")
    return " ".join(f"{where}{what}".split())  # keys of a file can have more than one line
