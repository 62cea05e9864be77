"""How often a stop rule errs."""

import torch


def stop_errors(stop, world):
    """How often a stop rule errs, over states: ``false`` of those that are not the goal, ``missed`` of the goals."""
    at_goal = world.pair(torch.arange(len(world.goals), device=world.device), world.goals)
    elsewhere = world.distances > 0
    return {
        "false": float((stop & elsewhere).sum() / elsewhere.sum()),
        "missed": float((~stop[at_goal]).float().mean()),
    }
