import pytest
import torch
from networks import make_policy
from torchrl.envs import Compose, StepCounter, TransformedEnv

from dirl.envs import NavigationEnv, SequentialViews, SurroundingViews
from dirl.training.rollout import collect

AGENTS, STEPS = 12, 20


def make_env(world, views=SurroundingViews, agents=AGENTS):
    transforms = Compose(StepCounter(7), views(world))
    return TransformedEnv(NavigationEnv(world, agents, seed=3), transforms)


@pytest.fixture
def policy(world):
    return make_policy(world.features, world.names, width=8).operator()


def test_agents_that_are_done_start_anew(world, policy):
    env = make_env(world)
    batch, agents = collect(env, policy, env.reset(), STEPS)
    done = batch["next", "done"].squeeze(-1)
    assert batch["next", "terminated"].any()
    assert batch["next", "truncated"].any()
    begun = batch[:, 1:][done[:, :-1]]
    assert (begun["step_count"] == 0).all()
    assert (begun["state"] != begun["goal"]).all()
    assert not torch.equal(begun["goal"], batch["next"][:, :-1][done[:, :-1]]["goal"])
    assert not batch["done"].any()
    assert not agents["done"].any()


def test_actions_are_sampled_and_not_the_most_probable_ones(world, policy):
    batch, _ = collect(make_env(world), policy, make_env(world).reset(), STEPS)
    case = batch["state"] * len(world) + batch["goal"]
    taken = torch.stack([case.flatten(), batch["action"].flatten()]).unique(dim=1)
    assert taken.shape[1] > 1.5 * len(case.unique())  # several in a state on the way to a goal


def test_two_short_calls_are_one_long_call(world, policy):
    def in_calls_of(*lengths):
        env = make_env(world, SequentialViews)
        torch.manual_seed(0)
        agents, batches = env.reset(), []
        for steps in lengths:
            batch, agents = collect(env, policy, agents, steps)
            batches.append(batch)
        return torch.cat(batches, 1), agents

    whole, parts = in_calls_of(15), in_calls_of(4, 1, 10)
    assert (whole[0] == parts[0]).all()
    assert (whole[1] == parts[1]).all()
