"""Image graphs as files: a folder with safetensors and JSON, nothing that could run code."""

import json
from pathlib import Path
from typing import Any

import torch

from dirl.agent.mapping.graph import ImageGraph, MapError
from dirl.agent.mapping.looks import UNKNOWN, VIEWS
from dirl.files.atomic import atomic_path, write_json
from dirl.files.seals import check_seal, sealed
from dirl.files.texts import read_text
from dirl.runs.shared import MISSING
from dirl.scenes.graph import ACTIONS

TENSORS, FACTS = "map.safetensors", "map.json"

SCHEMA = 1


def save_graph(graph: ImageGraph, folder: str | Path, *, extractor: str = "unknown") -> Path:
    """Write an image graph into a folder; an older one there is replaced.

    Args:
        graph: with at least one station.
        folder: made if there is none.
        extractor: what made the features of its views.

    Raises:
        MapError: the graph is empty, or safetensors is not installed.
    """
    folder = Path(folder)
    if not len(graph):
        raise MapError(f"{folder}: the map is empty; walk before it is saved")
    try:
        from safetensors.torch import save
    except ImportError:
        raise MapError(f"{folder}: {MISSING}") from None
    folder.mkdir(parents=True, exist_ok=True)
    tensors = {"views": graph.views, "moves": torch.tensor(graph.moves), "observed": torch.tensor(graph.observed)}
    facts = {key: getattr(graph, key) for key in ("threshold", "keep", "margin", "turns", "merge", "verify")}
    content = save(tensors)
    with atomic_path(folder / TENSORS) as temporary:
        temporary.write_bytes(content)
    write_json(folder / FACTS, sealed({"schema": SCHEMA, "extractor": extractor, **facts}, content))
    return folder


def load_graph(folder: str | Path, *, extractor: str | None = None) -> ImageGraph:
    """Read an image graph; the walker may be anywhere in it.

    Args:
        folder: that `save_graph` wrote.
        extractor: what will make the features to be compared; not checked if left out.

    Raises:
        MapError: the folder holds no map, it is damaged, or it was made with another extractor.
    """
    folder = Path(folder)
    try:
        from safetensors.torch import load
    except ImportError:
        raise MapError(f"{folder}: {MISSING}") from None
    if not (folder / TENSORS).is_file():
        raise MapError(f"{folder}: holds no map; it has no {TENSORS}")
    try:
        facts = json.loads(read_text(folder / FACTS))
        content = (folder / TENSORS).read_bytes()
        check_seal(facts, content)
        tensors = load(content)
        threshold, keep, margin = (float(facts[key]) for key in ("threshold", "keep", "margin"))
        merge, verify = bool(facts["merge"]), bool(facts.get("verify", False))
        graph = ImageGraph(threshold, keep, margin, int(facts["turns"]), merge=merge, verify=verify)
        _fill(graph, tensors)
    except Exception as error:  # safetensors has an exception of its own for each kind of damage
        reason = f"{type(error).__name__}: {error}".splitlines()[0][:200]
        raise MapError(f"{folder}: is no map of dirl ({reason})") from None
    if extractor is not None and facts.get("extractor") != extractor:
        raise MapError(f"{folder}: was made with another extractor: '{facts.get('extractor')}', not '{extractor}'")
    return graph


def _fill(graph: ImageGraph, tensors: dict[str, Any]) -> None:
    views, moves, observed = (tensors[key] for key in ("views", "moves", "observed"))
    stations = len(views)
    if views.ndim != 3 or views.shape[1] != VIEWS or not views.isfinite().all():
        raise ValueError(f"views of shape {list(views.shape)}")
    shape = (VIEWS * stations, len(ACTIONS))
    if moves.shape != shape or observed.shape != shape or moves.is_floating_point():
        raise ValueError(f"moves of shape {list(moves.shape)} for {stations} stations")
    if int(moves.min()) < UNKNOWN or int(moves.max()) >= len(moves):
        raise ValueError("a move leads to a node that is not there")
    for one in views:
        graph.add_station(one)
    graph.moves, graph.observed = moves.tolist(), observed.bool().tolist()
