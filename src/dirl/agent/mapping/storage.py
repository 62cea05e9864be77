"""Maps as files: sealed with a digest as checkpoints are, and read without running code."""

from dataclasses import fields
from pathlib import Path
from typing import Any

import torch

from dirl.agent.mapping.image_graph import ImageGraph, MapError
from dirl.agent.mapping.places import PlaceMap
from dirl.models.localising import Places
from dirl.perception.recognition.recogniser import NCC, Recogniser, recogniser_name
from dirl.runs.checkpoints import read_archive, save_checkpoint

FILE = "map.pt"

PLACES = tuple(field.name for field in fields(Places) if field.name not in ("mapped", "turns"))


def save_graph(
    graph: ImageGraph | PlaceMap,
    folder: str | Path,
    *,
    extractor: str = "unknown",
    recogniser: Recogniser | None = None,
) -> Path:
    """Write a map into a folder, which is made if there is none; an older map there is replaced.

    It tells what made the features of its views, and what described those of a `PlaceMap`; an `ImageGraph` knows its
    own recogniser.

    Raises:
        MapError: the map is empty.
    """
    folder = Path(folder)
    if not len(graph):
        raise MapError(f"{folder}: the map is empty; walk before it is saved")
    known: dict[str, Any] = {"turns": graph.turns, "extractor": extractor}
    if isinstance(graph, PlaceMap):
        places = {name: getattr(graph.places, name).cpu() for name in PLACES}
        known |= {"kind": "places", "seen": graph.seen.cpu(), **places}
    else:
        known |= {"views": graph.views, "moves": graph.moves, "observed": graph.observed, "threshold": graph.threshold}
        recogniser = graph.recogniser
    if recogniser is not None:
        known["recogniser"] = recogniser_name(recogniser)
    folder.mkdir(parents=True, exist_ok=True)
    save_checkpoint(folder / FILE, known)
    return folder


def load_graph(
    folder: str | Path, *, extractor: str | None = None, recogniser: Recogniser | None = None
) -> ImageGraph | PlaceMap:
    """Read the map in a folder that `save_graph` wrote; the walker may be anywhere in it.

    What will make the features to be compared, and what will describe and compare them, is not checked if left out; an
    image graph is then compared by correlation.

    Raises:
        MapError: the folder holds no map, it is damaged, or it was made with another extractor or recogniser.
    """
    file = Path(folder) / FILE
    if not file.is_file():
        raise MapError(f"{folder}: holds no map; it has no {FILE}")
    try:
        known = read_archive(file)
        graph: ImageGraph | PlaceMap
        if known.get("kind") == "places":
            places = {name: known[name] for name in PLACES}
            unmapped = torch.zeros(1, dtype=torch.bool)
            graph = PlaceMap(Places(**places, mapped=unmapped, turns=known["turns"]), known["seen"])
        else:
            recogniser = recogniser or NCC()
            graph = ImageGraph(known["threshold"], known["turns"], recogniser=recogniser)
            for panorama in known["views"]:
                graph.add_panorama(panorama)
            graph.moves, graph.observed = known["moves"], known["observed"]
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise MapError(f"{folder}: is no map of dirl ({type(error).__name__}: {error})") from None
    wanted = {"extractor": extractor, "recogniser": None if recogniser is None else recogniser_name(recogniser)}
    for name, value in wanted.items():
        if value is not None and known.get(name) != value:
            raise MapError(f"{folder}: was made with another {name}: '{known.get(name)}', not '{value}'")
    return graph
