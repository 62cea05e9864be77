"""Navigation by a topological map as a policy that is evaluated like any other: match, plan, go; nothing is learned."""

from collections.abc import Callable
from typing import Annotated, Any, ClassVar

import torch
from annotated_types import Ge, Interval
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from dirl.agent.mapping.image_graph import ImageGraph, MapError
from dirl.agent.mapping.places import ParticleMapper
from dirl.perception.recognition.recogniser import NCC, described_visits
from dirl.scenes import ACTIONS
from dirl.scenes.graph import IntArray, turns_per_circle
from dirl.scenes.world import World

NO_GOAL = -(2**60)
"""In a table of goals: a state that is none."""

CERTAIN = 30.0
"""The logit of the planned action, of others 0: sampled actions are the planned ones too."""

LAST_STEPS = 3
"""Within so many steps of the goal a policy that a map leads decides by itself."""

NO_WAY = 2**30
"""More steps than any path has."""


class GraphGuide:
    """The path to one goal by a topological map, step by step; errors of the map are corrected on the way.

    Args:
        graph: the map; where the agent is in it is forgotten.
        goal_views: the goal's four views, described, float32 ``[4, F]``, or one photo, ``[1, F]``.
        last_steps: within so many steps of the goal it gives no advice.

    Raises:
        MapError: the map is empty or does not fit the features.
    """

    def __init__(self, graph: ImageGraph, goal_views: Tensor, last_steps: int) -> None:
        if not len(graph):
            raise MapError("the map is empty; walk before it is used, see Navigator.explore")
        width = graph.views.shape[-1]
        if width != goal_views.shape[-1]:
            raise MapError(f"the map has {width} features a view, the navigator {goal_views.shape[-1]}")
        graph.lose()
        scores = graph.scores(goal_views)
        self.graph, self.last_steps = graph, last_steps
        self.goal = int(scores.argmax())
        """The node that looks most like the goal."""
        self.match = float(scores[self.goal])
        """How much it does, -1 to 1; a goal far from all that was seen has a low one."""
        self.goals = (scores >= self.match - graph.margin / 2).nonzero().flatten().tolist()
        """All nodes that look like it nearly as much: in disturbed views the same place may be several nodes."""
        self.action: int | None = None
        self._planned: tuple[int, Tensor] = (-1, torch.empty(0))

    def advise(self, views: Tensor) -> int | None:
        """Return the map's next action for what is seen now, float32 ``[4, F]``; None where the policy shall decide."""
        node = self.graph.follow(views, self.action)
        if node is None:
            return None
        if self._planned[0] != self.graph.changes:
            far = self.graph.plan(self.goals)
            nearest = torch.where(far < 0, NO_WAY, far).min(1).values
            self._planned = self.graph.changes, torch.where(nearest == NO_WAY, -1, nearest)
        distances = self._planned[1]
        if distances[node] <= self.last_steps:  # -1 where no path is known
            return None
        return self.graph.next_action(node, distances)


class GraphMemory(TensorDictModuleBase):
    """Walks once through each scene of its world, and then goes to any of the world's goals by the map of that walk.

    It matches what it sees and what the goal looks like with the nodes of the map, and takes the first action of a
    shortest path; where the map knows no path, all actions are equally probable. Reads ``view_ids`` and
    ``goal_view_ids``, int64 ``[B, 4]``, and writes ``logits``, float32 ``[B, 4]``.

    Args:
        world: where; the walker learns of it only what it sees and does.
        steps_per_state: length of the walk, in steps for each state of a scene.
        threshold: above this score two observations are of the same place and heading.
        seed: of the states where the walks begin.
        recogniser: by which they are; correlation if left out. One with log odds has a threshold of its own.
    """

    in_keys: ClassVar = ["view_ids", "goal_view_ids"]
    out_keys: ClassVar = ["logits"]

    def __init__(
        self,
        world: World,
        steps_per_state: Annotated[float, Interval(ge=0, le=100)] = 2.0,
        threshold: Annotated[float, Interval(ge=-1, le=1)] = 0.9,
        seed: Annotated[int, Ge(0)] = 0,
        recogniser: Any = None,
    ) -> None:
        super().__init__()
        recogniser = recogniser or NCC()
        least = None if recogniser.calibrated else threshold
        self.graphs: list[ImageGraph] = []
        generator = torch.Generator().manual_seed(seed)
        # The place of the pair of a goal and a state is row[goal] + state, as in `World.pair`; photos come behind.
        row, photo = torch.full((len(world),), NO_GOAL), torch.zeros(len(world), dtype=torch.int64)
        actions, distances, size = [], [], 0
        for index, (scene, offset) in enumerate(zip(world.scenes, world.offsets, strict=True)):
            count, goals = len(scene), world.local_goals(index).cpu()
            graph = ImageGraph(least, turns=turns_per_circle(scene.graph), recogniser=recogniser)
            visits = described_visits(recogniser, world, index)[:count].cpu()
            start = int(torch.randint(count, (1,), generator=generator))
            explore(graph, scene.graph, start, round(steps_per_state * count), visits.__getitem__)
            graph.lose()
            first, far = plan_table(graph, visits, goals)
            actions.append(first.flatten())
            distances.append(far.flatten())
            row[offset + goals] = size - offset + count * torch.arange(len(goals))
            photo[offset : offset + count] = count * len(goals)
            size += first.numel()
            self.graphs.append(graph)
        tables = {"actions": torch.cat(actions), "distances": torch.cat(distances), "row": row, "photo": photo}
        for name, table in tables.items():
            self.register_buffer(name, table.to(world.device))

    def planned(self, tensordict: TensorDictBase) -> tuple[Tensor, Tensor]:
        """Return the planned action, -1 without one, and the distance to the goal, -1 without a path; int64 ``[B]``."""
        state, goal_views = tensordict["view_ids"][..., 0], tensordict["goal_view_ids"]
        goal = goal_views[..., 0]
        is_photo = goal_views[..., 1] == len(self.row)  # the view id of what is not known
        is_goal = self.row[goal] != NO_GOAL
        pair = torch.where(is_goal, self.row[goal] + state + is_photo * self.photo[goal], 0)
        action, distance = (torch.where(is_goal, table[pair].long(), -1) for table in (self.actions, self.distances))
        return action, distance

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``logits``."""
        action, _ = self.planned(tensordict)
        chosen = torch.arange(len(ACTIONS), device=action.device) == action.unsqueeze(-1)
        return tensordict.set("logits", CERTAIN * chosen.float())


class GuidedPolicy(TensorDictModuleBase):
    """A policy that writes ``logits``, led by maps; it decides within ``last_steps`` of a goal, or where none leads."""

    out_keys: ClassVar = ["logits"]

    def __init__(self, policy: Any, memory: GraphMemory, last_steps: int = LAST_STEPS) -> None:
        super().__init__()
        self.policy, self.memory, self.last_steps = policy, memory, last_steps
        self.in_keys = [*policy.in_keys]
        self.cached = getattr(policy, "cached", None)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``logits``."""
        action, distance = self.memory.planned(tensordict)
        decided: TensorDictBase = self.policy(tensordict)
        chosen = torch.arange(len(ACTIONS), device=action.device) == action.unsqueeze(-1)
        led = ((action >= 0) & (distance > self.last_steps)).unsqueeze(-1)
        return decided.set("logits", torch.where(led, CERTAIN * chosen, decided["logits"]))


def explore(
    graph: ImageGraph | ParticleMapper, moves: IntArray, start: int, steps: int, look: Callable[[int], Tensor]
) -> list[int]:
    """Fill an empty map by a walk to what is still unknown; return the states passed.

    It ends early where nothing is left to be learned. The walker knows what it sees and does, never the graph of the
    scene or the numbers of states.

    Args:
        graph: the map.
        moves: the scene's graph, int64 ``[N, 4]``.
        start: the first state.
        steps: at most so many.
        look: what is seen ahead, right, back and left of a state, in the form that the map takes, ``[4, ...]``.
    """
    passed = [start]
    graph.see(look(start))
    for _ in range(steps):
        action = graph.frontier_action()
        if action is None:
            break
        after = int(moves[passed[-1], action])
        passed.append(passed[-1] if after < 0 else after)
        graph.see(look(passed[-1]), action)
    return passed


def plan_table(graph: ImageGraph, visits: Tensor, goals: Tensor) -> tuple[Tensor, Tensor]:
    """Return what to do in each of n states on the way to each of g goals, and how far the goals are.

    Args:
        graph: a map.
        visits: what is seen from each state, described, float32 ``[n, 4, F]``.
        goals: states, int64 ``[g]``.

    Returns:
        Actions, int8 ``[2, g, n]``, and distances in the map, int16 likewise; -1 where no path is known.
        First for goals of four views, then for goals of one photo, the view ahead.
    """
    here, moves = graph.scores(visits).argmax(1), torch.tensor(graph.moves)
    four, photo = graph.scores(visits[goals]), graph.scores(visits[goals, :1])
    actions = torch.empty((2, len(goals), len(visits)), dtype=torch.int8)
    distances = torch.empty(actions.shape, dtype=torch.int16)
    for kind, scores in enumerate((four, photo)):
        nodes, which = scores.argmax(1).unique(return_inverse=True)
        far = graph.plan(nodes.tolist())
        after = torch.where((moves >= 0).unsqueeze(-1), far[moves.clamp(min=0)], -1)  # [N, actions, G]
        nearer = (after >= 0) & (after < far.unsqueeze(1))
        first = torch.where(nearer.any(1), nearer.int().argmax(1), -1)  # none at the goal and without a path
        actions[kind] = first[here][:, which].T
        distances[kind] = far[here][:, which].T.to(torch.int16)
    return actions, distances
