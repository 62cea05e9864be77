import pytest
import torch
from rooms import grid_scene
from torchrl.envs import Compose, StepCounter, TransformedEnv
from torchrl.envs.utils import check_env_specs

from dirl.envs import NavigationEnv, Reward, SequentialViews, ViewFeatures
from dirl.scenes import make_world

AHEAD, RIGHT, LEFT, BACK = range(4)


@pytest.fixture
def world():
    """24 states with goals 0 and 13, and behind them 8 states in two unconnected places with goal 25."""
    room = grid_scene(3, 2, name="room", goals=(0, 13))
    split = grid_scene(3, 1, name="split", goals=(1,), blocked=[(1, 0)])
    return make_world([room, split])


def test_starts_reach_their_goal_and_are_not_it(world):
    agents = NavigationEnv(world, 3000).reset()
    starts = {goal: set(agents["state"][agents["goal"] == goal].tolist()) for goal in agents["goal"].unique().tolist()}
    # In the second scene only the other headings of the goal's own place reach it.
    assert starts == {0: set(range(24)) - {0}, 13: set(range(24)) - {13}, 25: {24, 26, 27}}


def test_a_false_stop_ends_the_episode_with_the_step_reward(world):
    stop = torch.zeros_like(world.distances, dtype=torch.bool)
    stop[world.pair(torch.tensor(0), torch.tensor(5))] = True
    env = NavigationEnv(world, 2, stop=stop)
    agents = env.reset()
    # The second agent has another goal, for which that state is none to stop in.
    agents["state"], agents["goal"], agents["action"] = torch.tensor([[4, 4], [0, 13], [RIGHT, RIGHT]])
    after = env.step(agents)["next"]
    assert Reward() == Reward(goal=10.0, step=-0.01, collision=-0.1)  # of the paper
    assert after["state"].tolist() == [5, 5]
    assert after["reward"].squeeze(-1).tolist() == pytest.approx([-0.01, -0.01])
    assert after["terminated"].squeeze(-1).tolist() == [True, False]


def walk(env, seed, steps=30):
    torch.manual_seed(seed)
    return env.rollout(steps, break_when_any_done=False)


def test_same_seeds_same_trajectory(world):
    first = walk(NavigationEnv(world, 6, seed=5), seed=1)
    env = NavigationEnv(world, 6, seed=0)
    env.set_seed(5)
    assert (walk(env, seed=1) == first).all()
    assert not torch.equal(walk(NavigationEnv(world, 6, seed=6), seed=1)["state"], first["state"])


def test_who_slips_stays_where_it_is(world):
    env = NavigationEnv(world, 4000, slip=0.2, seed=0)
    steps = walk(env, seed=0, steps=1)
    turned = (steps["action"] == RIGHT) | (steps["action"] == LEFT)
    still = (steps["state"] == steps["next", "state"])[turned]
    assert still.float().mean().item() == pytest.approx(0.2, abs=0.03)
    with pytest.raises(ValueError, match=r"slip=1: is a probability below 1"):
        NavigationEnv(world, slip=1)


AGENTS, STEPS = 6, 25


def test_sequential_views_recorded_in_the_env_are_each_episodes_last_four_states_with_their_features(world):
    transforms = Compose(StepCounter(5), SequentialViews(world), ViewFeatures(world.features))
    env = TransformedEnv(NavigationEnv(world, AGENTS), transforms)
    check_env_specs(env)
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
    for part in (steps, steps["next"]):
        assert torch.equal(part["observation"], world.features[part["view_ids"]])
        assert torch.equal(part["goal_observation"], world.features[part["goal_view_ids"]])
