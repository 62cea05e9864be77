r"""Train the network that tells where a goal lies, `dirl.models.locator.GoalLocator`, in rooms of your own.

    python recipes/scenes.py sample kind=all seed=330080 count=9 looks=2 encoder=efficientnet_lite0 patches=true \
        fine_patches=true changes.position=0.1 changes.heading=10 changes.exposure=0.3 out=rooms
    python examples/train_locator.py rooms=rooms out=located.pt
    python recipes/evaluate.py checkpoint=located.pt scene=bathroom_02

It learns from pairs of a visit and a goal of the same room, in looks that are sampled for each: which cell around the
agent holds the goal. It reads what the policy reads, by an encoder of its own that begins as the policy's, and the fine
patches. Policy and recogniser stay as they are.
"""

from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from omegaconf import OmegaConf
from torch import Tensor
from tqdm import tqdm

from dirl.cli.start import new_file, run, start
from dirl.config.schemas import Positive, Seed, option
from dirl.models.features import FeatureTable
from dirl.models.locator import GoalLocator
from dirl.perception.backbones.patches import FINE, are_fine, coarse
from dirl.runs.checkpoints import load_checkpoint, save_checkpoint
from dirl.scenes import World
from dirl.scenes.catalogue import collection_files
from dirl.training.build import load_trained

PHOTOS, COARSE = 0.5, 0.15
"""Shares of batches with goals of which only the view ahead is shown, and without fine patches, which not every scene
has."""

NEAR = {3: 0.3, 1: 0.15}
"""Shares of goals at most three moves away and at most one, where agents decide whether to stop."""

RATE, FINE_RATE, DECAY = 6e-4, 1.5e-3, 0.05

REACH = 14
"""Moves ahead, behind and to either side within which the goal is located."""

MIRRORED = [0, 3, 2, 1]
"""Views ahead, left, back and right, as a mirror shows them."""


@dataclass
class Options:
    """Train the network that tells where a goal lies."""

    rooms: str = option("a folder of rooms with features and fine patches, see scenes.py sample")
    out: str = option("the checkpoint to write (.pt): that of `general` with the new network")
    steps: Positive = option("of the optimiser", 3000)
    batch_size: Positive = option("pairs", 384)
    seed: Seed = option("of weights and pairs", 0)


def main(rooms: str, out: str, steps: int, batch_size: int, seed: int) -> None:
    """Train, and write the checkpoint with weights as float16."""
    torch.manual_seed(seed)
    file = new_file(out, ending=".pt")
    saved = load_checkpoint("general")
    scenes = [str(path) for path in collection_files(Path(rooms), None)]
    changes = {"scene": scenes, "goals": None, "evaluation.starts": "sampled"}
    _, policy, protocol = load_trained(saved, "general", changes)
    pairs = Pairs(protocol.world)
    locator = GoalLocator(deepcopy(policy.encoder), policy.heads.width, REACH)
    locator.fine.measure(pairs.patches)
    compares = [*locator.fine.parameters(), *locator.fusion.parameters()]
    reads = [*locator.encoder.parameters(), *locator.layers.parameters()]
    optimiser = torch.optim.AdamW([{"params": reads}, {"params": compares}], RATE, weight_decay=DECAY)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, [RATE, FINE_RATE], steps)
    bar = tqdm(range(steps), unit=" steps")
    for _ in bar:
        visit, goal, right, ahead = pairs.sample(batch_size)
        mirrored = bool(torch.rand(()) < 0.5)
        seen, wanted = (read(pairs.world, policy.features, ids, mirrored) for ids in (visit, goal))
        right = -right if mirrored else right
        if torch.rand(()) < PHOTOS:
            wanted = F.pad(wanted[0][:, :1], (0, 0, 0, 3)), wanted[1][:, :1]
        patches = () if torch.rand(()) < COARSE else (seen[1], wanted[1])
        located = locator(seen[0], wanted[0], *patches)
        # Facing right, what was to the right is ahead, and what was ahead is to the left; and so on.
        facing = [(right, ahead), (-ahead, right), (-right, -ahead), (ahead, -right)]
        cells = torch.stack([torch.stack(cell, 1) for cell in facing], 1).round().long().clamp(-REACH, REACH) + REACH
        row_major = cells[..., 1] * locator.side + cells[..., 0]
        loss = F.nll_loss(located.flatten(2).flatten(0, 1), row_major.flatten())
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
        bar.set_postfix(loss=f"{loss.item():.2f}")
    save_checkpoint(file, with_locator(saved, locator))


class Pairs:
    """Pairs of a visit and a goal of the same room; all rooms count alike.

    Args:
        world: of the rooms.

    Raises:
        ValueError: a room has no fine patches.
    """

    def __init__(self, world: World) -> None:
        if world.patches is None or not are_fine(world.patches):
            raise ValueError("the rooms have no fine patches; sample them with patches=true fine_patches=true")
        self.world, self.patches = world, world.patches
        places = [(scene.positions / scene.step_length, scene.directions) for scene in world.scenes]
        self.positions, self.directions = (
            torch.from_numpy(np.concatenate(parts)).float() for parts in zip(*places, strict=True)
        )
        """In moves, and as unit vectors, float32 ``[N, 2]`` of N states each."""

    def sample(self, count: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return view ids of visits and goals, int64 ``[B, 4]`` each, and where the goals lie from there.

        The last two say how many moves to the right and ahead, float32 ``[B]`` each.
        """
        world = self.world
        sizes = torch.tensor([len(scene) for scene in world.scenes])
        scene = torch.randint(len(sizes), (count,))
        first = torch.tensor(world.offsets[: len(sizes)])[scene]
        state, goal = (first + (torch.rand(count) * sizes[scene]).long() for _ in range(2))
        within = [reach for reach, share in NEAR.items() for _ in range(int(share * count))]
        for pair, reach in enumerate(within):
            here = slice(int(first[pair]), int(first[pair] + sizes[scene[pair]]))
            moves = (self.positions[here] - self.positions[state[pair]]).abs().sum(1)
            near = (moves < reach + 0.5).nonzero()[:, 0]
            goal[pair] = here.start + near[torch.randint(len(near), ())]
        way = self.positions[goal] - self.positions[state]
        aside, faced = world.surrounding[state, 1], world.surrounding[state, 0]
        look, other = (len(world) * torch.randint(world.looks, (count, 1)) for _ in range(2))
        views = (world.surrounding[state] + look, world.surrounding[goal] + other)
        return *views, (way * self.directions[aside]).sum(1), (way * self.directions[faced]).sum(1)


def read(world: World, table: FeatureTable, views: Tensor, mirrored: bool) -> tuple[Tensor, Tensor]:
    """Return features as the policy reads them, and fine patches, of view ids ``[B, 4]``.

    What a network sees of a mirrored view is nearly what it sees of the view, with its patches the other way round.
    """
    assert world.patches is not None
    pooled, patches = world.features[views], world.patches[views].float()
    if mirrored:
        pooled, patches = pooled[:, MIRRORED], patches[:, MIRRORED].unflatten(2, FINE).flip(3).flatten(2, 3)
    return table.standardise(torch.cat([pooled, coarse(patches).flatten(2)], -1)), patches


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
