"""The navigation task as one batched TorchRL environment over integers."""

from dataclasses import dataclass

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from dirl.scenes import ACTIONS
from dirl.scenes.world import World


@dataclass(frozen=True)
class Reward:
    """The reward of a step (paper section 4.2)."""

    goal: float = 10.0
    """The agent stopped at the goal."""
    step: float = -0.01
    """Every other step."""
    collision: float = -0.1
    """A blocked move, instead of ``step``."""


class NavigationEnv(EnvBase):
    """A batch of agents that walk to goals; a transition is one look-up in the world's graph.

    A reset draws a goal uniformly among the world's and a start uniformly among the other states that reach it. An
    episode ends (``terminated``) where ``stop`` says so, by default exactly at the goal. It has no step limit of its
    own: add TorchRL's ``StepCounter``, which truncates. With B agents, an observation holds

    - ``state``, ``goal``: states of the world, int64 ``[B]``;
    - ``scene``: the scene they are in, int64 ``[B]``;
    - ``look``, ``goal_look``, only in a world that changes: which of its looks the state has at this visit, sampled
      anew at every step, and the goal in this episode, int64 ``[B]``.

    The action is 0 ahead, 1 turn right, 2 turn left, 3 back, int64 ``[B]``; reward and done flags are ``[B, 1]``.

    Args:
        world: the scenes and goals; the environment runs on its device.
        num_agents: how many agents, B; or the shape of their batch, ``(R, B)`` for those of R runs.
        slip: the probability that an action has no effect.
        reward: of a step.
        stop: where an agent stops on its way to each goal, bool ``[P]``, see
            `dirl.perception.recognition.recogniser.TemplateStop`. A stop anywhere but at the goal ends the episode with
            the reward of an ordinary step.
        seed: of the generator that draws goals and starts. The policy draws the actions.
    """

    def __init__(
        self,
        world: World,
        num_agents: int | tuple[int, ...] = 1,
        *,
        slip: float = 0.0,
        reward: Reward | None = None,
        stop: Tensor | None = None,
        seed: int = 0,
    ) -> None:
        # It cannot happen. Allowing it avoids a check at every reset, which on a GPU is a host-device synchronisation.
        batch = (num_agents,) if isinstance(num_agents, int) else num_agents
        super().__init__(device=world.device, batch_size=batch, allow_done_after_reset=True)
        self.world = world
        self.reward, self.slip = reward or Reward(), slip
        if not 0 <= slip < 1:
            raise ValueError(f"slip={slip}: is a probability below 1")
        states, agents = len(world), self.batch_size
        self._look_keys = ("look", "goal_look") if world.looks > 1 else ()  # in one look nothing is sampled
        self.stop = (world.distances == 0 if stop is None else stop).to(self.device)
        self.goal_index = world.goal_index
        # The starts of a goal are consecutive, from `first_start` on.
        goal_index, state = world.pairs()
        reaches = world.distances > 0
        self.starts = state[reaches]
        self.start_count = torch.bincount(goal_index[reaches], minlength=len(world.goals))
        self.first_start = self.start_count.cumsum(0) - self.start_count
        self.generator = torch.Generator(self.device)
        self.generators = [self.generator]
        """One that all agents' goals and starts are drawn from, or one for each run."""
        sizes = {"state": states, "goal": states, "scene": len(world.scenes)} | dict.fromkeys(
            self._look_keys, world.looks
        )
        observed = {key: Categorical(size, shape=agents, device=self.device) for key, size in sizes.items()}
        self.observation_spec = Composite(observed, shape=agents, device=self.device)
        self.action_spec = Categorical(len(ACTIONS), shape=agents, device=self.device)
        self.reward_spec = Unbounded(shape=(*agents, 1), device=self.device)
        flag = Categorical(2, shape=(*agents, 1), device=self.device, dtype=torch.bool)
        self.full_done_spec = Composite(done=flag, terminated=flag.clone(), shape=agents, device=self.device)
        self.set_seed(seed)

    def _set_seed(self, seed: int | None) -> None:
        if seed is not None:
            self.generator.manual_seed(seed)

    def _any_look(self) -> Tensor:
        return torch.randint(self.world.looks, self.batch_size, generator=self.generator, device=self.device)

    def _reset(self, tensordict: TensorDictBase | None = None, **_: object) -> TensorDictBase:
        # Two numbers from 0 to 1 for each agent, [2, *batch].
        runs, *agents = self.batch_size
        each = (2, runs // len(self.generators), *agents)
        draw = torch.cat([torch.rand(each, generator=own, device=self.device) for own in self.generators], 1)
        goal = (draw[0] * len(self.world.goals)).long()
        start = (draw[1] * self.start_count[goal]).long()
        state = self.starts[self.first_start[goal] + start]
        done = torch.zeros((*self.batch_size, 1), dtype=torch.bool, device=self.device)
        return TensorDict(
            {
                "state": state,
                "goal": self.world.goals[goal],
                "scene": self.world.scene_of[state],
                **{key: self._any_look() for key in self._look_keys},
                "done": done,
                "terminated": done.clone(),
            },
            batch_size=self.batch_size,
            device=self.device,
        )

    def _move(self, tensordict: TensorDictBase) -> dict[str, Tensor]:
        """Return where the agents are after their actions, and which looks they see there."""
        state = tensordict["state"]
        after = self.world.graph[state, tensordict["action"]]
        if self.slip:
            after = torch.where(self._slipped(), state, after)
        looks = {"look": self._any_look(), "goal_look": tensordict["goal_look"]} if self.world.looks > 1 else {}
        return {"state": after, **looks}

    def _slipped(self) -> Tensor:
        return torch.rand(self.batch_size, generator=self.generator, device=self.device) < self.slip

    def restore_agents(self, agents: TensorDictBase) -> TensorDictBase:
        """Return the agents of a checkpoint, ``[B]``, as the environment goes on with them."""
        return agents

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        state, goal = tensordict["state"], tensordict["goal"]
        after = self._move(tensordict)
        next_state = after["state"]
        stopped = self.stop[self.world.pair(self.goal_index[goal], next_state)]
        reward = torch.where(next_state == state, self.reward.collision, self.reward.step)
        reward = torch.where(stopped & (next_state == goal), self.reward.goal, reward)
        done = stopped.unsqueeze(-1)
        return TensorDict(
            {
                **after,
                "goal": goal,
                "scene": tensordict["scene"],
                "reward": reward.unsqueeze(-1),
                "done": done,
                "terminated": done.clone(),
            },
            batch_size=self.batch_size,
            device=self.device,
        )
