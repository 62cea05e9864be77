"""Random rooms: fixed by kind and seed, all different, all usable."""

import pytest

from dirl.scenes.catalogue import split_of
from dirl.sources.rooms import check_room
from dirl.sources.rooms.description import description_text, parse_description
from dirl.sources.rooms.dump import scene_of
from dirl.sources.rooms.sampling import KINDS, sample_room
from dirl.sources.rooms.sampling.sample import draw_room
from dirl.sources.rooms.sampling.splits import EVERYTHING, HELD_OUT, TEST, TRAIN, repertoire_of
from dirl.sources.rooms.walkable import walk


@pytest.mark.parametrize("kind", KINDS)
def test_a_random_room_can_be_walked_in_and_written_down(kind):
    room = sample_room(kind, 123456, look=False)
    assert room.name == f"{kind}_123456"
    assert check_room(room) == []
    assert parse_description(description_text(room)) == room
    assert {"door", *KINDS[kind].needs} - {"table"} <= {piece.kind for piece in room.furniture}
    scene = scene_of(room, walk(room))
    assert len(scene) >= 4 * KINDS[kind].places
    assert len(scene.goals) == 5
    assert (scene.distances >= 0).all()


def test_seeds_fix_the_split_and_training_and_test_rooms_have_nothing_of_the_repertoire_in_common():
    found = {seed: split_of(seed) for seed in (0, 9_999, 10_000, 19_999, 20_000, 29_999, 30_000, 10**9)}
    assert list(found.values()) == [None, None, "test", "test", "validation", "validation", "train", "train"]
    assert [repertoire_of(seed) for seed in (5, 10_005, 20_005, 30_005)] == [EVERYTHING, TEST, TRAIN, TRAIN]
    for part in (*HELD_OUT, "seeds"):
        held = (getattr(one, part) for one in (EVERYTHING, TRAIN, TEST))
        whole, train, test = (set(range(*one) if part == "seeds" else one) for one in held)
        assert train, part
        assert test, part
        assert not train & test, part
        assert train | test == whole, part


def test_rooms_keep_to_the_repertoire_of_their_split():
    for first, other in ((10_000, TRAIN), (30_000, TEST)):
        rooms = [draw_room("bedroom", seed) for seed in range(first, first + 3)]
        materials = [one for room in rooms for name, one in room.materials.items() if name != "screen"]  # of stock
        absent = {*other.wallpapers, *other.paintings, *other.rugs, *other.outlooks}
        assert {one.kind for one in materials} & (absent - {"plain"}) == set()
        woods = {(one.options["a"], one.options["b"]) for one in materials if one.kind == "wood"}
        assert woods <= set(EVERYTHING.woods.values()) - set(other.woods.values())
        seeds = {piece.options["seed"] for room in rooms for piece in room.furniture if "seed" in piece.options}
        assert seeds
        assert not seeds & set(range(*other.seeds))
