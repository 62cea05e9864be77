"""The built-in rooms, collections of random ones, and how a user names scenes."""

import h5py
from refusals import refused
from rooms import grid_scene, published_dump

from dirl.scenes import PUBLISHED_GOALS, catalogue, load_scenes, write_dump
from dirl.scenes.catalogue import ROOMS, Thor
from dirl.scenes.io import read


def test_the_rooms_have_the_names_sizes_and_goals_of_the_paper_and_say_that_they_are_built_in():
    rooms = load_scenes("all")
    states = {"bathroom_02": 180, "bedroom_04": 408, "kitchen_02": 676, "living_room_08": 468}
    assert {room.name: len(room) for room in rooms} == states
    assert {room.name: room.goals for room in rooms} == dict(PUBLISHED_GOALS)
    assert {room.source for room in rooms} == {"rooms"}
    assert {(room.extractor, room.features.shape[1]) for room in rooms} == {(rooms[0].extractor, 2048)}
    assert "ResNet-50" in rooms[0].extractor
    assert sum(path.stat().st_size for path in ROOMS.glob("*.h5")) < 30e6


def test_published_dumps_have_a_folder_of_their_own_and_get_the_published_goals(tmp_path):
    for name in ("bathroom_02", "bathroom_01"):
        published_dump(tmp_path / f"{name}.h5", grid_scene(width=6, depth=5))
    first, second = load_scenes(["bathroom_02", "bathroom_01"], source=Thor(tmp_path))
    assert (first.name, first.source, first.goals) == ("bathroom_02", "thor", PUBLISHED_GOALS["bathroom_02"])
    assert (second.name, second.source, second.goals) == ("bathroom_01", "thor", ())
    with h5py.File(tmp_path / "bathroom_02.h5", "a") as file:
        file.attrs["goals"] = [3]
    assert load_scenes("bathroom_02", source=Thor(str(tmp_path)))[0].goals == (3,)
    refused(r"choose from bathroom_01, bathroom_02, all", load_scenes, "kitchen_02", source=Thor(tmp_path))
    refused("nowhere: there is no such folder", load_scenes, "all", source=Thor(tmp_path / "nowhere"))
    refused(r"^source=thor needs the folder of your dumps: source\.root=", load_scenes, "all", source=Thor())


def test_damaged_built_in_rooms_and_hashes_are_refused(tmp_path, monkeypatch):
    for file in ("SHA256SUMS", "bathroom_02.h5", "bathroom_02.patches.npy"):
        (tmp_path / file).write_bytes((ROOMS / file).read_bytes())
    monkeypatch.setattr(catalogue.Rooms, "folder", tmp_path)
    monkeypatch.setattr(read, "ROOMS", tmp_path)
    room = load_scenes("bathroom_02")[0]
    assert (len(room), room.patches is not None) == (180, True)
    content = bytearray((tmp_path / "bathroom_02.h5").read_bytes())
    content[-1] ^= 1
    (tmp_path / "bathroom_02.h5").write_bytes(content)
    refused(r"bathroom_02\.h5: is not the built-in room that was installed \(SHA-256 d", load_scenes, "bathroom_02")
    sums = (ROOMS / "SHA256SUMS").read_bytes()
    for damaged in (sums[:-9], sums.replace(b"bathroom_02.h5", b"bathroom\xff02.h5")):
        (tmp_path / "SHA256SUMS").write_bytes(damaged)
        refused("SHA256SUMS: is not the list of hashes that was installed", load_scenes, "bathroom_02")


def test_rooms_are_read_by_seed_and_split_whatever_else_the_folder_holds(tmp_path):
    collection = tmp_path / "many"
    for name in ("bedroom_30001", "bathroom_30000", "living_room_10000", "bedroom_9"):
        write_dump(collection / f"{name}.h5", grid_scene(name=name, depth=2 + (name == "bedroom_9")))
    (collection / "living_room_10000.toml").write_text("name = 'living_room_10000'")
    (collection / ".unfinished-1.h5").write_text("half a dump")
    rooms = load_scenes(f"collection:{collection}")
    assert [room.name for room in rooms] == ["bedroom_9", "living_room_10000", "bathroom_30000", "bedroom_30001"]
    assert [len(room) for room in rooms] == [36, 24, 24, 24]
    assert [room.name for room in load_scenes(f"collection:{collection}", split="train", rooms=1)] == ["bathroom_30000"]
    told = r"no room with split=validation; splits: \['none', 'test', 'train'\]"
    refused(told, load_scenes, f"collection:{collection}", split="validation")
    refused("holds no rooms such as bathroom_30000", load_scenes, f"collection:{collection.parent}")
