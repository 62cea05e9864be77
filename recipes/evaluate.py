"""Evaluate trained weights, beside shortest path and random.

    python recipes/evaluate.py checkpoint=runs/dirl_bathroom_02/2026-01-31_12-00-00
    python recipes/evaluate.py checkpoint=... starts=sampled episodes_per_goal=500 max_steps=500
    python recipes/evaluate.py checkpoint=... 'goals=[51]' stop=goal
    python recipes/evaluate.py checkpoint=... viewer=true              # a web page to step through episodes

All options: `Options` below.
"""

from dataclasses import dataclass
from typing import Annotated, Any

from annotated_types import Interval

from dirl.cli.start import new_file, run, start
from dirl.config.schemas import (
    ConfigError,
    Correlation,
    Device,
    GoalView,
    HeldOut,
    Match,
    Positive,
    Seed,
    Split,
    Starts,
    Stop,
    option,
)
from dirl.config.schemas import Episodes as EpisodeCount


@dataclass
class Options:
    """Evaluate trained weights. Null keeps the value of the run's own evaluation."""

    checkpoint: str = option("the folder of a run, or a .pt file in one")
    out: str | None = option("write the result to this file as JSON", None)
    trust: list[str] = option("packages whose classes the checkpoint's configuration may name, besides dirl's own", [])
    map: Annotated[float, Interval(ge=0, le=100)] | None = option(
        "a topological map: walk once through each scene, 2 = twice as many steps as it has states, and go by the map; "
        "with episodic_memory=localising a map of places",
        None,
    )
    last_steps: Annotated[int, Interval(ge=0, le=10**6)] | None = option(
        "with map: so near the goal the policy decides; null = 3, 0 = the map leads to the end; not with localising",
        None,
    )
    panorama: bool | None = option(
        "true: the agent sees the views of all headings of its place, not only four of them; null = in tours; with "
        "episodic_memory=planning or localising, not live",
        None,
    )
    arrows: bool | None = option(
        "true: the agent sees which moves are possible where it is, as visitors of a tour see its arrows; null = in "
        "tours; not live",
        None,
    )
    metric: str | None = option("a YAML file with a class of your own that measures episodes", None)
    viewer: bool = option(
        "write viewer_<scene>.html into the run's folder: step through episodes, walk the room", False
    )
    beside: str | None = option("with viewer=true: another checkpoint, whose agent can be shown beside this one", None)
    simulator: str | None = option(
        "live, the navigator in place of the tables: a YAML file with a simulator's class, or dump: its pictures",
        None,
    )
    slip: HeldOut = option("live only: the probability that an action has no effect", 0.0)
    turn_error: Annotated[float, Interval(ge=0, le=90)] = option(
        "live only: standard deviation of each turn, degrees", 0.0
    )
    scene: Any = option(
        "scenes to evaluate in: a dump that has moved, or other scenes with features of the same extractor", None
    )
    source: str | None = option(
        "what finds them: rooms | thor | a YAML file of your own; null = that of the training", None
    )
    split: Split | None = option("of a collection: train | validation | test", None)
    rooms: Positive | None = option("of a collection: the number of rooms, the first ones", None)
    goals: Any = option(
        "goal states, also ones it was not trained for: [51] for one scene, {bathroom_02: [51]} for several, or all; "
        "each of them is evaluated",
        None,
    )
    starts: Starts | None = option(
        "every: each state that reaches the goal (exact) | sampled: random states; null = those of the training, or "
        "sampled above 20,000 episodes",
        None,
    )
    episodes_per_goal: EpisodeCount | None = option("how many starts are sampled (sampled only)", None)
    max_steps: EpisodeCount | None = option("after so many steps an episode has failed", None)
    stop: Stop | None = option(
        "goal: the environment stops the agent at the goal | match: template matching does", None
    )
    threshold: Correlation | None = option("match above this correlation", None)
    match: Match | None = option("views: all four | front: only the view ahead", None)
    goal_view: GoalView | None = option(
        "surrounding: four views of the goal | front: one photo, matched with the view ahead above 0.95", None
    )
    recogniser: str | None = option(
        "ncc: correlation, as in the paper | exact: a match leaves no doubt | learned: for places that change | "
        "a YAML file of your own; null = that of the training",
        None,
    )
    episodic_memory: str | None = option(
        "none | planning: a path to the best exit not tried | "
        "localising: a filter over places that change, with recogniser=learned or exact | a YAML file",
        None,
    )
    seed: Seed | None = option("of sampled starts and actions", None)
    device: Device | None = option("cpu | cuda", None)
    root: str | None = option("the folder of the published dumps, if it has moved since (source=thor)", None)


if __name__ == "__main__":
    options = start(__doc__, Options)  # "loading ...", or help; the imports below take their time

from collections.abc import Mapping
from dataclasses import replace
from itertools import count
from pathlib import Path

from tqdm import tqdm

from dirl.agent.mapping import GraphMemory, GuidedPolicy
from dirl.agent.mapping.graph_policy import LAST_STEPS
from dirl.config.components import make
from dirl.config.files import goal_view_options, group_options, load_simulator, own_options
from dirl.evaluation.episodes import Episodes, Metric, sampled_starts, shortest_episodes
from dirl.evaluation.protocol import EvaluationProtocol, assess, assess_live, metrics
from dirl.models import LocalisingMemory, PlanningMemory
from dirl.perception.backbones.registry import packaged_encoder
from dirl.perception.recognition.recogniser import NCC, build_recogniser, stop_by
from dirl.reporting import draw_paths, run_title, summary_table, viewer_pages, write_goals
from dirl.reporting.tables import GOAL_COLUMNS
from dirl.runs.checkpoints import RunError, State, load_checkpoint, packaged_agent
from dirl.scenes import load_scenes
from dirl.scenes.graph import turns_per_circle
from dirl.scenes.io.files import write_json, write_text
from dirl.scenes.live import Dumped, LiveWorld, Noisy, Simulated, repeats, shortest_move, state_pose
from dirl.training.build import Trained, describe, load_trained, saved_config

MOST_EPISODES = 20_000
"""Of an evaluation for which no starts are asked for."""

DRAWN_SCENES = 8
"""Of how many scenes there are pictures of paths."""

LIVE_EPISODES = 100
"""Likewise, in a live world."""

PLANS = {"recogniser": "ncc", "episodic_memory": "planning"}
"""What an agent that localises chooses instead where views return, if neither is asked for."""

RETURNED = 0.98
"""Correlation above which it stops there: two places of a real house match by up to 0.92, in one view 0.976."""

CHANGING = (
    "these scenes never look the same twice, and the correlation of the paper misses nearly every arrival there: try "
    "recogniser=learned episodic_memory=localising"
)


def main(options: Options) -> None:
    """Evaluate, and print the tables."""
    result = evaluate(options)
    print(summary_table(result))
    print(*result.written, sep="\n", end="\n" if result.written else "")


class Result(dict[str, Any]):
    """What was measured."""

    written: list[str]
    """A line for each file that was written."""


def evaluate(options: Options) -> Result:
    """Read the checkpoint, run the episodes, write the files that were asked for."""
    check(options)
    saved = load_checkpoint(options.checkpoint)
    changes = {
        "scene": options.scene,
        "split": options.split,
        "rooms": options.rooms,
        "goals": options.goals,
        "source": group_options("source", options.source),
        "source.root": options.root,
        "device": options.device,
        "seed": options.seed,
        "stop.evaluation": options.stop,
        "stop.threshold": options.threshold,
        "stop.match": options.match,
        "episodic_memory": group_options("episodic_memory", options.episodic_memory),
        "recogniser": group_options("recogniser", options.recogniser),
        "evaluation.starts": options.starts,
        "evaluation.episodes_per_goal": options.episodes_per_goal,
        "evaluation.max_steps": options.max_steps,
    }
    given = {name: value for name, value in changes.items() if value is not None}
    changes = {**goal_view_options(options.goal_view), **given}
    trained, changes = loaded(saved, options, changes)
    if options.starts is None:
        trained = trained._replace(protocol=few_enough(trained.protocol))
    trained = as_visitors_see(trained, arrows=options.arrows, panorama=options.panorama)
    if options.metric is not None:
        metric = make("metric", own_options("metric", Path(options.metric)))
        trained = trained._replace(protocol=measured_by(trained.protocol, metric))
    if options.map is not None:
        trained = with_map(trained, options.map, options.last_steps)
    recogniser = build_recogniser(trained.config.recogniser, trust=trained.config.trust)
    if options.threshold is not None and recogniser.thresholds is not None:
        raise RunError("threshold: this recogniser has thresholds of its own; evaluate with recogniser=ncc")
    if misses_arrivals(trained):
        print(CHANGING)
    facts = describe(trained.config, trained.protocol.world)
    if packaged_agent(options.checkpoint) is not None:
        facts["agent"] = Path(options.checkpoint).name
    pages = viewer(trained, facts, beside(options, trained, changes)) if options.viewer else {}
    live = options.simulator is not None
    measured = walk_live(trained, options) if live else assess(trained.policy, trained.protocol)
    result = Result({"checkpoint": options.checkpoint, "frames": saved["frames"], **facts, **measured})
    result.written = []
    if packaged_agent(options.checkpoint) is not None and not live:
        result.written += leave_pictures(trained, facts, result)
    if options.out is not None:
        write_json(Path(options.out), result)
        result.written.append(f"all measures: {options.out}")
    for name, page in pages.items():
        file = run_folder(options.checkpoint) / name
        replaced = " (in place of the one before)" if file.exists() else ""
        write_text(file, page)
        result.written.append(f"viewer: {file}, {file.stat().st_size / 1e6:.1f} MB{replaced}")
    return result


def loaded(saved: State, options: Options, changes: dict[str, Any]) -> tuple[Trained, dict[str, Any]]:
    """Return the agent, and the changes of its configuration: where views return, it plans if nothing else is said.

    Correlation tells such views apart; a recogniser that allows for changes takes places of a maze for one.
    """
    config = saved_config(saved, options.checkpoint, changes, options.trust or [])
    memory = make("episodic_memory", config.episodic_memory, config.trust)
    live = options.simulator is not None  # a navigator walks there, see `walk_live`
    asked = [options.episodic_memory, options.recogniser, options.map]
    scenes = None
    if not live and asked == [None] * 3 and isinstance(memory, LocalisingMemory):
        source = make("source", config.source, config.trust)
        scenes = load_scenes(config.scene or [], source=source, split=config.split, rooms=config.rooms)
        if all(scene.looks == 1 for scene in scenes):  # their views return bit for bit
            changes = {**changes, **{name: group_options(name, option) for name, option in PLANS.items()}}
            changes["stop.threshold"] = options.threshold or RETURNED
    return load_trained(saved, options.checkpoint, changes, options.trust or [], scenes), changes


def leave_pictures(trained: Trained, facts: Mapping[str, Any], result: Mapping[str, Any]) -> list[str]:
    """A picture of paths in each scene, and a table of goals, in a new folder: an agent of the package has none."""
    policy, protocol = trained.policy, trained.protocol
    name = f"{facts['agent']}_{'+'.join(scene.name for scene in protocol.world.scenes[:DRAWN_SCENES])}"
    folder = next(found for number in count(1) if not (found := Path("evaluations") / f"{name}_{number}").exists())
    folder.mkdir(parents=True)
    written = []
    for index, scene in enumerate(protocol.world.scenes[:DRAWN_SCENES]):
        file = folder / f"paths_{scene.name}.png"
        draw_paths(policy, protocol, index, file, facts=facts)
        written.append(f"paths: {file}")
    write_goals(result["greedy"], folder / "goals.csv")
    columns = [f"  {name:<18}{meaning}" for name, meaning in GOAL_COLUMNS.items()]
    return [*written, f"greedy policy by goal: {folder / 'goals.csv'}, with the columns", *columns]


def check(options: Options) -> None:
    """Refuse options that need others or exclude them, and what cannot be written, before anything takes time."""
    if options.last_steps is not None and options.map is None:
        raise ConfigError(f"last_steps={options.last_steps}: only where a map leads; give map=2 too")
    if options.simulator is None and (options.slip or options.turn_error):
        raise ConfigError("slip, turn_error: only in a live world; give simulator=dump or a YAML file too")
    if options.simulator is not None and (options.viewer or options.map is not None):
        raise ConfigError("simulator: a live world has no viewer and no map; leave them out")
    if options.simulator is not None and (options.arrows or options.panorama):
        raise ConfigError("arrows, panorama: a live world shows neither; leave them out")
    if options.out is not None:
        new_file(options.out, ending="")
    if options.beside is not None and not options.viewer:
        raise ConfigError(f"beside={options.beside}: only the viewer shows two agents; give viewer=true too")


def as_visitors_see(trained: Trained, *, arrows: bool | None, panorama: bool | None) -> Trained:
    """The same agent, which sees the arrows and all headings of its place: if nothing else is asked for, in tours."""
    protocol = trained.protocol
    tour = all(scene.source.startswith("tour") for scene in protocol.world.scenes)
    plans = isinstance(protocol.memory, PlanningMemory | LocalisingMemory)
    if panorama and not plans:
        raise RunError("panorama: needs episodic_memory=planning or localising, which plan with all headings")
    seen: dict[str, Any] = {
        "arrows": tour if arrows is None else arrows,
        "panorama": tour and plans if panorama is None else panorama,
    }
    if protocol.held_out is not None:
        seen["held_out"] = replace(protocol.held_out, **seen)
    return trained._replace(protocol=replace(protocol, **seen))


def measured_by(protocol: EvaluationProtocol, metric: Metric) -> EvaluationProtocol:
    """The protocol with measures of one's own, also for goals that were held out."""
    held_out = None if protocol.held_out is None else replace(protocol.held_out, metric=metric)
    return replace(protocol, metric=metric, held_out=held_out)


def misses_arrivals(trained: Trained) -> bool:
    """Whether the agent stops by correlation in scenes with several looks (docs/results_agent.md)."""
    correlates = isinstance(build_recogniser(trained.config.recogniser, trust=trained.config.trust), NCC)
    return correlates and trained.protocol.world.looks > 1 and trained.config.stop.evaluation == "match"


def few_enough(protocol: EvaluationProtocol) -> EvaluationProtocol:
    """The protocol; with sampled starts where every start makes more than `MOST_EPISODES`, which takes long."""
    count, goals = len(protocol.starts[0]), len(protocol.world.goals)
    each = max(1, MOST_EPISODES // goals)
    if count <= MOST_EPISODES or count <= goals * each:
        return protocol
    print(f"{count} episodes from every start would take long: {each} starts of a goal are sampled (or starts=every)")
    return replace(protocol, starts=sampled_starts(protocol.world, each, protocol.seed))


def walk_live(trained: Trained, options: Options) -> dict[str, Any]:
    """Measures of a navigator in a live world, by policy; each image is encoded when it is first seen."""
    from dirl.agent.navigator import Navigator
    from dirl.evaluation.live_episodes import Remembered, evaluate_live
    from dirl.training.simulation import check_simulator

    config, policy, protocol = trained
    if len(protocol.world.scenes) > 1:
        raise RunError(f"simulator: walks in one scene, not in {len(protocol.world.scenes)}; name it: scene=...")
    scene = protocol.world.scenes[0]
    turns = turns_per_circle(scene.graph)
    if options.simulator == "dump":
        world: LiveWorld = Dumped(scene)
    else:
        simulator = load_simulator(str(options.simulator))
        check_simulator(simulator, scene, str(options.simulator))
        world = Simulated(simulator, step=shortest_move(scene), turns=turns)
    encoder = packaged_encoder(scene.extractor)
    if encoder is None:
        raise RunError(f"{scene.origin}: its features are of no encoder of the package; encode it again")
    chosen: Mapping[str, str | None] = {"recogniser": options.recogniser, "episodic_memory": options.episodic_memory}
    localises = not any(chosen.values()) and isinstance(protocol.memory, LocalisingMemory) and scene.looks == 1
    # A simulator may show the same views again, unless the agent errs in its turns.
    plans = localises and not options.turn_error and repeats(world, state_pose(scene, 0))
    if plans:
        chosen = PLANS
    navigator = Navigator.load(
        options.checkpoint,
        encoder,
        device=config.device,
        trust=options.trust,
        turns=turns,
        **chosen,
    )
    navigator.threshold = (options.threshold or RETURNED) if plans else config.stop.threshold
    navigator.encoder = Remembered(navigator.encoder)
    if options.starts is None:
        each = max(1, LIVE_EPISODES // len(protocol.world.goals))
        protocol = replace(protocol, starts=sampled_starts(protocol.world, each, protocol.seed))
    goal, start = protocol.starts
    states = protocol.world.goals.cpu()[goal.cpu()], start.cpu()

    def live(_: Any, told: bool = False) -> Episodes:
        return evaluate_live(
            navigator,
            Noisy(world, slip=options.slip, turn_error=options.turn_error, seed=config.seed),
            scene,
            states,
            max_steps=protocol.max_steps,
            one_photo=options.goal_view == GoalView.front,
            told=told,
        )

    shortest = shortest_episodes(protocol.world, protocol.starts)
    return {"shortest_path": metrics(shortest), **assess_live(policy, live)}


def with_map(trained: Trained, steps_per_state: float, last_steps: int | None) -> Trained:
    """The agent, with the map of one walk through each scene: its memory's own, or a topological map.

    A topological map leads the policy to ``last_steps`` before its goals. A memory that localises begins its episodes
    with the map, and decides as it does without.
    """
    protocol = trained.protocol
    if protocol.observation.history:
        raise RunError("map: needs a policy that sees four views around it; this one sees its last four")
    if not isinstance(protocol.memory, LocalisingMemory) or protocol.scores is None:
        recogniser = build_recogniser(trained.config.recogniser, protocol.world.device, trained.config.trust)
        memory = GraphMemory(protocol.world, steps_per_state, recogniser=recogniser)
        return trained._replace(
            policy=GuidedPolicy(trained.policy, memory, LAST_STEPS if last_steps is None else last_steps)
        )
    from dirl.evaluation.map_accuracy import map_quality, map_scene

    if last_steps is not None:
        raise RunError(f"last_steps={last_steps}: a memory that localises knows its map to the end; leave it out")
    maps = []
    for index, scene in enumerate(tqdm(protocol.world.scenes, desc="walks", unit=" scenes", disable=None)):
        known, passed = map_scene(
            protocol.world, index, protocol.memory, protocol.scores, steps_per_state, panorama=protocol.panorama
        )
        quality = map_quality(known, passed, protocol.world, index)
        tqdm.write(
            f"map of {scene.name}: {len(passed)} visits, {quality.nodes:.2f} nodes a state, "
            f"{100 * quality.covered:.0f} % of the states, {100 * quality.wrong:.1f} % of the moves wrong"
        )
        maps.append(known)
    return trained._replace(protocol=replace(protocol, maps=maps))


def beside(options: Options, trained: Trained, changes: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
    """The agent of a second checkpoint in the scenes and for the goals of the first, by its name."""
    if options.beside is None:
        return {}
    world = trained.protocol.world
    goals = {name: world.local_goals(index).tolist() for index, name in enumerate(world.names)}
    asked = {"scene": trained.config.scene, "goals": goals, "evaluation.max_steps": trained.protocol.max_steps}
    other = load_trained(load_checkpoint(options.beside), options.beside, {**changes, **asked}, options.trust or [])
    return {agent_name(options.beside): (other.policy, other.protocol)}


def viewer(trained: Trained, facts: Mapping[str, Any], others: Mapping[str, tuple[Any, Any]]) -> dict[str, str]:
    """The pages of the policy's greedy episodes, by file name, under the conditions of the evaluation."""
    config, policy, protocol = trained
    led = policy if isinstance(policy, GuidedPolicy) else None
    recogniser = build_recogniser(config.recogniser, protocol.world.device, config.trust)
    return viewer_pages(
        policy,
        protocol,
        matching=stop_by(recogniser, config.stop.threshold, config.stop.match),
        title=run_title(facts),
        critic=bool(set(config.losses) - {"imitation"}),
        beside=others,
        graphs=None if led is None else led.memory.graphs,
        last_steps=0 if led is None else led.last_steps,
    )


def agent_name(checkpoint: str) -> str:
    """What the viewer calls the agent of a checkpoint: its run's folder, or its name in the package."""
    return (packaged_agent(checkpoint) or run_folder(checkpoint).resolve()).name


def run_folder(checkpoint: str) -> Path:
    """The folder of the run that a checkpoint is of; those of an unfinished run lie one folder deeper."""
    path = Path(checkpoint)
    folder = path if path.is_dir() else path.parent
    return folder.parent if folder.name == "checkpoints" else folder


if __name__ == "__main__":
    run(lambda: main(options), options)
