"""recipes/scenes.py as a user runs it."""

import shlex
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest
from closet import closet
from commands import run_recipe
from networks import coarse_networks
from PIL import Image
from refusals import refused
from rooms import grid_scene
from scenes import COMMANDS, OPTIONS
from tours import Camera360, grid_truth, save, turned, write_table

from dirl.cli.parsing import parse
from dirl.scenes import SceneError, read_dump, write_dump
from dirl.scenes.views import encode


@pytest.fixture
def here(tmp_path, monkeypatch):
    """Relative names are in the test's own folder; networks read coarse views."""
    monkeypatch.chdir(tmp_path)
    coarse_networks(monkeypatch)
    return tmp_path


@pytest.fixture
def room(here):
    """A dump with views."""
    rng = np.random.default_rng(0)
    views = [encode(rng.integers(0, 256, (30, 40, 3), np.uint8)) for _ in range(24)]
    write_dump(here / "room.h5", grid_scene(goals=(0, 13)), views)


def run(line):
    """What the recipe does with a command line, without a process of its own."""
    command, *arguments = shlex.split(line)
    options = parse(OPTIONS[command], arguments)
    COMMANDS[type(options)](options)


def test_the_program_ends_with_one_line_or_with_the_work_done(room, here):
    status, _, errors = run_recipe(here, "scenes", "encode", "scene=room.h5", "out=room.h5", "encoder=x")
    assert (status, errors) == (1, "error: out=room.h5: this file exists already; it is not overwritten\n")
    status, printed, errors = run_recipe(here, "scenes", "export", "scene=room.h5", "out=out.h5")
    assert (status, printed.split(":")[0]) == (0, "out.h5"), errors
    assert sorted(path.name for path in here.iterdir()) == ["out.h5", "room.h5"]


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("encode scene=room.h5 out=new.h5 encoder=null", "encoder=null: encode needs one"),
        ("sample kind=bedrom out=new", "kind: there is no 'bedrom'; did you mean 'bedroom'?"),
        ("sample kind=bedroom out=room.h5", "room.h5: is there already, and is no collection"),
        ("export scene=room.h5 out=new.zip", "out=new.zip: the name must end in .h5"),
        ("sample kind=bedroom out=new looks=1 encoder=null", "looks=1: their views are encoded"),
        ("sample kind=bedroom out=new changes.heading=-1", "changes.heading=-1.0: must be greater than or equal to 0"),
    ],
)
def test_a_mistake_is_told_before_anything_is_written(room, here, line, says):
    assert says in refused(".", run, line)
    assert sorted(path.name for path in here.iterdir()) == ["room.h5"]


def test_photographs_become_a_dump_that_is_encoded_and_inspected(here, capsys):
    """Of two visits: the second one's pictures are looks of a place that changes."""
    folder = here / "office"
    folder.mkdir()
    lines = ["image,location,heading,x,z,ahead,goal,shot"]
    rng = np.random.default_rng(0)
    for shot in ("", "1"):
        for location, x in (("hall", 0), ("door", 1)):
            for turn in range(8):
                name = f"{location}{turn}{shot}.jpg"
                Image.fromarray(rng.integers(0, 256, (90, 160, 3), np.uint8)).save(folder / name)
                ahead = {("hall", 2): "door", ("door", 6): "hall"}.get((location, turn), "") if not shot else ""
                goal = "yes" if name == "door2.jpg" else ""
                lines.append(f"{name},{location},{45 * turn},{x},0,{ahead},{goal},{shot}")
    (folder / "states.csv").write_text("\n".join(lines))
    with pytest.raises(SceneError, match="of further shots only features are stored; give an encoder"):
        run("photos folder=office out=office.h5 encoder=null")
    run("photos folder=office out=office.h5 height=60 width=80 encoder=resnet50_small patches=true")
    assert "office.h5: 16 states (source: photos)" in capsys.readouterr().out
    scene = read_dump("office.h5")
    assert (scene.name, scene.goals, scene.looks, scene.views[0].shape) == ("office", (10,), 2, (60, 80, 3))
    assert scene.patches.shape == (16, 8, 96)
    run("encode scene=office.h5 encoder=resnet50_small out=encoded.h5")
    assert "extractor: ResNet-50, global average pool; RGB resized to 96x128" in capsys.readouterr().out
    np.testing.assert_allclose(read_dump("encoded.h5").features, scene.features, rtol=1e-4, atol=1e-6)
    run("inspect scene=encoded.h5 out=pictures threshold=0.2 match=front")
    printed = capsys.readouterr().out
    for words in ("| turn          | 45 degrees |", "ambiguous pairs (match=front above 0.2)", "problems:\n- states "):
        assert words in printed
    assert {path.name for path in (here / "pictures").iterdir()} == {"map.png", "contact_sheet.jpg"}


def test_a_tour_becomes_a_dump(here, capsys):
    """Its views are in the order of the states, and what a user must know of it is printed first."""
    truth = turned(grid_truth(2, 2), 0.5)
    (here / "hall").mkdir()
    write_table(here / "hall", truth, Camera360(), 16)
    for index, name in enumerate(truth.names):  # the brightness of a column tells the direction that it shows
        columns = (np.arange(64) / 64 * 360 - 180 + truth.middles[index]) % 360 * 255 / 360
        pixels = np.broadcast_to(columns[None, :, None], (32, 64, 3)).astype(np.uint8)
        save(pixels, here / "hall" / f"{name}.jpg")
    run("tour path=hall out=hall.h5 height=16 width=16 field_of_view=40 encoder=null")
    printed = capsys.readouterr().out.splitlines()
    assert printed[0] == "hall/links.csv: 4 panoramas"
    assert "hall.h5: 32 states (source: tour), " in printed[-2]
    scene = read_dump("hall.h5")
    assert (scene.positions[::8] == truth.places).all()
    shown = np.array([scene.views[state][:, 7:9].mean() for state in range(32)]).reshape(4, 8) * 360 / 255
    off = (shown - scene.headings.reshape(4, 8) + 180) % 360 - 180
    off = (off - np.median(off) + 180) % 360 - 180  # the zero of the map is any multiple of 45 degrees
    assert (np.abs(off) < 5).sum() >= 28  # not where white follows black
    run("tour path=hall out=encoded.h5 height=16 width=16 field_of_view=40 patches=false")
    encoded = read_dump("encoded.h5")
    ahead = encoded.graph[:, 0] >= 0
    assert ((encoded.along != 0).any(1) == ahead).all()
    # In a grid each arrow lies along a heading, whose view is here as wide as that along the arrow.
    np.testing.assert_allclose(encoded.along[ahead], encoded.features[ahead], atol=0.05)
    if find_spec("cv2") is None:
        assert encoded.toward is None
    else:
        assert not encoded.toward.any(), "nothing is to be recognised in a scale of greys"
    refused("headings=6: must be a multiple of four", run, "tour path=hall out=new.h5 headings=6 encoder=null")


def test_random_rooms_are_listed_with_what_was_checked(here, capsys, monkeypatch):
    pytest.importorskip("embreex")
    asked = []

    def room(kind, seed, *, threads):
        asked.append((kind, seed))
        return replace(closet(), name=f"{kind}_{seed}"), []

    monkeypatch.setattr("dirl.sources.rooms.collect.sample_views", room)
    line = "sample kind=bedroom seed=29999 count=2 out=many height=24 width=32 fine=false workers=1 encoder=null"
    run(line)
    first, *table = capsys.readouterr().out.splitlines()
    assert first == "many: 0 of 2 rooms are there"
    assert len(table) == 6
    assert table[2:4] == [
        "| bedroom_29999 | validation | 2 x 1.5 x 2.4 | 3 | 5 | 20 | none |",
        "| bedroom_30000 | train | 2 x 1.5 x 2.4 | 3 | 5 | 20 | none |",
    ]
    assert table[-1] == "2 rooms: many"
    made = [f"bedroom_{seed}.{ending}" for seed in (29999, 30000) for ending in ("h5", "toml")]
    assert sorted(path.name for path in (here / "many").iterdir()) == made
    assert asked == [("bedroom", 29999), ("bedroom", 30000)]
    run(line.replace("count=2", "count=3"))
    assert asked[2:] == [("bedroom", 30001)]
    assert capsys.readouterr().out.startswith("many: 2 of 3 rooms are there")
    refused("bedroom_29999 was made with height=24, not 25", run, line.replace("height=24", "height=25"))


def test_a_dump_goes_out_and_comes_back_as_it_was(room, capsys):
    run("export scene=room.h5 out=icra/out.h5")
    run("import scene=icra/out.h5 out=back.h5 source=thor goals=[3,4] name=hall")
    assert "back.h5: 24 states (source: thor)" in capsys.readouterr().out
    before, between, after = (read_dump(name) for name in ("room.h5", "icra/out.h5", "back.h5"))
    for part in ("graph", "positions", "headings", "distances", "features"):
        assert (getattr(after, part) == getattr(before, part)).all(), part
    assert (after.name, after.goals) == ("hall", (3, 4))
    for state in range(24):
        assert (after.views[state] == between.views[state]).all()
