"""A trained policy in rooms whose images are numbers, for whatever is given images."""

import numpy as np
import torch
from commands import train_config
from rooms import grid_scene

from dirl.models.build import build_policy, feature_table
from dirl.runs.folder import Run
from dirl.scenes import make_world
from dirl.training.build import build_observation

PIXELS = (2, 5)
"""Height and width of the images, which differ so that neither passes for the other."""


def images_of(states):
    """Images of states, uint8 ``[..., H, W, 3]``: every pixel of one is its state's number."""
    states = np.asarray(states, np.uint8)
    return np.broadcast_to(states[..., None, None, None], (*states.shape, *PIXELS, 3))


def look_up(world):
    """An encoder that knows the features of every image of `images_of`."""
    return lambda images: world.features[images[:, 0, 0, 0].long()]


def rooms(names=("grid",), width=16):
    """Rooms of 24 states; two are alike in everything but their features."""
    return make_world(
        [grid_scene(name=name, goals=(0, 13), seed=seed, feature_width=width) for seed, name in enumerate(names)]
    )


def walk_through(walk, world, around=None):
    """Go where the explorer wants to, as long as it wants to."""
    around = world.surrounding if around is None else around
    state, action = 3, None
    for _ in range(5 * len(world)):
        walk.see(images_of(around[state]), action)
        action = walk.next_action()
        if action is None:
            break
        state = int(world.graph[state, action])


def walk_until_stop(act, world, state, most):
    """The states that are passed until a navigator stops, later than at the first; and whether it stopped."""
    action, stopped, _ = act(int(state))
    walked = [int(state)]
    while len(walked) <= most and (len(walked) == 1 or not stopped):
        walked.append(int(world.graph[walked[-1], action]))
        action, stopped, _ = act(walked[-1])
    return walked, stopped


def trained(folder, world, *options):
    """The folder of a finished run with a policy that walks some way; that policy, and what it observes."""
    config = train_config("seed=1", "encoder.width=24", "heads.width=24", *options)
    folder.mkdir(exist_ok=True)
    observation = build_observation(config, world)
    run = Run(folder, config)
    run.begin(world, observation.order)
    policy = build_policy(config, feature_table(config, world), world.names, world=world)
    with torch.no_grad():  # untrained logits hardly differ; what is sampled shall
        for layer in policy.heads.policy.scenes.values():
            layer.weight.mul_(20)
    run.finish({"frames": 7, "network": policy.state_dict()}, {})
    run.close()
    return policy, observation
