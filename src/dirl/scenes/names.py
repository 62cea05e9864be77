"""Valid names of scenes: a name becomes part of files, titles, options and the network's modules."""

import re

from dirl.scenes.scene import SceneError

MAX_NAME = 100
"""Bytes of UTF-8; a file's name may have 255."""

ALLOWED = re.compile(r"[^\W_](?:[\w .,()+-]*[\w)+])?")
"""Letters and digits of any script, and what needs no care in paths, in matplotlib's titles and in Hydra's options."""


def check_name(name: str, origin: str) -> None:
    """Raise `SceneError` unless a scene can have that name; ``origin`` is its source, for errors.

    A network stores layers under the names of scenes, so names of a module's own attributes (``keys``) are excluded.
    """
    from torch import nn  # here, because the process that reads dumps does without torch

    if not ALLOWED.fullmatch(name) or len(name.encode()) > MAX_NAME:
        shown = name if len(name) <= 60 else f"{name[:60]}..."
        raise SceneError(
            f"{origin}: a scene cannot be called {shown!r}; a name has 1 to {MAX_NAME} letters, digits, spaces, and "
            "any of _.,()+- after the first"
        )
    if hasattr(nn.ModuleDict(), name.replace(".", "_")):
        raise SceneError(
            f"{origin}: a scene cannot be called {name!r}, which is a word of the network's own; choose another name"
        )
