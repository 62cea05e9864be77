"""An episodic memory that plans: the agent returns to the best exit that it has not tried yet."""

import math
from dataclasses import dataclass
from typing import Annotated, Self

import torch
import torch.nn.functional as F
from annotated_types import Interval
from torch import Tensor, nn

from dirl.envs.transforms import VIEWS
from dirl.scenes import ACTIONS
from dirl.scenes.graph import AHEAD, BACK, LEFT, RIGHT

SURE = 10.0
"""Cost of an action on the way to a goal that was seen, in nats: one action more is not worth considering."""

LAST = 1e4
"""Added to what is only tried where nothing else is left; more than any path costs."""

OPPOSITE = (3, 2, 1, 0)
"""Of ahead, right, left and back the action that undoes it."""


@dataclass
class Nodes:
    """What B agents know of N nodes, each a place and a heading there."""

    cost: Tensor
    """Of each action at each node, float32 ``[B, N, 4]``; infinite at unused places."""
    after: Tensor
    """The node that an action leads to, int64 ``[B, N, 4]``; -1 where that is not known."""

    @property
    def used(self) -> Tensor:
        """Nodes where an agent was, or which it faced from there, bool ``[B, N]``."""
        return self.cost.isfinite().any(-1)

    def select(self, chosen: Tensor) -> Self:
        """Return some of the agents, by mask or index."""
        return type(self)(*(value[chosen] for value in vars(self).values()))


@dataclass
class PlanState(Nodes):
    """What B agents have seen and done in their present episodes; made by `PlanningMemory.begin`.

    A node is a place and a heading, that of one of the K views there, clockwise from the first:
    ``K * place + heading``. K is four, or in a panorama the number of turns in a full circle. Each step makes a place,
    which stays unused where the agent recognises an earlier one.
    """

    ring: Tensor
    """The next node that was seen to the right and to the left of each at its place, in the form of ``after``."""
    taken: Tensor
    """Whether an agent took an action at a node, so that ``after`` is no guess, bool ``[B, N, 4]``."""
    goal: Tensor
    """Whether a node looks like the goal and the agent has not stood there, bool ``[B, N]``."""
    here: Tensor
    """The present node, int64 ``[B]``; -1 at the start."""
    action: Tensor
    """The last action, int64 ``[B]``; -1 at the start."""
    next_view: Tensor
    """Whether a turn leads to the next of the K views, bool ``[B]``: with four of them, a turn of 90 degrees."""


class PlanningMemory(nn.Module):
    """Replaces the policy's logits by those of a plan over the places of this episode.

    An action costs what the policy thinks of it, ``-log p``; one whose outcome is known costs ``repeated`` more, a turn
    ``turn`` more. The new logit of an action is minus the cost of the cheapest path that begins with it and ends with
    an action not tried yet. A goal that was seen, facing another way, is walked to on the shortest known path.

    So a policy that leads to new places decides as before. One that would return to where it was takes the most
    promising exit of all places instead, over the known path.

    At each place the policy is asked for all four headings, as the four views around the agent are those around it
    after a turn too. That a turn of 90 degrees leads from one to the next is assumed, and corrected where it does not.
    A smaller turn leads to four other views, which lie between them: where one has led, so do turns from the other
    three. In a panorama the views of all headings are seen at once, and each turn leads to the next. Moves count in
    both directions.

    It is used in evaluation, in the viewer and in a `dirl.Navigator`, but not in training. The policy must depend on
    the present state alone.

    Args:
        repeated: cost of a move whose outcome is known, in nats.
        turn: cost of a turn.
        threshold: two observations above this correlation are of the same place and heading.
    """

    def __init__(
        self,
        repeated: Annotated[float, Interval(ge=0, le=1000)] = 2.0,
        turn: Annotated[float, Interval(ge=0.001, le=1000)] = 0.1,
        threshold: Annotated[float, Interval(ge=-1, le=1)] = 0.95,
    ) -> None:
        super().__init__()
        self.repeated, self.turn, self.threshold = repeated, turn, threshold

    def begin(self, turns: Tensor, views: int = VIEWS) -> PlanState:
        """Return what agents know at the start of their episodes.

        Args:
            turns: in a full circle, int64 ``[B]``.
            views: that are seen around an agent, K: four, or in a panorama as many as all agents have turns.
        """
        agents, device = len(turns), turns.device
        nowhere = torch.full((agents,), -1, device=device)
        return PlanState(
            cost=torch.empty((agents, 0, len(ACTIONS)), device=device),
            after=torch.empty((agents, 0, len(ACTIONS)), dtype=torch.int64, device=device),
            ring=torch.empty((agents, 0, len(ACTIONS)), dtype=torch.int64, device=device),
            taken=torch.empty((agents, 0, len(ACTIONS)), dtype=torch.bool, device=device),
            goal=torch.empty((agents, 0), dtype=torch.bool, device=device),
            here=nowhere,
            action=nowhere,
            next_view=turns == views,
        )

    def arrive(self, before: PlanState, same: Tensor, cost: Tensor, goal: Tensor) -> PlanState:
        """Add where the agents are now, and what their last action led to.

        Args:
            before: the state so far, N nodes.
            same: whether each used node looks like where the agent is, bool ``[B, N]``.
            cost: of trying each action facing each of the K views around the agent, float32 ``[B, K, 4]``; those of
                agents at known nodes are not used.
            goal: whether it looks like the goal facing there, bool ``[B, K]``.
        """
        agents, nodes = same.shape
        device, views = same.device, cost.shape[1]
        known = same.any(1)
        new = nodes + torch.arange(views, device=device)
        here = torch.where(known, same.int().argmax(1) if nodes else nodes, nodes)
        cost = torch.where(known[:, None, None], math.inf, cost)
        ring = torch.full((agents, views, len(ACTIONS)), -1, device=device)
        ring[:, :, RIGHT], ring[:, :, LEFT] = new.roll(-1), new.roll(1)
        after = torch.where(before.next_view[:, None, None], ring, -1)
        at = torch.arange(agents, device=device)
        state = PlanState(
            cost=torch.cat([before.cost, cost], 1),
            after=torch.cat([before.after, after], 1),
            ring=torch.cat([before.ring, ring], 1),
            taken=torch.cat([before.taken, torch.zeros_like(ring, dtype=torch.bool)], 1),
            goal=torch.cat([before.goal, goal & ~known[:, None]], 1),
            here=here,
            action=before.action,
            next_view=before.next_view,
        )
        state.goal[at, here] = False  # the agent would have stopped
        if nodes:
            connect(state.after, before.here, before.action, here, views, state.taken, state.cost.isfinite())
            _connect_turns(state, before.here)
        return state

    def plan(self, state: PlanState, *, steps: bool = False) -> Tensor:
        """Return the logits of the actions where the agents are, float32 ``[B, 4]``; the policy's where all was tried.

        Costs are in nats, or with ``steps`` in actions, so that one whose outcome is known costs 1.
        """
        seen = state.goal.any(1)[:, None, None]
        # To a goal that was seen there is a path: at its place the agent turns until it faces it.
        after = torch.where(seen & (state.after < 0), state.ring, state.after)
        known = after >= 0
        again = again_costs(state.cost, self.repeated, self.turn, steps=steps)
        step = torch.where(known, torch.where(seen, SURE, again), state.cost + LAST * seen)
        # Where a move leads that was not taken is a guess: a passage of one way, or a place taken for another.
        moves = [AHEAD, BACK]
        guessed = torch.where(known & ~state.taken, state.cost + LAST, math.inf)[..., moves]
        nowhere = torch.full_like(after[..., moves], -1)
        costs = cheapest(torch.cat([step, guessed], -1), torch.cat([after, nowhere], -1), state.goal, state.here)
        costs, retried = costs[:, : len(ACTIONS)].clone(), costs[:, len(ACTIONS) :]
        costs[:, moves] = torch.minimum(costs[:, moves], retried)
        at = torch.arange(len(state.here), device=state.here.device)
        return -torch.where(costs.isinf().all(-1, keepdim=True), state.cost[at, state.here], costs)


def again_costs(cost: Tensor, repeated: float, turn: float, *, steps: bool) -> Tensor:
    """Return what actions cost whose outcome is known, of those of trying them, float32 ``[B, N, 4]``; see `plan`."""
    if steps:
        return torch.ones_like(cost)
    return cost + torch.tensor([repeated, turn, turn, repeated], device=cost.device)


def cheapest(step: Tensor, after: Tensor, goal: Tensor, here: Tensor) -> Tensor:
    """Return the cost of the cheapest path that begins with each action and ends at a goal or an unknown outcome.

    Args:
        step: cost of each of A actions at each node, float32 ``[B, N, A]``.
        after: the node that it leads to, int64 ``[B, N, A]``; -1 where that is not known.
        goal: nodes that are goals, bool ``[B, N]``.
        here: where the agents are, int64 ``[B]``.

    Returns:
        float32 ``[B, A]``; infinite where there is no such path.
    """
    # By action first, which is five times as fast; an unknown outcome is a node of value zero behind the others.
    nodes = after.shape[1]
    step, target = (table.movedim(-1, 0).contiguous() for table in (step, torch.where(after < 0, nodes, after)))
    value = F.pad(torch.where(goal, 0.0, math.inf), (0, 1))
    for _ in range(nodes + 1):  # a cheapest path passes each node once; costs that are no numbers never settle
        ways = torch.stack([value.gather(1, node) for node in target]).add_(step)
        better = torch.where(goal, 0.0, ways.amin(0))
        if torch.equal(better, value[:, :-1]):
            break
        value[:, :-1] = better
    return ways[:, torch.arange(len(here), device=here.device), here].T


def connect(
    after: Tensor,
    before: Tensor,
    action: Tensor,
    here: Tensor,
    views: int = VIEWS,
    taken: Tensor | None = None,
    possible: Tensor | None = None,
) -> None:
    """Note in ``after`` what an action led to, and what is guessed from it for the opposite headings and actions.

    Args:
        after: see `Nodes`; changed in place, as ``taken`` is.
        before: nodes where agents were, int64 ``[B]``.
        action: what they did there, int64 ``[B]``.
        here: nodes where they are now, int64 ``[B]``.
        views: at each place.
        taken: see `PlanState`; what was done is not overwritten by a guess. None = it is.
        possible: actions of which something is guessed, bool ``[B, N, 4]``; None = all.
    """
    at, opposite = torch.arange(len(here), device=here.device), torch.tensor(OPPOSITE, device=here.device)[action]
    moved, turned = here != before, (action == RIGHT) | (action == LEFT)
    # Ahead is back for who faces the other way.
    beyond, behind = (_turned(node, views // 2, views) for node in (before, here))
    guesses = [
        (moved, here, opposite, before),
        (~turned, beyond, opposite, behind),
        (moved & ~turned, behind, action, beyond),
    ]
    after[at, before, action] = here
    if taken is not None:
        taken[at, before, action] = True
    for chosen, node, done, outcome in guesses:
        if taken is not None:
            chosen = chosen & ~taken[at, node, done]
        if possible is not None:
            chosen = chosen & possible[at, node, done]
        after[at[chosen], node[chosen], done[chosen]] = outcome[chosen]


def _connect_turns(state: PlanState, before: Tensor) -> None:
    """Note what a turn by less than 90 degrees, from nodes int64 ``[B]``, means for the other three views there."""
    turned = ((state.action == RIGHT) | (state.action == LEFT)) & (state.here != before) & ~state.next_view
    at = torch.nonzero(turned)[:, 0]
    action, new = state.action[at], state.here[at] >= state.ring.shape[1] - VIEWS
    opposite = torch.tensor(OPPOSITE, device=at.device)[action]
    for right in range(VIEWS):
        start, end = _turned(before[at], right), _turned(state.here[at], right)
        state.after[at, start, action], state.after[at, end, opposite] = end, start
        beyond = state.ring[at, start, action]  # what was seen now lies between
        state.ring[at[new], end[new], action[new]] = beyond[new]
        state.ring[at[new], beyond[new], opposite[new]] = end[new]
        state.ring[at, start, action], state.ring[at, end, opposite] = end, start


def _turned(node: Tensor, right: int, views: int = VIEWS) -> Tensor:
    """Return the node of the same place that faces the view so many views to the right."""
    return node - node % views + (node + right) % views
