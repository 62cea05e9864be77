"""Training in a simulator: agents in turns, views that are encoded when they are seen, moves that go wrong."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from field import Field
from parts import Loop, make_parts, train_state
from refusals import refused
from torchrl.envs.utils import check_env_specs
from train import learn

from dirl.envs import NavigationEnv
from dirl.envs.live import LiveEnv
from dirl.evaluation.live_episodes import Remembered
from dirl.models import FeatureTable
from dirl.scenes import make_world, write_dump
from dirl.scenes.live import Pose
from dirl.sources.simulators import take_scene
from dirl.training import simulation
from dirl.training.simulation import Live, live_protocol, open_live


def encode(images):
    return images.flatten(1).float()


def field_scene():
    """The field with the features of what it shows at each state."""
    scene, _ = take_scene(Field(), source="field", step=1.0, turn=90)
    field, images = Field(), []
    for (x, z), heading in zip(scene.positions.tolist(), scene.headings.tolist(), strict=True):
        field.place(Pose(x, z, heading))
        images.append(field.look(heading))
    features = encode(torch.from_numpy(np.stack(images))).numpy()
    return replace(scene, features=features, goals=(0, 17), extractor="colours", views=None)


def make_env(agents=6, views=200, **options):
    world = make_world([field_scene()])
    table = FeatureTable(world.features, room=views)
    return LiveEnv(world, agents, simulator=Field(), encode=encode, table=table, views=views, **options)


def walk(env, steps, seed=0):
    """What a fixed sequence of actions leads to, ``[B, T]``."""
    draws, agents, taken = torch.Generator().manual_seed(seed), env.reset(), []
    for _ in range(steps):
        action = torch.randint(4, env.batch_size, generator=draws)
        taken.append(env.step(agents.set("action", action)))
        agents = taken[-1]["next"].exclude("reward")
    return torch.stack(taken, -1)


def test_without_errors_it_is_the_world_of_the_dump():
    env = make_env(seed=3)
    found, wanted = walk(env, 60), walk(NavigationEnv(env.world, 6, seed=3), 60)
    for key in ("state", "goal", "done", "reward"):
        assert torch.equal(found["next", key], wanted["next", key])
    around = env.world.surrounding[found["next", "state"]]
    assert torch.equal(env.table.table[found["next", "view_ids"]], env.world.features[around])
    goals = env.world.surrounding[found["next", "goal"]]
    assert torch.equal(env.table.table[found["next", "goal_view_ids"]], env.world.features[goals])
    walk(env, 150, seed=1)
    assert env.simulator.looks == len(env.rows) == len(env.world)  # a view that returns is rendered once


def test_who_slips_stays_and_who_errs_in_turning_goes_where_it_looks():
    slipping = walk(make_env(agents=200, slip=0.25), 5)
    still = (slipping["pose"] == slipping["next", "pose"]).all(-1)
    turns = (slipping["action"] == 1) | (slipping["action"] == 2)
    assert still[turns].float().mean().item() == pytest.approx(0.25, abs=0.05)
    env = make_env(agents=50, turn_error=4.0, views=4000)
    check_env_specs(env)
    steps = walk(env, 6)
    off = steps["next", "pose"][..., 2] % 90
    assert ((off > 0.5) & (off < 89.5)).any()
    assert torch.equal(env.world.scene_of[steps["next", "state"]], steps["scene"])
    nearest = env.places[steps["next", "state"]]
    assert ((steps["next", "pose"][..., 2] - nearest[..., 2] + 180) % 360 - 180).abs().max() <= 45


def test_the_views_seen_longest_ago_are_forgotten():
    env = make_env(agents=2, turn_error=4.0, views=60)
    steps = walk(env, 40)
    assert len(env.rows) == 60
    assert len(set(env.rows.values())) == 60
    last = steps["next"][:, -1]
    assert env.table.table[last["view_ids"]].abs().sum(-1).min() > 0
    before = env.table.table[last["view_ids"]]
    env.table.refresh()
    assert torch.equal(env.table.table[env.restore_agents(last)["view_ids"]], before)


def test_a_simulator_that_dies_is_one_line():
    env = make_env()
    env.simulator.look = lambda heading: 1 / 0
    refused(r"^field failed \(ZeroDivisionError: .*\); run the command again$", env.reset)


@pytest.fixture
def options(tmp_path, monkeypatch):
    """Of a training in the field, whose encoder is none of the package."""
    file = tmp_path / "field.h5"
    scene = field_scene()
    write_dump(file, scene)
    opened = Live(Field(), Remembered(encode))
    monkeypatch.setattr(simulation, "_opened", lambda *_: opened)
    small = ["encoder.width=16", "heads.width=16", "reinforcement.agents_per_scene=6", "evaluation.live_episodes=4"]
    return [f"scene={file}", "env=live", "env.simulator=x.yaml", "env.slip=0.1", "env.views=400", *small]


def test_the_recipe_trains_and_the_navigator_is_evaluated_in_it(options):
    parts = make_parts(*options, "evaluation.max_steps=12")
    state = train_state(parts)
    before = {name: value.clone() for name, value in parts.policy.named_parameters()}
    learn(state, Loop(state, 120))
    assert state.frames == 120
    assert any(not torch.equal(value, before[name]) for name, value in parts.policy.named_parameters())
    opened = open_live(parts.config, parts.world, parts.observation)
    walk = live_protocol(parts.config, opened, parts.world, parts.observation)
    found, told = walk(parts.policy), walk(parts.policy, told=True)
    assert len(found.steps) == len(told.steps) == 4
    assert not (told.false_stop | told.missed_stop).any()
    again = train_state(make_parts(*options))
    again.load_state_dict(state.state_dict())
    assert torch.equal(again.agents["pose"], state.agents["pose"])
    seen = [one.env.base_env.table.table[one.agents["view_ids"]] for one in (state, again)]
    assert torch.equal(*seen)


def test_what_is_impossible_in_a_simulator_is_one_line(options):
    refused("use observation=surrounding", train_state, make_parts(*options, "observation=sequential"))
    refused("use stop.training=goal", train_state, make_parts(*options, "stop.training=match"))
    told = "6 agents see up to 336 views between updates; give env.views"
    refused(told, train_state, make_parts(*options, "env.views=100"))
