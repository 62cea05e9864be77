"""Policies of a few lines, and what became of their episodes."""

import torch
from tensordict import TensorDict

from dirl.evaluation import episodes
from dirl.evaluation.experts import ShortestPathExpert

COUNTED = ("success", "steps", "false_stop", "missed_stop")


def run_episodes(policy, world, starts, *, observation, greedy=True, **conditions):
    """Episodes under the conditions of an `EvaluationProtocol`."""
    return episodes.EvaluationProtocol(world, observation, starts, **conditions).run(policy, greedy=greedy)


def expert(world, sureness=100.0):
    """The expert as a policy that looks: it stands in the last of sequential views, the first of surrounding ones."""
    shortest = ShortestPathExpert(world)

    def logits(rows):
        views, goal = rows["view_ids"], rows["goal_view_ids"][:, 0]
        tiled = (rows["goal_view_ids"] == goal[:, None]).all()
        state = views[:, -1 if tiled else 0]
        asked = TensorDict({"state": state % len(world), "goal": goal % len(world)}, rows.batch_size)  # in any look
        action = shortest(asked)["expert_action"].clamp(min=0)
        return sureness * torch.nn.functional.one_hot(action, 4).float()

    return Asked(logits)


class Asked(torch.nn.Module):
    """A policy by a function of what it observes."""

    def __init__(self, logits):
        super().__init__()
        self.logits, self.in_keys = logits, ["view_ids", "goal_view_ids"]

    def forward(self, rows):
        return rows.set("logits", self.logits(rows))


def always(action, sureness=100.0):
    """A policy that prefers one action everywhere."""
    return Asked(lambda rows: sureness * torch.eye(4)[action].expand(len(rows), 4))


def indifferent():
    """A policy without preference."""
    return Asked(lambda rows: torch.zeros(len(rows), 4))


def outcome(episodes):
    return {key: getattr(episodes, key).tolist() for key in COUNTED}
