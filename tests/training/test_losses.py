"""Each way of learning, alone, must solve a small room (red if its loss points the wrong way); what updates tell."""

import pytest
import torch
from commands import room_file, train_config
from train import imitate, reinforce

from dirl.evaluation import metrics
from dirl.models import actor_critic
from dirl.runs.folder import Run
from dirl.training.build import build_env, learning_parts, run_policy
from dirl.training.losses import make_gradients, summarise
from dirl.training.rollout import collect


def learn(tmp_path, *options):
    """Train in a room of 6 places (24 states), and evaluate greedily from every start, before and after."""
    fixed = [f"scene={room_file(tmp_path)}", "network.width=64", "evaluation.times=0", "checkpoint.every_seconds=1e9"]
    config = train_config(*fixed, *options)
    torch.manual_seed(config.seed)
    parts = learning_parts(config)
    before = metrics(run_policy(parts))
    run = Run(tmp_path, config)
    run.begin(parts.world)
    if len(parts.demos):
        imitate(parts, run, parts.demos)
    reinforce(parts, run)
    return before, metrics(run_policy(parts))


def test_imitation_alone_learns_what_the_expert_shows(tmp_path):
    before, after = learn(tmp_path, "system=il", "imitation.share=1", "imitation.lr=3e-3")
    assert before["sr"] < 0.5
    assert after["sr"] == 1
    assert after["spl"] == 1


@pytest.mark.parametrize("objective", ["a2c", "ppo"])
def test_reinforcement_alone_finds_every_goal(tmp_path, objective):
    options = ["imitation.share=0", "optimiser.lr=2e-3", f"objective={objective}"]
    sizes = ["reinforcement.frames_per_scene=30_000", "reinforcement.agents_per_scene=30"]
    before, after = learn(tmp_path, *options, *sizes)
    assert before["sr"] < 0.5
    assert after["sr"] == 1
    assert after["spl"] > 0.85


def test_an_update_tells_the_episodes_that_ended_in_it_in_their_order(tmp_path):
    sizes = ["reinforcement.agents_per_scene=30", "reinforcement.max_steps=9", "network.width=8"]
    parts = learning_parts(train_config(f"scene={room_file(tmp_path)}", *sizes))
    env = build_env(parts)
    batch, _ = collect(env, actor_critic(parts.network), env.reset(), 20)
    (losses,) = make_gradients(parts, parts.network)(batch, 1.0)
    update = summarise(env, batch, losses)
    goals, steps = [], []
    for step in range(20):
        for agent in range(30):
            if batch[agent, step]["next", "done"]:
                goals.append(parts.world.goals.tolist().index(batch[agent, step]["goal"]))
                steps.append(batch[agent, step]["next", "step_count"].item())
    assert update.frames == 600
    assert len(set(goals)) > 1
    assert (update.goal_index, update.steps) == (goals, steps)
    assert update.values["loss_objective"] == losses["loss_objective"].item()
