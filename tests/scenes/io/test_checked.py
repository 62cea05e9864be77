"""What a file holds, against annotated types."""

from dataclasses import dataclass
from typing import Annotated

import pytest
from annotated_types import Ge

from dirl.scenes import SceneError
from dirl.scenes.io.checked import check_choice, checked


@dataclass
class Camera:
    height: Annotated[float, Ge(0)]
    pixels: tuple[int, int] = (4, 3)


@dataclass
class File:
    name: str
    camera: Camera


def test_tables_become_dataclasses_lists_tuples_and_whole_numbers_floats():
    made = checked({"name": "a", "camera": {"height": 2, "pixels": [8, 6]}}, File)
    assert made == File("a", Camera(2.0, (8, 6)))
    assert type(made.camera.height) is float


@pytest.mark.parametrize(
    ("camera", "says"),
    [
        ({"height": -1}, "f: camera.height: must be greater than or equal to 0, found -1"),
        ({"height": 1, "pixels": [4]}, "f: camera.pixels[1]: is missing"),
        ({"heigt": 1}, "f.camera: there is no 'heigt'; did you mean 'height'?"),
        ({}, "f: camera.height: is missing"),
    ],
)
def test_what_does_not_fit_is_told_with_its_place(camera, says):
    with pytest.raises(SceneError) as refused:
        checked({"name": "a", "camera": camera}, File, "f")
    assert str(refused.value) == says


def test_cells_of_a_table_are_numbers_if_they_read_so():
    assert checked({"height": "1.5"}, Camera, strict=False) == Camera(1.5)
    with pytest.raises(SceneError, match=r"^height: must be a valid number, .* found 'high'$"):
        checked({"height": "high"}, Camera, strict=False)


def test_a_choice_that_there_is_not_is_told_its_neighbour_or_the_first_of_all():
    check_choice("red", ["red", "green"], "colour")
    with pytest.raises(SceneError, match=r"^colour: there is no 'rad'; did you mean 'red'\?$"):
        check_choice("rad", ["red", "green"], "colour")
    with pytest.raises(SceneError, match=r"^tour: there is no panorama 'x'; choose from p0, p1, .*, p99, \.\.\.$"):
        check_choice("x", [f"p{number}" for number in range(500)], "tour", "panorama")
