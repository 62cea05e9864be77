"""A world: several scenes as one state space, in tensors, with the goals to be reached in it."""

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from dirl.scenes.graph import RIGHT, shortest_distances, turns_per_circle
from dirl.scenes.scene import Scene, SceneError


@dataclass(frozen=True, eq=False)
class World:
    """Scenes laid one behind the other: a state of the world is its number in the scene plus the scene's offset.

    Made by `make_world`. N states in L looks each, S scenes, G goals, D feature width; all tensors on one device.
    """

    scenes: tuple[Scene, ...]
    names: tuple[str, ...]
    """Those of the scenes."""
    offsets: tuple[int, ...]
    """The first state of each scene."""
    looks: int
    """How many looks each state has, L; one if the world never changes."""
    graph: Tensor
    """Next state, int64 ``[N, 4]``; a blocked move leads back to the state itself."""
    surrounding: Tensor
    """The states ahead, right, back and left of each state, int64 ``[N, 4]``."""
    features: Tensor
    """The frozen backbone's output, float32 ``[L * N, D]``: that of look l of a state is row ``l * N + state``."""
    patches: Tensor | None
    """What each part of each view shows, float16 ``[L * N, cells, channels]``; None if a scene has none."""
    along: Tensor | None
    """What is seen along the arrow ahead of each state, float32 ``[N, D]``; None if a scene does not say."""
    toward: Tensor | None
    """How clearly that arrow leads to the goal, by its four views or the one ahead, float16 ``[2, P]``, see
    ``distances``; None if a scene does not say."""
    scene_of: Tensor
    """The scene of each state, int64 ``[N]``."""
    turns: Tensor
    """The right turns in a full circle of each scene, int64 ``[S]``: 4 if a turn is 90 degrees, 12 if it is 30."""
    goals: Tensor
    """The goal states, scene by scene, int64 ``[G]``."""
    goals_of: tuple[range, ...]
    """The places in ``goals`` of those of each scene."""
    goal_index: Tensor
    """The place in ``goals`` of each state, int64 ``[N]``; -1 where it is none."""
    distances: Tensor
    """Fewest actions for each pair of a goal and a state of its scene, int16 ``[P]``; -1 where it cannot be reached.

    A block a scene, goal by goal: P is the sum over the scenes of goals x states, so that memory is linear in scenes.
    """
    row: Tensor
    """Of each goal, int64 ``[G]``: its pair with a state is ``row[goal_index] + state``, see `pair`."""

    def __len__(self) -> int:
        """Return the number of states."""
        return len(self.graph)

    def pictures(self, scene: int) -> Tensor:
        """Return the view ids of one scene, look by look, int64 ``[L * n]``."""
        states = torch.arange(len(self.scenes[scene]), device=self.device) + self.offsets[scene]
        return torch.cat([states + look * len(self) for look in range(self.looks)])

    @property
    def device(self) -> torch.device:
        """Where the tensors are."""
        return self.graph.device

    @property
    def possible(self) -> Tensor:
        """Which actions are possible in each state, as the arrows of a tour show, bool ``[N, 4]``."""
        return self.graph != torch.arange(len(self), device=self.device)[:, None]

    def panoramas(self) -> Tensor:
        """Return the states of all headings of each place, clockwise from each state, int64 ``[N, K]``.

        Raises:
            SceneError: scenes whose turns differ.
        """
        counts = self.turns.unique().tolist()
        if len(counts) > 1:
            raise SceneError(f"panoramas of {counts} views: scenes have turns of several angles; take them apart")
        views = [torch.arange(len(self), device=self.device)]
        for _ in range(counts[0] - 1):
            views.append(self.graph[views[-1], RIGHT])
        return torch.stack(views, 1)

    def pair(self, goal_index: Tensor, state: Tensor) -> Tensor:
        """Return the place of pairs in ``distances`` and every other table of pairs, int64 ``[...]``.

        Args:
            goal_index: goals by their place in ``goals``, int64 ``[...]``.
            state: states of the goals' scenes, int64 ``[...]``; this is not checked.
        """
        return self.row[goal_index] + state

    def distance(self, goal_index: Tensor, state: Tensor) -> Tensor:
        """Return the fewest actions from states of the goals' scenes, int64 ``[...]``; -1 where no path leads there."""
        return self.distances[self.pair(goal_index, state)].long()

    def pairs(self) -> tuple[Tensor, Tensor]:
        """Return goal index and state of every pair, int64 ``[P]`` each, in the order of ``distances``."""
        sizes = torch.tensor([len(scene) for scene in self.scenes], device=self.device)
        of_goal = sizes[self.scene_of[self.goals]]
        goal_index = torch.repeat_interleave(torch.arange(len(self.goals), device=self.device), of_goal)
        return goal_index, torch.arange(len(goal_index), device=self.device) - self.row[goal_index]

    def block(self, table: Tensor, goal_index: int) -> Tensor:
        """Return the rows of a table of pairs ``[P, ...]`` for one goal, in the order of its scene's states."""
        scene = int(self.scene_of[self.goals[goal_index]])
        first = int(self.row[goal_index]) + self.offsets[scene]
        return table[first : first + len(self.scenes[scene])]

    def local_goals(self, scene: int) -> Tensor:
        """Return the goals of one scene, given by its place in ``scenes``, as its own states, int64 ``[g]``."""
        return self.goals[self.goals_of[scene].start : self.goals_of[scene].stop] - self.offsets[scene]

    def with_goals(self, goals: "Goals") -> "World":
        """Return the same scenes with other goals, see `make_world`; what does not depend on goals is shared."""
        return replace(self, **_goal_tables(self.scenes, self.offsets, goals)).to(self.device)

    def to(self, device: torch.device | str) -> "World":
        """Return the same world with its tensors on a device."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        moved = {name: value.to(device) for name, value in values.items() if isinstance(value, Tensor)}
        return World(**{**values, **moved})


Goals = int | Sequence[int] | Mapping[str, int | Sequence[int]] | None
"""Goal states of one scene, or of several by name."""


def make_world(scenes: Sequence[Scene], goals: Goals = None) -> World:
    """Join scenes.

    Args:
        scenes: at least one; distinct names, features of one extractor and width.
        goals: the goals of one scene, or of several by name, as states of the scene; the scenes' own if left out.

    Raises:
        SceneError: incompatible scenes, a scene without features or goals, or an invalid goal.
    """
    if not scenes:
        raise SceneError("a world needs at least one scene")
    names = [scene.name for scene in scenes]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise SceneError(f"the scene '{twice[0]}' is named twice")
    first = scenes[0]
    for scene in scenes:
        if scene.features is None:
            raise SceneError(f"{scene.origin}: has no features (dataset resnet_feature); encode its views first")
        assert first.features is not None
        if scene.extractor != first.extractor or scene.features.shape[1] != first.features.shape[1]:
            raise SceneError(
                f"{scene.name} and {first.name} have features of different extractors, which cannot be mixed: "
                f"'{scene.extractor}' ({scene.features.shape[1]} wide) and "
                f"'{first.extractor}' ({first.features.shape[1]} wide)"
            )
    counts = sorted({scene.looks for scene in scenes})
    if len(counts) > 1 and counts[:-1] != [1]:
        raise SceneError(f"the scenes have different numbers of looks, {counts}; make them with one or as many")
    looks = counts[-1]  # a scene of one look shows it at every visit
    sizes = [len(scene) for scene in scenes]
    offsets = tuple(int(offset) for offset in np.cumsum([0, *sizes[:-1]]))
    of_goals = _goal_tables(scenes, offsets, goals)
    parts = list(zip(scenes, offsets, strict=True))
    graphs = [np.where(s.graph < 0, np.arange(len(s))[:, None], s.graph) + offset for s, offset in parts]
    features = np.concatenate(_look_by_look(scenes, "features", looks), dtype=np.float32)
    shared = []
    for scene, offset in parts:
        # In place of its own features a scene gets its part of the world's: those of 1,000 rooms take a gigabyte.
        own = features[offset : offset + len(scene)]
        own.setflags(write=False)
        shared.append(copy.copy(scene))
        object.__setattr__(shared[-1], "features", own)  # of the same values, so that nothing is to be checked again
    along = [scene.along for scene in scenes if scene.along is not None]
    patches = [scene.patches for scene in scenes if scene.patches is not None]
    shapes = sorted({each.shape[1:] for each in patches})
    if len(patches) == len(scenes) and len(shapes) > 1:
        raise SceneError(f"the scenes' patches have different shapes, {shapes}; encode them alike")
    all_patches = _look_by_look(scenes, "patches", looks) if len(patches) == len(scenes) else None
    return World(
        scenes=tuple(shared),
        names=tuple(names),
        offsets=offsets,
        looks=looks,
        graph=torch.from_numpy(np.concatenate(graphs)),
        surrounding=torch.from_numpy(np.concatenate([s.surrounding + offset for s, offset in parts])),
        features=torch.from_numpy(features),
        patches=None if all_patches is None else torch.from_numpy(np.concatenate(all_patches)),
        along=torch.from_numpy(np.concatenate(along, dtype=np.float32)) if len(along) == len(scenes) else None,
        scene_of=torch.repeat_interleave(torch.arange(len(scenes)), torch.tensor(sizes)),
        turns=torch.tensor([turns_per_circle(scene.graph) for scene in scenes]),
        **of_goals,
    )


def _look_by_look(scenes: Sequence[Scene], name: str, looks: int) -> list[NDArray[np.floating]]:
    """Return the features or patches of all scenes in their first look, then in the next one, and so on."""
    return [
        getattr(scene, name) if look == 0 or scene.looks == 1 else getattr(scene, f"look_{name}")[look - 1]
        for look in range(looks)
        for scene in scenes
    ]


def _goal_tables(scenes: Sequence[Scene], offsets: Sequence[int], goals: Goals) -> dict[str, Any]:
    """Return the fields of a world that depend on its goals, by name; see `make_world`."""
    names = [scene.name for scene in scenes]
    if goals is not None and not isinstance(goals, Mapping):
        if len(scenes) > 1:
            raise SceneError(f"goals of several scenes are given by name, e.g. {{{names[0]}: [0, 4]}}, not {goals!r}")
        goals = {names[0]: goals}
    unknown = sorted(set(goals or {}) - set(names))
    if unknown:
        raise SceneError(f"goals are given for '{unknown[0]}', which is not among the scenes {names}")
    chosen, goals_of, blocks, toward, rows, pairs = list[int](), list[range](), [], [], [], 0
    for scene, offset in zip(scenes, offsets, strict=True):
        given = (goals or {}).get(scene.name, scene.goals)
        states = list(given) if isinstance(given, Sequence) and not isinstance(given, str) else [given]
        if not states:
            raise SceneError(f"{scene.origin}: names no goals; choose some, e.g. goals=[0,{len(scene) // 2}]")
        scene.check_goals(states)
        if len(set(states)) < len(states):
            raise SceneError(f"{scene.name}: a goal is named twice in {states}")
        if scene.toward is not None:
            toward.append(scene.toward[:, :, states].swapaxes(1, 2).reshape(2, -1))
        goals_of.append(range(len(chosen), len(chosen) + len(states)))
        chosen += [goal + offset for goal in states]
        blocks.append(shortest_distances(scene.graph, np.array(states)).T.astype(np.int16).ravel())
        rows += [pairs + place * len(scene) - offset for place in range(len(states))]
        pairs += len(states) * len(scene)
    goal_index = torch.full((sum(map(len, scenes)),), -1)
    goal_index[chosen] = torch.arange(len(chosen))
    return {
        "goals": torch.tensor(chosen),
        "goals_of": tuple(goals_of),
        "goal_index": goal_index,
        "distances": torch.from_numpy(np.concatenate(blocks)),
        "toward": torch.from_numpy(np.concatenate(toward, 1)) if len(toward) == len(scenes) else None,
        "row": torch.tensor(rows),
    }
