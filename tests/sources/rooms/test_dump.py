"""Building rooms: what the checks find, what stands in the file, and many rooms by any number of processes."""

import json
import os
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from closet import closet, start_with_closets
from commands import serve
from PIL import Image
from refusals import refused

pytest.importorskip("embreex")

from dirl.perception.backbones import ViewEncoder
from dirl.perception.backbones.patches import patch_attributes
from dirl.scenes import SceneError, load_scenes, read_dump
from dirl.scenes.catalogue import split_of
from dirl.scenes.io import processes
from dirl.scenes.io.files import PREFIX
from dirl.sources.rooms import build_room, check_room, describe_room, read_description
from dirl.sources.rooms.checks import check_views, contrast, thumbnail
from dirl.sources.rooms.collect import RoomSettings, make_rooms, missing_rooms
from dirl.sources.rooms.description import Piece
from dirl.sources.rooms.dump import Changes, look_views
from dirl.sources.rooms.sampling.sample import LOOK, look_around
from dirl.sources.rooms.view import Renderer
from dirl.sources.rooms.walkable import walk

REFERENCES = Path(__file__).parents[2] / "data" / "bathroom_02.png"
"""Six small views of the bathroom in coarse light, side by side, from the machine that made the rooms."""

SMALL = {"size": (24, 32), "fine": False}


def test_furniture_that_meets_other_furniture_leaves_the_room_or_is_in_the_way_is_found():
    def problems(*pieces):
        room = closet()
        return check_room(replace(room, furniture=(*room.furniture, *pieces), grid=replace(room.grid, places=None)))

    (found,) = problems(Piece("stool", (0.3, 0.3, 0.45), at=(1.6, 1.25)))
    assert found.startswith("[[furniture]] number 1 (stool) and [[furniture]] number 4 (stool) reach ")
    picture = Piece("picture", (0.3, 0.05, 0.3), wall="north", along=1.5, options={"image": "paper"})
    assert problems(picture) == []  # over a stool
    (found,) = problems(Piece("stool", (0.3, 0.3, 0.45), at=(1.95, 0.4)))
    assert found == "[[furniture]] number 4 (stool) reaches 10 cm out of the room"
    found = problems(Piece("stool", (0.3, 0.3, 0.45), at=(0.7, 0.3)))
    assert "[[furniture]] number 2 (door): less than 0.6 m in front of it are free" in found
    screens = (Piece("cabinet", (0.04, 1.5, 1.0), at=(x, 0.75)) for x in (0.65, 1.15))
    assert "[grid] only 2 of 5 free points can be reached from each other" in problems(*screens)


def test_blank_and_alike_views_are_found():
    views = np.random.default_rng(0).integers(0, 256, (20, 24, 32, 3)).astype(np.uint8)
    views[19] = views[0]  # another place
    views[4] = views[8]  # the next place, the same heading
    views[7] = 90
    found = check_views(np.stack(list(map(thumbnail, views))), np.array(list(map(contrast, views))), walk(closet()))
    assert found == [
        "state 7: its view is nearly blank (standard deviation 0.0 of 255)",
        "states 0 and 19 look alike (correlation 1.00) but are far apart",
    ]


def test_a_room_is_built_with_graph_views_features_and_its_description(tmp_path, monkeypatch):
    encoder = ViewEncoder(lambda views: views.float().mean((1, 2)), {"extractor": "colours", "weights": "none"})
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    build_room(closet(), tmp_path / "closet.h5", encoder=encoder, **SMALL)
    scene = read_dump(tmp_path / "closet.h5")
    assert (scene.name, scene.goals, scene.source) == ("closet", (3,), "synthetic")
    assert (scene.graph == walk(closet()).graph).all()
    assert scene.views[0].shape == (24, 32, 3)
    assert scene.views[0].std() > 10
    assert (scene.features.shape, scene.features.dtype) == ((20, 3), np.float16)
    assert scene.extractor == "colours; none"
    with h5py.File(tmp_path / "closet.h5") as file:
        assert 'name = "closet"' in file.attrs["room"]
    monkeypatch.setattr(os, "cpu_count", lambda: 4)  # threads and smaller turns give the same views
    build_room(closet(), tmp_path / "turns.h5", **SMALL, turn=45)
    turns = read_dump(tmp_path / "turns.h5")
    assert (len(turns), turns.goals) == (2 * len(scene), (6,))
    assert all((scene.views[state] == turns.views[2 * state]).all() for state in range(len(scene)))


def test_what_cannot_be_built_is_refused_at_once(tmp_path):
    (tmp_path / "closet.h5").write_text("mine")
    refused("size=.4, 32.: views are 8 to 4096 pixels", build_room, closet(), tmp_path / "new.h5", size=(4, 32))
    refused("turn=100: a turn must go into 90 degrees", build_room, closet(), tmp_path / "new.h5", turn=100)
    refused("this file exists already", build_room, closet(), tmp_path / "closet.h5")
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == [("closet.h5", "mine")]


def test_the_bathroom_is_built_the_same_on_this_machine():
    """Up to rounding, which moves a ray across an edge here and there, and so a pixel of a hundred (graph: above)."""
    room = describe_room("bathroom_02")
    way, renderer = walk(room), Renderer.of(room, fine=False)
    poses = [(*way.places[state // 4], way.headings[state % 4]) for state in (9, 40, 75, 110, 143, 170)]
    views = np.concatenate([renderer.view(room.camera, pose, (15, 20)) for pose in poses], 1)
    with Image.open(REFERENCES) as image:
        error = np.abs(views - np.asarray(image).astype(float))
    assert error.mean() < 0.2
    assert (error <= 1).mean() > 0.99


def test_each_error_changes_the_views_and_more_of_it_more():
    room = closet()
    way, renderer = walk(room), Renderer.of(room, fine=False)

    def look(seed=0, **changes):
        made = Changes(**{"position": 0, "heading": 0, "exposure": 0, **changes})
        return np.stack(list(look_views(renderer, room.camera, way, (24, 32), made, seed))).astype(float)

    planned = look()
    assert np.array_equal(look(seed=1), planned)
    for name, size in {"position": 0.05, "heading": 5, "exposure": 0.2}.items():
        some = look(**{name: size})
        assert 0.3 < np.abs(some - planned).mean() < np.abs(look(**{name: 3 * size}) - planned).mean()
        assert np.array_equal(look(**{name: size}), some)
        assert not np.array_equal(look(seed=1, **{name: size}), some)
    # `some` is the one of other exposures: that of a place is of all its views.
    brightness = (some.mean((1, 2, 3)) / planned.mean((1, 2, 3))).reshape(-1, 4)
    assert brightness.std(1).max() < 0.05
    assert brightness.mean(1).std() > 0.05


PLAIN = RoomSettings(height=24, width=32, fine=False, encoder=None)
WANTED = [("bathroom", 10_000), ("bathroom", 30_000), ("bathroom", 30_001)]
UGLY = ("bathroom", 13)


def test_rooms_become_a_collection_and_a_killed_job_goes_on_also_without_a_room_of_some_seed(tmp_path, monkeypatch):
    drawn = []

    def draw(kind, seed, *, threads):
        """Every room is the closet."""
        drawn.append((kind, seed))
        if drawn[-1] == UGLY:
            raise SceneError("kind=bathroom seed=13: none of 60 rooms passed the checks; the last: it is ugly")
        room = replace(closet(), name=f"{kind}_{seed}")
        return room, look_around(room)

    monkeypatch.setattr("dirl.sources.rooms.collect.sample_views", draw)
    rooms = make_rooms(tmp_path, WANTED, PLAIN, workers=1)
    first = next(rooms)
    rooms.close()
    (tmp_path / "bathroom_30000.toml").write_text("half a descript")  # as a job leaves that is killed
    (tmp_path / f"{PREFIX}1.h5").write_bytes(b"half a dump")
    assert missing_rooms(tmp_path, WANTED, PLAIN.stored(None)) == WANTED[1:]
    error, *rest = make_rooms(tmp_path, [UGLY, *WANTED[1:]], PLAIN, workers=1)
    assert "none of 60 rooms passed" in str(error)
    made = [first, *rest]
    assert drawn == [WANTED[0], UGLY, *WANTED[1:]]
    assert missing_rooms(tmp_path, WANTED, PLAIN.stored(None)) == []
    assert [room.split for room in made] == [split_of(seed) for _, seed in WANTED] == ["test", "train", "train"]
    assert [(room.states, room.places) for room in made] == [(20, 5)] * 3
    assert made[0].problems == build_room(closet(), tmp_path / "other_1.h5", **SMALL)
    assert read_description(tmp_path / "bathroom_30000.toml").name == "bathroom_30000"
    with h5py.File(tmp_path / "bathroom_30001.h5") as file:
        assert file.attrs["seed"] == 30_001
    refused(r"other_1\.h5: says not how it was made", missing_rooms, tmp_path, WANTED, PLAIN.stored(None))
    (tmp_path / "mine.txt").write_text("a file of somebody else")
    refused("is there already, and is no collection", missing_rooms, tmp_path, WANTED, PLAIN.stored(None))


def test_two_processes_make_rooms_whose_features_and_patches_say_what_made_them(tmp_path, monkeypatch):
    context = serve()  # its forks need not import anything
    monkeypatch.setattr(processes, "get_context", lambda _: context)
    monkeypatch.setattr(processes, "_start", start_with_closets)
    wanted = [("bathroom", 30_000), ("bathroom", 930_000)]
    settings = replace(PLAIN, height=LOOK[0], width=LOOK[1], encoder="resnet50_small", patches=True)
    made = list(make_rooms(tmp_path, wanted, settings, workers=2))
    assert {room.name for room in made} == {f"{kind}_{seed}" for kind, seed in wanted}
    scene, other = load_scenes(f"collection:{tmp_path}")
    assert (scene.views[0] != other.views[0]).any()
    assert (scene.features.shape, scene.patches.shape) == ((20, 2048), (20, 8, 96))
    with h5py.File(tmp_path / "bathroom_30000.h5") as file:
        assert dict(file["patches"].attrs) == patch_attributes()
        stored = json.loads(file.attrs["settings"])
    assert settings.stored(settings.load_encoder()) == stored
    assert (stored["extractor"], stored["patches"]) == (scene.extractor, "; ".join(patch_attributes().values()))
