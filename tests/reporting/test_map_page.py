"""What other programs get of a map of a recording: a page, a route for Nav2, MCAP."""

import json

import numpy as np
import pytest
from hall import look, walk
from PIL import Image
from refusals import refused

from dirl.agent.mapping.frames import find_links, map_recordings
from dirl.reporting.map_page import write_mcap, write_page, write_route


@pytest.fixture(scope="module")
def frames():
    ahead = walk([(1 + x, 2.5, 0) for x in range(12)])
    return [(image, time, (time, 2.0, 0.0)) for image, time, _ in ahead]


def test_a_page_steps_through_a_map_and_shows_where_the_photo_was_found(tmp_path, sift, frames, browser):
    graph = map_recordings([frames, walk([(1.2 + x, 2.4, 1) for x in range(12)])], sift, 65.0)
    graph = find_links(graph, sift)
    found = graph.find(sift, sift.describe([look(6.4, 2.3, 4)]))
    file = tmp_path / "walk.html"
    write_page(graph, file, graph.path(2, found.frame), found)
    page = browser.new_page()
    page.goto(file.as_uri())
    assert page.locator("h1").inner_text() == f"walk: 24 frames, {len(graph.links)} links"
    assert f"frame {found.frame}, {found.answer}" in page.locator("#answer").inner_text()
    assert page.locator("#here_text").inner_text().startswith(f"frame {found.frame},")
    page.keyboard.press("ArrowRight")
    assert page.locator("#here_text").inner_text().startswith(f"frame {found.frame + 1},")
    assert page.evaluate("document.getElementById('here').naturalWidth") == 240
    page.evaluate(f"go({graph.links[0, 0]})")
    assert f"linked: frame {graph.links[0, 1]}" in page.locator("#linked").inner_text()


def test_a_map_with_positions_is_a_route_of_nav2(tmp_path, sift, frames):
    file = tmp_path / "walk.geojson"
    write_route(map_recordings([frames[:3]], sift, 65.0), file)
    features = json.loads(file.read_text())["features"]
    nodes, edges = (
        [one for one in features if one["geometry"]["type"] == kind] for kind in ("Point", "MultiLineString")
    )
    assert [node["geometry"]["coordinates"] for node in nodes] == [[0, 2], [1, 2], [2, 2]]
    ends = {(edge["properties"]["startid"], edge["properties"]["endid"]) for edge in edges}
    assert ends == {(0, 1), (1, 0), (1, 2), (2, 1)}
    assert len({one["properties"]["id"] for one in features}) == len(features)
    refused("needs positions", write_route, map_recordings([walk([(1, 2, 0), (2, 2, 0)])], sift, 65.0), file)


def test_a_way_is_written_as_mcap_that_ros_2_reads(tmp_path):
    highlevel = pytest.importorskip("rosbags.highlevel")
    pytest.importorskip("mcap")
    file = tmp_path / "way.mcap"
    write_mcap(file, [(0.0, np.zeros((8, 8, 3), np.uint8), "ahead 2 s"), (2.5, np.zeros((8, 8, 3), np.uint8), "")])
    with highlevel.AnyReader([file]) as reader:
        told = [(one.topic, stamp, reader.deserialize(data, one.msgtype)) for one, stamp, data in reader.messages()]
    assert [(topic, stamp) for topic, stamp, _ in told] == [
        (topic, stamp) for stamp in (0, 2_500_000_000) for topic in ("/camera/image/compressed", "/moves")
    ]
    assert told[1][2].data == "ahead 2 s"
    image = tmp_path / "first.jpg"
    image.write_bytes(told[0][2].data.tobytes())
    with Image.open(image) as opened:
        assert opened.size == (8, 8)
