import copy

import torch
from networks import FEATURES, WIDTH

from dirl.models import SiameseEncoder


def encoder():
    torch.manual_seed(0)
    return SiameseEncoder(FEATURES, WIDTH)


def observations(*shape):
    return torch.randn(2, *shape, 4, FEATURES, generator=torch.Generator().manual_seed(1))


def test_four_views_are_embedded_together_and_both_embeddings_fused():
    made, (observation, goal_observation) = encoder(), observations(9)
    rows, fusion = [], torch.cat([made.fusion.weight, made.goal_fusion.weight], 1)
    for views, goal_views in zip(observation, goal_observation, strict=True):
        both = [(made.embedding.weight @ torch.cat(list(four)) + made.embedding.bias) for four in (views, goal_views)]
        rows.append((fusion @ torch.cat(both).relu() + made.fusion.bias).relu())
    torch.testing.assert_close(made(observation, goal_observation), torch.stack(rows))


def test_observation_and_goal_are_embedded_by_the_same_weights():
    made, (observation, goal_observation) = encoder(), observations(9)
    swapped = copy.deepcopy(made)
    with torch.no_grad():
        swapped.fusion.weight.copy_(made.goal_fusion.weight)
        swapped.goal_fusion.weight.copy_(made.fusion.weight)
    torch.testing.assert_close(swapped(goal_observation, observation), made(observation, goal_observation))
    assert [name for name, _ in swapped.named_parameters()] == [
        "embedding.weight", "embedding.bias", "fusion.weight", "fusion.bias",
        "goal_fusion.weight",
    ]  # fmt: skip
