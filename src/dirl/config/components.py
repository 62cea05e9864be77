"""Components by ``_target_``: finding the class that a configuration names, checking its options, making it.

A group of ``conf/`` (``encoder``, ``losses``, ...) names a class by its full path and gives its options. The class's
annotated signature defines the valid options: types, and bounds of ``annotated_types``. Further arguments (the
world, the width of a view's features) are passed by the names of its parameters, see `GROUPS`.
"""

import difflib
import importlib
import inspect
import traceback
import typing
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from dirl.config.schemas import ConfigError, Schedule, TrainConfig

TARGET = "_target_"

Options = Mapping[str, Any]
"""Of a component by name, ``_target_`` among them."""

Parameters = dict[str, tuple[Any, bool]]
"""By name: the annotation, and whether it must be given."""

GROUPS: Mapping[str, frozenset[str]] = {
    "observation": frozenset({"world"}),
    "encoder": frozenset({"num_features", "num_views", "patch_shape"}),
    "memory": frozenset({"input_size", "in_key", "out_key"}),
    "heads": frozenset({"scenes", "in_features", "num_actions"}),
    "policy": frozenset({"world", "features", "encoder", "heads", "memory"}),
    "episodic_memory": frozenset(),
    "recogniser": frozenset(),
    "expert": frozenset({"world", "seed"}),
    "losses": frozenset({"policy", "actor_network", "actor", "critic_network", "world"}),
    "optimiser": frozenset({"params"}),
    "source": frozenset(),
    "env": frozenset({"world", "num_agents", "encode", "table", "front", "reward", "stop", "seed"}),
}
"""The groups, and what is offered to the constructors of their classes by name of parameter."""

PUBLIC = frozenset(
    {
        "torch.optim.Adam",
        "torch.optim.AdamW",
        "torch.optim.RMSprop",
        "torch.optim.SGD",
        "torchrl.modules.GRUModule",
        "torchrl.modules.LSTMModule",
        "torchrl.objectives.A2CLoss",
        "torchrl.objectives.ClipPPOLoss",
    }
)
"""Classes of other packages that a configuration read from a file may name, besides dirl's own."""

MODULE = "torch.nn.modules.module.Module"
BASES = {
    "optimiser": "torch.optim.optimizer.Optimizer",
    # Experts, sampled pairs, caches and matching ask a transform what is seen of a state, not the environment alone.
    "observation": "dirl.envs.transforms.SurroundingViews",
    "env": "dirl.envs.navigation.NavigationEnv",  # whose agents a checkpoint holds, and whose goals are counted
}
"""What the classes of a group are, if not a `MODULE`; by name, so that this module does not import torch."""

METHODS = {
    "simulator": ("place", "push", "look"),  # `dirl.scenes.live.Simulator`
    "source": ("load",),  # `dirl.scenes.catalogue.SceneSource`
    "recogniser": ("fit", "describe", "scores"),  # `dirl.perception.recognition.Recogniser`
    "image_encoder": (),  # `dirl.perception.backbones.registry.ImageEncoder`
    "metric": (),  # `dirl.evaluation.episodes.Metric`
}
"""What the classes of other groups must have; they are no modules."""

NONE = ("memory", "episodic_memory", "losses")
"""Groups of which a policy may have none."""


def components(config: TrainConfig) -> Mapping[str, Options]:
    """Return the options of each component of a `TrainConfig` that names a class, by dotted name (``losses.a2c``).

    Raises:
        ConfigError: a value that is no component.
    """
    chosen = {}
    for group in GROUPS:
        value = getattr(config, group)
        if group == "losses" and not isinstance(value, Mapping):
            raise ConfigError(f"losses={value}: expected a mapping of losses by name")
        for name, options in value.items() if group == "losses" else [(None, value)]:
            full = group if name is None else f"{group}.{name}"
            if not isinstance(options, Mapping) or TARGET not in options:
                raise ConfigError(f"{full}: names no class; give it {full}.{TARGET}=package.module.Class")
            if options[TARGET] is not None:
                chosen[full] = dict(options)
            elif group not in NONE:
                raise ConfigError(f"{full}.{TARGET}=null: a training needs one; leave it out, or name a class")
    return chosen


def packages_to_trust(config: TrainConfig) -> list[str]:
    """Return the packages that must be trusted to read the configuration from a file, see `find_class`."""
    targets = [str(options[TARGET]) for options in components(config).values()]
    return sorted({target.partition(".")[0] for target in targets if target not in PUBLIC} - {"dirl"})


def check_components(config: TrainConfig, trust: Collection[str] | None = None) -> None:
    """Find the class of every component of a `TrainConfig` and check its options, before anything is made.

    Raises:
        ConfigError: see `find_class` and `check_options`.
    """
    for name, options in components(config).items():
        check_options(name, class_parameters(find_class(name, options[TARGET], trust)), options)


def find_class(name: str, target: object, trust: Collection[str] | None = None) -> type:
    """Return the class that a component names, ``package.module.Class``.

    ``trust`` are packages whose classes a configuration may name besides dirl's own and `PUBLIC`; None = any, for a
    configuration that the user composed on the command line. Of other packages nothing is imported.

    Raises:
        ConfigError: there is no such class, or it is not trusted.
    """
    where = f"{name}.{TARGET}={target}"
    if not isinstance(target, str) or not all(part.isidentifier() for part in target.split(".")) or "." not in target:
        raise ConfigError(f"{where}: must be the full name of a class, package.module.Class")
    module_name, _, class_name = target.rpartition(".")
    package = target.split(".")[0]
    trusted = trust is None or target in PUBLIC or package == "dirl" or package in trust
    if not trusted:
        raise ConfigError(
            f"{where}: a configuration from a file names a class of '{package}'; trust=[{package}] allows it"
        )
    try:
        cls = getattr(importlib.import_module(module_name), class_name)
    except (ImportError, AttributeError) as error:
        raise ConfigError(f"{where}: there is no such class ({error}); is its folder on PYTHONPATH?") from None
    if not inspect.isclass(cls):
        raise ConfigError(f"{where}: is no class")
    group = name.split(".")[0]
    if missing := [method for method in METHODS.get(group, ()) if not callable(getattr(cls, method, None))]:
        gym = "; an environment that has reset and step: dirl.sources.gym.GymSimulator" if hasattr(cls, "step") else ""
        raise ConfigError(f"{where}: has no method {missing[0]}, which every {group} has{gym}")
    base = BASES.get(group, MODULE)
    if group not in METHODS and base not in {f"{each.__module__}.{each.__qualname__}" for each in cls.__mro__}:
        raise ConfigError(f"{where}: must be a subclass of {base}")
    # `dirl.envs.navigation.EnvBase` is a class that dirl only imports.
    if trust is not None and target not in PUBLIC and cls.__module__.split(".")[0] != package:
        raise ConfigError(f"{where}: is not defined in '{package}' but in '{cls.__module__}'; name it there")
    return cls


def class_parameters(cls: type) -> Parameters:
    """Return the named parameters of a class's constructor; ``**kwargs`` stands for those of its bases.

    What a base needs is not required: the class itself may give it.
    """
    parameters: Parameters = {}
    # TorchRL's metaclasses hide a class's own signature.
    for constructor in (vars(owner)["__init__"] for owner in cls.__mro__ if "__init__" in vars(owner)):
        try:
            hints = typing.get_type_hints(constructor, include_extras=True)
        except (NameError, TypeError):  # a name that is only imported for type checkers
            hints = {}
        own = list(inspect.signature(constructor).parameters.values())[1:]
        named = [p for p in own if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)]
        new = {p.name: (hints.get(p.name, Any), p.default is p.empty and not parameters) for p in named}
        parameters = new | parameters
        if all(p.kind is not p.VAR_KEYWORD for p in own):
            break
    return parameters


def check_options(name: str, parameters: Parameters, options: Options) -> None:
    """Check a component's options, ``_target_`` among them, against the parameters of its constructor.

    Raises:
        ConfigError: an unknown or missing option, or a value of the wrong type or out of bounds.
    """
    group = name.split(".")[0]
    changing = schedules(name, options) if group == "losses" else {}
    offered, kind = GROUPS.get(group, frozenset()), str(options[TARGET]).rpartition(".")[2]
    choices = [option for option in parameters if option not in offered]
    for option, value in options.items():
        if option == TARGET or (option == "weight" and group == "losses"):
            continue
        check_choice(f"option '{name}.{option}'", str(option), choices, f"{name}.")
        if isinstance(value, Mapping) and TARGET in value:
            raise ConfigError(f"{name}.{option}: a component cannot hold another one")
        if option not in changing:
            check_value(f"{name}.{option}", value, parameters[option][0])
    for option, (_, required) in parameters.items():
        if required and option not in options and option not in offered:
            raise ConfigError(f"{name}.{option}: {kind} needs it; give {name}.{option}=...")


def schedules(name: str, options: Options) -> dict[str, Schedule]:
    """Return the options of a loss that change linearly over the training, and its ``weight``, constant or not.

    One that changes is given as ``{start: ..., end: ...}``.

    Raises:
        ConfigError: one is no finite number.
    """
    by_name = {}
    for option, value in {"weight": 1.0, **options}.items():
        changes = isinstance(value, Mapping) and set(value) == {"start", "end"}
        if not changes and option != "weight":
            continue
        ends = value if changes else {"start": value, "end": value}
        for end in ends.values():
            check_value(f"{name}.{option}", end, float)
        by_name[option] = Schedule(**{key: float(end) for key, end in ends.items()})
    return by_name


def make(name: str, options: Options, trust: Collection[str] | None = None, **offered: object) -> Any:
    """Make a component (``encoder``, ``losses.a2c``, ...) by its options; with None as ``_target_`` none is made.

    What is ``offered`` goes to those parameters of the constructor that have these names. For ``trust`` see
    `find_class`.

    Raises:
        ConfigError: see `find_class` and `check_options`; or the constructor refuses its arguments.
    """
    if options[TARGET] is None:
        return None
    cls = find_class(name, options[TARGET], trust)
    parameters = class_parameters(cls)
    check_options(name, parameters, options)
    given = {key: value for key, value in options.items() if key != TARGET}
    if name.startswith("losses."):
        given |= {option: schedule.start for option, schedule in schedules(name, options).items()}
        del given["weight"]
    wanted = {key: value for key, value in offered.items() if key in parameters}
    try:
        return cls(**given, **wanted)
    # torch asserts what its layers are given, and its optimisers index lists that may be short.
    except (TypeError, ValueError, AssertionError, IndexError, RuntimeError) as error:
        raise ConfigError(f"{name}: {cls.__name__} refuses its options: {error}") from None
    except CODE as error:
        raise ConfigError(f"{name}: {cls.__name__} cannot be made: {describe_error(error, cls)}") from None


CODE = (ArithmeticError, AssertionError, AttributeError, LookupError, NameError, RuntimeError, TypeError, ValueError)
"""What the code of a component raises; errors of the machine are others."""


@contextmanager
def tried(name: str, used: object, how: str = "") -> Iterator[None]:
    """Report an error of a component within this context in one line; ``how`` says how it is called.

    Raises:
        ConfigError: the component, or a check of what it gave, raised one of `CODE`.
    """
    try:
        yield
    except ConfigError:
        raise
    except CODE as error:
        raise ConfigError(f"{name}: cannot be called as it should{how}: {describe_error(error, type(used))}") from None


def describe_error(error: Exception, cls: type) -> str:
    """Return what a class's code raised, in one line with the place in its own file, as no traceback shows it."""
    says = " ".join(str(error.args[0] if isinstance(error, KeyError) and error.args else error).split())
    if not says or not isinstance(error, RuntimeError | ValueError):  # which say what is wrong by themselves
        says = f"{type(error).__name__}: {says}" if says else type(error).__name__
    try:
        file = inspect.getsourcefile(cls)
    except (OSError, TypeError):  # a class of an interactive session
        file = None
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
    return f"{says} ({Path(file).name}, line {lines[-1]})" if file and lines else says


def check_choice(what: str, given: str, choices: Collection[str], prefix: str = "") -> None:
    """Raise `ConfigError` unless there is such a choice; ``what`` names what is missing.

    Suggested are those that end in the same name, as an option of another group does; else the one most alike.
    """
    if given in choices:
        return
    last = given.rpartition(".")[2]
    near = [choice for choice in choices if choice.rpartition(".")[2] == last]
    near = near or difflib.get_close_matches(given, choices, n=1)
    hint = f"choose from {', '.join(choices) or 'none'}"
    if near:
        hint = f"did you mean {' or '.join(prefix + choice for choice in near)}?"
    raise ConfigError(f"there is no {what}; {hint}")


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
        first = error.errors(include_url=False, include_input=False)[0]
        where = "".join(f"[{part}]: " if isinstance(part, int) else f"{part}: " for part in first["loc"])
        what = first["msg"].replace("Input should", "must").replace("Field required", "is missing")
        if first["type"] == "needs_python_object":
            where, what = "", "must be an object of Python, which no option can be"
        told = " ".join(f"{where}{what}".split())  # keys of a file can have more than one line
        raise ConfigError(f"{name}={'null' if value is None else value}: {told}") from None
