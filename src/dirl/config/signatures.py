"""The parameters of a constructor, from a class, or from its source without importing torch."""

import ast
import importlib.util
import inspect
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, Literal

from dirl.config.bounds import Bounds

Parameters = dict[str, tuple[Any, bool]]
"""By name: the annotation, and whether it must be given."""


class Tensor:
    """Stands for torch's in annotations, ``float | Tensor``."""


NAMES = {
    **{kind.__name__: kind for kind in (int, float, bool, str, list, dict, tuple)},
    **{"Annotated": Annotated, "Any": Any, "Bounds": Bounds, "Literal": Literal, "Tensor": Tensor},
    **{"Callable": Callable, "Mapping": Mapping, "Sequence": Sequence},
}
"""What an annotation is understood in; one with any other name stands for any value."""


def class_parameters(cls: type) -> Parameters:
    """The named parameters of a class's constructor; ``**kwargs`` stands for those of its bases.

    What a base needs is not required: the class itself may give it.
    """
    found: Parameters = {}
    for owner in cls.__mro__:
        if "__init__" not in vars(owner):
            continue
        above = _signature(owner)
        found = {**{name: (kind, needed and not found) for name, (kind, needed) in above.items()}, **found}
        if not any(p.kind is p.VAR_KEYWORD for p in inspect.signature(vars(owner)["__init__"]).parameters.values()):
            break
    return found


def _signature(owner: type) -> Parameters:
    """The named parameters of the constructor that a class defines: annotation, and whether one must be given."""
    constructor = vars(owner)["__init__"]  # TorchRL's metaclasses hide the class's own signature
    try:
        hints = typing.get_type_hints(constructor, include_extras=True)
    except (NameError, TypeError):  # a name that is only imported for type checkers
        hints = {}
    return {
        name: (hints.get(name, Any), parameter.default is parameter.empty)
        for name, parameter in list(inspect.signature(constructor).parameters.items())[1:]
        if parameter.kind in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY)
    }


def read_parameters(target: str) -> Parameters | None:
    """The named parameters of a class's constructor; ``**kwargs`` stands for those of its bases.

    Nothing is imported or run: neither the class nor the packages that hold it.

    Args:
        target: the class, ``package.module.Class``; modules may import it from one another.

    Returns:
        The parameters, or None where the source does not tell them.
    """
    module, _, name = target.rpartition(".")
    found = _find_class(module, name)
    return None if found is None else _parameters(*found)


def _find_class(module: str, name: str, hops: int = 9) -> tuple[str, ast.ClassDef] | None:
    """A class and the module that defines it, which may be another one that this imports it from."""
    for node in _body(module):
        if isinstance(node, ast.ClassDef) and node.name == name:
            return module, node
        if isinstance(node, ast.ImportFrom) and hops:
            for alias in node.names:
                if (alias.asname or alias.name) == name:
                    return _find_class(_absolute(module, node), alias.name, hops - 1)
    return None


def _absolute(module: str, node: ast.ImportFrom) -> str:
    if node.level == 0:
        return node.module or ""
    file = _file(module)
    above = module.split(".") if file is not None and file.name == "__init__.py" else module.split(".")[:-1]
    return ".".join([*above[: len(above) - node.level + 1], *filter(None, [node.module])])


def _body(module: str) -> Sequence[ast.stmt]:
    """The statements of a module; none if it has no source."""
    file = _file(module)
    with suppress(OSError, SyntaxError, ValueError):
        return [] if file is None else ast.parse(file.read_text(encoding="utf-8")).body
    return []


def _file(module: str) -> Path | None:
    """The source of a module."""
    package, *inside = module.split(".")
    with suppress(ImportError, ValueError, AttributeError):
        spec = importlib.util.find_spec(package)  # of a package's module it would import the package
        if spec is None or spec.origin is None:
            return None
        origin = Path(spec.origin)
        path = origin.parent.joinpath(*inside)
        candidates = [path / "__init__.py", path.with_suffix(".py")] if inside else [origin]
        return next((file for file in candidates if file.is_file() and file.suffix == ".py"), None)
    return None


def _parameters(module: str, owner: ast.ClassDef, hops: int = 9) -> Parameters | None:
    constructor = next(
        (node for node in owner.body if isinstance(node, ast.FunctionDef) and node.name == "__init__"), None
    )
    if constructor is None:
        return _of_base(module, owner, hops, own=False)
    own = _own(constructor)
    if constructor.args.kwarg is None:
        return own
    above = _of_base(module, owner, hops, own=bool(own))
    return None if above is None else {**above, **own}


def _of_base(module: str, owner: ast.ClassDef, hops: int, *, own: bool) -> Parameters | None:
    """The parameters of the only base; none is required if the class has its own, which may give it."""
    base = owner.bases[0] if len(owner.bases) == 1 and hops else None
    found = _find_class(module, base.id) if isinstance(base, ast.Name) else None
    above = None if found is None else _parameters(*found, hops - 1)
    return {name: (kind, needed and not own) for name, (kind, needed) in above.items()} if above is not None else None


def _own(constructor: ast.FunctionDef) -> Parameters:
    arguments = constructor.args
    placed = [*arguments.posonlyargs, *arguments.args]
    needed = len(placed) - len(arguments.defaults)
    found = {argument.arg: (_annotation(argument), place < needed) for place, argument in enumerate(placed)}
    for self_or_positional in (placed[0], *arguments.posonlyargs):
        found.pop(self_or_positional.arg, None)
    keywords: Iterable[tuple[ast.arg, ast.expr | None]] = zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True)
    return found | {argument.arg: (_annotation(argument), default is None) for argument, default in keywords}


def _annotation(argument: ast.arg) -> Any:
    """What an annotation means, if it is made of `NAMES`, constants, ``|``, ``[]`` and calls of `Bounds`."""
    allowed = (ast.Name, ast.Load, ast.Constant, ast.BinOp, ast.BitOr, ast.Subscript, ast.Tuple, ast.UnaryOp, ast.USub)
    node = argument.annotation
    if node is None:
        return Any
    for part in ast.walk(node):
        called = isinstance(part, ast.Call) and isinstance(part.func, ast.Name) and part.func.id == "Bounds"
        if not called and not isinstance(part, allowed):
            return Any
    with suppress(NameError, TypeError):
        return eval(compile(ast.Expression(node), "<annotation>", "eval"), {"__builtins__": {}, **NAMES})
    return Any
