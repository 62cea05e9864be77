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

TESTED = {"goals": "all", "evaluation.goals": GOALS, "evaluation.max_steps": MAX_STEPS, "seed": 0}


def walked(dump: str, agent: str) -> Iterator[tuple[str, Episodes]]:
    """Episodes in one scene by what walked them."""
    _, policy, protocol = load_agent(agent, {**TESTED, "scene": dump})
    protocol = replace(protocol, starts=drawn_starts(protocol.world))
    yield FOUR, protocol.run(policy)
    for name, walk in controls(policy, protocol).items():
        yield name, walk()


def report_other_worlds(dumps: Sequence[str], agent: str, out: Path) -> str:
    """Write the measures of an agent in scenes that it was not trained in, and of controls from the same starts."""
    found: dict[str, list[dict[str, float]]] = {}
    for dump in dumps:
        for way, episodes in walked(dump, agent):
            found.setdefault(way, []).append(metrics(episodes))
    table = measure_table({"walks by": "", "scenes": "d"})
    for way, of_each in found.items():
        table.add(way, len(dumps), *([one[key] for one in of_each] for key in MEASURES))
    text = "Interquartile mean over scenes and, in brackets, its 95 % bootstrap interval."
    return write_tables(out, f"{agent} in other worlds", text, {"other_worlds": table}, {})
