"""Make a map of a first-person video: its frames, and links between frames of one place.

    python recipes/map.py video=walk.mp4 out=walk.pt field_of_view=65

All options: `Options` below.
"""

from dataclasses import dataclass
from typing import Annotated, Any

from annotated_types import Interval

from dirl.cli.start import new_file, run, start
from dirl.config.schemas import FieldOfView, option


@dataclass
class Options:
    """Make a map of first-person recordings."""

    out: str = option("a new file (.pt) for the map")
    video: Any = option("a video, a folder of images (0.jpg, 1.jpg, ...), or several: [first.mp4,second.mp4]", None)
    bag: str | None = option("instead of a video: a bag of ROS 1 or 2 (.bag, .mcap, a folder)", None)
    topic: str | None = option("of a bag's images; null = the only one", None)
    odometry: str | None = option("topic of a bag's nav_msgs/Odometry; null = the only one, if there is any", None)
    every: Annotated[float, Interval(ge=0.02, le=60)] = option(
        "seconds between frames that are kept, whose views must overlap; of a folder all are kept", 1.0
    )
    field_of_view: FieldOfView | None = option(
        "of the camera from left to right, degrees; null = as the photos tell, else 65", None
    )
    points: str | None = option(
        "what finds points: xfeat, sift, or columns (of walls in VizDoom); null = the best that is installed",
        None,
    )
    page: str | None = option("a new file (.html) in which to step through the map", None)
    route: str | None = option("a new file (.geojson) for Nav2's Route Server; needs odometry", None)


if __name__ == "__main__":
    options = start(__doc__, Options)  # "loading ...", or help; the imports below take their time

from pathlib import Path

from dirl.agent.mapping.frames import check_memory, find_links, load_matcher, map_recordings
from dirl.config.files import names
from dirl.config.schemas import ConfigError
from dirl.reporting.map_page import write_page, write_route
from dirl.sources.video import Recording

FIELD_OF_VIEW = 65.0
"""Of a phone held across, degrees."""


def main(options: Options) -> None:
    """Read the frames, look for links, write the map."""
    if (options.video is None) == (options.bag is None):
        raise ConfigError("video, bag: name a recording by one of them")
    new_file(options.out, ending=".pt")
    for file, ending in ((options.page, ".html"), (options.route, ".geojson")):
        if file is not None:
            new_file(file, ending=ending)
    sources = names("video", options.bag if options.video is None else options.video)
    recordings = [Recording(Path(source), options.every, options.topic, options.odometry) for source in sources]
    expected = sum(recording.count for recording in recordings)
    check_memory(expected, options.every)
    for recording in recordings:
        if recording.left_out:
            print(f"{recording.source}: no images, left out: {', '.join(recording.left_out[:5])}")
    angle = options.field_of_view or recordings[0].field_of_view
    matcher = load_matcher(options.points)
    graph = map_recordings(recordings, matcher, angle or FIELD_OF_VIEW, expected, progress=True)
    graph = find_links(graph, matcher, progress=True)
    graph.save(options.out)
    print(f"| {Path(options.out).name} | |\n|---|--:|")
    print(f"| frames | {len(graph)} |\n| seconds between them | {graph.spacing:.2f} |\n| links | {len(graph.links)} |")
    print(f"| field of view | {graph.field_of_view:.0f}{'' if angle else ', assumed'} |\n| points | {graph.kind} |")
    print(f"map: {options.out}")
    if options.route is not None:
        write_route(graph, Path(options.route))
        print(f"route: {options.route}")
    if options.page is not None:
        write_page(graph, Path(options.page))
        print(f"page: {options.page}")


if __name__ == "__main__":
    run(lambda: main(options), options)
