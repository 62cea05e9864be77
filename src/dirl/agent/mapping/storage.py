"""Maps as files: a folder with safetensors and JSON, nothing that could run code."""

import json
from dataclasses import fields
from pathlib import Path
from typing import Any

import torch

from dirl.agent.mapping.image_graph import ImageGraph, MapError
from dirl.agent.mapping.places import PlaceMap
from dirl.models.localising import Places
from dirl.perception.recognition.recogniser import NCC, Recogniser, recogniser_name
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
        facts = {"threshold": graph.threshold, "turns": graph.turns}
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
        tensors = load(content)
        graph: ImageGraph | PlaceMap
        if facts.get("kind") == "places":
            known = {name: tensors[name] for name in PLACES}
            places = Places(**known, mapped=torch.zeros(1, dtype=torch.bool), turns=facts["turns"])
            graph = PlaceMap(places, tensors["seen"])
        else:
            recogniser = recogniser or NCC()
            graph = ImageGraph(facts["threshold"], facts["turns"], recogniser=recogniser)
            for panorama in tensors["views"]:
                graph.add_panorama(panorama)
            graph.moves, graph.observed = tensors["moves"].tolist(), tensors["observed"].tolist()
    except Exception as error:  # safetensors has an exception of its own for each kind of damage
        reason = f"{type(error).__name__}: {error}".splitlines()[0][:200]
        raise MapError(f"{folder}: is no map of dirl ({reason})") from None
    wanted = {"extractor": extractor, "recogniser": None if recogniser is None else recogniser_name(recogniser)}
    for name, value in wanted.items():
        if value is not None and facts.get(name) != value:
            raise MapError(f"{folder}: was made with another {name}: '{facts.get(name)}', not '{value}'")
    return graph
