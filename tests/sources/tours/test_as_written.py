"""Tours as the tools and their users really write them: case, comments, JavaScript, missing and huge files."""

import json
import os
import re

import pytest
from PIL import Image
from tours import WRITERS, written

from dirl.scenes import SceneError
from dirl.sources.tours import read_tour
from dirl.sources.tours.images import Equirectangular, read_panorama

NAMES = [f"place_{index}" for index in range(4)]


def edit(file, *changes):
    text = file.read_text()
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    file.write_text(text)


def links(tour):
    return {(panorama.id, link.target) for panorama in tour.panoramas for link in panorama.links}


def test_krpano_names_scenes_in_any_case(tmp_path):
    before = links(read_tour(written("krpano", tmp_path)))
    edit(tmp_path / "tour.xml", ('scene name="place_', 'scene name="Place_'))
    after = read_tour(tmp_path)
    assert links(after) == {(a.replace("p", "P", 1), b.replace("p", "P", 1)) for a, b in before}
    assert not after.notes


@pytest.mark.parametrize(
    ("headings", "stated"), [(["0.0"] * 4, [None] * 4), (["0.0", "90", "", "0"], [0, 90, None, 0])]
)
def test_krpano_states_a_heading_of_zero_where_it_knows_none(tmp_path, headings, stated):
    written("krpano", tmp_path)
    file = tmp_path / "tour.xml"
    file.write_text(re.sub(r' heading="[^"]*"', "", file.read_text()))
    edit(
        file,
        *[(f'name="{n}"', f'name="{n}" heading="{h}"') for n, h in zip(NAMES, headings, strict=True)],
    )
    assert [panorama.heading for panorama in read_tour(tmp_path).panoramas] == stated


def test_an_encrypted_krpano_tour_says_so(tmp_path):
    (tmp_path / "tour.xml").write_text("<encrypted>KENCPUZRtQi/hM</encrypted>")
    with pytest.raises(SceneError, match=r"tour\.xml: is encrypted; make the tour again with encrypt=false"):
        read_tour(tmp_path)


def test_marzipano_may_have_comments_bare_keys_and_trailing_commas(tmp_path):
    before = links(read_tour(written("marzipano", tmp_path)))
    edit(
        tmp_path / "data.js",
        ("var APP_DATA =", "// by hand\n'use strict';\nvar APP_DATA = /* all of it */"),
        ('"scenes": [', "scenes: [ // the rooms"),
        ("]\n  }", "],\n  }"),
    )
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


def test_a_script_that_makes_its_configuration_by_code_is_refused_in_one_line(tmp_path):
    file = written("pannellum", tmp_path) / "tour.json"
    text = file.read_text()
    file.unlink()
    (tmp_path / "script.js").write_text(f"v({text.replace('{', '{ load: go(), ', 1)})")
    with pytest.raises(
        SceneError, match=r"^\S+script\.js: is no JSON, and no object of JavaScript without code \("
    ) as caught:
        read_tour(tmp_path)
    assert "\n" not in str(caught.value)
    (tmp_path / "other.htm").write_text(text)
    with pytest.raises(SceneError, match=r"holds 2 tours of pannellum, other\.htm too; name the file"):
        read_tour(tmp_path)


@pytest.mark.parametrize("kind", WRITERS)
def test_panoramas_without_files_can_be_skipped(tmp_path, kind):
    tour = read_tour(written(kind, tmp_path))
    first = tour.panoramas[0]
    for file in set(first.image.files()):
        file.unlink()
    with pytest.raises(
        SceneError, match=rf"there is no file .*; without these panoramas: 'skip=\[{re.escape(first.id)}\]'$"
    ):
        read_tour(tmp_path)
    left = read_tour(tmp_path, skip=[first.id])
    assert [one.id for one in left.panoramas] == [one.id for one in tour.panoramas[1:]]
    assert links(left) == {pair for pair in links(tour) if first.id not in pair}
    with pytest.raises(SceneError, match=rf"skip: there is no panorama '{re.escape(first.id)}x'; did you mean '"):
        read_tour(tmp_path, skip=[first.id, f"{first.id}x"])
    with pytest.raises(SceneError, match="names no panoramas but those to skip"):
        read_tour(tmp_path, skip=[one.id for one in tour.panoramas])


@pytest.mark.parametrize(
    ("name", "says"),
    [
        (".", "expected the name of a file, found '.'"),
        ("./", "expected the name of a file, found './'"),
        ("x" * 300 + ".jpg", "there is no file "),
        ("pipe.jpg", "there is no file "),
        ("folder.jpg", "there is no file "),
    ],
)
def test_odd_names_of_images_are_refused_in_one_line(tmp_path, name, says):
    file = written("pannellum", tmp_path) / "tour.json"
    os.mkfifo(tmp_path / "pipe.jpg")
    (tmp_path / "folder.jpg").mkdir()
    edit(file, ('"place_0.jpg"', json.dumps(name)))
    with pytest.raises(SceneError, match=re.escape(says)) as caught:
        read_tour(tmp_path)
    assert "\n" not in str(caught.value)


def test_panoramas_between_the_limits_of_pillow_and_of_dirl_are_read(tmp_path, monkeypatch):
    file = tmp_path / "large.png"
    Image.new("RGB", (400, 200)).save(file)
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 10_000)  # Pillow refuses twice as many
    assert read_panorama(Equirectangular(file), 1000)[0].shape == (200, 400, 3)
    assert Image.MAX_IMAGE_PIXELS == 10_000
    monkeypatch.setattr("dirl.sources.tours.images.MAX_PHOTO_PIXELS", 70_000)
    with pytest.raises(SceneError, match="400x200 pixels are more than 70000"):
        read_panorama(Equirectangular(file), 1000)
