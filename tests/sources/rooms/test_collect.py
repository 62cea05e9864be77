"""Many rooms: made once, in any order, by any number of processes, and going on after a job was killed."""

from dataclasses import replace

import h5py
import pytest
from closet import closet, start_with_closets

pytest.importorskip("embreex")

from dirl.perception.backbones.patches import patch_attributes
from dirl.scenes import SceneError, read_dump
from dirl.scenes.collection import INDEX, read_collection
from dirl.scenes.io import processes
from dirl.sources.rooms import build_room, read_description
from dirl.sources.rooms.collect import RoomSettings, make_rooms, missing_rooms
from dirl.sources.rooms.sampling.sample import LOOK, look_around
from dirl.sources.rooms.sampling.splits import split_of

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


def test_rooms_become_a_collection(drawn, tmp_path):
    made = list(make_rooms(tmp_path, WANTED, PLAIN, workers=1))
    collection = read_collection(tmp_path)
    assert collection.entries == tuple(made)
    assert [entry.split for entry in made] == [split_of(seed) for _, seed in WANTED] == ["test", "train", "train"]
    assert [len(scene) for scene in collection] == [entry.states for entry in made] == [20, 20, 20]
    assert made[0].checks["places"] == 5
    assert made[0].checks["problems"] == build_room(closet(), tmp_path / "other.h5", size=(24, 32), fine=False)
    assert read_description(tmp_path / "bathroom_30001.toml").name == "bathroom_30001"
    with h5py.File(tmp_path / "bathroom_30001.h5") as file:
        assert file.attrs["seed"] == 30_001
    assert list(collection.damaged()) == []
    assert missing_rooms(tmp_path, WANTED, PLAIN.stored(None)) == []
    with (tmp_path / "bathroom_10000.h5").open("ab") as file:
        file.write(b"x")
    assert missing_rooms(tmp_path, WANTED, PLAIN.stored(None)) == WANTED[:1]


def test_a_killed_job_goes_on(drawn, tmp_path):
    rooms = make_rooms(tmp_path, WANTED, PLAIN, workers=1)
    next(rooms)
    rooms.close()
    # What a job leaves that is killed while it writes a room, and before it has written the index.
    (tmp_path / "bathroom_30000.toml").write_text("half a descript")
    (tmp_path / "bathroom_30000.h5.tmp").write_bytes(b"half a dump")
    assert missing_rooms(tmp_path, WANTED, PLAIN.stored(None)) == WANTED[1:]
    list(make_rooms(tmp_path, WANTED[1:], PLAIN, workers=1))
    assert drawn == WANTED
    assert list(read_collection(tmp_path).damaged()) == []
    (tmp_path / INDEX).unlink()
    assert missing_rooms(tmp_path, WANTED, PLAIN.stored(None)) == WANTED  # killed before the first line
    (tmp_path / "mine.txt").write_text("a file of somebody else")
    with pytest.raises(SceneError, match="is there already, and is no collection"):
        missing_rooms(tmp_path, WANTED, PLAIN.stored(None))


def test_a_seed_without_a_room_does_not_stop_the_others_and_rooms_of_a_collection_are_made_alike(drawn, tmp_path):
    error, entry = make_rooms(tmp_path, [("bathroom", 13), ("bathroom", 14)], PLAIN, workers=1)
    assert "none of 60 rooms passed" in str(error)
    assert [entry.name] == [one.name for one in read_collection(tmp_path).entries] == ["bathroom_14"]
    for key, value in {"width": 40, "precision": "bfloat16"}.items():
        other = replace(PLAIN, **{key: value}).stored(None)
        with pytest.raises(SceneError, match=f"bathroom_14 was made with {key}=.*, not {value}; give the same options"):
            missing_rooms(tmp_path, WANTED, other)


def test_the_views_of_the_look_are_those_that_a_build_would_take(drawn, tmp_path):
    settings = replace(PLAIN, height=LOOK[0], width=LOOK[1])
    list(make_rooms(tmp_path, WANTED[:1], settings, workers=1))
    build_room(closet(), tmp_path / "built.h5", size=LOOK, fine=False, progress=False)
    made, built = read_collection(tmp_path)[0], read_dump(tmp_path / "built.h5")
    assert all(made.views.encoded(state) == built.views.encoded(state) for state in range(20))


def test_features_and_patches_say_what_made_them(drawn, tmp_path):
    settings = replace(PLAIN, encoder="resnet50_small", patches=True)
    (entry,) = make_rooms(tmp_path, WANTED[:1], settings, workers=1)
    scene = read_collection(tmp_path)[0]
    assert (scene.features.shape, scene.patches.shape) == ((20, 2048), (20, 8, 96))
    assert entry.settings["extractor"] == scene.extractor
    with h5py.File(tmp_path / "bathroom_10000.h5") as file:
        assert dict(file["patches"].attrs) == patch_attributes()
    assert settings.stored(settings.load_encoder()) == entry.settings
    assert entry.settings["patches"] != "none"


def test_two_processes_make_rooms(tmp_path, monkeypatch):
    monkeypatch.setattr(processes, "_start", start_with_closets)
    wanted = [("bathroom", 30_000), ("bathroom", 930_000)]
    settings = replace(PLAIN, height=LOOK[0], width=LOOK[1])
    made = list(make_rooms(tmp_path, wanted, settings, workers=2))
    assert sorted((entry.kind, entry.seed) for entry in made) == wanted
    collection = read_collection(tmp_path)
    assert collection.entries == tuple(sorted(made, key=lambda entry: entry.seed))
    assert list(collection.damaged()) == []
    assert (collection[0].views[0] != collection[1].views[0]).any()
