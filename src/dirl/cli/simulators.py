"""A simulator of the user's own, by the file that names it."""

from pathlib import Path

from dirl.config.choices import own_options
from dirl.config.components import make
from dirl.config.schemas import ConfigError
from dirl.scenes.live import Simulator


def load_simulator(file: str) -> Simulator:
    """The simulator that a YAML file names: ``_target_``, its class, and the arguments of its constructor.

    Raises:
        ConfigError: there is no such file or class, or it lacks a member of `dirl.scenes.live.Simulator`.
    """
    made = make("simulator", own_options("simulator", Path(file)))
    missing = [name for name in ("name", "pose", "place", "push", "look") if not hasattr(made, name)]
    if missing:
        raise ConfigError(
            f"simulator={file}: {type(made).__name__} has no {', '.join(missing)}; see dirl.scenes.live.Simulator"
        )
    found: Simulator = made
    return found
