"""Pictures of a trained policy, from the parts of its run."""

from pathlib import Path

import torch

from dirl.evaluation import action_values
from dirl.reporting import draw_policy, draw_trajectories, run_title, write_gif
from dirl.scenes.matching import TemplateStop
from dirl.training.build import Parts, describe, run_trajectories


def draw_scene(parts: Parts, index: int, folder: Path, count: int = 5) -> None:
    """Pictures of a scene's first goal: greedy episodes, that of the farthest start as a GIF; maps of the policy."""
    world, scene = parts.world, parts.world.scenes[index]
    goal_index = world.goals_in(index)[0]
    distances = world.distances[goal_index]
    order = torch.argsort(distances, descending=True, stable=True)[: int((distances > 0).sum())]
    starts = order[torch.linspace(0, 0.9 * (len(order) - 1), min(count, len(order))).long()]
    episodes, paths = run_trajectories(parts, (torch.full_like(starts, goal_index), starts))
    goal = int(world.goals[goal_index]) - world.offsets[index]
    facts = describe(parts) | {"scene": scene.name, "source": scene.source}
    title = f"{run_title(facts)}, goal {goal}"
    walked = [[state - world.offsets[index] for state in path] for path in paths]
    success = episodes.success.tolist()
    draw_trajectories(scene, goal, walked, folder / f"trajectories_{scene.name}.png", success=success, title=title)
    write_gif(scene, goal, walked[0], folder / f"episode_{scene.name}.gif", title=title, success=success[0])
    matching = TemplateStop(parts.config.stop.threshold, parts.config.stop.match)
    probabilities, value = action_values(parts.network, world, parts.sight, goal_index)
    scores = matching.scores(world)[goal_index, world.scene_of == index]
    draw_policy(
        scene,
        goal,
        probabilities.cpu(),
        value.cpu(),
        scores.cpu(),
        folder / f"maps_{scene.name}.png",
        title=title,
        threshold=matching.threshold,
    )
