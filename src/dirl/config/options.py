"""Fields of a dataclass of options: value and meaning are in `option`, type and bounds in the annotation.

Bounds are those of ``annotated_types``, ``Annotated[int, Ge(1)]`` or ``Annotated[float, Interval(ge=0, le=1)]``.
"""

import re
from dataclasses import field, fields, is_dataclass
from pathlib import Path
from typing import Any, get_type_hints

MISSING = "???"
"""OmegaConf's mark, whose import would take a tenth of a second."""


def option(meaning: str = "", default: object = MISSING) -> Any:
    """Return the field of an option.

    Args:
        meaning: in words, for ``--help`` and the page of all options.
        default: its value, a list, or a dataclass of options; without one the option must be given, or stands in
            ``conf/``.
    """
    metadata = {"meaning": meaning}
    if isinstance(default, list):
        return field(default_factory=lambda: list(default), metadata=metadata)
    if isinstance(default, type):
        return field(default_factory=default, metadata=metadata)
    return field(default=default, metadata=metadata)


def option_types(schema: type, prefix: str = "", *, bounds: bool = False) -> dict[str, Any]:
    """Return the types of all options by their dotted names; with ``bounds`` as they are annotated."""
    types: dict[str, Any] = {}
    for name, kind in get_type_hints(schema, include_extras=bounds).items():
        types[prefix + name] = kind
        if isinstance(kind, type) and is_dataclass(kind):
            types |= option_types(kind, f"{prefix}{name}.", bounds=bounds)
    return types


def meanings(schema: type, prefix: str = "") -> dict[str, str]:
    """Return what the options mean, by their dotted names."""
    texts, kinds = {}, get_type_hints(schema)
    for each in fields(schema):
        texts[prefix + each.name] = each.metadata.get("meaning", "")
        if isinstance(kinds[each.name], type) and is_dataclass(kinds[each.name]):
            texts |= meanings(kinds[each.name], f"{prefix}{each.name}.")
    return texts


def comments(file: Path) -> dict[str, str]:
    """Return the comments beside the options of a component's class in its file of ``conf/``."""
    return dict(re.findall(r"^ *(\w+):[^#\n]*#\s*(.+)$", file.read_text(encoding="utf-8"), re.MULTILINE))
