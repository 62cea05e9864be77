"""Collections: folders of random rooms, whose names say kind and seed, and so the split."""

import pytest
from rooms import grid_scene

from dirl.scenes import SceneError, load_scenes, write_dump


@pytest.fixture
def folder(tmp_path):
    """Four rooms, and what else a folder may hold."""
    folder = tmp_path / "many"
    for name in ("bedroom_30001", "bathroom_30000", "living_room_10000", "bedroom_9"):
        write_dump(folder / f"{name}.h5", grid_scene(name=name, depth=2 + (name == "bedroom_9")))
    (folder / "living_room_10000.toml").write_text("name = 'living_room_10000'")
    (folder / ".unfinished-1.h5").write_text("half a dump")
    return folder


def test_rooms_are_read_by_seed_and_split(folder):
    rooms = load_scenes(f"collection:{folder}")
    assert [room.name for room in rooms] == ["bedroom_9", "living_room_10000", "bathroom_30000", "bedroom_30001"]
    assert [len(room) for room in rooms] == [36, 24, 24, 24]
    assert [room.name for room in load_scenes(f"collection:{folder}", split="train", rooms=1)] == ["bathroom_30000"]
    with pytest.raises(SceneError, match=r"no room with split=validation; splits: \['none', 'test', 'train'\]"):
        load_scenes(f"collection:{folder}", split="validation")
    with pytest.raises(SceneError, match="is no collection; it holds no rooms such as bathroom_30000"):
        load_scenes(f"collection:{folder.parent}")


def test_a_damaged_room_is_named(folder):
    data = bytearray((folder / "bedroom_30001.h5").read_bytes())
    data[-9] ^= 1
    (folder / "bedroom_30001.h5").write_bytes(data)
    with pytest.raises(SceneError, match=r"bedroom_30001\.h5: "):
        load_scenes(f"collection:{folder}")
