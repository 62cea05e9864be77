import subprocess
import sys

import pytest
from commands import ROOT, run_recipe, train_config
from omegaconf import OmegaConf

from dirl.commandline import check_overrides, one_line_errors, option_names
from dirl.config import BenchmarkConfig, ConfigError, EvaluateConfig, TrainConfig, parse_config


def test_options_are_named_with_dots():
    names = option_names(TrainConfig)
    assert {"scene", "reinforcement", "reinforcement.gamma", "logger.name"} <= set(names)


@pytest.mark.parametrize(
    "arguments",
    [
        ["scene=[bathroom_02,kitchen_02]", "-m", "seed=0,1,2", "preset=paper", "source.root=/a/b"],
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
