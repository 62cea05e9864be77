"""Fetching trained policies from the Hugging Face Hub, or from folders of the same form (`dirl.reporting.sharing`).

Loading one runs no code from it: weights are safetensors, and the configuration may name only classes of dirl and of
packages that the user trusts, as in every checkpoint.
"""

from pathlib import Path
from typing import Any

from dirl.runs.export import CONFIG, FACTS
from dirl.runs.paths import WEIGHTS, packaged_agent

FILES = [WEIGHTS, CONFIG, FACTS, "README.md", "summary.json", "*.png", "*.gif"]
"""What is fetched from a repository; other files are not."""


class HubError(ValueError):
    """A policy cannot be shared or fetched; the message says why in one line."""


def fetch_pretrained(name: str | Path, *, revision: str | None = None) -> Path:
    """The folder of a shared policy: ``name`` itself if it is a local folder, else a download from the Hub.

    An agent of the package, as ``general``, is never looked for in the Hub.

    `dirl.agent.navigator.Navigator.load` and ``recipes/evaluate.py`` take this folder as ``checkpoint``.

    Args:
        name: a folder, or ``user/name`` in the Hub.
        revision: a commit, branch or tag; the latest if left out.

    Raises:
        HubError: there is no such policy, or it cannot be fetched.
    """
    if (agent := packaged_agent(name)) is not None:
        return agent
    folder = Path(name)
    if not folder.is_dir():
        try:
            folder = Path(hub_library().snapshot_download(str(name), revision=revision, allow_patterns=FILES))
        except (OSError, ValueError) as error:
            raise HubError(
                f"{name}: is no local folder, and cannot be fetched from the Hub: {first_line(error)}"
            ) from None
    if not (folder / WEIGHTS).is_file():
        raise HubError(f"{name}: holds no policy shared by dirl: it has no {WEIGHTS}")
    return folder


def hub_library() -> Any:
    """The module huggingface_hub; raises `HubError` if it is not installed."""
    try:
        import huggingface_hub
    except ImportError:
        raise HubError("the Hub needs huggingface_hub, which is not installed: pip install 'dirl[hub]'") from None
    return huggingface_hub


def first_line(error: Exception) -> str:
    """The first line of an error's message, or its type."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0]
