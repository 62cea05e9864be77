"""Maps of recordings and ways through them, for other programs and for people: a page, MCAP, and GeoJSON."""

import base64
import html
import io
import json
from collections.abc import Iterable, Sequence
from importlib.resources import files
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from dirl.agent.mapping.frames import Found, FrameMap
from dirl.agent.mapping.image_graph import MapError
from dirl.scenes.io.files import atomic_path, write_text

MOST_PICTURES = 1200
"""On a page; of a longer map every second frame is shown, or every third."""


def write_page(graph: FrameMap, file: Path, path: Sequence[int] = (), found: Found | None = None) -> None:
    """Write a page, in one file, to step through a map: pictures, links, the way, and where a photo was found."""
    shown = list(range(0, len(graph), -(-len(graph) // MOST_PICTURES)))
    data = {
        "times": graph.times.round(2).tolist(),
        "parts": graph.parts.tolist(),
        "links": graph.links.tolist(),
        "path": [int(frame) for frame in path],
        "shown": shown,
        "pictures": [base64.b64encode(graph.pictures[frame]).decode() for frame in shown],
        "found": None,
    }
    if found is not None:
        scores = np.round(found.scores, 1).tolist()
        probability = round(found.probability, 3)
        data["found"] = {"frame": found.frame, "answer": found.answer, "probability": probability, "scores": scores}
    page = files("dirl.reporting").joinpath("walk.html").read_text(encoding="utf-8")
    page = page.replace("TITLE", html.escape(f"{file.stem}: {len(graph)} frames, {len(graph.links)} links"))
    write_text(file, page.replace("DATA", json.dumps(data).replace("</", "<\\/")))


def write_route(graph: FrameMap, file: Path) -> None:
    """Write the map as a graph of Nav2's Route Server, GeoJSON in metres of the odometry.

    Raises:
        MapError: the recording had no odometry.
    """
    if graph.places is None:
        raise MapError(f"{file}: a route needs positions; record a bag with nav_msgs/Odometry")
    at = graph.places[:, :2].round(3).tolist()
    nodes = [
        _feature({"id": frame, "frame": "odom"}, {"type": "Point", "coordinates": place})
        for frame, place in enumerate(at)
    ]
    joined = graph.graph.tocoo()
    edges = [
        _feature(
            {"id": len(at) + number, "startid": int(start), "endid": int(end), "cost": round(float(cost), 2)},
            {"type": "MultiLineString", "coordinates": [[at[start], at[end]]]},
        )
        for number, (start, end, cost) in enumerate(zip(joined.row, joined.col, joined.data, strict=True))
    ]
    write_text(file, json.dumps({"type": "FeatureCollection", "name": file.stem, "features": nodes + edges}) + "\n")


def _feature(properties: dict[str, object], geometry: dict[str, object]) -> dict[str, object]:
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def write_mcap(file: Path, steps: Iterable[tuple[float, NDArray[np.uint8], str]]) -> None:
    """Write pictures and what is said with them as an MCAP file, which Foxglove and Rerun open.

    They are ROS 2 messages: ``sensor_msgs/CompressedImage`` on ``/camera/image/compressed``, ``std_msgs/String`` on
    ``/moves``. A step is seconds, the picture, RGB, uint8 ``[H, W, 3]``, and a text.

    Raises:
        MapError: the packages that write it are not installed.
    """
    try:
        from mcap.writer import Writer
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise MapError(
            f"{file}: an MCAP file needs packages that are not installed: pip install 'dirl[bags]'"
        ) from None
    store = get_typestore(Stores.ROS2_HUMBLE)
    types = {"/camera/image/compressed": "sensor_msgs/msg/CompressedImage", "/moves": "std_msgs/msg/String"}
    image_type, text_type = (store.types[name] for name in types.values())
    with atomic_path(file) as temporary, temporary.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library="dirl")
        channels = {}
        for topic, name in types.items():
            definition = store.generate_msgdef(name, ros_version=2)[0].encode()
            schema = writer.register_schema(name, "ros2msg", definition)
            channels[topic] = writer.register_channel(topic, "cdr", schema)
        for seconds, picture, text in steps:
            stamp = store.types["builtin_interfaces/msg/Time"](int(seconds), int(seconds % 1 * 1e9))
            header = store.types["std_msgs/msg/Header"](stamp, "camera")
            jpeg = io.BytesIO()
            Image.fromarray(picture).save(jpeg, "JPEG", quality=85)
            image = image_type(header, "jpeg", np.frombuffer(jpeg.getvalue(), np.uint8))
            for topic, message in (("/camera/image/compressed", image), ("/moves", text_type(text))):
                data = bytes(store.serialize_cdr(message, types[topic]))
                writer.add_message(channels[topic], int(seconds * 1e9), data, int(seconds * 1e9))
        writer.finish()
