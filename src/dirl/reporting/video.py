"""Episodes as a video."""

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image
from torch import nn

from dirl.evaluation.protocol import EvaluationProtocol
from dirl.reporting.animation import FRAME_MS, HOLD_MS, episode_frames
from dirl.reporting.tables import run_title
from dirl.scenes.io.atomic import atomic_path

FPS = 10
"""A step is shown for several frames: players do not like slower videos."""


def write_mp4(episodes: Sequence[Sequence[Image.Image]], file: Path) -> None:
    """Write episodes as one MP4 (H.264), one after the other; the last picture of each is held.

    Args:
        episodes: the pictures of each, of any sizes.
        file: the video to write.

    Raises:
        ImportError: imageio-ffmpeg is not installed.
        OSError: the file cannot be written.
    """
    from imageio_ffmpeg import write_frames

    frames = [frame for episode in episodes for frame in episode]
    width, height = (2 * -(-max(frame.size[axis] for frame in frames) // 2) for axis in (0, 1))  # H.264: even sizes
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "video.mp4"
        video = write_frames(str(made), (width, height), fps=FPS, macro_block_size=2, ffmpeg_log_level="error")
        video.send(None)
        for episode in episodes:
            for frame in episode:
                canvas = Image.new("RGB", (width, height), "white")
                canvas.paste(frame)
                shown = HOLD_MS if frame is episode[-1] else FRAME_MS
                for _ in range(shown * FPS // 1000):
                    video.send(np.asarray(canvas).tobytes())
        video.close()
        with atomic_path(file) as temporary:
            temporary.write_bytes(made.read_bytes())


def film_scene(
    policy: nn.Module, protocol: EvaluationProtocol, index: int, file: Path, *, facts: Mapping[str, Any], count: int = 5
) -> None:
    """Write a video of greedy episodes in one scene, each from the start that is farthest from its goal.

    Args:
        policy: trained.
        protocol: how it is evaluated, and where.
        index: of the scene in the world.
        file: the video to write.
        facts: of the run, see `dirl.training.build.describe`.
        count: episodes at most, of goals spread evenly over those of the scene.
    """
    world, scene, offset = protocol.world, protocol.world.scenes[index], protocol.world.offsets[index]
    among = world.goals_in(index)
    goals = [among[place] for place in torch.linspace(0, len(among) - 1, min(count, len(among))).long().tolist()]
    starts = [int(world.block(world.distances, goal).argmax()) + offset for goal in goals]
    episodes, paths = protocol.trajectories(policy, (torch.tensor(goals), torch.tensor(starts)))
    films = []
    for goal, path, success in zip(goals, paths, episodes.success.tolist(), strict=True):
        state, walked = int(world.goals[goal]) - offset, [passed - offset for passed in path]
        title = f"{run_title({**facts, 'scene': scene.name, 'source': scene.source})}, goal {state}"
        films.append(episode_frames(scene, state, walked, title=title, success=success))
    write_mp4(films, file)
