"""Losses and optimisers against their formulas."""

import pytest
import torch
import torch.nn.functional as F
from commands import train_config
from networks import gradients, make_policy
from tensordict import TensorDict

from dirl.config.components import make
from dirl.training.objectives import ImitationLoss, OptimalActionsLoss, TFRMSprop, clip_gradients

STATES, SCENES, ROWS = 20, ("a", "b"), 12


@pytest.fixture
def network():
    return make_policy(torch.randn(STATES, 6, generator=torch.Generator().manual_seed(0)), SCENES, width=16)


def made(name, network, *options):
    """The loss as ``conf/objective`` describes it, with constant coefficients."""
    coefficients = ["reinforcement.entropy_coef={start:0.02,end:0.02}", "reinforcement.critic_coef=0.25"]
    config = train_config(f"objective={name}", *coefficients, *options)
    operator = network.operator()
    heads = {"actor_network": operator.get_policy_head(), "critic_network": operator.get_value_head()}
    return make(f"losses.{name}", config.losses[name], **heads)


@pytest.fixture
def frames():
    """What the heads need of a batch: the trunk's output and what the rollout and the advantages left."""
    torch.manual_seed(0)
    rows = {"hidden": torch.randn(ROWS, 16), "scene": torch.randint(2, (ROWS,)), "action": torch.randint(4, (ROWS,))}
    rows |= {"advantage": torch.randn(ROWS, 1), "value_target": torch.randn(ROWS, 1)}
    return TensorDict(rows, [ROWS])


def heads_of(network, frames):
    """Log-probabilities of the actions taken, entropies and values, ``[B]`` each."""
    log_probs = network.heads.policy(frames["hidden"], frames["scene"]).log_softmax(-1)
    value = network.heads.value(frames["hidden"], frames["scene"]).squeeze(-1)
    taken = log_probs[torch.arange(ROWS), frames["action"]]
    return taken, -(log_probs.exp() * log_probs).sum(-1), value


def check_losses(network, loss, frames, objective, reduce):
    """Losses and gradients against the formulas: a gain for each frame, an entropy bonus and squared errors."""
    found = loss(frames)
    taken, entropies, values = heads_of(network, frames)
    expected = {
        "loss_objective": -reduce(objective(taken, frames["advantage"].squeeze(-1))),
        "loss_entropy": -0.02 * reduce(entropies),
        "loss_critic": 0.25 * reduce((values - frames["value_target"].squeeze(-1)) ** 2),
    }
    losses = {key: found[key] for key in found.keys() if key.startswith("loss_")}  # noqa: SIM118
    torch.testing.assert_close(losses, expected)
    total = gradients(network, sum(losses.values()))
    torch.testing.assert_close(total, gradients(network, sum(expected.values())))


@pytest.mark.parametrize("reduction", ["mean", "sum"])
def test_a2c_is_the_papers_formula(network, frames, reduction):
    loss = made("a2c", network, f"reinforcement.reduction={reduction}")
    gain = lambda taken, advantage: taken * advantage  # noqa: E731
    check_losses(network, loss, frames, gain, getattr(torch, reduction))


def test_ppo_clips_the_ratio(network, frames):
    old = heads_of(network, frames)[0].detach() + torch.linspace(-0.6, 0.6, ROWS)
    frames["action_log_prob"] = old

    def gain(taken, advantage):
        ratio = (taken - old).exp()
        return torch.minimum(ratio * advantage, ratio.clamp(0.7, 1.3) * advantage)

    loss = made("ppo", network, "losses.ppo.clip_epsilon=0.3")
    check_losses(network, loss, frames, gain, torch.mean)


@pytest.fixture
def demonstrations():
    torch.manual_seed(0)
    rows = {name: torch.randint(STATES, (ROWS, 4)) for name in ("view_ids", "goal_view_ids")}
    rows |= {"scene": torch.randint(2, (ROWS,)), "expert_action": torch.randint(4, (ROWS,))}
    return TensorDict(rows, [ROWS])


@pytest.mark.parametrize("reduction", [{}, {"reduction": "sum"}, {"reduction": "none"}])
def test_imitation_is_cross_entropy(network, demonstrations, reduction):
    loss = ImitationLoss(network.operator().get_policy_operator(), **reduction)
    found = loss(demonstrations)["loss_imitation"]
    expected = F.cross_entropy(network(demonstrations.copy())["logits"], demonstrations["expert_action"], **reduction)
    torch.testing.assert_close(found, expected)
    torch.testing.assert_close(gradients(network, found.sum()), gradients(network, expected.sum()))


def test_any_optimal_action_is_right(network, demonstrations):
    optimal = torch.rand(ROWS, 4, generator=torch.Generator().manual_seed(1)) < 0.5
    optimal[torch.arange(ROWS), demonstrations["expert_action"]] = True
    batch = network.trunk()(demonstrations.copy()).set("optimal_actions", optimal)
    result = OptimalActionsLoss(network.operator().get_policy_head())(batch)
    logits = network(demonstrations.copy())["logits"]
    chance = (logits.softmax(-1) * optimal).sum(-1)
    torch.testing.assert_close(result["loss_imitation"], -chance.log().mean())
    right = optimal[torch.arange(ROWS), logits.argmax(-1)]
    assert result["accuracy"].item() == pytest.approx(right.float().mean().item())


def test_rmsprop_is_tensorflows():
    """Its update written out, with a decay of 0.99 and an epsilon of 0.1."""
    torch.manual_seed(0)
    weights, gradient_steps = torch.randn(3, dtype=torch.float64), torch.randn(30, 3, dtype=torch.float64) * 5
    parameter = torch.nn.Parameter(weights.clone())
    optimiser = TFRMSprop([parameter], lr=0.1)
    square = 1.0
    for gradient in gradient_steps:
        parameter.grad = gradient.clone()
        optimiser.step()
        square = 0.99 * square + 0.01 * gradient**2
        weights = weights - 0.1 * gradient / (square + 0.1) ** 0.5
    torch.testing.assert_close(parameter.data, weights)


@pytest.mark.parametrize(("per_variable", "expected"), [(False, [[0.6, 0.0], [0.0, 0.8]]), (True, [[1, 0], [0, 1]])])
def test_gradients_are_clipped_together_or_each(per_variable, expected):
    parameters = [torch.nn.Parameter(torch.zeros(2)) for _ in range(2)]
    parameters[0].grad, parameters[1].grad = torch.tensor([3.0, 0.0]), torch.tensor([0.0, 4.0])
    assert clip_gradients(parameters, 1.0, per_variable=per_variable).item() == pytest.approx(5.0)
    for parameter, gradient in zip(parameters, expected, strict=True):
        assert parameter.grad.tolist() == pytest.approx(gradient, abs=1e-4)
