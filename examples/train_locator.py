"""Train the network that tells where a goal lies, `dirl.models.policy.GoalLocator`, in rooms of your own.

    python recipes/scenes.py sample kind=all seed=330000 count=9 looks=2 encoder=efficientnet_lite0 patches=true out=r
    python examples/train_locator.py rooms=r out=located.pt
    python recipes/evaluate.py checkpoint=located.pt scene=bathroom_02

It learns from pairs of a visit and a goal of the same room, in looks that are sampled for each: which cell around the
agent holds the goal. It reads what the policy reads, by an encoder of its own that begins as the policy's. Policy and
recogniser stay as they are.
"""

from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from omegaconf import OmegaConf
from torch import Tensor
from tqdm import tqdm

from dirl.cli.start import new_file, run, start
from dirl.config.options import option
from dirl.config.schemas import Positive, Seed
from dirl.models.policy import GoalLocator
from dirl.runs.checkpoints import load_checkpoint, save_checkpoint
from dirl.scenes import World
from dirl.scenes.catalogue import collection_files
from dirl.training.build import load_trained

PHOTOS = 0.4
"""Share of the goals of which only the view ahead is shown."""

SPREAD = 0.6
"""Standard deviation of the target around the goal, in cells: to be off by one is no great error."""

RATE, DECAY = 1e-3, 0.05

REACH = 14
"""Moves ahead, behind and to either side within which the goal is located."""


@dataclass
class Options:
    """Train the network that tells where a goal lies."""

    rooms: str = option("a folder of rooms with features and patches, see scenes.py sample")
    out: str = option("the checkpoint to write (.pt): that of `general` with the new network")
    steps: Positive = option("of the optimiser", 2000)
    batch_size: Positive = option("pairs", 1024)
    seed: Seed = option("of weights and pairs", 0)


def main(rooms: str, out: str, steps: int, batch_size: int, seed: int) -> None:
    """Train, and write the checkpoint with weights as float16."""
    torch.manual_seed(seed)
    file = new_file(out, ending=".pt")
    saved = load_checkpoint("general")
    scenes = [str(path) for path in collection_files(Path(rooms), None)]
    changes = {"scene": scenes, "goals": None, "evaluation.starts": "sampled"}
    _, policy, protocol = load_trained(saved, "general", changes)
    world = protocol.world
    places = [(scene.positions / scene.step_length, scene.directions) for scene in world.scenes]
    stands = [torch.from_numpy(np.concatenate(parts)).float() for parts in zip(*places, strict=True)]
    locator = GoalLocator(deepcopy(policy.encoder), policy.heads.width, REACH)
    axis = torch.arange(-REACH, REACH + 1)
    spread = torch.softmax(-((axis[:, None] - axis).float() ** 2) / (2 * SPREAD**2), 1)
    optimiser = torch.optim.AdamW(locator.parameters(), RATE, weight_decay=DECAY)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, RATE, steps)
    bar = tqdm(range(steps), unit=" steps")
    for _ in bar:
        visit, goal, right, ahead = sample_pairs(world, *stands, batch_size)
        shown = policy.features(goal)
        shown[torch.rand(batch_size) < PHOTOS, 1:] = 0
        near = (torch.stack([right, ahead]).clamp(-REACH, REACH) + REACH).round().long()
        target = spread[near[1]][:, :, None] * spread[near[0]][:, None]
        loss = -(target * locator(policy.features(visit), shown)).sum((1, 2)).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
        bar.set_postfix(loss=f"{loss.item():.2f}")
    save_checkpoint(file, with_locator(saved, locator))


def sample_pairs(
    world: World, positions: Tensor, directions: Tensor, count: int
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return view ids of visits and goals, int64 ``[B, 4]`` each, and where the goals lie from there.

    The last two say how many moves to the right and ahead, float32 ``[B]`` each. Positions of N states are in moves,
    directions unit vectors, float32 ``[N, 2]``. All rooms count alike.
    """
    sizes = torch.tensor([len(scene) for scene in world.scenes])
    scene = torch.randint(len(sizes), (count,))
    first = torch.tensor(world.offsets[: len(sizes)])[scene]
    state, goal = (first + (torch.rand(count) * sizes[scene]).long() for _ in range(2))
    way = positions[goal] - positions[state]
    aside, faced = world.surrounding[state, 1], world.surrounding[state, 0]
    look, other = (len(world) * torch.randint(world.looks, (count, 1)) for _ in range(2))
    views = (world.surrounding[state] + look, world.surrounding[goal] + other)
    return *views, (way * directions[aside]).sum(1), (way * directions[faced]).sum(1)


def with_locator(saved: dict[str, Any], locator: GoalLocator) -> dict[str, Any]:
    """Return a checkpoint with the network, instead of the one that it had if any."""
    kept = {name: value for name, value in saved["network"].items() if not name.startswith("locator.")}
    weights = {f"locator.{name}": value.half() for name, value in locator.state_dict().items()}
    config = OmegaConf.create(saved["config"])
    config.policy.locates = REACH
    return {**saved, "network": {**kept, **weights}, "config": OmegaConf.to_yaml(config)}


if __name__ == "__main__":
    options = start(__doc__, Options)
    run(lambda: main(**vars(options)))
