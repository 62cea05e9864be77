"""A navigator walked in a live world by its own code, so that what is measured is what a robot runs."""

from hashlib import sha256

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from dirl.agent.loading import Encoder
from dirl.agent.navigator import Navigator
from dirl.evaluation.episodes import Episodes
from dirl.scenes.graph import turns_per_circle
from dirl.scenes.live import LiveWorld, arrived, shortest_move, state_pose
from dirl.scenes.scene import Scene


class Remembered:
    """An encoder that remembers the last so many images: ``navigator.encoder = Remembered(navigator.encoder)``."""

    def __init__(self, encoder: Encoder, images: int = 20_000) -> None:
        self.encoder, self.known, self.most = encoder, dict[bytes, Tensor](), images

    def __call__(self, images: Tensor) -> Tensor:
        """Return features of images, uint8 ``[N, H, W, 3]``."""
        keys = [sha256(image.numpy().tobytes()).digest() for image in images.cpu()]
        new = {key: index for index, key in enumerate(keys) if key not in self.known}
        if new:
            self.known |= zip(new, torch.as_tensor(self.encoder(images[list(new.values())])), strict=True)
        rows = torch.stack([self.known[key] for key in keys])
        for key in list(self.known)[: max(0, len(self.known) - self.most)]:
            del self.known[key]
        return rows


def evaluate_live(
    navigator: Navigator,
    world: LiveWorld,
    scene: Scene,
    starts: tuple[Tensor, Tensor],
    *,
    max_steps: int = 100,
    one_photo: bool = False,
    told: bool = False,
) -> Episodes:
    """Walk a navigator in a world by its own `reset` and `act`, as a robot does, one episode from each start.

    The agent has arrived where it stops nearer to the goal than half of the scene's shortest move, with a heading
    nearer to the goal's than to that of a neighbouring state.

    Args:
        navigator: sees four views around it.
        world: with the coordinates of the scene.
        scene: says where goals and starts are, and how long shortest paths.
        starts: goal states and start states, int64 ``[E]`` each; the ``goal_index`` of the result is the goal state.
        max_steps: after so many an episode has failed.
        one_photo: show the navigator the view ahead at the goal alone.
        told: the agent is told where it has arrived, instead of stopping where it thinks so.
    """
    goal_state, start = (states.cpu() for states in starts)
    turn = 360 / turns_per_circle(scene.graph)
    within = shortest_move(scene) / 2
    shortest = torch.from_numpy(scene.distances[start.numpy(), goal_state.numpy()].astype(np.int64))
    episodes = Episodes.failed(goal_state, start, shortest, max_steps)
    pairs = list(zip(goal_state.tolist(), start.tolist(), strict=True))
    for episode, (goal, first) in enumerate(tqdm(pairs, desc="live", unit=" episodes", disable=None)):
        wanted = state_pose(scene, goal)
        world.reset(wanted)
        navigator.reset(world.views()[0] if one_photo else world.views())
        world.reset(state_pose(scene, first))
        for step in range(max_steps + 1):
            decision = navigator.act(world.views())
            there = arrived(world.pose, wanted, within, turn / 2)
            if there if told else decision.stop:
                episodes.success[episode], episodes.false_stop[episode] = there, not there
                episodes.steps[episode] = step if there else max_steps
                break
            episodes.missed_stop[episode] |= there
            if step < max_steps:
                world.step(int(decision.action))
    return episodes
