import pytest
import torch
from networks import make_policy
from rooms import grid_scene
from torch.utils._python_dispatch import TorchDispatchMode
from torchrl.envs import Compose, StepCounter, TransformedEnv

from dirl.envs import NavigationEnv, SequentialViews, SurroundingViews
from dirl.models import distinct
from dirl.models import policy as policy_module
from dirl.scenes import make_world
from dirl.training.rollout import collect

AGENTS, STEPS = 12, 20


@pytest.fixture
def world():
    return make_world([grid_scene(3, 2, name="a", goals=(0, 13)), grid_scene(2, 2, name="b", goals=(9,))])


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


class Questions(TorchDispatchMode):
    """Notes every operation whose answer Python, or a size, waits for."""

    def __init__(self):
        super().__init__()
        self.asked = []

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        name = function.overloadpacket.__name__
        indices = args[1] if name in ("index", "index_put_", "_index_put_impl_") else []
        masks = any(index is not None and index.dtype == torch.bool for index in indices)
        if masks or name in ("_local_scalar_dense", "nonzero", "masked_select", "_unique2", "equal", "bincount"):
            self.asked.append(name)
        return function(*args, **(kwargs or {}))


def cached_policy(world):
    policy = make_policy(world.features, world.names, width=8)
    policy.cache(world.surrounding)
    return policy


def test_a_rollout_makes_no_host_device_synchronisation(world, monkeypatch):
    """A GPU would have to finish its work before it answers; what an agent does is decided without."""
    for module in (policy_module, distinct):
        monkeypatch.setattr(module, "reading_waits", lambda tensor: True)
    env, policy = make_env(world), cached_policy(world)
    operator = policy.operator()
    with policy.cached.keeping(learns=True):
        _, agents = collect(env, operator, env.reset(), 1)  # sets up what is set up once
        monkeypatch.setattr(torch.Tensor, "tolist", None, raising=False)  # of which the dispatcher does not hear
        with Questions() as questions:
            collect(env, operator, agents, STEPS)
    assert questions.asked == []
