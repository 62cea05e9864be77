import pytest
import torch
from commands import train_config
from networks import make_policy
from rooms import grid_scene
from tensordict import TensorDict
from torchrl.envs import Compose, StepCounter, TransformedEnv

from dirl.config.components import make
from dirl.envs import NavigationEnv, SurroundingViews
from dirl.scenes import make_world
from dirl.training.objectives import bootstrap, make_advantages
from dirl.training.rollout import collect

STATES, SCENES, ROWS = 20, ("a", "b"), 12


@pytest.fixture
def network():
    return make_policy(torch.randn(STATES, 6, generator=torch.Generator().manual_seed(0)), SCENES, width=16)


def gradients(network, loss):
    network.zero_grad()
    loss.backward()
    return {name: parameter.grad for name, parameter in network.named_parameters()}


def made(name, network, entropy, value, *options):
    """The loss as ``conf/objective`` describes it, with constant coefficients."""
    coefficients = [f"reinforcement.entropy_coef={{start:{entropy},end:{entropy}}}"]
    config = train_config(f"objective={name}", *coefficients, f"reinforcement.critic_coef={value}", *options)
    operator = network.operator()
    heads = {"actor_network": operator.get_policy_head(), "critic_network": operator.get_value_head()}
    return make(f"losses.{name}", config.losses[name], **heads)


@pytest.fixture
def frames():
    """What the heads need of a batch: the trunk's output and what the rollout and the advantages left."""
    torch.manual_seed(0)
    return TensorDict(
        {
            "hidden": torch.randn(ROWS, 16),
            "scene": torch.randint(2, (ROWS,)),
            "action": torch.randint(4, (ROWS,)),
            "advantage": torch.randn(ROWS, 1),
            "value_target": torch.randn(ROWS, 1),
        },
        [ROWS],
    )


def heads_of(network, frames):
    """Log-probabilities of the actions taken, entropies and values, ``[B]`` each."""
    log_probs = network.heads.policy(frames["hidden"], frames["scene"]).log_softmax(-1)
    value = network.heads.value(frames["hidden"], frames["scene"]).squeeze(-1)
    taken = log_probs[torch.arange(ROWS), frames["action"]]
    return taken, -(log_probs.exp() * log_probs).sum(-1), value


def check_losses(network, loss, frames, objective, entropy, value, reduce):
    """Losses and gradients against the formulas: a gain for each frame, an entropy bonus and squared errors."""
    found = loss(frames)
    taken, entropies, values = heads_of(network, frames)
    expected = {
        "loss_objective": -reduce(objective(taken, frames["advantage"].squeeze(-1))),
        "loss_entropy": -entropy * reduce(entropies),
        "loss_critic": value * reduce((values - frames["value_target"].squeeze(-1)) ** 2),
    }
    losses = {key: found[key] for key in found.keys() if key.startswith("loss_")}  # noqa: SIM118
    torch.testing.assert_close(losses, expected)
    total = gradients(network, sum(losses.values()))
    torch.testing.assert_close(total, gradients(network, sum(expected.values())))


@pytest.mark.parametrize("reduction", ["mean", "sum"])
def test_a2c_is_the_papers_formula(network, frames, reduction):
    loss = made("a2c", network, 0.02, 0.25, f"reinforcement.reduction={reduction}")
    gain = lambda taken, advantage: taken * advantage  # noqa: E731
    check_losses(network, loss, frames, gain, 0.02, 0.25, getattr(torch, reduction))


@pytest.mark.parametrize("reduction", ["mean", "sum"])
def test_ppo_clips_the_ratio(network, frames, reduction):
    old = heads_of(network, frames)[0].detach() + torch.linspace(-0.6, 0.6, ROWS)
    frames["action_log_prob"] = old

    def gain(taken, advantage):
        ratio = (taken - old).exp()
        return torch.minimum(ratio * advantage, ratio.clamp(0.7, 1.3) * advantage)

    loss = made("ppo", network, 0.02, 0.25, f"reinforcement.reduction={reduction}", "losses.ppo.clip_epsilon=0.3")
    check_losses(network, loss, frames, gain, 0.02, 0.25, getattr(torch, reduction))


def test_ppos_first_step_is_a2cs(network, frames):
    frames["action_log_prob"] = heads_of(network, frames)[0].detach()
    ppo = made("ppo", network, 0, 0)(frames)
    a2c = made("a2c", network, 0, 0)(frames)
    torch.testing.assert_close(ppo["loss_objective"], -frames["advantage"].mean())
    first, same = (gradients(network, losses["loss_objective"]) for losses in (ppo, a2c))
    torch.testing.assert_close(first, same)


@pytest.fixture(scope="module")
def rollout():
    """Steps with ends of both kinds, at goals and at the limit of 6 steps, with the value of each state."""
    world = make_world([grid_scene(2, 1, goals=(1,))])
    env = TransformedEnv(NavigationEnv(world, 10), Compose(StepCounter(6), SurroundingViews(world)))
    operators = make_policy(world.features, world.names, width=8).operator()
    torch.manual_seed(1)
    return operators, collect(env, operators, env.reset(), 15)[0]


@torch.no_grad()
def next_values(rollout):
    """The value of the state behind each step, asked for one by one, ``[B, T, 1]``."""
    operators, batch = rollout
    return operators.get_value_operator()(batch["next"].reshape(-1))["state_value"].view(10, 15, 1)


def test_bootstrap_gives_the_critics_value_of_each_next_state(rollout):
    operators, batch = rollout
    values = bootstrap(batch.clone(), operators.get_value_operator())["next", "state_value"]
    # What stands behind a goal is never used.
    going = ~batch["next", "terminated"]
    torch.testing.assert_close(values[going], next_values(rollout)[going])
    assert not values.requires_grad
    assert values.shape == (10, 15, 1)


def test_bootstrap_asks_the_critic_only_behind_the_last_step_and_where_an_episode_was_cut_off(rollout):
    operators, batch = rollout
    critic, sizes = operators.get_value_operator(), []
    critic.register_forward_hook(lambda module, inputs, output: sizes.append(len(output)))
    bootstrap(batch.clone(), critic)
    truncated = batch["next", "truncated"]
    assert truncated[:, :-1].any()
    assert sizes == [truncated[:, :-1].sum() + 10]


@pytest.mark.parametrize(("gamma", "lmbda"), [(0.9, 1.0), (0.99, 0.95), (0.9, 0.0)])
def test_advantages_equal_the_sum_over_time(rollout, gamma, lmbda):
    operators, batch = rollout
    following = next_values(rollout)
    batch = make_advantages(gamma, lmbda)(bootstrap(batch.clone(), operators.get_value_operator()))
    flags = [batch["next", key].squeeze(-1) for key in ("terminated", "truncated")]
    assert all(flag[:, :-1].any() for flag in flags)
    for agent in range(10):
        advantage = 0.0
        for time in reversed(range(15)):
            terminated, truncated = (flag[agent, time].item() for flag in flags)
            value = batch["state_value"][agent, time].item()
            # An episode that ended has no future; one that was cut off has, but its advantages end here too.
            future = 0.0 if terminated else gamma * following[agent, time].item()
            error = batch["next", "reward"][agent, time].item() + future - value
            advantage = error + (0.0 if terminated or truncated else gamma * lmbda * advantage)
            assert batch["advantage"][agent, time].item() == pytest.approx(advantage, abs=1e-4)
            assert batch["value_target"][agent, time].item() == pytest.approx(advantage + value, abs=1e-4)
