"""Command lines: what is taken, and what is told in one line; the dataclasses of options."""

from dataclasses import dataclass
from typing import Annotated, Any

import pytest
from annotated_types import Interval
from refusals import refused

from dirl.cli.parsing import compose_training, parse, prepare
from dirl.config.files import typed
from dirl.config.options import option
from dirl.config.schemas import Device


@dataclass
class Inner:
    """A group."""

    size: float = option("metres", 0.5)


@dataclass
class Options:
    """What a command takes."""

    file: str = option("the file to read")
    count: Annotated[int, Interval(ge=1, le=9)] | None = option("how many", None)
    device: Device = option("", Device.cpu)
    axes: list[str] = option("", ["x"])
    anything: Any = option("", None)
    inner: Inner = option("by how much", Inner)


def test_a_command_line_is_a_dataclass():
    options = parse(Options, ["file=a b.h5", "count=9", "device=cuda", "axes=[z]", "anything={a:[1]}", "inner.size=1"])
    assert options == Options("a b.h5", 9, Device.cuda, ["z"], {"a": [1]}, Inner(1.0))
    assert parse(Options, ["file=a"]) == Options("a")


@pytest.mark.parametrize(
    ("argument", "told"),
    [
        ("fiel=a", "there is no option 'fiel'; did you mean file?"),
        ("size=1", "there is no option 'size'; did you mean inner.size?"),
        ("count=x", "count=x: Value 'x' of type 'str' could not be converted to Integer"),
        ("count=0", "count=0: must be greater than or equal to 1"),
        ("device=gpu", "device=gpu: Invalid value 'gpu', expected one of [cpu, cuda]"),
        ("inner=3", "inner=3: inner is a group of options"),
        ("count=1,2", "count=1,2: must be one value; a list is written as 'count=[a,b]'"),
        ("inner.size=nan", "inner.size=nan: must be a finite number"),
        ("file=[a", "file=[a: is not of the form name=value"),
        ("file=???", "file must be given: the file to read"),
        ("anything=${nope}", "anything: Interpolation key 'nope' not found"),
    ],
)
def test_what_cannot_be_read_is_one_line(argument, told):
    assert refused(".", parse, Options, ["file=a", argument]).startswith(told)


@pytest.mark.parametrize(
    ("argument", "told"),
    [
        ("gamma=1", "there is no option 'gamma'; did you mean reinforcement.gamma?"),
        ("seed=x", "seed=x: Value 'x' of type 'str' could not be converted to Integer"),
        ("encoder=siamesse", "In 'train': Could not find 'encoder/siamesse' Available options in 'encoder': comparing"),
        ("reinforcement.gamma=2", "reinforcement.gamma=2.0: must be less than or equal to 1"),
        ("logger=[]", "logger=[]: must name a choice of logger"),
        ("hydra.nope=1", "Could not override 'hydra.nope'"),
    ],
)
def test_what_a_training_does_not_take_is_one_line(argument, told):
    assert refused(".", lambda: typed(compose_training([argument]))).startswith(told)


@pytest.mark.parametrize(
    ("argument", "prepared"),
    [
        ("imitation.bc_coef=0,0.5", "imitation.bc_coef={start:0,end:0},{start:0.5,end:0.5}"),
        ("imitation.bc_coef={start:1,end:0}", "imitation.bc_coef={start:1,end:0}"),
        ("encoder.width=8", "++encoder.width=8"),
        ("~heads.width", "~heads.width"),
        ("losses=[imitation,gail]", "losses=[imitation,gail]"),
        ("hydra.run.dir=x", "hydra.run.dir=x"),
    ],
)
def test_a_number_is_a_constant_schedule_and_options_of_components_may_be_added(argument, prepared):
    assert prepare(["-m", "--config-dir", "x", argument]) == ["-m", "--config-dir", "x", prepared]
