"""Types and bounds of options."""

import math
from typing import Annotated, Any, Literal

import pytest
import torch
from annotated_types import Interval
from refusals import refused

from dirl.config.components import check_value
from dirl.config.schemas import Device

Count = Annotated[int, Interval(ge=0, le=9)]


@pytest.mark.parametrize(
    ("value", "kind", "told"),
    [
        (object(), Any, ""),
        (None, Count | None, ""),
        (1, float, ""),
        ("cpu", Device, ""),
        ([0.9, 0.999], tuple[float, float], ""),
        (0.5, float | torch.Tensor, ""),
        (3, "Unknown", ""),  # a name that only type checkers know
        (True, int, "must be a valid integer"),
        ("3", int, "must be a valid integer"),
        (math.nan, float, "must be a finite number"),
        (10, Count | None, "must be less than or equal to 9"),
        ([1, 10], list[Count], "[1]: must be less than or equal to 9"),
        ("c", Literal["a", "b"], "must be 'a' or 'b'"),
        ("gpu", Device, "must be 'cpu' or 'cuda'"),
        (0.5, torch.Tensor, "must be an object of Python, which no option can be"),
    ],
)
def test_a_value_fits_its_type_or_what_it_must_be_is_told(value, kind, told):
    if not told:
        check_value("x", value, kind)
    else:
        assert refused(".", check_value, "x", value, kind) == f"x={value}: {told}"
