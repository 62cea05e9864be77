"""Train the network that compares frames, `dirl.perception.columns.ColumnNet`, in random mazes of VizDoom.

    python examples/train_columns.py out=columns.pt        # needs dirl[vizdoom]
    python examples/train_columns.py out=try.pt mazes=2 frames=60 steps=3

A player walks at random in 160 mazes of ``mazes.py``, whose walls are none of SPTM's test mazes. Its poses and
the plan of the maze tell where each column of a frame meets a wall, and in which column of another frame that point is
seen; both are what the network learns. Where the network is used, neither is known.
"""

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
import vizdoom
from mazes import CELL, Maze, draw_maze, write_mazes
from numpy.typing import NDArray
from sptm import AHEAD, BUTTONS, IDLE, TURN_LEFT, TURN_RIGHT
from torch import Tensor

from dirl.cli.start import run, start
from dirl.config.schemas import option
from dirl.perception.columns import BEARING, COLUMNS, UNIT, ColumnNet, images_of

Frames, Poses, Depths = NDArray[np.uint8], NDArray[np.float64], NDArray[np.float64]

OFTEN = [0.45, 0.06, 0.06, 0.06, 0.05, 0.16, 0.16]

NEAR_WALL, KEPT = 70, 0.05
"""Of frames whose walls are nearer than so many units, half of the columns or more, so many are kept."""

PLACES, ANCHORS = 5, 20
"""Mazes of a batch, and pairs of near frames of each."""

RATE, WARM = 4e-3, 10
"""Highest learning rate, after so many steps; then half a cosine."""


@dataclass
class Options:
    """Train the network that compares frames of Doom."""

    out: str = option("weights to write (.pt)")
    mazes: int = option("that are walked in", 160)
    frames: int = option("of each walk", 400)
    steps: int = option("of the optimiser", 900)
    seed: int = option("of mazes, walks and weights", 0)


def main(out: str, mazes: int, frames: int, steps: int, seed: int) -> None:
    """Record, train, and write the weights as float16."""
    random = np.random.default_rng(seed)
    torch.manual_seed(seed)
    plans = [draw_maze(random) for _ in range(mazes)]
    places = []
    for plan, (images, poses) in zip(plans, record(plans, frames, random), strict=True):
        depths = cast(plan, poses)
        kept = (np.median(depths, axis=1) > NEAR_WALL) | (random.random(len(depths)) < KEPT)
        if kept.sum() >= ANCHORS:
            places.append((images[kept], poses[kept], depths[kept]))
    net = ColumnNet().to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    optimizer = torch.optim.AdamW(net.parameters(), weight_decay=1e-2)
    for step in range(steps):
        for group in optimizer.param_groups:
            group["lr"] = RATE * min(1, (step + 1) / WARM) * (0.5 + 0.5 * np.cos(np.pi * step / steps) + 0.01)
        images, poses, depths, pairs = draw_batch(places, random)
        loss = loss_of(net, images, poses, depths, pairs)
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), 5.0)
        optimizer.step()
        if step % 25 == 0:
            print(f"step {step}: loss {loss.item():.2f}", flush=True)
    halves = {name: value.half() if value.is_floating_point() else value for name, value in net.state_dict().items()}
    torch.save(halves, out)


def record(plans: list[Maze], count: int, random: np.random.Generator) -> list[tuple[Frames, Poses]]:
    """Frames of a random walk in each maze, ``[count, HEIGHT, WIDTH, 3]``, and poses: x, y, heading in degrees."""
    found = []
    iwad = Path(vizdoom.__file__).parent / "freedoom2.wad"
    with tempfile.TemporaryDirectory() as folder:
        wad = Path(folder) / "mazes.wad"
        write_mazes(wad, plans, iwad, random)
        game = vizdoom.DoomGame()
        game.set_doom_config_path(f"{folder}/settings.ini")
        game.set_doom_game_path(str(iwad))
        game.set_doom_scenario_path(str(wad))
        game.set_window_visible(False)
        game.set_screen_resolution(vizdoom.ScreenResolution.RES_160X120)
        game.set_screen_format(vizdoom.ScreenFormat.RGB24)
        for shown in ("hud", "weapon", "crosshair"):
            getattr(game, f"set_render_{shown}")(False)
        game.set_available_buttons([getattr(vizdoom.Button, name) for name in BUTTONS if name])
        variables = [getattr(vizdoom.GameVariable, name) for name in ("POSITION_X", "POSITION_Y", "ANGLE")]
        game.set_available_game_variables(variables)
        game.set_episode_timeout(0)
        game.add_game_args("+cl_run 1")
        game.init()
        for number in range(1, len(plans) + 1):
            game.set_doom_map(f"map{number:02d}")
            game.new_episode()
            game.make_action([0] * 6, 20)
            found.append(walk(game, count, random))
        game.close()
    return found


def walk(game: vizdoom.DoomGame, count: int, random: np.random.Generator) -> tuple[Frames, Poses]:
    """Moves of random length, more often ahead, and a turn where a wall stops."""
    frames, poses = [], np.zeros((count, 3))
    action, left, still = IDLE, 0, 0
    for step in range(count):
        state = game.get_state()
        small = images_of(state.screen_buffer[None])[0]
        frames.append(((small + 0.5) * 255).round().to(torch.uint8).permute(1, 2, 0).numpy())
        poses[step] = state.game_variables
        moved = np.hypot(*(poses[step] - poses[step - 1])[:2]) if step else np.inf
        still = still + 1 if moved < 4 else 0
        if still >= 2 and action not in (TURN_LEFT, TURN_RIGHT):
            action, left, still = int(random.choice([TURN_LEFT, TURN_RIGHT])), int(random.integers(1, 5)), 0
        elif left <= 0:
            action = int(random.choice(7, p=OFTEN))
            left = int(random.integers(1, 9 if action == AHEAD else 4))
        left -= 1
        game.make_action([int(name == BUTTONS[action]) for name in BUTTONS if name], 4)
    return np.stack(frames), poses


def cast(maze: Maze, poses: Poses) -> Depths:
    """How far the wall in each column of each frame is, ``[N, COLUMNS]``."""
    angle = np.radians(poses[:, 2:]) - BEARING.numpy()
    nearest = np.full(angle.shape, np.inf)
    start, way = poses[:, :2] / CELL, np.stack([np.cos(angle), np.sin(angle)])
    for axis, walls in enumerate((maze.right, maze.up.T)):
        along, across = np.where(np.abs(way[axis]) < 1e-6, 1e-6, way[axis]), way[1 - axis]
        for line in range(walls.shape[0] + 1):
            distance = (line - start[:, axis, None]) / along
            cell = np.floor(start[:, 1 - axis, None] + distance * across).astype(int)
            inside = (distance > 0) & (cell >= 0) & (cell < walls.shape[1])
            wall = line == 0 or walls[line - 1][cell.clip(0, walls.shape[1] - 1)]
            nearest = np.where(inside & wall, np.minimum(nearest, distance), nearest)
    return np.minimum(nearest * CELL, 3000)


def seen_in(poses: Poses, depths: Depths, others: Poses, other_depths: Depths) -> tuple[Depths, NDArray[np.bool_]]:
    """In which column of the other frame, a fraction, each column's point of a wall is; whether it is seen there."""
    angle = np.radians(poses[:, 2:]) - BEARING.numpy()
    x, y = (
        poses[:, axis, None] + depths * way(angle) - others[:, axis, None] for axis, way in ((0, np.cos), (1, np.sin))
    )
    heading = np.radians(others[:, 2:])
    ahead, right = x * np.cos(heading) + y * np.sin(heading), x * np.sin(heading) - y * np.cos(heading)
    column = (right / np.maximum(ahead, 1) + 1) / 2 * COLUMNS - 0.5
    inside = (ahead > 4) & (column > -0.5) & (column < COLUMNS - 0.5)
    column, distance = column.clip(0, COLUMNS - 1), np.hypot(ahead, right)
    at, low, high = (
        np.take_along_axis(other_depths, rounded(column).astype(int), 1) for rounded in (np.round, np.floor, np.ceil)
    )
    near = 0.12 * distance + 12
    between = (np.minimum(low, high) - near < distance) & (distance < np.maximum(low, high) + near)
    smooth = np.abs(low - high) < 0.5 * distance
    return column, inside & ((np.abs(at - distance) < near) | (between & smooth))


def draw_batch(
    places: list[tuple[Frames, Poses, Depths]], random: np.random.Generator
) -> tuple[Tensor, Poses, Depths, NDArray[np.int64]]:
    """Images, poses and depths of frames of some mazes, and pairs of them: near ones, and any of one maze."""
    images, poses, depths, pairs, first = [], [], [], [], 0
    for number in random.choice(len(places), min(PLACES, len(places)), replace=False):
        all_images, all_poses, all_depths = places[number]
        anchors, partners = random.choice(len(all_poses), ANCHORS, replace=False), []
        for anchor in anchors:
            apart = np.hypot(*(all_poses[:, :2] - all_poses[anchor, :2]).T)
            turned = np.abs((all_poses[:, 2] - all_poses[anchor, 2] + 180) % 360 - 180)
            near = np.flatnonzero((apart < random.choice([60, 120, 250, 350])) & (turned < 70) & (apart + turned > 3))
            partners.append(random.choice(near) if len(near) else random.integers(len(all_poses)))
        chosen = np.concatenate([anchors, partners])
        images.append(all_images[chosen])
        poses.append(all_poses[chosen])
        depths.append(all_depths[chosen])
        one = np.concatenate([np.arange(ANCHORS), np.arange(2 * ANCHORS)])
        two = np.concatenate([np.arange(ANCHORS) + ANCHORS, random.permutation(2 * ANCHORS)])
        pairs.append(np.stack([one, two]) + first)
        first += len(chosen)
    return images_of(np.concatenate(images)), np.concatenate(poses), np.concatenate(depths), np.concatenate(pairs, 1)


def loss_of(net: ColumnNet, images: Tensor, poses: Poses, depths: Depths, pairs: NDArray[np.int64]) -> Tensor:
    """Cross-entropy of which column matches, or none, both ways, and of the logarithm of depths."""
    looks, log_depth = net(images)
    loss = F.smooth_l1_loss(log_depth, torch.from_numpy(np.log(depths / UNIT)).float(), beta=0.1)
    alike = torch.einsum("nci,ncj->nij", looks[pairs[0]], looks[pairs[1]]) * net.sharp.exp()
    for (one, two), logits in ((pairs, alike), (pairs[::-1], alike.transpose(1, 2))):
        column, seen = seen_in(poses[one], depths[one], poses[two], depths[two])
        logits = torch.cat([logits, net.none.expand(*logits.shape[:2], 1)], 2).log_softmax(2)
        low = np.floor(column).astype(int)
        part = torch.from_numpy(column - low).float()
        below, above = (torch.from_numpy(np.minimum(low + more, COLUMNS - 1))[..., None] for more in (0, 1))
        match = -(1 - part) * logits.gather(2, below)[..., 0] - part * logits.gather(2, above)[..., 0]
        visible = torch.from_numpy(seen)
        loss = loss + 0.5 * match[visible].mean() - 0.3 * logits[..., COLUMNS][~visible].mean()
    return loss


if __name__ == "__main__":
    options = start(__doc__, Options)
    run(lambda: main(**vars(options)))
