"""Types and bounds of options."""

import math
from typing import Annotated, Any, Literal

import pytest
import torch

from dirl.config.bounds import Bounds
from dirl.config.options import option_types
from dirl.config.schemas import ConfigError, Device, TrainConfig
from dirl.config.values import check_choice, check_value, misfit

Count = Annotated[int, Bounds(0, 9)]


@pytest.mark.parametrize(
    ("value", "kind"),
    [
        (3, Any),
        ("x", Any),
        (object(), Any),
        (3, Count),
        (None, Count | None),
        (1, float),
        ("cpu", Device),
        ([1, 2], list[Count]),
        (0.5, float | torch.Tensor),
        ("a", Literal["a", "b"]),
        ([0.9, 0.999], tuple[float, float]),
    ],
)
def test_a_value_fits_its_type(value, kind):
    assert misfit(value, kind) == ""


@pytest.mark.parametrize(
    ("value", "kind", "told"),
    [
        (True, int, "must be a valid integer"),
        ("3", int, "must be a valid integer"),
        (True, float, "must be a valid number"),
        (math.nan, float, "must be a finite number"),
        (10, Count, "must be less than or equal to 9"),
        (10, Count | None, "must be less than or equal to 9"),
        ([1, 10], list[Count], "[1]: must be less than or equal to 9"),
        (3, list[Count], "must be a valid array"),
        ({"a": 0.5}, dict[str, int], "a: must be a valid integer"),
        ("c", Literal["a", "b"], "must be 'a' or 'b'"),
        ("gpu", Device, "must be 'cpu' or 'cuda'"),
        (0.5, torch.Tensor, "must be an object of Python, which no option can be"),
    ],
)
def test_of_a_value_of_another_type_what_it_must_be_is_told(value, kind, told):
    assert misfit(value, kind) == told


def test_an_annotation_that_only_type_checkers_know_is_not_checked():
    assert misfit(3, "Unknown") == ""


def test_bounds_are_told_where_there_may_be_nothing():
    with pytest.raises(ConfigError, match=r"^x=10: must be less than or equal to 9$"):
        check_value("x", 10, Count | None)
    check_value("x", None, Count | None)


def test_what_there_is_not_is_told_its_neighbour():
    with pytest.raises(ConfigError, match=r"^there is no colour 'rad'; did you mean red\?$"):
        check_choice("colour 'rad'", "rad", ["red", "green"])
    with pytest.raises(ConfigError, match=r"^there is no colour 'x'; choose from red, green$"):
        check_choice("colour 'x'", "x", ["red", "green"])


def test_annotations_hold_the_bounds():
    assert option_types(TrainConfig)["reinforcement.gamma"] is float
    assert option_types(TrainConfig, bounds=True)["reinforcement.gamma"].__metadata__ == (Bounds(0, 1),)
