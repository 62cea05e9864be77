"""The structure of the package: which wing may import which. A new arrow or file in the root is decided here."""

import ast
import functools
from pathlib import Path

import dirl

ROOT = Path(dirl.__file__).parent

FLOORS = (
    ("config", "scenes"),
    ("envs", "perception", "runs"),
    ("models", "sources"),
    ("agent", "cli"),
    ("evaluation",),
    ("reporting",),
    ("training",),
    ("experiments",),
)
"""From the bottom up: a wing imports only from floors below its own."""

ARROWS = 57  # two for `dirl.train`: dirl names it, and it reads options as commands do; one for errors of own metrics
"""Pairs of wings of which one imports the other, at most."""


def module(path):
    parts = ("dirl", *path.relative_to(ROOT).with_suffix("").parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module(path): path for path in ROOT.rglob("*.py")}


@functools.cache
def imports(name):
    """The modules of dirl that a module imports, at its top or later; a package if no module of it is named."""
    found = set()
    for node in ast.walk(ast.parse(MODULES[name].read_text())):
        named = []
        if isinstance(node, ast.Import):
            named = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            named = [f"{node.module}.{alias.name}" for alias in node.names]
        for one in named:
            while one and one not in MODULES:
                one = one.rpartition(".")[0]
            if one and one != name:
                found.add(one)
    return found


def arrows():
    found = {}
    for name in MODULES:
        for other in imports(name):
            pair = name.split(".")[1:2], other.split(".")[1:2]
            if pair[0] != pair[1]:
                found.setdefault((*pair[0], *pair[1]), (name, other))
    return found


def test_every_wing_has_a_floor_and_the_root_no_module_of_its_own():
    wings = {path.name for path in ROOT.iterdir() if path.is_dir() and (path / "__init__.py").is_file()}
    assert wings == {wing for floor in FLOORS for wing in floor}
    assert {path.name for path in ROOT.glob("*.py")} == {"__init__.py", "__main__.py"}


def test_no_wing_imports_upwards_and_no_more_than_before_import_each_other():
    floor_of = {wing: number for number, floor in enumerate(FLOORS) for wing in floor}
    between = {pair: where for pair, where in arrows().items() if len(pair) == 2 and set(pair) <= set(floor_of)}
    assert not {pair: where for pair, where in between.items() if floor_of[pair[0]] <= floor_of[pair[1]]}
    assert len(arrows()) <= ARROWS


def test_no_two_modules_import_each_other():
    modules = {name for name, path in MODULES.items() if path.name != "__init__.py"}
    assert [(name, other) for name in modules for other in imports(name) & modules if name in imports(other)] == []
