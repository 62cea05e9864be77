"""Maps as files: a folder with safetensors and JSON, nothing that could run code."""

import json
from dataclasses import fields
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from dirl.agent.images import check_turns
from dirl.agent.mapping.image_graph import ImageGraph, MapError
from dirl.agent.mapping.panoramas import UNKNOWN, VIEWS
from dirl.agent.mapping.places import PlaceMap
from dirl.models.localising import Places
from dirl.perception.recognition.recogniser import NCC, Recogniser, recogniser_name
from dirl.scenes.graph import ACTIONS
from dirl.scenes.io.files import MOST_WEIGHTS, atomic_path, check_seal, read_bytes, read_text, sealed, write_json

MISSING = "needs a package that is not installed (safetensors): pip install 'dirl[maps]'"

TENSORS, FACTS = "map.safetensors", "map.json"

SCHEMA = 1

PLACES = tuple(field.name for field in fields(Places) if field.name not in ("mapped", "turns"))


def save_graph(
    graph: ImageGraph | PlaceMap,
    folder: str | Path,
    *,
    extractor: str = "unknown",
    recogniser: Recogniser | None = None,
) -> Path:
    """Write a map into a folder; an older one there is replaced.

    Args:
        graph: with at least one place.
        folder: made if there is none.
        extractor: what made the features of its views.
        recogniser: what described the views of a `PlaceMap`; an `ImageGraph` knows its own.

    Raises:
        MapError: the map is empty, or safetensors is not installed.
    """
    folder = Path(folder)
    if not len(graph):
        raise MapError(f"{folder}: the map is empty; walk before it is saved")
    try:
        from safetensors.torch import save
    except ImportError:
        raise MapError(f"{folder}: {MISSING}") from None
    folder.mkdir(parents=True, exist_ok=True)
    if isinstance(graph, PlaceMap):
        tensors = {"seen": graph.seen, **{name: getattr(graph.places, name) for name in PLACES}}
        tensors = {name: value.cpu().contiguous() for name, value in tensors.items()}
        facts: dict[str, Any] = {"kind": "places", "turns": graph.turns}
    else:
        tensors = {"views": graph.views, "moves": torch.tensor(graph.moves), "observed": torch.tensor(graph.observed)}
        facts = {key: getattr(graph, key) for key in ("threshold", "keep", "margin", "turns", "merge", "verify")}
        recogniser = graph.recogniser
    if recogniser is not None:
        facts["recogniser"] = recogniser_name(recogniser)
    content = save(tensors)
    with atomic_path(folder / TENSORS) as temporary:
        temporary.write_bytes(content)
    write_json(folder / FACTS, sealed({"schema": SCHEMA, "extractor": extractor, **facts}, content))
    return folder


def load_graph(
    folder: str | Path, *, extractor: str | None = None, recogniser: Recogniser | None = None
) -> ImageGraph | PlaceMap:
    """Read a map; the walker may be anywhere in it.

    Args:
        folder: that `save_graph` wrote.
        extractor: what will make the features to be compared; not checked if left out.
        recogniser: what will describe and compare them; of an image graph correlation if left out.

    Raises:
        MapError: the folder holds no map, it is damaged, or it was made with another extractor or recogniser.
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
        content = read_bytes(folder / TENSORS, MOST_WEIGHTS)
        check_seal(facts, content)
        places = facts.get("kind") == "places"
        if not places:
            recogniser = recogniser or NCC()
        graph = (
            _places(load(content), int(facts["turns"])) if places else _image_graph(facts, load(content), recogniser)
        )
    except Exception as error:  # safetensors has an exception of its own for each kind of damage
        reason = f"{type(error).__name__}: {error}".splitlines()[0][:200]
        raise MapError(f"{folder}: is no map of dirl ({reason})") from None
    wanted = {"extractor": extractor, "recogniser": None if recogniser is None else recogniser_name(recogniser)}
    for name, value in wanted.items():
        if value is not None and facts.get(name) != value:
            raise MapError(f"{folder}: was made with another {name}: '{facts.get(name)}', not '{value}'")
    return graph


def _image_graph(facts: dict[str, Any], tensors: dict[str, Tensor], recogniser: Recogniser | None) -> ImageGraph:
    threshold, keep, margin = (float(facts[key]) for key in ("threshold", "keep", "margin"))
    merge, verify = bool(facts["merge"]), bool(facts.get("verify", False))
    graph = ImageGraph(threshold, keep, margin, int(facts["turns"]), merge=merge, verify=verify, recogniser=recogniser)
    views, moves, observed = (tensors[key] for key in ("views", "moves", "observed"))
    panoramas = len(views)
    if views.ndim != 3 or views.shape[1] != VIEWS or views.dtype != torch.float32 or not views.isfinite().all():
        raise ValueError(f"views: {views.dtype} {list(views.shape)}")
    for name, kind in (("moves", torch.int64), ("observed", torch.bool)):
        if tensors[name].shape != (VIEWS * panoramas, len(ACTIONS)) or tensors[name].dtype != kind:
            raise ValueError(f"{name}: {tensors[name].dtype} {list(tensors[name].shape)} for {panoramas} panoramas")
    if int(moves.min()) < UNKNOWN or int(moves.max()) >= len(moves):
        raise ValueError("a move leads to a node that is not there")
    for panorama in views:
        graph.add_panorama(panorama)
    graph.moves, graph.observed = moves.tolist(), observed.tolist()
    return graph


def _places(tensors: dict[str, Tensor], turns: int) -> PlaceMap:
    """Return a map of T visits of P places, whose tensors have the shapes that `dirl.models.localising.Places` says."""
    seen, (visits, count) = tensors["seen"], (tensors["node"].shape[1], tensors["heading"].shape[1])
    nodes, views = turns * count, tensors["goal"].shape[-1]
    check_turns(turns)
    if views not in (VIEWS, turns):
        raise ValueError(f"{views} views of {turns} headings")
    expected = {
        "cost": ((1, nodes, len(ACTIONS)), torch.float32),
        "after": ((1, nodes, len(ACTIONS)), torch.int64),
        "taken": ((1, nodes, len(ACTIONS)), torch.bool),
        "node": ((1, visits), torch.int64),
        "goal": ((1, visits, views), torch.float32),
        "position": ((1, count, 2), torch.int64),
        "heading": ((1, count), torch.int64),
        "action": ((1,), torch.int64),
    }
    for name, (shape, kind) in expected.items():
        if tensors[name].shape != shape or tensors[name].dtype != kind or bool(tensors[name].isnan().any()):
            raise ValueError(f"{name}: {tensors[name].dtype} {list(tensors[name].shape)}")
    if not 0 <= int(tensors["node"].min()) <= int(tensors["node"].max()) < nodes:
        raise ValueError("a visit is of a node that is not there")
    if not -1 <= int(tensors["after"].min()) <= int(tensors["after"].max()) < nodes:
        raise ValueError("a move leads to a node that is not there")
    if (
        seen.shape[:3] != (1, visits, views)
        or seen.ndim != 4
        or seen.dtype != torch.float32
        or not seen.isfinite().all()
    ):
        raise ValueError(f"seen: {seen.dtype} {list(seen.shape)}")
    known = {name: tensors[name] for name in expected}
    return PlaceMap(Places(**known, mapped=torch.zeros(1, dtype=torch.bool), turns=turns), seen)
