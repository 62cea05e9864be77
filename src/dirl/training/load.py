"""Policies with weights: new ones for training, and trained ones with their evaluation protocol."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from dirl.config.saved import read_config
from dirl.config.schemas import Axes, Cache, ConfigError, TrainConfig
from dirl.envs import SequentialViews, SurroundingViews
from dirl.envs.transforms import front_only
from dirl.evaluation.protocol import EvaluationProtocol
from dirl.models import FeatureTable, ObservationTable
from dirl.models.build import build_policy, feature_table, reads_linearly
from dirl.models.weights import check_extractor, load_weights, tell_of_turns, turns_of_training
from dirl.runs.checkpoints import load_checkpoint
from dirl.runs.paths import ARCHITECTURE, initial_weights_file
from dirl.scenes import World
from dirl.scenes.catalogue import collection_folder
from dirl.scenes.scene import turns_of
from dirl.training.build import build_goals, build_observation, build_protocol, build_world


class Trained(NamedTuple):
    """A trained policy."""

    config: TrainConfig
    policy: nn.Module
    protocol: EvaluationProtocol
    """Where and how it is evaluated."""


def load_trained(
    saved: Mapping[str, Any],
    origin: str,
    changes: Mapping[str, Any] | None = None,
    trust: Collection[str] = (),
) -> Trained:
    """The policy of a checkpoint, in the world of its configuration.

    Args:
        saved: see `dirl.runs.checkpoints.load_checkpoint`.
        origin: where it stood, for errors.
        changes: options to replace in its configuration, by dotted name.
        trust: packages whose classes it may name, see `dirl.config.components.find_class`.

    Raises:
        ConfigError: the configuration, or what it makes, cannot be used; or the weights do not fit.
        SceneError: a scene or goal that does not exist or cannot be used.
    """
    given = dict(changes or {})
    if "goals" in given:
        given.setdefault("hold_out", 0.0)
        given.setdefault("evaluation.goals", None)  # all that are named, though the run drew some of its own
    if "scene" in given and collection_folder(given["scene"]) is None:  # else the rooms of the training's split
        # Of other rooms their own goals, from every start, unless something else is said.
        own = {"goals": None, "hold_out": 0.0, "evaluation.goals": None, "evaluation.starts": "every"}
        given = {"split": None, "rooms": None, **own, **given}
    # Goals are sampled with the seed of the training: with another, trained ones would count as held out.
    seed = given.pop("seed", None)
    config = read_config(saved["config"], origin, given, trust)
    rooms = None if "scene" in given else collection_folder(config.scene or [])
    if rooms is not None and not rooms.is_dir():
        raise ConfigError(f"{origin}: its training rooms, {rooms}, are not here; say where to evaluate it: scene=...")
    world = build_world(config, saved["extractor"])
    tell_of_turns(turns_of_training(saved), turns_of(world.scenes), origin)
    held_out = build_goals(config, world.scenes).held_out
    if seed is not None:
        config = replace(config, seed=seed)
    observation = build_observation(config, world)
    policy = trained_policy(saved, origin, config, world, observation)
    return Trained(config, policy, build_protocol(config, world, observation, held_out))


def learning_policy(
    config: TrainConfig,
    world: World,
    observation: SurroundingViews,
    initial: Mapping[str, Tensor] | None = None,
    features: FeatureTable | None = None,
) -> nn.Module:
    """The policy for training; with ``network.cache=auto`` each distinct observation is embedded once.

    It begins with the weights ``initial``, see `initial_weights`, or with some sampled with the seed; then it can learn
    in the principal axes of the observations. ``features`` are those of another run in the same world, if there is one.
    """
    everywhere = world
    if held_out := build_goals(config, world.scenes).held_out:  # a policy that knows the world walks to all goals
        trained = {name: world.local_goals(index).tolist() for index, name in enumerate(world.names)}
        everywhere = world.with_goals({name: (*trained[name], *held_out[name]) for name in world.names})
    views = len(observation.order)
    live = config.env.get("simulator") is not None  # then more views are seen than those of the world
    room = config.env["views"] if live else 0
    table = features or feature_table(config, world, initial, str(config.init), room=room)
    noisy = config.imitation.noise > 0
    surrounding, front = (None, False) if live else _seen_of_each(observation, front=config.imitation.front_only > 0)
    if (
        features is None
        and config.network.axes == Axes.principal
        and config.network.cache == Cache.auto
        and reads_linearly(config)
        and initial is None  # given weights would change in the last digit
        and not noisy  # which is added to features
        and not live
        and not front
        and (surrounding is not None or type(observation) is SequentialViews)  # one's own may hide views at any time
        and len(world) <= world.features.shape[1]  # with more states there is next to nothing to save
    ):
        table = ObservationTable(table.features, table.mean, table.std, table.axes, surrounding, views)
    policy: Any = build_policy(config, table, world.names, world=everywhere, views=views)
    if initial is not None:
        load_weights(policy, initial, str(config.init), world.names)
    if config.network.cache == Cache.auto and hasattr(policy, "cache"):
        policy.cache(surrounding, views=views, front=front)
    return policy


def _seen_of_each(observation: SurroundingViews, *, front: bool) -> tuple[Tensor | None, bool]:
    """What is observed in each picture, int64 ``[N, V]``, and whether goals may be given by their front view alone.

    It is what the transform says, not the world's own: one's own may hide views. None unless the first view id tells
    the others of observation and goal, so that a cache may go by it. ``front`` is whether drawn pairs have such goals,
    see `DrawnPairs`.
    """
    every = torch.arange(observation.pictures, device=observation.surrounding.device)
    seen, goal = observation.reset_view_ids(every), observation.goal_view_ids(every)
    alone = not torch.equal(goal, seen)
    fronts = front or alone
    told = torch.equal(seen[:, 0], every) and not (alone and not torch.equal(goal, front_only(seen, len(every))))
    if observation.history or not told or (fronts and bool((seen == len(every)).any())):
        return None, fronts
    return seen, fronts


def trained_policy(
    saved: Mapping[str, Any], origin: str, config: TrainConfig, world: World, observation: SurroundingViews
) -> nn.Module:
    """The policy of a checkpoint, see `load_trained`, in a world of its configuration or with other goals.

    Raises:
        ConfigError: the scenes' features are of another extractor, or the weights do not fit the configuration.
    """
    check_extractor(saved, world.scenes[0].extractor, origin)
    names = world.names
    if not set(names) <= set(saved["scenes"]) and len(names) == len(saved["scenes"]):
        names = saved["scenes"]  # its heads serve as many others, in order
    table, views = feature_table(config, world, saved["network"], origin), len(observation.order)
    policy: Any = build_policy(config, table, names, world=world, views=views)
    load_weights(policy, saved["network"], origin, names)
    if config.network.cache == Cache.auto and hasattr(policy, "cache"):
        surrounding, front = _seen_of_each(observation, front=False)
        policy.cache(surrounding, views=views, front=front)
    return policy


def with_architecture(config: TrainConfig, overrides: Sequence[str]) -> tuple[TrainConfig, Mapping[str, Any] | None]:
    """The configuration with the architecture of the checkpoint that ``init`` names, and that checkpoint.

    Without ``init`` the configuration is unchanged, and there is no checkpoint.

    Raises:
        ConfigError: an option of the architecture is given beside ``init``.
        RunError: there is no such checkpoint, or it is damaged.
    """
    if config.init is None:
        return config, None
    saved = load_checkpoint(initial_weights_file(config.init, overrides))
    trained = read_config(saved["config"], config.init, trust=config.trust or [])
    return replace(config, **{name: getattr(trained, name) for name in ARCHITECTURE}), saved


def initial_weights(
    config: TrainConfig, world: World, saved: Mapping[str, Any] | None = None
) -> Mapping[str, Tensor] | None:
    """The weights that a training begins with, by name; None without ``init``.

    ``saved`` is the checkpoint that ``init`` names, if it has been read, or the one that the run itself resumes from.

    Raises:
        ConfigError: they were trained on the features of another extractor, or have heads for other scenes.
        RunError: there is no such checkpoint, or it is damaged.
    """
    if config.init is None:
        return None
    saved = saved or load_checkpoint(config.init)
    check_extractor(saved, world.scenes[0].extractor, f"init={config.init}")
    unknown = sorted(set(world.names) - set(saved["scenes"]))
    if unknown and not config.heads.get("shared"):
        raise ConfigError(f"init={config.init}: has heads for the scenes {saved['scenes']}, none for {unknown[0]}")
    return saved["network"]
