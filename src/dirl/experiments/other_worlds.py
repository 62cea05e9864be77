"""An agent, unchanged, in simulators that nobody of this project drew: how well it finds goals, beside controls."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from dirl.evaluation.episodes import Episodes
from dirl.evaluation.experts import RandomPolicy
from dirl.evaluation.protocol import metrics
from dirl.experiments.any_goal import FOUR, MEASURES, wrong_goals
from dirl.experiments.results import Column, Table
from dirl.experiments.unseen_rooms import GOALS, MAX_STEPS, drawn_starts
from dirl.models import PlanningMemory
from dirl.runs.checkpoints import load_checkpoint
from dirl.training.load import load_trained

TESTED = {"goals": "all", "evaluation.goals": GOALS, "evaluation.max_steps": MAX_STEPS}

Walked = Mapping[str, Mapping[str, Episodes]]
"""Of each scene's name, the episodes by what walked them."""


def zero_shot(dumps: Sequence[str], agent: str = "general", seed: int = 0) -> dict[str, dict[str, Episodes]]:
    """Episodes of an agent in scenes that it was not trained in, and of controls from the same starts.

    Args:
        dumps: files, with the features that the agent reads.
        agent: its checkpoint, see `dirl.runs.checkpoints.load_checkpoint`.
        seed: of goals, starts and sampled actions.
    """
    saved, found = load_checkpoint(agent), {}
    for dump in dumps:
        _, policy, protocol = load_trained(saved, agent, {**TESTED, "scene": dump, "seed": seed})
        world = protocol.world
        protocol = replace(protocol, starts=drawn_starts(world, seed=seed))
        found[world.names[0]] = {
            FOUR: protocol.run(policy),
            "another goal's views": replace(protocol, shown=wrong_goals(world), stop=None).run(policy),
            # As in `dirl.experiments.any_goal.walked_by`.
            "sweep that ignores the goal": protocol.run(
                RandomPolicy(), greedy=isinstance(protocol.memory, PlanningMemory)
            ),
            "random walk": protocol.run_random(),
        }
    return found


def table(found: Walked) -> Table:
    """The measures over the scenes: interquartile mean and 95 % interval."""
    shown = Table(Column("walks by"), Column("scenes", "d"), *(Column(name, ".3f") for name in MEASURES.values()))
    for way in next(iter(found.values())):
        of_each = [metrics(episodes[way]) for episodes in found.values()]
        shown.add(way, len(found), *([one[key] for one in of_each] for key in MEASURES))
    return shown
