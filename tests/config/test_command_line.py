import subprocess
import sys
from dataclasses import is_dataclass
from typing import Any

import pytest
from commands import ROOT, run_recipe, train_config
from omegaconf import OmegaConf

from dirl.config.command_line import SCHEMAS, _wanted, check_overrides, one_line_errors, option_types
from dirl.config.schemas import BenchmarkConfig, ConfigError, EvaluateConfig, TrainConfig, parse_config


def test_options_are_named_with_dots():
    names = option_types(TrainConfig)
    assert {"scene", "reinforcement", "reinforcement.gamma", "logger.name"} <= set(names)


@pytest.mark.parametrize(
    "arguments",
    [
        ["scene=[bathroom_02,kitchen_02]", "-m", "seed=0,1,2", "preset=paper", "source.root=/a/b"],
        ["reward.goal=5", "device=cuda", "resume=null", "seed=range(0,3)", "objective=ppo", "network.width=${seed}"],
        ["goals={bathroom_02:[26]}", "hydra.run.dir=x", "hydra/launcher=joblib", "+reinforcement.gamma=0.5"],
        ["--cfg", "job"],
    ],
)
def test_known_options_pass(arguments):
    check_overrides(TrainConfig, arguments)


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("gamma", "did you mean reinforcement.gamma"),
        ("imitation.shares", "did you mean imitation.share"),
        ("reward.xyzzy", "choose from reward.goal, reward.step, reward.collision, reward.scale"),
    ],
)
def test_an_unknown_option_is_told_its_neighbours(name, told):
    with pytest.raises(ConfigError, match=f"^there is no option '{name}'; {told}"):
        check_overrides(TrainConfig, [f"{name}=1"])


@pytest.mark.parametrize(
    ("recipe", "argument", "told"),
    [
        ("train", "seed=x", "seed=x: must be a whole number"),
        ("train", "seed=0,1,many", "seed=many: must be a whole number"),
        ("train", "network.width=1.5", "network.width=1.5: must be a whole number"),
        ("train", "reward.goal='a lot'", "reward.goal=a lot: must be a number"),
        ("train", "reward.goal=null", "reward.goal=null: must be a number"),
        ("train", "device=gpu", "device=gpu: must be one of cpu, cuda"),
        ("train", "network.standardise=perhaps", "network.standardise=perhaps: must be true or false"),
        ("train", "resume=[a]", "resume=['a']: must be text or null"),
        ("evaluate", "stop=never", "stop=never: must be one of goal, match or null"),
        ("import", "goals=[a]", "goals=['a']: must be a list, each a whole number or null"),
        ("import", "goals=3", "goals=3: must be a list, each a whole number or null"),
    ],
)
def test_a_value_of_another_type_is_told_the_one_that_is_wanted(recipe, argument, told):
    with pytest.raises(ConfigError) as raised:
        check_overrides(SCHEMAS[recipe], [argument])
    assert str(raised.value) == told


def test_every_type_of_option_has_words():
    for schema in SCHEMAS.values():
        for name, kind in option_types(schema).items():
            assert kind is Any or is_dataclass(kind) or _wanted(kind), name


def test_a_recipe_ends_with_one_line_at_a_value_of_another_type(tmp_path):
    status, _, errors = run_recipe(tmp_path, "train", "scene=bathroom_02", "seed=x")
    assert (status, errors) == (1, "error: seed=x: must be a whole number\n")
    assert list(tmp_path.iterdir()) == []


def test_an_error_in_the_input_ends_the_program_and_its_empty_folder(tmp_path):
    folder = tmp_path / "runs" / "dirl" / "now"
    folder.mkdir(parents=True)
    (tmp_path / "other").touch()
    with pytest.raises(SystemExit, match=r"^error: no such thing$"), one_line_errors(folder):
        raise ValueError("no such thing")
    assert [entry.name for entry in tmp_path.iterdir()] == ["other"]


def test_an_error_of_the_program_keeps_its_traceback():
    with pytest.raises(KeyError), one_line_errors():
        raise KeyError("a bug")


def test_a_saved_configuration_is_read_back_and_can_be_changed():
    config = train_config("scene=bathroom_02", "imitation.rule=interval")
    text = OmegaConf.to_yaml(OmegaConf.structured(config))
    assert parse_config(text, "here") == config
    changed = parse_config(text, "here", {"stop.threshold": 0.8, "goals": [51]})
    assert (changed.stop.threshold, changed.goals) == (0.8, [51])


@pytest.mark.parametrize("text", ["scene: [", "colour: red", "seed: many", "seed: -1"])
def test_what_is_no_configuration_names_where_it_stood(text):
    with pytest.raises(ConfigError, match=r"^here/config.yaml: holds no configuration of this version"):
        parse_config(text, "here/config.yaml")


@pytest.mark.parametrize("recipe", ["train", "evaluate", "benchmark"])
def test_help_says_what_a_recipe_does_with_examples(tmp_path, recipe):
    status, printed, _ = run_recipe(tmp_path, recipe, "--help")
    assert status == 0
    assert f"python recipes/{recipe}.py" in printed
    schema = {"train": TrainConfig, "evaluate": EvaluateConfig, "benchmark": BenchmarkConfig}[recipe]
    assert all(f"{name}:" in printed for name in schema.__dataclass_fields__)


def test_the_package_tells_versions_device_and_scenes():
    printed = subprocess.run(
        [sys.executable, "-m", "dirl"], cwd=ROOT, capture_output=True, text=True, check=True, timeout=120
    ).stdout
    for words in ("dirl 0.1.0", "torchrl 0.", "device=cuda", "kitchen_02: 676 states"):
        assert words in printed
