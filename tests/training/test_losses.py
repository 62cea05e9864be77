"""Rollouts and their advantages, the losses of an update together, and what updates tell."""

import pytest
import torch
from commands import room_file
from networks import make_policy
from parts import make_parts, train_state
from refusals import refused
from tensordict import TensorDict
from torchrl.envs import Compose, StepCounter, TransformedEnv

from dirl.config.schemas import Schedule
from dirl.envs import NavigationEnv, SequentialViews, SurroundingViews
from dirl.models import recurrent_keys
from dirl.training.objectives import Losses, ScheduledLoss, as_first_steps, bootstrap, make_advantages, minibatches
from dirl.training.rollout import collect, report

SMALL = ["encoder.width=8", "heads.width=8", "reinforcement.agents_per_scene=30", "reinforcement.max_steps=9"]
GRU = ["memory=gru", "memory.hidden_size=8"]


@pytest.fixture
def room(tmp_path):
    return f"scene={room_file(tmp_path)}"


def rollout(parts, steps=20):
    """Steps with advantages, ``[B, T]``, and the environment they were walked in."""
    state = train_state(parts)
    batch, _ = collect(state.env, parts.policy.operator(), state.agents, steps)
    critic = parts.policy.operator().get_value_operator()
    return make_advantages(0.9, 0.9)(bootstrap(batch, critic)), state.env


def rows(parts):
    """Steps with advantages as the losses read them."""
    return next(minibatches(rollout(parts)[0], 1, 1, by_agent=bool(recurrent_keys(parts.policy))))


def test_an_update_tells_the_episodes_that_ended_in_it_in_their_order(room):
    parts = make_parts(room, *SMALL)
    batch, env = rollout(parts)
    losses = parts.losses(batch.reshape(-1), 1.0)
    (update,) = report(env, batch, losses).read()
    ended = batch.transpose(0, 1)[batch["next", "done"].squeeze(-1).T]  # step by step, agent by agent
    goals = [parts.world.goals.tolist().index(goal) for goal in ended["goal"].tolist()]
    assert update.frames == 600
    assert len(set(goals)) > 1
    assert (update.goal_index, update.steps) == (goals, ended["next", "step_count"].flatten().tolist())
    assert update.values["loss_objective"] == losses["loss_objective"].item()
    target, value = (batch[key].flatten().double() for key in ("value_target", "state_value"))
    explained = 1 - (target - value).var().item() / target.var().item()
    assert update.values["explained_variance"] == pytest.approx(explained, abs=1e-4)


@pytest.mark.parametrize("memory", [[], GRU], ids=["no memory", "gru"])
@pytest.mark.parametrize("left", [1.0, 0.25])
def test_the_losses_are_those_of_each_module_on_its_own_rows_weighted(room, memory, left):
    parts = make_parts(room, *SMALL, *memory, "imitation.bc_coef={start:0.8,end:0.4}", "imitation.fraction=0.5")
    batch = rows(parts)
    found = parts.losses(batch.copy(), left)
    trunk = parts.losses.trunk
    shown = trunk(as_first_steps(parts.policy, parts.demos).copy())
    imitation = parts.losses.losses["imitation"].module(shown)
    torch.testing.assert_close(found["loss_imitation"], (0.4 + 0.4 * left) * imitation["loss_imitation"])
    assert found["accuracy"] == imitation["accuracy"]
    if not memory:
        a2c = parts.losses.losses["a2c"].module(trunk(batch.copy()))
        torch.testing.assert_close(found["loss_objective"], a2c["loss_objective"])
    names = {"loss_imitation", "loss_objective", "loss_entropy", "loss_critic"}
    assert {name for name in found.keys() if name.startswith("loss_")} == names  # noqa: SIM118, of a TensorDict


def test_losses_without_weight_or_demonstrations_are_left_out(room):
    both, rewarded, imitated = (
        make_parts(room, *SMALL, *options).losses
        for options in ([], ["imitation.bc_coef={start:0,end:0}"], ["objective=none"])
    )
    assert [list(one.losses) for one in (both, rewarded, imitated)] == [["a2c", "imitation"], ["a2c"], ["imitation"]]
    assert [one.on_rollouts for one in (both, rewarded, imitated)] == [True, True, False]


def test_a_loss_of_ones_own_that_writes_something_else_is_told(room):
    parts = make_parts(room, *SMALL)
    batch = rows(parts)
    for written, told in (
        ({"reported": 0.0}, r"losses\.own: Own writes no loss_\* entry"),
        ({"loss_own": torch.zeros(2)}, r"losses\.own: gives loss_own \[2\]; expected one number, \[\]"),
        ({"loss_objective": 0.0}, r"losses\.own: writes loss_objective, as another loss does"),
    ):
        losses = {**parts.losses.losses, "own": ScheduledLoss(Own(written), {"weight": Schedule(1.0, 1.0)})}
        refused(f"^{told}$", Losses(parts.policy, losses, parts.demos), batch.copy(), 1.0)


class Own(torch.nn.Module):
    """A loss that writes what it is given."""

    in_keys = ("hidden",)

    def __init__(self, written):
        super().__init__()
        self.written = written

    def forward(self, batch):
        self.read = batch
        return TensorDict(self.written)


def test_a_loss_compares_if_it_takes_demonstrations_beside_the_rollout():
    class OnDemonstrations(Own):
        """Whose argument is called so, though it reads nothing else."""

        in_keys = ("expert_action",)

        def forward(self, demonstrations):
            return TensorDict(self.written)

    loss = ScheduledLoss(OnDemonstrations({}), {})
    assert (loss.on_demonstrations, loss.compares) == (True, False)


def test_what_the_loss_sees_of_a_memory_is_what_the_rollout_saw(room):
    parts = make_parts(room, *SMALL, *GRU)
    batch, _ = rollout(parts)
    assert batch["next", "done"][:, :-1].any()
    seen = Own({"loss_own": torch.zeros(())})
    losses = Losses(parts.policy, {"own": ScheduledLoss(seen, {"weight": Schedule(1.0, 1.0)})}, parts.demos)
    losses(batch, 1.0)
    hidden = seen.read
    logits = parts.policy.heads.policy(hidden["hidden"], hidden["scene"])
    chosen = logits.log_softmax(-1).gather(-1, hidden["action"].unsqueeze(-1)).squeeze(-1)
    torch.testing.assert_close(chosen, batch["action_log_prob"].flatten())


def test_minibatches_take_every_row_once_a_pass(room):
    parts = make_parts(room, *SMALL)
    batch, _ = rollout(parts)
    batch["number"] = torch.arange(600).view(30, 20)
    whole = list(minibatches(batch, epochs=2, count=1))
    assert [part["number"].tolist() for part in whole] == [list(range(600))] * 2
    parts_of = list(minibatches(batch, epochs=2, count=4))
    assert [len(part) for part in parts_of] == [150] * 8
    for first in (0, 4):
        numbers = torch.cat([part["number"] for part in parts_of[first : first + 4]])
        assert sorted(numbers.tolist()) == list(range(600)) != numbers.tolist()
    agents = list(minibatches(batch, epochs=1, count=3, by_agent=True))
    assert [part.batch_size for part in agents] == [(10, 20)] * 3
    assert all((part["number"].diff() == 1).all() for part in agents)


@pytest.fixture
def policy(world):
    return make_policy(world.features, world.names, width=8).operator()


def walked(world, policy, views, *lengths):
    """What agents collect in calls of so many steps, ``[B, T]``, and where that leaves them."""
    env = TransformedEnv(NavigationEnv(world, 12, seed=3), Compose(StepCounter(7), views(world)))
    torch.manual_seed(0)
    agents, batches = env.reset(), []
    for steps in lengths:
        batch, agents = collect(env, policy, agents, steps)
        batches.append(batch)
    return torch.cat(batches, 1), agents


def test_agents_that_are_done_start_anew_and_their_actions_are_not_always_the_most_probable_ones(world, policy):
    batch, agents = walked(world, policy, SurroundingViews, 20)
    done = batch["next", "done"].squeeze(-1)
    assert batch["next", "terminated"].any()
    assert batch["next", "truncated"].any()
    begun = batch[:, 1:][done[:, :-1]]
    assert (begun["step_count"] == 0).all()
    assert (begun["state"] != begun["goal"]).all()
    assert not torch.equal(begun["goal"], batch["next"][:, :-1][done[:, :-1]]["goal"])
    assert not batch["done"].any()
    assert not agents["done"].any()
    case = batch["state"] * len(world) + batch["goal"]
    taken = torch.stack([case.flatten(), batch["action"].flatten()]).unique(dim=1)
    assert taken.shape[1] > 1.5 * len(case.unique())  # several in a state on the way to a goal


def test_short_calls_are_one_long_call(world, policy):
    whole, parts = (walked(world, policy, SequentialViews, *lengths) for lengths in ((15,), (4, 1, 10)))
    assert (whole[0] == parts[0]).all()
    assert (whole[1] == parts[1]).all()


@pytest.mark.parametrize(("gamma", "lmbda"), [(0.9, 1.0), (0.99, 0.95)])
def test_advantages_equal_the_sum_over_time(world, policy, gamma, lmbda):
    critic, (batch, _) = policy.get_value_operator(), walked(world, policy, SurroundingViews, 15)
    with torch.no_grad():  # of the state behind each step, asked for one by one
        following = critic(batch["next"].reshape(-1))["state_value"].view(12, 15, 1)
    batch = make_advantages(gamma, lmbda)(bootstrap(batch, critic))
    flags = [batch["next", key].squeeze(-1) for key in ("terminated", "truncated")]
    assert all(flag[:, :-1].any() for flag in flags)
    for agent in range(12):
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
