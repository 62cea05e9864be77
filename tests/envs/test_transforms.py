import pytest
import torch
from torchrl.envs import Compose, StepCounter, TransformedEnv
from torchrl.envs.utils import check_env_specs

from dirl.envs import NavigationEnv, SequentialViews, SurroundingViews, ViewFeatures

AGENTS, STEPS = 6, 25


def test_sequential_views_recorded_in_the_env_are_each_episodes_last_four_states(world):
    env = TransformedEnv(NavigationEnv(world, AGENTS), Compose(StepCounter(5), SequentialViews(world)))
    torch.manual_seed(0)
    steps = env.rollout(STEPS, break_when_any_done=False)
    assert steps["next", "done"].sum() > AGENTS
    for agent in steps:
        history = None
        for step in agent:
            # `history` is None where an episode begins.
            history = history or [step["state"].item()] * 4
            assert step["view_ids"].tolist() == history
            history = [*history[1:], step["next", "state"].item()]
            assert step["next", "view_ids"].tolist() == history
            if step["next", "done"]:
                history = None


@pytest.mark.parametrize("kind", [SurroundingViews, SequentialViews])
def test_the_features_behind_the_views_are_looked_up_in_the_env(world, kind):
    transforms = Compose(StepCounter(5), kind(world), ViewFeatures(world.features))
    env = TransformedEnv(NavigationEnv(world, AGENTS), transforms)
    check_env_specs(env)
    steps = env.rollout(STEPS, break_when_any_done=False)
    assert steps["next", "done"].any()
    for part in (steps, steps["next"]):
        assert part["observation"].shape == (AGENTS, STEPS, 4, 16)
        assert torch.equal(part["observation"], world.features[part["view_ids"]])
        assert torch.equal(part["goal_observation"], world.features[part["goal_view_ids"]])
