"""Building rooms: what the checks find, what stands in the file, and that another machine builds the same."""

import os
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from closet import closet
from PIL import Image
from refusals import refused

pytest.importorskip("embreex")
from dirl.perception.backbones import ResNet50, ViewEncoder, preprocess
from dirl.scenes import read_dump
from dirl.sources.rooms import build_room, built_in_rooms, check_room, describe_room
from dirl.sources.rooms.checks import check_views, contrast, thumbnail
from dirl.sources.rooms.description import Piece
from dirl.sources.rooms.dump import Changes, look_views
from dirl.sources.rooms.view import Renderer
from dirl.sources.rooms.walkable import walk

REFERENCES = Path(__file__).parents[2] / "data" / "bathroom_02"
"""Views of the bathroom in coarse light, 60x80 PNG, rendered on the machine that made the rooms; named by states."""

SMALL = {"size": (24, 32), "fine": False}


def problems(*pieces):
    room = closet()
    return check_room(replace(room, furniture=(*room.furniture, *pieces), grid=replace(room.grid, places=None)))


@pytest.mark.parametrize("name", ["closet", *built_in_rooms()])
def test_a_well_made_room_has_no_problems(name):
    assert check_room(closet() if name == "closet" else describe_room(name)) == []


def test_furniture_that_meets_other_furniture_leaves_the_room_or_is_in_the_way_is_found():
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


def test_a_room_is_built_with_graph_views_features_and_its_description(tmp_path):
    backbone = ResNet50()
    encoder = ViewEncoder(
        lambda views: backbone(preprocess(views)), {"extractor": "random ResNet-50", "weights": "none"}
    )
    build_room(closet(), tmp_path / "closet.h5", encoder=encoder, **SMALL)
    scene = read_dump(tmp_path / "closet.h5")
    assert (scene.name, scene.goals, scene.source) == ("closet", (3,), "synthetic")
    assert (scene.graph == walk(closet()).graph).all()
    assert scene.views[0].shape == (24, 32, 3)
    assert scene.views[0].std() > 10
    assert (scene.features.shape, scene.features.dtype) == ((20, 2048), np.float16)
    assert scene.extractor == "random ResNet-50; none"
    with h5py.File(tmp_path / "closet.h5") as file:
        assert 'name = "closet"' in file.attrs["room"]


def test_threads_and_smaller_turns_give_the_same_views(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    build_room(closet(), tmp_path / "one.h5", **SMALL)
    monkeypatch.setattr(os, "cpu_count", lambda: 4)
    build_room(closet(), tmp_path / "two.h5", **SMALL, turn=45)
    one, two = read_dump(tmp_path / "one.h5"), read_dump(tmp_path / "two.h5")
    assert len(two) == 2 * len(one)
    assert all((one.views[state] == two.views[2 * state]).all() for state in range(len(one)))
    assert (one.goals, two.goals) == ((3,), (6,))


@pytest.mark.parametrize(("options", "message"), [
    ({"size": (4, 32)}, "size=.4, 32.: views are 8 to 4096 pixels"),
    ({"turn": 100}, "turn=100: a turn must go into 90 degrees"),
    ({}, "this file exists already"),
])  # fmt: skip
def test_what_cannot_be_built_is_refused_at_once(tmp_path, options, message):
    (tmp_path / "closet.h5").write_text("mine")
    out = tmp_path / ("new.h5" if options else "closet.h5")
    refused(message, build_room, closet(), out, **{**SMALL, **options})
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == [("closet.h5", "mine")]


def test_the_bathroom_is_built_the_same_on_this_machine():
    """Up to rounding, which moves a ray across an edge here and there: a PSNR above 50 dB (the graph: see above)."""
    room = describe_room("bathroom_02")
    way, renderer = walk(room), Renderer.of(room, fine=False)
    stored = sorted(REFERENCES.glob("*.png"))
    assert len(stored) == 6
    for file in stored:
        place, heading = divmod(int(file.stem), 4)
        with Image.open(file) as image:
            reference = np.asarray(image).astype(float)
        view = renderer.view(room.camera, (*way.places[place], way.headings[heading]), reference.shape[:2])
        error = ((view - reference) ** 2).mean()
        assert 10 * np.log10(255**2 / max(error, 1e-9)) > 50, f"state {file.stem}"


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
