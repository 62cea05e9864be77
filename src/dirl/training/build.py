"""From a configuration to the parts of a run: the one place where they are put together, for every recipe."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDict
from torch import Tensor
from torch.optim import Optimizer
from torchrl.envs import Compose, EnvBase, StepCounter, TransformedEnv

from dirl.config.schemas import (
    Axes,
    ConfigError,
    Device,
    Optimiser,
    PolicyName,
    Starts,
    Stop,
    TrainConfig,
    parse_config,
)
from dirl.envs import OBSERVATIONS, NavigationEnv, Reward, SurroundingViews
from dirl.evaluation import (
    Episodes,
    evaluate,
    every_start,
    random_policy,
    report,
    run_episodes,
    sampled_starts,
    shortest_episodes,
    trajectories,
)
from dirl.experts import demonstrations
from dirl.models import Network, feature_statistics, make_network
from dirl.objectives import TFRMSprop
from dirl.runs.folder import RunError
from dirl.scenes import World, load_scenes, make_world
from dirl.scenes.matching import TemplateStop


@dataclass(frozen=True)
class Parts:
    """What the stages of a run work on."""

    config: TrainConfig
    world: World
    sight: SurroundingViews
    """What agents see."""
    network: Network
    demos: TensorDict
    """The expert's, ``[M]``, with views."""
    starts: tuple[Tensor, Tensor]
    """Goal index and start state of each episode of an evaluation, int64 ``[E]`` each."""
    stop: Tensor | None
    """Where an evaluated agent stops on its way to each goal, bool ``[G, N]``; None = exactly at the goal."""


def build_parts(config: TrainConfig) -> Parts:
    """Read the scenes and make everything that a run needs; decided by the configuration alone.

    Raises:
        SceneError: a scene or goal that does not exist or cannot be used.
        ValueError: an option that no part accepts, or a device that is not there.
    """
    if config.device == Device.cuda and not torch.cuda.is_available():
        raise ConfigError("device=cuda: torch sees no CUDA device here; use device=cpu")
    scenes = load_scenes(config.scene or [], source=config.source.name, root=config.source.root)
    workers, agents = config.reinforcement.workers, config.reinforcement.agents_per_scene * len(scenes)
    if workers > agents:
        raise ConfigError(f"reinforcement.workers={workers}: there are only {agents} agents to share among them")
    if workers > 1 and config.device != Device.cpu:
        raise ConfigError(f"reinforcement.workers={workers}: several workers learn on the CPU only; use device=cpu")
    world = make_world(scenes, config.goals).to(config.device)
    sight = OBSERVATIONS[config.observation](world).to(world.device)
    network = make_network(
        world.features,
        world.names,
        statistics=feature_statistics(world.features) if config.network.standardise else None,
        heads=config.network.heads,
        width=config.network.width,
        seed=config.seed,
    )
    # A demonstrated state has no history: the expert is seen there as at the start of an episode.
    demos = demonstrations(world, config.imitation.share, config.imitation.rule, config.seed)
    testing = config.evaluation
    return Parts(
        config=config,
        world=world,
        sight=sight,
        network=network.to(world.device),
        demos=demos.update({"views": sight.begin(demos["state"]), "goal_views": sight.begin(demos["goal"])}),
        starts=every_start(world)
        if testing.starts == Starts.every
        else sampled_starts(world, testing.episodes_per_goal, config.seed),
        stop=_stop_table(config, config.stop.evaluation, world),
    )


def learning_parts(config: TrainConfig) -> Parts:
    """`build_parts`, with the network in the axes it shall learn in."""
    parts = build_parts(config)
    world = parts.world
    # With more states than features of a view there is next to nothing to save.
    if config.network.axes == Axes.principal and len(world) <= world.features.shape[1]:
        parts.network.encoder.use_principal_axes(None if parts.sight.history else world.surrounding)
    return parts


def trained_parts(saved: Mapping[str, Any], origin: str, changes: Mapping[str, Any] | None = None) -> Parts:
    """The parts of a run with the weights of a checkpoint.

    Args:
        saved: see `dirl.runs.folder.load_checkpoint`.
        origin: where it stood, for errors.
        changes: options to replace in its configuration, by dotted name.

    Raises:
        RunError: the scenes' features are of another extractor than those it was trained on.
        ConfigError, SceneError: see `build_parts`.
    """
    parts = build_parts(parse_config(saved["config"], origin=origin, changes=changes))
    extractor = parts.world.scenes[0].extractor
    if extractor != saved["extractor"]:
        raise RunError(
            f"the scenes' features are of another extractor than those {origin} was trained on: "
            f"'{extractor}', not '{saved['extractor']}'"
        )
    parts.network.load_state_dict(saved["network"])
    return parts


def _stop_table(config: TrainConfig, rule: Stop, world: World) -> Tensor | None:
    return TemplateStop(config.stop.threshold, config.stop.match)(world) if rule == Stop.match else None


def build_env(parts: Parts, *, agents: int | None = None, seed: int | None = None) -> EnvBase:
    """The environment of training, with step limit, reward scale and views.

    Args:
        parts: of the run.
        agents: how many walk in it; all of them if left out.
        seed: of goals and starts; the configuration's if left out.
    """
    config, world = parts.config, parts.world
    reward, scale = config.reward, config.reward.scale
    env = NavigationEnv(
        world,
        agents or config.reinforcement.agents_per_scene * len(world.scenes),
        reward=Reward(reward.goal * scale, reward.step * scale, reward.collision * scale),
        stop=_stop_table(config, config.stop.training, world),
        seed=config.seed if seed is None else seed,
    )
    return TransformedEnv(env, Compose(StepCounter(max_steps=config.reinforcement.max_steps), parts.sight))


def build_optimiser(parts: Parts) -> Optimizer:
    """The optimiser of reinforcement."""
    options, weights = parts.config.optimiser, parts.network.parameters()
    if options.name == Optimiser.adam:
        return torch.optim.Adam(weights, lr=options.lr, eps=options.eps, fused=True)
    return TFRMSprop(weights, lr=options.lr, eps=options.eps)


def run_policy(parts: Parts, *, greedy: bool = True) -> Episodes:
    """One episode from each of the evaluation's starts, with the network as it is now."""
    return evaluate(parts.network, parts.world, parts.starts, greedy=greedy, **_conditions(parts))


def run_random(parts: Parts) -> Episodes:
    """The same for a random walker, which the environment stops: it shall only be lost, not also misled."""
    conditions = {**_conditions(parts), "stop": None}
    return run_episodes(random_policy, parts.world, parts.starts, greedy=False, **conditions)


def run_trajectories(
    parts: Parts, starts: tuple[Tensor, Tensor], *, greedy: bool = True
) -> tuple[Episodes, list[list[int]]]:
    """Episodes from given starts, and the states that each passed."""
    return trajectories(parts.network, parts.world, starts, greedy=greedy, **_conditions(parts))


def describe(parts: Parts) -> dict[str, Any]:
    """What a table or picture of a run must say of it."""
    names = parts.world.names
    return {
        "scene": names[0] if len(names) == 1 else list(names),
        "source": parts.world.source,
        "system": parts.config.system,
        "preset": parts.config.preset,
        "seed": parts.config.seed,
        "demonstrations": len(parts.demos),
    }


def assess(parts: Parts) -> dict[str, dict[str, Any]]:
    """The measures of the policy, greedy and sampled, and of shortest path and random, from the same starts.

    Where the policy is one of the latter two, greedy and sampled are the same.
    """
    world, policy = parts.world, parts.config.policy
    baselines = {
        "shortest_path": report(shortest_episodes(world, parts.starts), world),
        "random": report(run_random(parts), world),
    }
    if policy != PolicyName.network:
        return {**baselines, "greedy": baselines[policy], "sampled": baselines[policy]}
    return {
        **baselines,
        "greedy": report(run_policy(parts), world),
        "sampled": report(run_policy(parts, greedy=False), world),
    }


def _conditions(parts: Parts) -> dict[str, Any]:
    config = parts.config
    limit = config.evaluation.max_steps
    return {"sight": parts.sight, "stop": parts.stop, "max_steps": limit, "seed": config.seed}
