import pytest
import torch
import torch.nn.functional as F
from networks import make_policy
from tensordict import TensorDict

from dirl.training.objectives import ImitationLoss, OptimalActionsLoss

STATES, SCENES, ROWS = 20, ("a", "b"), 12


@pytest.fixture
def network():
    return make_policy(torch.randn(STATES, 6, generator=torch.Generator().manual_seed(0)), SCENES, width=16)


def gradients(network, loss):
    network.zero_grad()
    loss.backward()
    return {name: parameter.grad for name, parameter in network.named_parameters()}


@pytest.fixture
def demonstrations():
    torch.manual_seed(0)
    return TensorDict(
        {
            "view_ids": torch.randint(STATES, (ROWS, 4)),
            "goal_view_ids": torch.randint(STATES, (ROWS, 4)),
            "scene": torch.randint(2, (ROWS,)),
            "expert_action": torch.randint(4, (ROWS,)),
        },
        [ROWS],
    )


def logits_of(network, batch):
    return network(batch.copy())["logits"]


def imitation(network, **options):
    return ImitationLoss(network.operator().get_policy_operator(), **options)


@pytest.mark.parametrize("reduction", [{}, {"reduction": "sum"}, {"reduction": "none"}])
def test_imitation_is_cross_entropy(network, demonstrations, reduction):
    found = imitation(network, **reduction)(demonstrations)["loss_imitation"]
    expected = F.cross_entropy(logits_of(network, demonstrations), demonstrations["expert_action"], **reduction)
    torch.testing.assert_close(found, expected)
    torch.testing.assert_close(gradients(network, found.sum()), gradients(network, expected.sum()))


def test_imitation_trains_everything_but_the_value_head(network, demonstrations):
    found = gradients(network, imitation(network)(demonstrations)["loss_imitation"])
    assert {name for name, gradient in found.items() if gradient is None} == {
        f"heads.value.scenes.{scene}.{kind}" for scene in SCENES for kind in ("weight", "bias")
    }


def test_accuracy_is_the_share_of_expert_actions_that_are_the_most_probable(network, demonstrations):
    best = logits_of(network, demonstrations).argmax(-1)
    demonstrations["expert_action"] = torch.where(torch.arange(ROWS) < 9, best, (best + 1) % 4)
    assert imitation(network)(demonstrations)["accuracy"] == 0.75


def test_imitation_has_the_keys_of_a_torchrl_loss(network, demonstrations):
    loss = imitation(network)
    assert set(loss.in_keys) == {"view_ids", "goal_view_ids", "scene", "expert_action"}
    assert set(loss(demonstrations).keys()) == set(loss.out_keys) == {"loss_imitation", "accuracy"}
    value, _ = loss(**{key: demonstrations[key] for key in loss.in_keys})
    loss.set_keys(expert_action="label")
    renamed = demonstrations.rename_key_("expert_action", "label")
    torch.testing.assert_close(value, loss(renamed)["loss_imitation"])


def test_any_optimal_action_is_right(network, demonstrations):
    optimal = torch.rand(ROWS, 4, generator=torch.Generator().manual_seed(1)) < 0.5
    optimal[torch.arange(ROWS), demonstrations["expert_action"]] = True
    batch = network.trunk()(demonstrations.copy()).set("optimal_actions", optimal)
    result = OptimalActionsLoss(network.operator().get_policy_head())(batch)
    logits = logits_of(network, demonstrations)
    chance = (logits.softmax(-1) * optimal).sum(-1)
    torch.testing.assert_close(result["loss_imitation"], -chance.log().mean())
    right = optimal[torch.arange(ROWS), logits.argmax(-1)]
    assert result["accuracy"].item() == pytest.approx(right.float().mean().item())


def test_with_one_optimal_action_it_is_the_cross_entropy(network, demonstrations):
    batch = network.trunk()(demonstrations.copy())
    batch["optimal_actions"] = F.one_hot(demonstrations["expert_action"], 4).bool()
    head = network.operator().get_policy_head()
    losses = [made(head)(batch)["loss_imitation"] for made in (OptimalActionsLoss, ImitationLoss)]
    torch.testing.assert_close(*losses)
