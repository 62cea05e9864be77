"""An agent, unchanged, in simulators that nobody of this project drew: how well it finds goals, beside controls."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from dirl.evaluation.episodes import Episodes
from dirl.evaluation.protocol import metrics
from dirl.experiments.measures import (
    FOUR,
    GOALS,
    MAX_STEPS,
    MEASURES,
    controls,
    drawn_starts,
    load_agent,
    measure_table,
)
from dirl.experiments.results import write_tables

TOLD = "the same, told when it has arrived"

TESTED = {"goals": "all", "evaluation.goals": GOALS, "evaluation.max_steps": MAX_STEPS, "seed": 0}


def walked(dump: str, agent: str) -> Iterator[tuple[str, str, Episodes]]:
    """Episodes in one scene, by their limit of steps and by what walked them."""
    # Views of these worlds return bit for bit; a memory that localises cannot be told where it has arrived.
    _, policy, protocol = load_agent(agent, {**TESTED, "scene": dump}, recogniser="ncc", episodic_memory="planning")
    world = protocol.world
    for limit, max_steps in {"other_worlds": MAX_STEPS, "other_worlds_by_size": len(world)}.items():
        limited = replace(protocol, starts=drawn_starts(world), max_steps=max_steps)
        yield limit, FOUR, limited.run(policy)
        yield limit, TOLD, replace(limited, stop=None).run(policy)
        for name, walk in controls(policy, limited).items():
            yield limit, name, walk()


def report_other_worlds(dumps: Sequence[str], agent: str, out: Path) -> str:
    """Write the measures of an agent in scenes that it was not trained in, and of controls from the same starts."""
    found: dict[str, dict[str, list[dict[str, float]]]] = {}
    for dump in dumps:
        for limit, way, episodes in walked(dump, agent):
            found.setdefault(limit, {}).setdefault(way, []).append(metrics(episodes))
    tables = {limit: measure_table({"walks by": "", "scenes": "d"}) for limit in found}
    for limit, ways in found.items():
        for way, of_each in ways.items():
            tables[limit].add(way, len(dumps), *([one[key] for one in of_each] for key in MEASURES))
    text = (
        "Mean over scenes, in brackets its 95 % bootstrap interval, and the worst scene. "
        f"An episode has at most {MAX_STEPS} steps, in the second table as many as the scene has states."
    )
    return write_tables(out, f"{agent} in other worlds", text, tables, {})
