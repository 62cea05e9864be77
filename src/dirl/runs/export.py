"""A trained policy as a folder that others can read: safetensors, YAML and JSON, nothing that could run code."""

import json
from pathlib import Path

from dirl.runs.paths import WEIGHTS, RunError
from dirl.runs.schema import State, check_entries
from dirl.scenes.io.atomic import atomic_path, write_json, write_text
from dirl.scenes.io.bounded import MOST_WEIGHTS, read_bytes, read_text
from dirl.scenes.io.digest import check_seal, sealed

CONFIG, FACTS = "config.yaml", "dirl.json"
"""The files of such a folder beside the weights by name: the run's configuration, and `KEYS`."""

KEYS = ("extractor", "scenes", "views", "turns", "frames", "schema")
"""What of a checkpoint stands in `FACTS`."""

MISSING = "needs a package that is not installed (safetensors): pip install 'dirl[hub]'"


def write_shared(saved: State, folder: Path) -> None:
    """Write a checkpoint, see `load_checkpoint`, into an existing folder, which `read_shared` reads.

    Raises:
        RunError: safetensors is not installed.
    """
    try:
        from safetensors.torch import save
    except ImportError:
        raise RunError(f"{folder}: {MISSING}") from None
    weights = {name: value.clone().contiguous() for name, value in saved["network"].items()}  # none may share memory
    content = save(weights, {"format": "pt"})
    with atomic_path(folder / WEIGHTS) as temporary:
        temporary.write_bytes(content)
    write_text(folder / CONFIG, saved["config"])
    facts = {key: saved[key] for key in KEYS if key in saved}
    write_json(folder / FACTS, sealed(facts, content, saved["config"].encode()))


def read_shared(folder: Path) -> State:
    """Return what `dirl.runs.checkpoints.load_checkpoint` reads of a run, of a folder that `write_shared` wrote.

    Raises:
        RunError: it is damaged, or holds something else, or safetensors is not installed.
    """
    try:
        from safetensors.torch import load
    except ImportError:
        raise RunError(f"{folder}: {MISSING}") from None
    file = folder / WEIGHTS
    try:
        data = read_bytes(file, MOST_WEIGHTS)
        facts = json.loads(read_text(folder / FACTS))
        state = {key: facts[key] for key in KEYS if key in facts}
        state["config"] = read_text(folder / CONFIG)
        check_seal(facts, data, state["config"].encode())
        state["network"] = load(data)
    except Exception as error:  # safetensors has an exception of its own for each kind of damage
        reason = f"{type(error).__name__}: {error}".splitlines()[0][:200]
        raise RunError(f"{folder}: is no policy shared by dirl ({reason})") from None
    return check_entries(state, file)
