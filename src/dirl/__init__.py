"""Target-driven visual navigation by deep imitation reinforcement learning."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dirl.agent.mapping.guide import Guide
    from dirl.agent.navigator import Navigator
    from dirl.training.python import evaluate, train

__all__ = ["Guide", "Navigator", "__version__", "evaluate", "train"]


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


def __getattr__(name: str) -> Any:
    # Imported when asked for, so that `import dirl` stays light.
    if name == "Navigator":
        from dirl.agent.navigator import Navigator

        return Navigator
    if name in ("train", "evaluate"):
        from dirl.training import python

        return getattr(python, name)
    if name == "Guide":
        from dirl.agent.mapping.guide import Guide

        return Guide
    if name == "__version__":
        from importlib.metadata import version

        return version("dirl")
    raise AttributeError(f"module 'dirl' has no attribute '{name}'")
