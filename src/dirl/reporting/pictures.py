"""Pictures of a trained policy in one scene."""

from pathlib import Path

import torch
from torch import nn

from dirl.evaluation.protocol import EvaluationProtocol, action_values
from dirl.perception.recognition.matching import TemplateStop
from dirl.reporting.animation import write_gif
from dirl.reporting.maps import draw_policy
from dirl.reporting.tables import run_title
from dirl.reporting.trajectories import draw_trajectories
from dirl.runs.paths import Summary


def draw_scene(
    policy: nn.Module,
    protocol: EvaluationProtocol,
    index: int,
    folder: Path,
    *,
    matching: TemplateStop,
    facts: Summary,
    count: int = 5,
) -> None:
    """Draw a scene's first goal: greedy episodes, that of the farthest start as a GIF; maps of the policy.

    Args:
        policy: trained.
        protocol: how it is evaluated, and where.
        index: of the scene in the world.
        folder: for the files.
        matching: computes the map of matching scores.
        facts: of the run, see `dirl.training.build.describe`.
        count: number of episodes in the picture.
    """
    world, scene = protocol.world, protocol.world.scenes[index]
    goal_index = world.goals_in(index)[0]
    file = folder / f"trajectories_{scene.name}.png"
    goal, walked, success, title = draw_paths(policy, protocol, index, file, facts=facts, count=count)
    write_gif(scene, goal, walked, folder / f"episode_{scene.name}.gif", title=title, success=success)
    probabilities, value = action_values(policy, world, protocol.observation, goal_index)
    draw_policy(
        scene,
        goal,
        probabilities.cpu(),
        value.cpu(),
        world.block(matching.scores(world), goal_index).cpu(),
        folder / f"maps_{scene.name}.png",
        title=title,
        threshold=matching.threshold,
    )


def draw_paths(
    policy: nn.Module,
    protocol: EvaluationProtocol,
    index: int,
    file: Path,
    *,
    facts: Summary,
    count: int = 5,
) -> tuple[int, list[int], bool, str]:
    """Draw greedy episodes to a scene's first goal, as `draw_scene` does.

    Returns:
        The goal, the path from the farthest start, whether it succeeded, and a title.
    """
    world, scene = protocol.world, protocol.world.scenes[index]
    goal_index, offset = world.goals_in(index)[0], world.offsets[index]
    distances = world.block(world.distances, goal_index).long()
    order = torch.argsort(distances, descending=True, stable=True)[: int((distances > 0).sum())] + offset
    starts = order[torch.linspace(0, 0.9 * (len(order) - 1), min(count, len(order))).long()]
    episodes, paths = protocol.trajectories(policy, (torch.full_like(starts, goal_index), starts))
    goal = int(world.goals[goal_index]) - offset
    title = f"{run_title({**facts, 'scene': scene.name, 'source': scene.source})}, goal {goal}"
    walked = [[state - offset for state in path] for path in paths]
    success = episodes.success.tolist()
    draw_trajectories(scene, goal, walked, file, success=success, title=title)
    return goal, walked[0], success[0], title
