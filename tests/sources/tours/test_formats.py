"""Tours of all kinds: of a room that is known exactly, and as users write them, odd, broken or hostile."""

import os
import re
import struct
import zlib
from functools import partial

import numpy as np
import pytest
from closet import closet
from PIL import Image
from refusals import refused
from tours import WRITERS, Camera360, room_truth, turned, write_krpano, write_pannellum, written

from dirl.scenes.views import decode
from dirl.sources.rooms.walkable import walk
from dirl.sources.tours import pixels, read_tour
from dirl.sources.tours.conversion import tour_scene
from dirl.sources.tours.pixels import cut_views, read_panorama, six_images


def change(file, old, new, count=1):
    text = file.read_text()
    assert re.search(old, text, re.DOTALL), old
    file.write_text(re.sub(old, lambda _: new, text, count=count, flags=re.DOTALL))


def links(tour):
    return {(panorama.id, link.target) for panorama in tour.panoramas for link in panorama.links}


SPOILT = {
    "code instead of data": ("marzipano", "data.js", r'"scenes": ', '"scenes": all() + ', "data.js: is no JSON, and"),
    "a scene outside": ("marzipano", "data.js", "place_0", "../../etc", "scene '../../etc': .* lies outside of"),
    "no such tile": ("marzipano", "data.js", "place_0", "hall", "'hall': there is no file .*hall"),
    "a yaw of text": ("marzipano", "data.js", r'"yaw": [-.\de]+', '"yaw": "x"', "'place_0': yaw: expected a number"),
    "tiles without end": ("marzipano", "data.js", r'"size": 8', '"size": 30000', "are more than 64 tiles a side"),
    "an entity": ("krpano", "tour.xml", "^", '<!DOCTYPE k [<!ENTITY a "aa">]>', "has a document type"),
    "encrypted": ("krpano", "tour.xml", "^.*$", "<encrypted>K</encrypted>", "is encrypted; make the tour again"),
    "a scene twice": ("krpano", "tour.xml", 'name="place_1"', 'name="PLACE_0"', "two scenes have the name 'PLACE_0'"),
    "on the web": ("krpano", "tour.xml", 'cube url="', 'cube url="https://x.org/', "place_0': '.*' is on the web"),
    "turned": ("krpano", "tour.xml", "<image>", '<image prealign="0|3|0">', "turns the panorama.*'skip=.place_0.'$"),
    "an absolute path": ("pannellum", "tour.json", '"place_0.jpg"', '"/etc/passwd"', "'/etc/passwd' lies outside"),
    "a pipe": ("pannellum", "tour.json", '"place_0.jpg"', '"pipe.jpg"', "there is no file "),
    "deep JSON": ("pannellum", "tour.json", "^.*$", '{"scenes":' * 100_000, "is no JSON"),
    "another column": ("table", "links.csv", "yaw", "jaw", "links.csv: line 1: columns: there is no 'jaw'; did you"),
}


@pytest.mark.parametrize("case", SPOILT)
def test_a_broken_tour_is_refused_in_one_line(case, tmp_path):
    kind, file, old, new, says = SPOILT[case]
    written(kind, tmp_path)
    os.mkfifo(tmp_path / "pipe.jpg")
    change(tmp_path / file, old, new)
    assert file.split(".")[0] in refused(says, read_tour, tmp_path)


def test_headings_and_places_that_tours_state_are_read(tmp_path):
    """A heading of zero everywhere is what krpano states where it knows none."""
    for headings, stated in ((["0.0"] * 4, [None] * 4), (["0.0", "90", "", "0"], [0, 90, None, 0])):
        file = written("krpano", tmp_path) / "tour.xml"
        for heading in headings:
            change(file, ' heading=""', f" heading='{heading}'")
        assert [panorama.heading for panorama in read_tour(tmp_path).panoramas] == stated
    file.unlink()
    change(written("pannellum", tmp_path) / "tour.json", '"type": "equirect', '"northOffset": 12, "type": "equirect')
    assert [panorama.heading for panorama in read_tour(tmp_path).panoramas] == [12, None, None, None]
    written("table", tmp_path)
    (tmp_path / "panoramas.csv").write_text("image,heading\nplace_1.jpg,30\nplace_2.jpg,\n")
    told = [(one.position, one.heading) for one in read_tour(tmp_path).panoramas]
    assert told == [(None, None), (None, 30.0), (None, None), (None, None)]


def test_marzipano_may_have_comments_bare_keys_and_trailing_commas(tmp_path):
    before, file = links(read_tour(written("marzipano", tmp_path))), tmp_path / "data.js"
    change(file, "var APP_DATA =", "// by hand\n'use strict';\nvar APP_DATA = /* all of it */")
    change(file, r'"scenes": \[', "scenes: [ // the rooms")
    change(file, r"\]\n  }", "],\n  }", count=0)
    assert links(read_tour(tmp_path)) == before


SCRIPTS = {
    "script.js": "var other = {a: 1};\npannellum.viewer('panorama', %s);\n",
    "config.js": "'use strict';\n/* scenes: see below */ const config = %s;\npannellum.viewer('p', config);",
    "index.html": "<html><style>body { margin: 0 }</style><script>\nif (1) { pannellum.viewer('p', %s) }</script>",
}


@pytest.mark.parametrize("name", SCRIPTS)
def test_pannellum_may_be_configured_in_a_script(tmp_path, name):
    file = written("pannellum", tmp_path) / "tour.json"
    before = links(read_tour(tmp_path))
    bare = re.sub(r'"(\w+)":', r"\1:", file.read_text()).replace('"', "'").rstrip()
    (tmp_path / name).write_text(SCRIPTS[name] % (bare[:-1] + "/* the end */,\n}"))
    file.unlink()
    (tmp_path / "pannellum.js").write_text("window.pannellum = (function () { return {}; })();")
    for path in (tmp_path, tmp_path / name):
        assert links(read_tour(path)) == before


def test_functions_of_hot_spots_and_other_files_do_not_hide_a_tour(tmp_path):
    file = written("pannellum", tmp_path) / "tour.json"
    function = "function (div, args) { if (args) { div.title = '}'; } return {go: () => { /* } */ }}; }"
    change(file, '"type": "info"', f'"createTooltipFunc": {function}, "type": "info"', count=0)
    (tmp_path / "package.json").write_text('{"name": "a tour: {it, is}"}')
    (tmp_path / "index.html").write_text('<p>It\'s here</p><script src="pannellum.js"></script>')
    assert len(links(read_tour(tmp_path))) == 8


@pytest.mark.parametrize("kind", WRITERS)
def test_panoramas_without_files_can_be_skipped(tmp_path, kind):
    tour = read_tour(written(kind, tmp_path))
    first = tour.panoramas[0]
    for file in set(first.image.files()):
        file.unlink()
    refused(rf"there is no file .*; without these .*: 'skip=\[{re.escape(first.id)}\]'$", read_tour, tmp_path)
    left = read_tour(tmp_path, skip=[first.id])
    assert [one.id for one in left.panoramas] == [one.id for one in tour.panoramas[1:]]
    assert links(left) == {pair for pair in links(tour) if first.id not in pair}


def test_what_is_no_tour_is_refused_nor_a_panorama_that_can_be_skipped(tmp_path):
    refused("there is no such file or folder", read_tour, tmp_path / "nowhere")
    refused(r"is no tour; expected one of data\.js", read_tour, tmp_path)
    for name in ("a.json", "b.json"):
        (tmp_path / name).write_text('{"scenes": 1}')
    refused("expected 'scenes'", read_tour, tmp_path / "a.json")
    refused(r"holds 2 tours of pannellum, a\.json too; name the file", read_tour, tmp_path)
    table = written("table", tmp_path) / "links.csv"
    ids = [one.id for one in read_tour(table).panoramas]
    refused("names no panoramas but those to skip", read_tour, table, skip=ids)
    refused("skip: there is no panorama 'place_0.jpgx'; did you mean '", read_tour, table, skip=["place_0.jpgx"])


def test_links_that_lead_nowhere_are_left_out_and_noted(tmp_path):
    written("table", tmp_path)
    text = (tmp_path / "links.csv").read_text()
    rows = ["place_0.jpg,place_0.jpg,5", "place_0.jpg,place_1.jpg,70", ""]
    (tmp_path / "links.csv").write_text(text + "\n".join(rows))
    Image.new("RGB", (16, 8)).save(tmp_path / "attic.png")
    tour = read_tour(tmp_path)
    assert [link.target for link in tour.panoramas[0].links] == ["place_1.jpg", "place_2.jpg"]
    assert tour.panoramas[0].links[0].yaw == 0
    assert tour.notes == (
        "1 images have no link and are left out, the first: attic.png",
        "1 links from a panorama to itself are left out, the first: 'place_0.jpg' to 'place_0.jpg'",
        "1 links beside another one to the same panorama are left out, the first: 'place_0.jpg' to 'place_1.jpg'",
    )
    written("marzipano", tmp_path)
    change(tmp_path / "data.js", '"target": "place_1"', '"target": "attic"')
    assert read_tour(tmp_path).notes == (
        "1 links to panoramas that the tour does not have are left out, the first: 'place_0' to 'attic'",
    )


def cut_all(tour):
    shown = [panorama.image for panorama in tour.panoramas]
    return list(cut_views(shown, np.zeros((len(shown), 1)), size=(16, 16), field_of_view=90))


def test_a_broken_image_is_named(tmp_path):
    tour = read_tour(written("marzipano", tmp_path))
    assert len(cut_all(tour)) == 4
    tile = tmp_path / "tiles/place_2/2/l/1/0.jpg"
    whole = tile.read_bytes()
    tile.write_bytes(whole[: len(whole) // 2])
    refused(r"place_2/2/l/1/0\.jpg: not a readable image", cut_all, tour)
    Image.new("RGB", (5, 2)).save(tile)
    refused(r"place_2/2/l/0/0\.jpg: the tiles of face 'l' make", cut_all, tour)
    other = read_tour(written("table", tmp_path) / "links.csv")
    Image.new("RGB", (40, 30)).save(tmp_path / "place_1.jpg")
    refused(r"place_1\.jpg: 40x30 pixels; an equirectangular image is twice as wide", cut_all, other)


def test_flat_pictures_of_a_tour_are_left_out(tmp_path):
    krpano, pannellum = written("krpano", tmp_path) / "tour.xml", written("pannellum", tmp_path) / "tour.json"
    change(krpano, "<image>", '<image hfov="1.00">')
    change(pannellum, '"type"', '"haov": 90, "type"')
    for tour in map(read_tour, (krpano, pannellum)):
        assert [panorama.id for panorama in tour.panoramas] == ["place_1", "place_2", "place_3"]
        assert "1 flat pictures are left out, the first: " in tour.notes[0]


def test_declared_sizes_are_checked_before_any_tile_is_decoded(tmp_path, monkeypatch):
    tour = read_tour(written("marzipano", tmp_path))
    header = struct.pack(">II5B", 12_000, 12_000, 8, 2, 0, 0, 0)  # of a PNG of 144 million pixels that are not there
    chunk = struct.pack(">I", len(header)) + b"IHDR" + header + struct.pack(">I", zlib.crc32(b"IHDR" + header))
    for tile in (tmp_path / "tiles" / "place_1").rglob("*.jpg"):
        tile.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk + struct.pack(">I", 9) + b"IDAT")
    refused(r"place_1.*: the tiles of face 'f' make 24000x24000 pixels, not 8x8", cut_all, tour)
    monkeypatch.setattr(pixels, "MAX_FACE_PIXELS", 8**2 - 1)
    tour = read_tour(written("krpano", tmp_path) / "tour.xml")
    refused("the tiles of face 'f' make 8x8 pixels, not a square", cut_all, tour)


KINDS = {
    **WRITERS,
    **{f"krpano_{image}": partial(write_krpano, image=image) for image in ("multires", "level", "sphere")},
    **{f"pannellum_{image}": partial(write_pannellum, image=image) for image in ("cubemap", "multires")},
}
SIZE, FOV = (24, 32), 75.0


@pytest.fixture(scope="module")
def camera():
    pytest.importorskip("embreex")
    return Camera360(closet())


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_read_back_as_the_room(kind, camera, tmp_path):
    truth = turned(room_truth(), 0.5)
    tour = read_tour(KINDS[kind](tmp_path, truth, camera))
    assert len(tour.panoramas) == 5
    made = tour_scene(tour, headings=8)
    looks = (truth.middles[:, None] + made.yaws) % 360
    shift = round(looks[0, 0] / 45)  # the zero of the map is not known: by it the numbers of headings differ
    states = (8 * np.arange(5)[:, None] + (np.arange(8) + shift) % 8).ravel()
    expected = np.append(np.argsort(states), -1)[walk(closet(), 45).graph[states]]
    assert (made.scene.graph == expected).all()
    off = (looks - 45 * ((np.arange(8) + shift) % 8) + 180) % 360 - 180
    assert np.abs(off).max() < 1
    assert np.allclose(np.diff(made.scene.headings.reshape(5, 8)[:, :2]) % 360, 45)
    images = [panorama.image for panorama in tour.panoramas]
    views = [decode(view) for view in cut_views(images[:1], made.yaws[:1], size=SIZE, field_of_view=FOV)]
    for heading in (0, 1, 6):
        seen = camera.view(truth.places[0], truth.middles[0] + made.yaws[0, heading], SIZE, FOV)
        error = np.abs(views[heading].astype(float) - seen)
        assert error.mean() < 6, heading
        other = camera.view(truth.places[0], truth.middles[0] + made.yaws[0, heading] + 12, SIZE, FOV)
        assert np.abs(views[heading].astype(float) - other).mean() > 2 * error.mean(), heading


def test_faces_of_a_cube_that_differ_in_size_are_refused(tmp_path):
    for face in "frblud":
        side = 16 if face == "d" else 8
        Image.new("RGB", (side, side)).save(tmp_path / f"{face}.png")
    cube = six_images(lambda face: tmp_path / f"{face}.png")
    refused(r"f\.png: the faces of this cube differ in size", read_panorama, cube, 4.0)
