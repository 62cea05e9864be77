"""Many rooms: made once, in any order, by any number of processes, and going on after a job was killed."""

import json
from dataclasses import replace

import h5py
import pytest
from closet import closet, start_with_closets
from refusals import refused

pytest.importorskip("embreex")

from dirl.perception.backbones.patches import patch_attributes
from dirl.scenes import SceneError, load_scenes
from dirl.scenes.catalogue import split_of
from dirl.scenes.io import processes
from dirl.scenes.io.files import PREFIX
from dirl.sources.rooms import build_room, read_description
from dirl.sources.rooms.collect import RoomSettings, make_rooms, missing_rooms
from dirl.sources.rooms.sampling.sample import LOOK, look_around

PLAIN = RoomSettings(height=24, width=32, fine=False, encoder=None)
WANTED = [("bathroom", 10_000), ("bathroom", 30_000), ("bathroom", 30_001)]


@pytest.fixture
def drawn(monkeypatch):
    """Every room is the closet; which ones were asked for."""
    drawn = []

    def draw(kind, seed, *, threads):
        drawn.append((kind, seed))
        if seed == 13:
            raise SceneError("kind=bathroom seed=13: none of 60 rooms passed the checks; the last: it is ugly")
        room = replace(closet(), name=f"{kind}_{seed}")
        return room, look_around(room)

    monkeypatch.setattr("dirl.sources.rooms.collect.sample_views", draw)
    return drawn


def test_rooms_become_a_collection_and_a_killed_job_goes_on(drawn, tmp_path):
    rooms = make_rooms(tmp_path, WANTED, PLAIN, workers=1)
    first = next(rooms)
    rooms.close()
    (tmp_path / "bathroom_30000.toml").write_text("half a descript")  # as a job leaves that is killed
    (tmp_path / f"{PREFIX}1.h5").write_bytes(b"half a dump")
    assert missing_rooms(tmp_path, WANTED, PLAIN.stored(None)) == WANTED[1:]
    made = [first, *make_rooms(tmp_path, WANTED[1:], PLAIN, workers=1)]
    assert drawn == WANTED
    assert missing_rooms(tmp_path, WANTED, PLAIN.stored(None)) == []
    assert [room.split for room in made] == [split_of(seed) for _, seed in WANTED] == ["test", "train", "train"]
    assert [(room.states, room.places) for room in made] == [(20, 5)] * 3
    assert made[0].problems == build_room(closet(), tmp_path / "other_1.h5", size=(24, 32), fine=False)
    assert read_description(tmp_path / "bathroom_30000.toml").name == "bathroom_30000"
    with h5py.File(tmp_path / "bathroom_30001.h5") as file:
        assert file.attrs["seed"] == 30_001
    refused(r"other_1\.h5: says not how it was made", missing_rooms, tmp_path, WANTED, PLAIN.stored(None))
    (tmp_path / "mine.txt").write_text("a file of somebody else")
    refused("is there already, and is no collection", missing_rooms, tmp_path, WANTED, PLAIN.stored(None))


def test_a_seed_without_a_room_does_not_stop_the_others_and_rooms_of_a_collection_are_made_alike(drawn, tmp_path):
    error, entry = make_rooms(tmp_path, [("bathroom", 13), ("bathroom", 14)], PLAIN, workers=1)
    assert "none of 60 rooms passed" in str(error)
    assert [entry.name] == [one.name for one in load_scenes(f"collection:{tmp_path}")] == ["bathroom_14"]
    with pytest.raises(SceneError, match="bathroom_14 was made with width=32, not 40; give the same options"):
        missing_rooms(tmp_path, WANTED, replace(PLAIN, width=40).stored(None))


def test_features_and_patches_say_what_made_them(drawn, tmp_path):
    settings = replace(PLAIN, encoder="resnet50_small", patches=True)
    list(make_rooms(tmp_path, WANTED[:1], settings, workers=1))
    scene = load_scenes(f"collection:{tmp_path}")[0]
    assert (scene.features.shape, scene.patches.shape) == ((20, 2048), (20, 8, 96))
    with h5py.File(tmp_path / "bathroom_10000.h5") as file:
        assert dict(file["patches"].attrs) == patch_attributes()
        stored = json.loads(file.attrs["settings"])
    assert settings.stored(settings.load_encoder()) == stored
    assert (stored["extractor"], stored["patches"]) == (scene.extractor, "; ".join(patch_attributes().values()))


def test_two_processes_make_rooms(tmp_path, monkeypatch):
    monkeypatch.setattr(processes, "_start", start_with_closets)
    wanted = [("bathroom", 30_000), ("bathroom", 930_000)]
    settings = replace(PLAIN, height=LOOK[0], width=LOOK[1])
    made = list(make_rooms(tmp_path, wanted, settings, workers=2))
    assert {room.name for room in made} == {f"{kind}_{seed}" for kind, seed in wanted}
    collection = load_scenes(f"collection:{tmp_path}")
    assert (collection[0].views[0] != collection[1].views[0]).any()
