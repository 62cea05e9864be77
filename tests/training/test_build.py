"""From a configuration to the parts of a run; what does not fit together is one line."""

import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
from commands import room_file, train_config
from networks import make_policy
from parts import make_parts
from rooms import grid_scene
from torch import nn

from dirl.config.schemas import ConfigError
from dirl.models import FeatureTable, ObservationTable, plain_weights, recurrent_keys
from dirl.models.build import build_policy, load_weights
from dirl.scenes import SceneError, make_world, write_dump
from dirl.training.build import build_env, build_goals, build_world, trained_policy
from dirl.training.job import tell_of_far_goals

SMALL = ["encoder.width=8", "heads.width=8"]


def test_a_policys_first_weights_are_decided_by_the_seed_alone():
    made = []
    for torchs_seed, seed in ((0, 7), (1, 7), (1, 8)):
        torch.manual_seed(torchs_seed)
        policy = build_policy(train_config(f"seed={seed}", *SMALL), FeatureTable(torch.rand(5, 3)), ["a", "b"])
        made.append(policy.state_dict())
        drawn = torch.rand(1)
        torch.manual_seed(torchs_seed)
        torch.rand(5, 3)
        assert torch.rand(1) == drawn, "making a network disturbed torch's own generator"
    assert all(torch.equal(made[0][key], made[1][key]) for key in made[0])
    assert not torch.equal(made[0]["encoder.embedding.weight"], made[2]["encoder.embedding.weight"])


class Flat(nn.Module):
    """An encoder that forgets the rows."""

    def __init__(self, num_features):
        super().__init__()

    def forward(self, observation, goal_observation):
        return (observation - goal_observation).flatten()


class Narrow(nn.Module):
    """An encoder of views of three features."""

    def __init__(self, num_features):
        super().__init__()
        self.layer = nn.Linear(3, 5)

    def forward(self, observation, goal_observation):
        return self.layer(observation - goal_observation).mean(1)


class Silent(nn.Module):
    def __init__(self, num_features):
        super().__init__()

    def forward(self, observation, goal_observation):
        return None


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("Flat", r"encoder: gives \[28\] for one row; expected \[1, width\]"),
        ("Narrow", r"encoder: cannot be called as it should, on features \[1, 4, 7\]: mat1 and mat2"),
        ("Silent", r"encoder: gives NoneType for one row"),
    ],
)
def test_an_encoder_that_does_not_encode_rows_is_refused(name, told, monkeypatch):
    monkeypatch.setitem(sys.modules, "house", sys.modules[__name__])
    config = train_config()
    config.encoder = {"_target_": f"house.{name}"}
    with pytest.raises(ConfigError, match=f"^{told}") as raised:
        build_policy(config, FeatureTable(torch.rand(5, 7)), ["a"])
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("observation", ["surrounding", "sequential"])
@pytest.mark.parametrize(
    ("axes", "width", "principal"), [("principal", 32, True), ("principal", 16, False), ("features", 32, False)]
)
def test_principal_axes_are_used_where_there_are_no_more_states_than_features(
    tmp_path, observation, axes, width, principal
):
    write_dump(tmp_path / "room.h5", grid_scene(feature_width=width))
    policy = make_parts(
        f"scene={tmp_path / 'room.h5'}", *SMALL, f"network.axes={axes}", f"observation={observation}"
    ).policy
    assert isinstance(policy.features, ObservationTable) == principal
    assert (policy.cached.surrounding is not None) == (observation == "surrounding")


def test_an_agents_memory_is_emptied_with_every_episode(tmp_path):
    parts = make_parts(
        f"scene={room_file(tmp_path)}", *SMALL, "memory=gru", "memory.hidden_size=8", "reinforcement.max_steps=4"
    )
    env = build_env(parts.config, parts.world, parts.observation, parts.policy, agents=9)
    steps = env.rollout(12, parts.policy.operator(), break_when_any_done=False)
    (key,) = recurrent_keys(parts.policy)
    begins = steps["is_init"].squeeze(-1)
    assert begins[:, 0].all()
    assert begins[:, 1:].any()
    assert torch.equal(begins[:, 1:], steps["next", "done"][:, :-1, 0])
    assert not steps[key][begins].any()
    assert steps[key][~begins].any(-1).all()


def test_weights_of_some_scenes_are_loaded_by_name():
    features = torch.rand(6, 3)
    whole, part = make_policy(features, ["a", "b", "v1.0"], seed=1), make_policy(features, ["v1.0", "a"], seed=2)
    load_weights(part, plain_weights(whole), "here", ["v1.0", "a"])
    for name in ("a", "v1_0"):
        for layers in ("trunk", "policy", "value"):
            key = f"heads.{layers}.scenes.{name}.{'0.' if layers == 'trunk' else ''}weight"
            assert torch.equal(part.state_dict()[key], whole.state_dict()[key])
    assert torch.equal(part.encoder.fusion.weight, whole.encoder.fusion.weight)


def test_features_of_another_extractor_are_refused(tmp_path):
    parts = make_parts(f"scene={room_file(tmp_path)}", *SMALL)
    saved = {"network": plain_weights(parts.policy), "scenes": ["grid"], "extractor": "CLIP"}
    with pytest.raises(ConfigError, match="here: was trained on features of another extractor: 'CLIP', not 'random'"):
        trained_policy(saved, "here", parts.config, parts.world, parts.observation)


def test_a_machine_without_a_gpu_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(ConfigError, match=r"^device=cuda: torch sees no CUDA device here; use device=cpu$"):
        build_world(train_config(f"scene={room_file(tmp_path)}", "device=cuda"))


def test_the_expert_may_walk_to_other_goals_than_the_run_has(tmp_path):
    options = [f"scene={room_file(tmp_path)}", *SMALL, "hold_out=0.3", "imitation.fraction=1"]
    parts = make_parts(*options, "imitation.sampled=true", "imitation.goals=all")
    torch.manual_seed(0)
    shown = set(parts.demos.draw(2000)["goal"].tolist())
    held_out = set(build_goals(parts.config, parts.world.scenes).held_out["grid"])
    assert held_out
    assert shown == set(range(24)) - held_out
    assert parts.world.goals.tolist() == [0, 13]  # where reinforcement is
    with pytest.raises(ConfigError, match=r"imitation\.goals: applies to sampled pairs only"):
        make_parts(*options, "imitation.goals=all")
    with pytest.raises(SceneError, match=r"^imitation\.goals: grid: goals=some: must be states, or one of all"):
        make_parts(*options, "imitation.sampled=true", "imitation.goals=some")


@pytest.mark.parametrize("options", [["memory=gru"], ["observation=sequential"]])
def test_a_policy_of_more_than_the_present_views_cannot_plan(tmp_path, options):
    with pytest.raises(
        ConfigError, match=r"^episodic_memory: PlanningMemory asks .*choose episodic_memory=counts or none$"
    ):
        make_parts(f"scene={room_file(tmp_path)}", "episodic_memory=planning", *options, *SMALL)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([], r"^episodic_memory=localising weighs log odds, and NCC has none: add recogniser=learned$"),
        (["recogniser=learned", "stop.evaluation=goal"], r"^stop.evaluation=goal: a LocalisingMemory stops by "),
    ],
)
def test_a_memory_that_localises_weighs_log_odds_for_its_stop(tmp_path, options, message):
    with pytest.raises(ConfigError, match=message):
        make_parts(f"scene={room_file(tmp_path)}", "episodic_memory=localising", *options, *SMALL)


def test_goals_that_few_states_reach_are_told(capsys):
    room = grid_scene(goals=(0, 13))
    graph = np.where(np.arange(len(room))[:, None] < 4, room.graph, np.where(room.graph < 4, -1, room.graph))
    tell_of_far_goals(make_world([replace(room, graph=graph)]))
    told = capsys.readouterr().out
    assert told.startswith(
        "grid: most states cannot reach 1 of 2 goals, the worst: 0 can be reached from 4 of 24 states"
    )
    tell_of_far_goals(make_world([room]))
    assert not capsys.readouterr().out
