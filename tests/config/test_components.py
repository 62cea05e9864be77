"""Components by ``_target_``, configurations in files, types and bounds of options: every mistake is one line."""

import math
import sys
from functools import partial
from typing import Annotated, Any, Literal

import pytest
import torch
from annotated_types import Interval
from commands import train_config
from refusals import refused
from torch import nn

from dirl.config.components import (
    check_components,
    check_value,
    components,
    find_class,
    make,
    packages_to_trust,
    schedules,
)
from dirl.config.files import MAX_CHARACTERS, config_text, group_options, read_config
from dirl.config.folders import CONF
from dirl.config.schemas import Device, Schedule


class Mine(nn.Module):
    """A component of a user's own."""

    def __init__(
        self,
        num_features: int,
        depth: Annotated[int, Interval(ge=1, le=8)],
        kind: Literal["mean", "max"] = "mean",
        plain=None,
    ) -> None:
        super().__init__()
        self.options = (num_features, depth, kind, plain)


class Deeper(Mine):
    """Hands everything on to its base."""

    def __init__(self, *, layers: int = 2, **kwargs) -> None:
        super().__init__(**kwargs)
        self.layers = layers


@pytest.fixture(autouse=True)
def package(monkeypatch):
    """This module as a package of the user's."""
    monkeypatch.setitem(sys.modules, "house", sys.modules[__name__])
    for made in (Mine, Deeper):
        monkeypatch.setattr(made, "__module__", "house")


refusal = partial(refused, ".")


@pytest.mark.parametrize("target", ["house.Mine", "house.Deeper"])
def test_a_class_is_made_of_its_options_and_of_what_it_is_offered(target):
    options = {"_target_": target, "depth": 8, "kind": "max", "plain": "anything"}
    assert make("encoder", options, num_features=7, world=object()).options == (7, 8, "max", "anything")
    told = "^heads: ActorCriticHeads refuses its options: the scenes' names must differ"
    given = {"scenes": ["a.b", "a_b"], "in_features": 2, "num_actions": 4}
    refused(told, make, "heads", {"_target_": "dirl.models.ActorCriticHeads"}, **given)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({}, "encoder.depth: Mine needs it; give encoder.depth=..."),
        ({"depth": 2, "dept": 3}, "there is no option 'encoder.dept'; did you mean encoder.depth?"),
        ({"depth": 2, "num_features": 3}, "there is no option 'encoder.num_features'; choose from depth, kind, plain"),
        ({"depth": None}, "encoder.depth=null: must be a valid integer"),
        ({"depth": 0}, "encoder.depth=0: must be greater than or equal to 1"),
        ({"depth": 2, "plain": {"_target_": "os.system"}}, "encoder.plain: a component cannot hold another one"),
    ],
    ids=str,
)
def test_an_option_that_does_not_fit_is_refused(options, told):
    assert refusal(make, "encoder", {"_target_": "house.Mine", **options}, num_features=7).startswith(told)


@pytest.mark.parametrize(
    ("group", "target", "told"),
    [
        ("encoder", "Mine", "must be the full name of a class"),
        ("encoder", "nobody.Knows", "there is no such class (No module named 'nobody'); is its folder on PYTHONPATH?"),
        ("encoder", "os.system", "is no class"),
        ("encoder", "dirl.models.policy.nn.Linear", "there is no such class"),
        ("encoder", "dirl.envs.navigation.EnvBase", "is not defined in 'dirl' but in 'torchrl"),
        ("encoder", "torch.optim.Adam", "must be a subclass of torch.nn.modules.module.Module"),
        ("observation", "torchrl.envs.transforms.StepCounter", "must be a subclass of dirl.envs.transforms.Surrou"),
        ("source", "dirl.runs.folder.Run", "has no method load, which every source has"),
        ("simulator", "pathlib.PurePath", "has no method place, which every simulator has"),
    ],
)
def test_what_is_no_class_of_a_component_is_refused(group, target, told):
    message = refusal(find_class, group, target, () if target.startswith("dirl.") else None)
    assert message.startswith(f"{group}._target_={target}: ")
    assert told in message


def test_every_component_of_a_configuration_is_found():
    config = train_config("objective=ppo")
    assert set(components(config)) == {
        "observation", "encoder", "heads", "policy", "recogniser", "expert", "losses.imitation", "losses.ppo",
        "optimiser", "source", "env",
    }  # fmt: skip
    check_components(config, ())
    config.encoder = {"width": 3}
    assert refusal(components, config).startswith("encoder: names no class")
    assert make("memory", {"_target_": None}) is None
    config.encoder = {"_target_": None}
    assert refusal(components, config).startswith("encoder._target_=null: a training needs one")
    for system in (CONF / "system").glob("*.yaml"):
        check_components(train_config(f"system={system.stem}"), ())
    config = train_config()
    config.losses["a2c"]["gama"] = 1
    assert refusal(check_components, config).startswith("there is no option 'losses.a2c.gama'")


def test_schedules_are_weights_and_what_has_a_start_and_an_end():
    options = {"_target_": "x.Y", "weight": 2, "coef": {"start": 1, "end": 0}, "other": 3}
    assert schedules("losses.mine", options) == {"weight": Schedule(2.0, 2.0), "coef": Schedule(1.0, 0.0)}
    assert schedules("losses.mine", {"_target_": "x.Y"}) == {"weight": Schedule(1.0, 1.0)}
    assert "losses.mine.weight=" in refusal(schedules, "losses.mine", {"weight": float("inf")})


def test_the_packages_that_a_configuration_needs_trusted_are_named():
    config = train_config()
    assert packages_to_trust(config) == []
    config.encoder = {"_target_": "mine.deep.Encoder"}
    config.losses["gail"] = {"_target_": "theirs.GAIL"}
    config.optimiser = {"_target_": "torch.optim.Adam"}
    assert packages_to_trust(config) == ["mine", "theirs"]


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


unread = partial(refused, ".", read_config)


def test_a_saved_configuration_is_read_back_without_trust_and_can_be_changed():
    config = train_config("scene=bathroom_02", "imitation.rule=interval", "trust=[os]")
    text = config_text(config)
    read = read_config(text, "here")
    assert (read.trust, config.trust) == ([], ["os"])
    read.trust = config.trust
    assert read == config
    changed = read_config(text, "here", {"stop.threshold": 0.8, "goals": [51]}, trust=["mine"])
    assert (changed.stop.threshold, changed.goals, changed.trust) == (0.8, [51], ["mine"])


@pytest.mark.parametrize(
    "text", ["scene: [", "colour: red", "seed: -1", "", "- 1", "losses: [a2c]", "seed: !!binary x"]
)
def test_what_is_no_configuration_names_where_it_stood(text):
    told = unread(text, "here/config.yaml")
    assert told.startswith("here/config.yaml: holds no configuration of this version")


def test_what_could_read_the_environment_or_run_or_grow_is_refused():
    text = config_text(train_config("scene=bathroom_02"))
    assert "${...}" in unread(text.replace("project: dirl", "project: '${oc.env:HOME}'"), "here")
    assert "YAML aliases" in unread("a: &a [x]\nb: *a\n" + text, "here")
    assert f"at most {MAX_CHARACTERS} are read" in unread(text + "#" * MAX_CHARACTERS, "here")
    unread("scene: !!python/object/apply:os.system ['true']", "here")
    unread("scene: " + "[" * 5000, "here")
    assert "trust=[os]" in unread(text.replace("dirl.models.SiameseEncoder", "os.system"), "here")


def test_a_choice_is_a_file_of_the_group_or_of_ones_own_or_refused_in_one_line(tmp_path):
    own = tmp_path / "mine.yaml"
    assert group_options("recogniser", None) is None
    assert group_options("recogniser", "ncc") == {"_target_": "dirl.perception.recognition.NCC"}
    refused(f"^recogniser={own}: there is no such file", group_options, "recogniser", str(own))
    own.write_text("_target_: mine.Recogniser\nwidth: 3\n")
    assert group_options("recogniser", str(own)) == {"_target_": "mine.Recogniser", "width": 3}
    wrong = {
        "junk": "cannot be read as options: it is no mapping of options",
        "a: [": "cannot be read as options: while",
    }
    for text, reason in (wrong | {"width: 3": "has no _target_, which names the class"}).items():
        own.write_text(text)
        refused(f"^recogniser={own}: {reason}", group_options, "recogniser", str(own))
