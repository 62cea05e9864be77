"""Target-driven visual navigation by deep imitation reinforcement learning."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dirl.agent.mapping.guide import Guide
    from dirl.agent.navigator import Navigator
    from dirl.training.python import evaluate, train

__all__ = ["Guide", "Navigator", "__version__", "evaluate", "train"]


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


MODULES = {
    "Guide": "dirl.agent.mapping.guide",
    "Navigator": "dirl.agent.navigator",
    "evaluate": "dirl.training.python",
    "train": "dirl.training.python",
}
"""Where names are imported from when they are asked for, so that `import dirl` stays light."""


def __getattr__(name: str) -> Any:
    if name in MODULES:
        return getattr(import_module(MODULES[name]), name)
    if name == "__version__":
        from importlib.metadata import version

        return version("dirl")
    raise AttributeError(f"module 'dirl' has no attribute '{name}'")
