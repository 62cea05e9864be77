"""Collections: an index that survives being killed, and scenes that are read when they are asked for."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest
from rooms import grid_scene

from dirl.scenes import SceneError, write_dump
from dirl.scenes.collection import INDEX, Entry, add_entry, read_collection
from dirl.scenes.io.digest import file_digest
from dirl.scenes.io.read import read_dump


def add(folder, kind, seed, split, **options):
    name = f"{kind}_{seed}"
    folder.mkdir(exist_ok=True)
    scene = grid_scene(name=name, **options)
    write_dump(folder / f"{name}.h5", scene)
    entry = Entry(
        name, kind, seed, split, len(scene), {"problems": []}, {"width": 64}, file_digest(folder / f"{name}.h5")
    )
    add_entry(folder, entry)
    return entry


@pytest.fixture
def folder(tmp_path):
    """Four rooms, out of order."""
    folder = tmp_path / "many"
    for kind, seed, split in (
        ("bedroom", 30001, "train"),
        ("bathroom", 30000, "train"),
        ("bedroom", 10000, "test"),
        ("bedroom", 30000, "train"),
    ):
        add(folder, kind, seed, split, depth=2 + (kind == "bedroom"))
    return folder


def test_scenes_are_read_one_at_a_time_by_seed_and_kind(folder):
    collection = read_collection(folder)
    assert [scene.name for scene in collection] == ["bedroom_10000", "bathroom_30000", "bedroom_30000", "bedroom_30001"]
    assert (len(collection), len(collection[1]), len(collection[-1])) == (4, 24, 36)
    assert [entry.seed for entry in collection[2:].entries] == [30000, 30001]
    (folder / "bedroom_30001.h5").unlink()
    assert collection[0].name == "bedroom_10000"  # no other dump is touched
    with pytest.raises(SceneError, match=r"bedroom_30001\.h5: there is no such file"):
        collection[3]


def test_features_of_a_room_are_read_when_they_are_used(folder):
    """They are memory-mapped, so that many rooms need memory for them only once, in their world."""
    scene = read_collection(folder)[0]
    base = scene.features
    while not isinstance(base, np.memmap):
        base = base.base
    assert (scene.features == read_dump(folder / "bedroom_10000.h5").features).all()


def test_splits_are_selected(folder):
    collection = read_collection(folder)
    assert [entry.name for entry in collection.select(split="test").entries] == ["bedroom_10000"]
    assert len(collection.select(split="train")) == 3
    with pytest.raises(SceneError, match=r"no room with split=validation; splits: \['test', 'train'\]"):
        collection.select(split="validation")


def test_a_changed_or_missing_dump_and_another_room_are_found(folder):
    collection = read_collection(folder)
    assert list(collection.damaged()) == []
    (folder / "bathroom_30000.h5").unlink()
    with (folder / "bedroom_10000.h5").open("ab") as file:
        file.write(b"x")
    assert list(collection.damaged()) == ["bedroom_10000", "bathroom_30000"]
    write_dump(folder / "bedroom_10000.h5", grid_scene())
    with pytest.raises(SceneError, match=r"bedroom_10000\.h5: has 24 states; collection\.jsonl says 36"):
        collection[0]


@pytest.mark.parametrize("kept", [1, -1])
def test_a_line_that_was_cut_short_is_forgotten(folder, kept):
    index = folder / INDEX
    before = index.read_bytes()
    entry = read_collection(folder).entries[-1]
    line = (json.dumps(asdict(replace(entry, name="bedroom_7", seed=7))) + "\n").encode()
    index.write_bytes(before + line[:kept])
    assert len(read_collection(folder)) == 4
    add(folder, "kitchen", 5, None)
    assert read_collection(folder).entries[0].name == "kitchen_5"
    assert len(read_collection(folder)) == 5


def test_the_later_line_of_a_room_counts(folder):
    entry = read_collection(folder).entries[0]
    add_entry(folder, replace(entry, sha256="0" * 64))
    assert read_collection(folder).entries[0].sha256 == "0" * 64
    assert len(read_collection(folder)) == 4


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("{}", "line 5: name: is missing"),
        ("nonsense", "line 5: is no entry of a collection"),
        ("seed", "line 5: seed: must be a valid integer, found '30001'"),
        ("name", "line 5: name: expected one without slashes, found '../up'"),
    ],
)
def test_a_spoilt_index_names_the_line(folder, line, says, tmp_path):
    with pytest.raises(SceneError, match=r"is no collection; it holds no collection\.jsonl"):
        read_collection(tmp_path)
    changed = {"seed": {"seed": "30001"}, "name": {"name": "../up"}}
    if line in changed:
        line = json.dumps(asdict(read_collection(folder).entries[0]) | changed[line])
    with (folder / INDEX).open("a") as file:
        file.write(line + "\n")
    with pytest.raises(SceneError, match=says) as caught:
        read_collection(folder)
    assert "\n" not in str(caught.value)
