import subprocess
import sys
from dataclasses import is_dataclass
from typing import Any

import pytest
from commands import ROOT, run_program, run_recipe, train_config

from dirl.cli.command_line import prepare
from dirl.config.conf_schemas import SCHEMAS
from dirl.config.schemas import ConfigError, TrainConfig
from dirl.config.values import misfit, option_types
from dirl.runs.errors import one_line_exits

CONF = ROOT / "conf"


def test_options_are_named_with_dots():
    names = option_types(TrainConfig)
    assert {"scene", "reinforcement", "reinforcement.gamma", "logger.name"} <= set(names)


@pytest.mark.parametrize(
    "arguments",
    [
        ["scene=[bathroom_02,kitchen_02]", "seed=0,1,2", "preset=paper", "source=thor"],
        ["reward.goal=5", "device=cuda", "resume=null", "seed=range(0,3)", "objective=ppo", "imitation.rounds=${seed}"],
        ["goals={bathroom_02:[26]}", "hydra.run.dir=x", "hydra/launcher=joblib", "+reinforcement.gamma=0.5"],
        ["--cfg", "job"],
    ],
)
def test_known_options_pass(arguments):
    assert prepare(TrainConfig, ["-m", *arguments], CONF) == ["-m", *arguments]


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("gamma", "did you mean reinforcement.gamma"),
        ("imitation.fractions", "did you mean imitation.fraction"),
        ("reward.xyzzy", "choose from reward.goal, reward.step, reward.collision, reward.scale"),
    ],
)
def test_an_unknown_option_is_told_its_neighbours(name, told):
    with pytest.raises(ConfigError, match=f"^there is no option '{name}'; {told}"):
        prepare(TrainConfig, [f"{name}=1"], CONF)


@pytest.mark.parametrize(
    ("recipe", "argument", "told"),
    [
        ("train", "seed=x", "seed=x: must be a valid integer"),
        ("train", "seed=0,1,many", "seed=many: must be a valid integer"),
        ("train", "imitation.rounds=1.5", "imitation.rounds=1.5: must be a valid integer"),
        ("train", "reward.goal='a lot'", "reward.goal=a lot: must be a valid number"),
        ("train", "reward.goal=null", "reward.goal=null: must be a valid number"),
        ("train", "device=gpu", "device=gpu: must be 'cpu' or 'cuda'"),
        ("train", "network.standardise=perhaps", "network.standardise=perhaps: must be a valid boolean"),
        ("train", "resume=[a]", "resume=['a']: must be a valid string"),
        ("evaluate", "stop=never", "stop=never: must be 'goal' or 'match'"),
        ("import", "goals=[a]", "goals=['a']: [0]: must be a valid integer"),
        ("import", "goals=3", "goals=3: must be a valid array"),
        ("import", "goals=[[1]]", "goals=[[1]]: [0]: must be a valid integer"),
        ("sample", "virtual.yaws=[a]", "virtual.yaws=['a']: [0]: must be a valid number"),
        ("sample", "virtual.yaws=[[1]]", "virtual.yaws=[[1]]: [0]: must be a valid number"),
    ],
)
def test_a_value_of_another_type_is_told_the_one_that_is_wanted(recipe, argument, told):
    with pytest.raises(ConfigError) as raised:
        prepare(SCHEMAS[recipe], ["-m", argument], CONF if recipe == "train" else None)
    assert str(raised.value) == told


@pytest.mark.parametrize(
    ("argument", "told"),
    [
        ("system=nope", "there is no system=nope; choose from a3c, any_goal, dagger, dirl"),
        ("encoder=nope", "there is no encoder=nope; choose from comparing, siamese"),
        ("encoder=siamesse", "there is no encoder=siamesse; did you mean encoder=siamese?"),
        ("memory=none,grru", "there is no memory=grru; did you mean memory=gru?"),
        ("losses=[imitation,other]", "there is no losses=other; choose from imitation"),
    ],
)
def test_an_unknown_choice_of_a_group_is_told_the_choices(argument, told):
    with pytest.raises(ConfigError) as raised:
        prepare(TrainConfig, ["-m", argument], CONF)
    assert str(raised.value).startswith(told)
    assert "\n" not in str(raised.value)


def test_a_folder_of_ones_own_has_more_choices(tmp_path):
    (tmp_path / "encoder").mkdir()
    (tmp_path / "encoder" / "mine.yaml").touch()
    for given in ([f"--config-dir={tmp_path}"], ["--config-dir", str(tmp_path)], ["-cd", str(tmp_path)]):
        assert prepare(TrainConfig, [*given, "encoder=mine"], CONF) == [*given, "encoder=mine"]
    with pytest.raises(ConfigError, match="no encoder=mine"):
        prepare(TrainConfig, ["encoder=mine"], CONF)


def test_options_of_components_get_the_prefix_by_which_hydra_adds_what_is_not_listed():
    given = ["encoder.width=8", "losses.a2c.gamma=0.5", "optimiser._target_=torch.optim.SGD"]
    assert prepare(TrainConfig, given, CONF) == [f"++{argument}" for argument in given]
    plain = ["+encoder.width=8", "~heads.width", "encoder=siamese", "reward.goal=1"]
    assert prepare(TrainConfig, plain, CONF) == plain


@pytest.mark.parametrize(
    ("argument", "prepared"),
    [
        ("reinforcement.entropy_coef=0.01", "reinforcement.entropy_coef={start:0.01,end:0.01}"),
        ("imitation.bc_coef=0", "imitation.bc_coef={start:0,end:0}"),
        ("imitation.bc_coef=0,0.5", "imitation.bc_coef={start:0,end:0},{start:0.5,end:0.5}"),
        ("imitation.bc_coef={start:1,end:0}", "imitation.bc_coef={start:1,end:0}"),
        ("imitation.bc_coef.start=1", "imitation.bc_coef.start=1"),
    ],
)
def test_a_number_is_a_constant_schedule(argument, prepared):
    assert prepare(TrainConfig, ["-m", argument], CONF) == ["-m", prepared]
    if not argument.startswith("imitation.bc_coef=0,"):
        train_config(prepared)  # Hydra takes it


def test_a_constant_schedule_reaches_the_loss():
    config = train_config(*prepare(TrainConfig, ["reinforcement.entropy_coef=0.03"], CONF))
    assert config.losses["a2c"]["entropy_coeff"] == {"start": 0.03, "end": 0.03}


def test_every_type_of_option_is_checked():
    for schema in SCHEMAS.values():
        for name, kind in option_types(schema).items():
            assert kind is Any or is_dataclass(kind) or misfit({"a": {}}, kind), name


def test_a_recipe_ends_with_one_line_at_a_value_of_another_type(tmp_path):
    status, _, errors = run_program(tmp_path, "train", "scene=bathroom_02", "seed=x")
    assert (status, errors) == (1, "error: seed=x: must be a valid integer\n")
    assert list(tmp_path.iterdir()) == []


def test_an_error_in_the_input_ends_the_program_and_its_empty_folder(tmp_path):
    folder = tmp_path / "runs" / "dirl" / "now"
    folder.mkdir(parents=True)
    (tmp_path / "other").touch()
    with pytest.raises(SystemExit, match=r"^error: no such thing$"), one_line_exits(folder=folder):
        raise ValueError("no such thing")
    assert [entry.name for entry in tmp_path.iterdir()] == ["other"]


@pytest.mark.parametrize("recipe", ["train", "evaluate", "benchmark"])
def test_help_says_what_a_recipe_does_with_examples(tmp_path, recipe):
    status, printed, _ = run_recipe(tmp_path, recipe, "--help")
    assert status == 0
    assert f"python recipes/{recipe}.py" in printed
    assert all(f"{name}:" in printed for name in SCHEMAS[recipe].__dataclass_fields__)


def test_the_package_tells_versions_device_and_scenes():
    printed = subprocess.run(
        [sys.executable, "-m", "dirl"], cwd=ROOT, capture_output=True, text=True, check=True, timeout=3600
    ).stdout
    for words in ("dirl 0.", "torchrl 0.", "device=cuda", "kitchen_02: 676 states"):
        assert words in printed


def test_a_sweep_without_its_flag_is_told_the_flag():
    with pytest.raises(ConfigError, match=r"seed=1,2: several values are a sweep; add -m"):
        prepare(TrainConfig, ["scene=bathroom_02", "seed=1,2"], CONF)
