"""Places that change: how well goals are found where no visit looks like another, beside controls."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

from tqdm import tqdm

from dirl.evaluation.episodes import Episodes
from dirl.experiments.figures import draw_spl
from dirl.experiments.measures import (
    MEASURES,
    RANDOM,
    SWEEP,
    WRONG,
    by_measure,
    controls,
    kept,
    load_agent,
    measure_table,
)
from dirl.experiments.results import write_tables
from dirl.scenes import World
from dirl.scenes.collection import INDEX
from dirl.scenes.palette import SYSTEM_COLORS

TESTED: dict[str, Any] = {
    "split": "test",
    "rooms": None,
    "goals": "every:8",
    "evaluation.goals": None,
    "evaluation.starts": "sampled",
    "evaluation.episodes_per_goal": 3,
    "evaluation.max_steps": 100,
    "stop.threshold": 0.95,
    "stop.evaluation": "match",
}

GOAL_VIEWS = {"surrounding": "four views", "front": "one photo"}

RECOGNISED = {
    "ncc": ("ncc", "planning"),
    "learned, localising": ("learned", "localising"),
}
"""Recogniser and episodic memory, by the name of the pair in the tables."""

TOLD = "told when it has arrived"

CONTROLS = {TOLD: "o-", f"{WRONG}, told": "s--", f"{SWEEP}, told": "^:", f"{RANDOM}, told": "v:"}
"""Each stops exactly at the goal; with the learned recogniser the memory knows places again. Markers in the figure."""

Measured = dict[str, list[float]]
"""A value for each room, by measure."""

Tables = dict[tuple[str, ...], Any]
"""What no policy changes, shared by agents: scores and stops by collection, recogniser, goal view and kind of stop."""


def tested(collection: str) -> dict[str, Any]:
    """The options of an evaluation in the test rooms of a collection, or in all dumps of another folder."""
    dumps = sorted(str(file) for file in Path(collection).glob("*.h5"))
    if dumps and not (Path(collection) / INDEX).is_file():
        return {**TESTED, "scene": dumps, "split": None}
    return {**TESTED, "scene": f"collection:{collection}"}


def walked(agent: str, collection: str, goal_view: str, way: str, tables: Tables) -> tuple[World, Episodes]:
    """Episodes in the scenes of a folder with looks, see `tested`, and these scenes.

    ``goal_view`` is one of `GOAL_VIEWS`, ``way`` one of `RECOGNISED` or `CONTROLS`.
    """
    recogniser, memory = RECOGNISED.get(way, ("learned", "planning"))
    changes = {**tested(collection), "stop.evaluation": "goal" if way in CONTROLS else "match"}
    _, policy, protocol = load_agent(agent, changes, goal_view, recogniser=recogniser, episodic_memory=memory)
    protocol = replace(
        protocol,
        scores=tables.setdefault((collection, recogniser), protocol.scores),
        stop=tables.setdefault((collection, recogniser, goal_view, str(changes["stop.evaluation"])), protocol.stop),
    )
    walk = controls(policy, protocol).get(way.removesuffix(", told"))
    return protocol.world, walk() if walk else protocol.run(policy)


def measured(out: Path, agent: str, collection: str, goal_view: str, way: str, tables: Tables) -> Measured:
    """`MEASURES` of each room; from the folder, if they were measured before."""
    parts = (Path(agent).name, Path(collection).name, way.replace(", ", "_").replace(" ", "_"), goal_view)
    file = out / "measured" / f"{'-'.join(parts)}.json"
    return kept(file, lambda: by_measure(*walked(agent, collection, goal_view, way, tables)))


def report_changes(collections: Sequence[str], agents: Sequence[str], out: Path) -> str:
    """Measure, and write tables and a figure. What was measured is kept in the folder, and not measured again.

    Collections are folders with looks, see `tested`, in the order of the strength of the changes. Controls are of the
    first agent.
    """
    ways = [(agent, way) for agent in agents for way in RECOGNISED] + [(agents[0], way) for way in CONTROLS]
    cases = list(product(GOAL_VIEWS, ways))
    found = {}
    table = measure_table({"rooms": "", "goal": "", "agent": "", "recogniser": ""})
    with tqdm(total=len(collections) * len(cases), desc="changes", unit=" cases", disable=None) as bar:
        for collection in collections:
            tables = Tables()  # of one collection at a time: they take a gigabyte
            for view, (agent, way) in cases:
                found[collection, view, agent, way] = values = measured(out, agent, collection, view, way, tables)
                names = Path(collection).name, GOAL_VIEWS[view], Path(agent).name, way
                table.add(*names, *(values[key] for key in MEASURES))
                bar.update()
    lines = []
    colors = list(SYSTEM_COLORS.values())
    for index, (agent, way) in enumerate(ways):
        spl = {
            shown: [found[one, view, agent, way]["spl"] for one in collections] for view, shown in GOAL_VIEWS.items()
        }
        if way in CONTROLS:
            lines.append((way, "0.6", CONTROLS[way], spl))
        else:
            lines.append((f"{Path(agent).name}: {way}", colors[index % len(colors)], "o-", spl))
    draw_spl(lines, [Path(one).name for one in collections], out, "changes", apart=0.04)
    note = (
        "Of a collection the test rooms, **synthetic, not AI2-THOR**, which no training saw, of another folder all "
        "scenes; three starts for every eighth state as the goal, 100 steps. Mean over rooms, in brackets its "
        "95 % bootstrap interval over rooms, and the worst room. No visit and no goal has the look without errors."
    )
    shown = "SPL of each recogniser over the strength of the changes, with four views and with one photo"
    return write_tables(out, "Places that change", note, {"changes": table}, {"changes": shown})
