"""Scenes from a folder of photographs with states.csv."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import ExifTags, Image
from refusals import refused
from rooms import grid_scene

from dirl.scenes.views import decode
from dirl.sources.photos import draft_table, encoded_photos, read_photos
from dirl.sources.video import photo_field_of_view

HEADER = "image,location,heading,x,z,ahead"


def corridor(offset=0):
    """Two places, hall and door, one metre apart; ahead of the hall, looking along +x, is the door."""
    lines = []
    for location, x in (("hall", 0), ("door", 1)):
        for turn in range(4):
            heading = offset + 90 * turn
            ahead = {("hall", 1): "door", ("door", 3): "hall"}.get((location, turn), "")
            lines.append(f"{location}_{turn}.png,{location},{heading:g},{x},0,{ahead}")
    return lines


def folder_of(path, lines, header=HEADER):
    for line in lines:
        image = path / line.split(",")[0]
        if image.suffix == ".png":
            Image.new("RGB", (40, 30), (len(line), 50, 90)).save(image)
    (path / "states.csv").write_text("\n".join([header, *lines]) + "\n", encoding="utf-8")
    return path


@given(width=st.integers(1, 3), depth=st.integers(1, 3), turns=st.sampled_from([4, 8, 12]), data=st.data())
@settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_room_written_as_a_table_is_read_back(tmp_path, width, depth, turns, data):
    walls = data.draw(st.lists(st.tuples(st.integers(0, width - 1), st.integers(0, depth - 1)), unique=True))
    room = grid_scene(width, depth, headings=turns, blocked=walls[: width * depth - 1], goals=())
    Image.new("RGB", (4, 3)).save(tmp_path / "all.png")
    lines = [
        f"all.png,{state // turns},{room.headings[state]},{x},{z},"
        + ",".join("" if to < 0 else str(to // turns) for to in room.graph[state, [0, 3]])
        for state, (x, z) in enumerate(room.positions)
    ]
    shuffled = data.draw(st.permutations(range(len(lines))))
    (tmp_path / "states.csv").write_text("\n".join([f"{HEADER},back", *(lines[i] for i in shuffled)]))
    read, _ = read_photos(tmp_path)
    # States are numbered by where they first stand in the table: match them by place and heading.
    number = {(tuple(p), h): state for state, (p, h) in enumerate(zip(read.positions, read.headings, strict=True))}
    mine = np.array([number[tuple(p), h] for p, h in zip(room.positions, room.headings, strict=True)])
    assert (read.graph[mine] == np.where(room.graph >= 0, mine[room.graph], -1)).all()


def changed(line, old, new):
    lines = corridor()
    assert old in lines[line]
    lines[line] = lines[line].replace(old, new)
    return lines


@pytest.mark.parametrize(
    ("lines", "says"),
    [
        (changed(0, "hall_0.png", "hall_9.jpg"), "line 2: image: there is no file 'hall_9.jpg' in"),
        (changed(0, "hall_0.png", "../secret.png"), "line 2: image: '.*' lies outside of "),
        (changed(2, ",180,", ",170,"), "line 3: location 'hall': from heading 90 to the next, 170, are 80 degrees; 4"),
        (changed(1, ",door", ",dor"), "line 3: ahead: there is no location 'dor'; did you mean 'door'"),
        (["a.png,hall,0,0,0,"] * 361, "line 2: location 'hall' has 361 headings; at most 360"),
        (corridor()[:7], "line 6: location 'door' has 3 headings; expected the same mult"),
        (corridor()[:4] + corridor(offset=30)[4:], "line 3: ahead: 'door' has no image with heading 90; a move keeps"),
        (
            corridor() + [line.replace("hall", "yard") for line in corridor()[:4]],
            "ahead: 'door' is also ahead of 'hall', .*; add a column back",
        ),
    ],
)
def test_a_table_that_makes_no_sense_is_refused(tmp_path, lines, says):
    folder_of(tmp_path, lines)
    assert refused(says, read_photos, tmp_path).startswith(str(tmp_path))


def test_images_are_cropped_in_the_middle_and_scaled(tmp_path):
    picture = Image.new("RGB", (100, 60), "red")
    picture.paste("blue", (0, 0, 8, 60))  # of ten columns that are cut off
    picture.save(tmp_path / "a.png")
    (view,) = map(decode, encoded_photos([tmp_path / "a.png"], 30, 40))
    assert view.shape == (30, 40, 3)
    assert (view.argmax(-1) == 0).all()
    Image.fromarray(np.linspace(0, 65535, 1200).astype(np.uint16).reshape(30, 40)).save(tmp_path / "grey.png")
    (view,) = map(decode, encoded_photos([tmp_path / "grey.png"], 30, 40))  # of 16 bits, which keeps its upper eight
    assert abs(view[:, :, 0].astype(float) - np.linspace(0, 255, 1200).reshape(30, 40)).mean() < 5


def test_a_panorama_and_what_is_no_image_are_no_views(tmp_path):
    mark = b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><GPano:ProjectionType>x</GPano:ProjectionType></x:xmpmeta>'
    for size, options in (((400, 200), {}), ((4000, 1990), {}), ((400, 300), {"xmp": mark})):
        Image.new("RGB", size).save(tmp_path / "a.jpg", **options)
        refused(r"a\.jpg: \d+x\d+ pixels are a panorama", list, encoded_photos([tmp_path / "a.jpg"], 30, 40))
    (tmp_path / "a.jpg").write_bytes(b"no image")
    refused(r"a.jpg: not a readable image", list, encoded_photos([tmp_path / "a.jpg"], 30, 40))


def shots(lines, count):
    """Further shots of every row, in an order of their own."""
    cells = [line.split(",") for line in lines]
    again = [[f"{n}_{image}", *rest[:-1], "", str(n)] for n in range(1, count + 1) for image, *rest in reversed(cells)]
    return [*(f"{line}," for line in lines), *(",".join(row) for row in again)]


def test_further_shots_are_looks_if_each_is_a_visit_to_every_place(tmp_path):
    scene, images = read_photos(folder_of(tmp_path, shots(corridor(), 2), f"{HEADER},shot"))
    once, first = read_photos(folder_of(tmp_path, corridor()))
    assert (scene.graph == once.graph).all()
    assert [one.name for one in images] == [f"{shot}{one.name}" for shot in ("", "1_", "2_") for one in first]
    turned = [line.replace(",hall,0,", ",hall,359.5,") if line[:2] == "1_" else line for line in shots(corridor(), 1)]
    assert len(read_photos(folder_of(tmp_path, turned, f"{HEADER},shot"))[1]) == 16  # nearly the same heading
    lacking = folder_of(tmp_path, shots(corridor(), 1)[:-1], f"{HEADER},shot")
    refused("line 2: 'hall' has no image of shot 1 with heading 0; a shot is a visit to", read_photos, lacking)


def photo(file, time=None, north=None):
    exif = Image.Exif()
    if time is not None:
        exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.DateTimeOriginal] = f"2026:11:26 10:00:{time:02}"
    if north is not None:
        exif.get_ifd(ExifTags.IFD.GPSInfo)[ExifTags.GPS.GPSImgDirection] = north
    Image.new("RGB", (40, 30)).save(file, exif=exif)


def test_damaged_exif_is_told_in_one_line(tmp_path):
    for number in range(4):
        Image.new("RGB", (40, 30)).save(tmp_path / f"{number}.webp", exif=b"Exif\0\0no TIFF")
    file = tmp_path / "0.webp"
    for read in (lambda: draft_table(tmp_path), lambda: list(encoded_photos([file], 16, 16))):
        refused(r"\.webp: its EXIF is damaged \(not a TIFF file", read)
    assert photo_field_of_view(file) is None


def drafted(folder, **options):
    """What is said of a drafted table; places and headings by image; and the scene that it makes."""
    said = draft_table(folder, **options)
    scene = read_photos(folder)[0]
    rows = [line.split(",") for line in (folder / "states.csv").read_text().splitlines()[1:]]
    return said, {image: (place, float(heading)) for image, place, heading, *_ in rows}, scene


def test_a_table_is_drafted_by_what_names_say(tmp_path):
    for name in ("hall_n", "hall_e", "hall_s", "hall_w", "door_0", "door_90", "door_180", "door_270"):
        photo(tmp_path / f"{name}.jpg")
    said, found, scene = drafted(tmp_path)
    assert "headings: by their names" in said
    assert found["hall_s.jpg"] == ("hall", 180)
    assert found["door_270.jpg"] == ("door", 270)
    ahead, back = scene.graph[:, 0], scene.graph[:, 3]
    assert (ahead >= 0).sum() == (back >= 0).sum() == 2


def test_a_table_is_drafted_by_time_and_compass(tmp_path):
    norths = [12, 280, 190, 101, 95, 185, 276, 5]  # one place counter-clockwise, one clockwise
    for second, north in enumerate(norths):
        photo(tmp_path / f"{9 - second}.jpg", second, north)
    said, found, _ = drafted(tmp_path)
    assert "order: by the times in their EXIF" in said
    assert "headings: by the compass" in said
    assert [found[f"{9 - second}.jpg"] for second in range(8)] == [
        *(("place_1", heading) for heading in (0, 270, 180, 90)),
        *(("place_2", heading) for heading in (90, 180, 270, 0)),
    ]


def test_a_table_is_drafted_in_the_order_of_names_where_nothing_else_is_known(tmp_path):
    for number in range(1, 17):
        photo(tmp_path / f"IMG_{number}.jpg", time=3 if number == 5 else None)
    refused(r"holds no states.csv; it has a row for each image: image,location", read_photos, tmp_path)
    said, found, _ = drafted(tmp_path, headings=8)
    assert "headings: by the order" in said
    assert found["IMG_10.jpg"] == ("place_2", 45)
    (tmp_path / "states.csv").unlink()
    (tmp_path / "states.csv").symlink_to(tmp_path / "elsewhere.csv")
    refused("is there already", draft_table, tmp_path)
    (tmp_path / "states.csv").unlink()
    photo(tmp_path / "IMG_17.jpg")
    refused("17 photos are no whole places of 8 headings each", draft_table, tmp_path, headings=8)
    photo(tmp_path / "a\nb.jpg")
    refused("a photo: expected the name of a file, found", draft_table, tmp_path, headings=8)
    (tmp_path / "states.csv").touch()
    refused(r"states\.csv: is empty", read_photos, tmp_path)


def test_a_table_may_have_decimal_commas_and_headings_a_little_off_that_begin_anywhere(tmp_path):
    lines = [line.replace(",1,0,", ",1.25,-0.5,") for line in corridor(offset=-20.4)]
    lines[2] = lines[2].replace("159.6", "160.3")
    folder_of(tmp_path, lines)
    (tmp_path / "states.csv").write_text(
        "\n".join([HEADER, *lines]).replace(",", ";").replace(".", ",").replace(",png", ".png")
    )
    scene, _ = read_photos(tmp_path)
    assert scene.headings.tolist() == pytest.approx([69.6, 160.3, 249.6, 339.6, 69.6, 159.6, 249.6, 339.6])
    assert (scene.graph[:, 0] >= 0).sum() == 2
    assert scene.positions[-1].tolist() == [1.25, -0.5]
