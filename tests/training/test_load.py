"""Trained policies in other places and with other goals than they were trained with."""

import json

import pytest
import torch
from commands import TINY, done, run_recipe, train_config
from rooms import grid_scene

from dirl.agent.decisions import observe
from dirl.config.schemas import ConfigError
from dirl.envs import SurroundingViews
from dirl.envs.transforms import front_only
from dirl.runs.checkpoints import load_checkpoint
from dirl.scenes import write_dump
from dirl.training.build import build_world, learning_policy, load_trained

SHAPES = {"left": (3, 2), "right": (2, 3)}


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A folder with dumps of two rooms and a run that was trained in both."""
    folder = tmp_path_factory.mktemp("two")
    for seed, (name, shape) in enumerate(SHAPES.items()):
        write_dump(folder / f"{name}.h5", grid_scene(*shape, name=name, goals=(0, 5), feature_width=64, seed=seed))
    scenes = ",".join(str(folder / f"{name}.h5") for name in SHAPES)
    done(folder, "train", f"scene=[{scenes}]", *TINY, "hydra.run.dir=run")
    return folder


@pytest.mark.parametrize("name", SHAPES)
def test_a_policy_of_two_scenes_decides_by_the_layers_of_the_one_it_is_in(trained, name):
    saved = load_checkpoint(trained / "run")
    _, both, protocol = load_trained(saved, "run")
    _, one, alone = load_trained(saved, "run", {"scene": str(trained / f"{name}.h5")})
    whole, part = protocol.run(both), alone.run(one)
    inside = whole.select(protocol.world.scene_of[whole.start] == protocol.world.names.index(name))
    for field in ("steps", "success", "shortest"):
        assert torch.equal(getattr(inside, field), getattr(part, field))


class OnlyAhead(SurroundingViews):
    """A transform of one's own that shows the view ahead, and hides the others."""

    def reset_view_ids(self, picture):
        return front_only(super().reset_view_ids(picture), self.pictures)


@pytest.mark.parametrize("axes", ["principal", "features"])
def test_a_cached_policy_sees_what_the_observation_shows_and_nothing_else(tmp_path, axes):
    write_dump(tmp_path / "room.h5", grid_scene(3, 2, goals=(0, 5), feature_width=64))
    found = []
    for cache in ("auto", "off"):
        config = train_config(f"scene={tmp_path / 'room.h5'}", f"network.cache={cache}", f"network.axes={axes}")
        world = build_world(config)
        observation = OnlyAhead(world)
        policy = learning_policy(config, world, observation)
        state, goal = torch.arange(24), torch.zeros(24, dtype=torch.int64)
        found.append(policy(observe(world, observation, state, observation.reset_view_ids(state), goal))["logits"])
    torch.testing.assert_close(*found, atol=1e-5, rtol=0)


def test_a_dump_that_has_moved_or_has_another_name_is_named_anew(trained, tmp_path):
    summary = json.loads((trained / "run" / "summary.json").read_text())
    for name in SHAPES:
        (trained / f"{name}.h5").rename(tmp_path / f"{name}_moved.h5")
    try:
        status, _, errors = run_recipe(tmp_path, "evaluate", f"checkpoint={trained / 'run'}")
        assert status == 1
        assert errors.count("\n") == 1
        scenes = f"scene=[{','.join(str(tmp_path / f'{name}_moved.h5') for name in SHAPES)}]"
        given = ("seed=3", "max_steps=50", "out=result.json")
        done(tmp_path, "evaluate", f"checkpoint={trained / 'run'}", scenes, *given)
        result = json.loads((tmp_path / "result.json").read_text())
        assert {key: result["greedy"][key] for key in ("atl", "sr")} == {
            key: summary["greedy"][key] for key in ("atl", "sr")
        }
    finally:
        for name in SHAPES:
            (tmp_path / f"{name}_moved.h5").rename(trained / f"{name}.h5")


def test_goals_replace_the_goals_of_all_scenes(trained):
    saved = load_checkpoint(trained / "run")
    _, _, protocol = load_trained(saved, "run", {"goals": {"left": [7], "right": [2, 3]}})
    assert protocol.world.goals.tolist() == [7, 24 + 2, 24 + 3]


def test_a_third_scene_has_no_layers(trained, tmp_path):
    saved = load_checkpoint(trained / "run")
    write_dump(tmp_path / "other.h5", grid_scene(name="other", feature_width=64))
    with pytest.raises(ConfigError, match="the weights do not fit"):
        load_trained(saved, "run", {"scene": str(tmp_path / "other.h5")})


def test_turns_that_the_training_did_not_have_are_told_of_in_one_line(trained, tmp_path, capsys):
    for headings in (4, 8):
        room = grid_scene(3, 2, name="left", goals=(0, 5), feature_width=64, headings=headings)
        write_dump(tmp_path / f"room_{headings}.h5", room)
    saved = load_checkpoint(trained / "run")
    assert saved["turns"] == [4]
    load_trained(saved, "run", {"scene": str(tmp_path / "room_4.h5")})
    assert capsys.readouterr().err == ""
    told = "warning: run: was trained with turns of 90 degrees; with turns of 45 degrees its paths may be much longer"
    for known in (saved, {key: value for key, value in saved.items() if key != "turns"}):  # none stood there before
        load_trained(known, "run", {"scene": str(tmp_path / "room_8.h5")})
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith(told)
    load_trained({**saved, "turns": [4, 8]}, "run", {"scene": str(tmp_path / "room_8.h5")})
    assert capsys.readouterr().err == ""
