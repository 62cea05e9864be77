"""A scene in memory: checked when made, immutable; three formats of views and no other, decoded when looked at."""

import warnings
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from malformed import VIEW, picture
from PIL import Image
from refusals import refused
from rooms import grid_scene, read_here

from dirl.scenes import Scene, write_dump
from dirl.scenes.scene import MAX_NAME, check_name
from dirl.scenes.views import FORMATS, FileViews, ImageError, decode


def parts(**changes):
    """What the 24 states of a scene are made from, every array owned by the caller."""
    arrays = {name: getattr(grid_scene(), name).copy() for name in ("graph", "positions", "headings", "features")}
    return {"name": "room", "origin": "here", **arrays, **changes}


def spoiled(name, state, value):
    array = parts()[name].astype(float)
    array[state] = value
    return {name: array}


def test_a_scene_cannot_be_changed_nor_through_the_arrays_that_it_was_made_of():
    given = parts()
    made = Scene(**given)
    for name in ("graph", "positions", "headings", "features", "distances", "surrounding"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(made, name)[0] = 1
    for name in ("graph", "positions", "headings", "features"):
        before = getattr(made, name).copy()
        given[name][:] = 0
        assert (getattr(made, name) == before).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"graph": parts()["graph"].astype(float)}, "graph: expected integer values, found float64"),
        (spoiled("positions", 7, np.nan), "location: state 7 holds a value that is not finite"),
        (spoiled("positions", 7, 9.0), r"location: state 6 is at \[0.5, 0.0\] but .* right, 7, is at \[9.0, 9.0\]"),
        ({"features": np.ones((23, 2))}, r"resnet_feature: expected shape \(24, 'any'\), found \(23, 2\)"),
        (spoiled("features", 11, np.nan), "resnet_feature: state 11 holds a value that is not finite"),
        ({"along": np.ones((24, 1), np.float16)}, r"along_feature: expected shape \(24, \d+\), found \(24, 1\)"),
        ({"views": FileViews("file.h5", "observation", np.zeros((23, 2), int))}, "23 views for 24 states"),
        ({"goals": (0, 24)}, r"goal 24 is not a state; states are 0\.\.23"),
    ],
)
def test_a_scene_that_cannot_be_used_is_refused(change, message):
    refused(f"^here: {message}", Scene, **parts(**change))


def test_a_goal_no_state_leads_to_is_refused(scene):
    graph = np.concatenate([scene.graph, np.full((1, 4), -1)])
    spare = {"positions": np.zeros((25, 2)), "headings": np.zeros(25), "features": None}
    made = Scene(**parts(graph=graph, **spare))
    made.check_goals([23])
    refused("here: goal 24 cannot be reached from any other state", made.check_goals, [24])
    refused("here: goal 24 cannot be reached from any other state", Scene, **parts(graph=graph, goals=(0, 24), **spare))


def test_raw_views_come_as_they_are_stored_and_only_those_there_are(dump):
    views = read_here(dump).views
    assert len(views) == 24
    assert views[23].dtype == np.uint8
    assert views[23].tolist() == np.full((3, 4, 3), 23).tolist()
    for state in (-1, 24):
        with pytest.raises(IndexError, match=rf"room\.h5: state {state} has no view; states are 0\.\.23"):
            views[state]


GOOD = ["bathroom_02", "2nd floor", "Küche (neu)", "台所", "room.v2", "a+b, c-d", "x" * MAX_NAME, "0"]
BAD = ["", " ", "..", "../x", "a\\b", "$x$", "-x", "x.", "a\nb", "a:b", "x" * (MAX_NAME + 1), "é" * 51, "\udcff"]
BAD += ["keys", "items", "forward", "training", "a{b}", "a=b", "'a'", "a%b", "~a"]


def test_bad_names_are_refused_in_one_line():
    for name in GOOD:
        check_name(name, "here")
    for name in BAD:
        assert len(refused("^here: a scene cannot be called ", check_name, name, "here")) < 250


def test_decoding_in_threads_changes_nothing_of_the_process(monkeypatch):
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 100)
    filters, data = [*warnings.filters], picture("PNG", (40, 30))
    with ThreadPoolExecutor(4) as threads:
        assert {view.shape for view in threads.map(decode, [data] * 400)} == {(30, 40, 3)}
    assert Image.MAX_IMAGE_PIXELS == 100
    assert warnings.filters == filters


@pytest.mark.parametrize("kind", FORMATS)
def test_damaged_images_are_one_line(kind):
    data, rng = picture(kind, (40, 30)), np.random.default_rng(0)
    reasons = []
    for length in range(1, len(data), 7):
        broken = bytearray(data[:length])
        broken[rng.integers(length)] ^= 0xFF
        try:
            assert decode(bytes(broken)).shape[2] == 3
        except ImageError as error:
            reasons.append(str(error))
    assert reasons
    assert not any("\n" in text or "0x" in text for text in reasons)  # no addresses of objects


def test_a_file_that_went_away_or_became_shorter_is_one_line(tmp_path):
    path = tmp_path / "room.h5"
    write_dump(path, grid_scene(), [VIEW] * 24)
    views = read_here(path).views
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(ValueError, match=r"room\.h5: observation_webp: state 5: the file has become shorter$"):
        views[5]
    path.unlink()
    with pytest.raises(ValueError, match=r"room\.h5: observation_webp: cannot be read any more \(No such file"):
        views.stored(5)
