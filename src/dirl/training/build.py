"""The components of a run, built from its configuration by one function each; and trained policies with theirs."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import torch
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torchrl.envs import Compose, EnvBase, InitTracker, StepCounter, Transform, TransformedEnv

from dirl.config.components import TARGET, Options, components, find_class, make, schedules, tried
from dirl.config.files import read_config
from dirl.config.schemas import Axes, Cache, ConfigError, Device, GoalView, Starts, Stop, TrainConfig
from dirl.envs import Reward, SequentialViews, SurroundingViews
from dirl.envs.transforms import broken_promise, front_only
from dirl.evaluation.episodes import every_start, sampled_starts
from dirl.evaluation.experts import demonstrations, shown_states
from dirl.evaluation.protocol import EvaluationProtocol
from dirl.models import (
    ActorCritic,
    FeatureTable,
    LocalisingMemory,
    ObservationTable,
    PlanningMemory,
    recurrent_keys,
    state_primer,
)
from dirl.models.build import (
    build_policy,
    check_extractor,
    feature_table,
    load_weights,
    pixels_read,
    reads_patches,
    tell_of_turns,
    turns_of_training,
)
from dirl.perception.backbones.registry import encoded_as
from dirl.perception.recognition.recogniser import (
    ScoreFunction,
    StopRule,
    VisitScores,
    build_recogniser,
    set_memory_threshold,
    stop_by,
)
from dirl.runs.checkpoints import Facts, State
from dirl.scenes import Scene, SceneError, load_scenes
from dirl.scenes.catalogue import collection_folder
from dirl.scenes.goals import ChosenGoals, choose_goals
from dirl.scenes.world import Goals, World, make_world
from dirl.training.objectives import ImitationLoss, Losses, ScheduledLoss, trained_parameters
from dirl.training.pairs import Demonstrations, DrawnPairs


def build_world(config: TrainConfig, extractor: str | None = None, scenes: Sequence[Scene] | None = None) -> World:
    """Read the scenes, unless they are given, and join them into a world, on the configured device.

    Scenes with views get the features of ``extractor``, on which a checkpoint was trained, see `encoded_as`.

    Raises:
        SceneError: a scene or goal that does not exist or cannot be used.
        ConfigError: the device is not available, or so many workers are impossible.
    """
    check_device(config.device)
    if scenes is None:
        source = make("source", config.source, config.trust)
        scenes = load_scenes(config.scene or [], source=source, split=config.split, rooms=config.rooms)
    if extractor is not None:
        patches, pixels = reads_patches(config), pixels_read(config)
        scenes = [encoded_as(scene, extractor, patches=patches, pixels=pixels) for scene in scenes]
    workers, agents = config.reinforcement.workers, config.reinforcement.agents_per_scene * len(scenes)
    if workers > agents:
        raise ConfigError(f"reinforcement.workers={workers}: there are only {agents} agents to share among them")
    if workers > 1 and config.device != Device.cpu:
        raise ConfigError(f"reinforcement.workers={workers}: several workers learn on the CPU only; use device=cpu")
    return make_world(scenes, build_goals(config, scenes).trained).to(config.device)


def check_device(device: Device) -> None:
    """Raise `ConfigError` if the device is not available."""
    if device == Device.cuda and not torch.cuda.is_available():
        raise ConfigError("device=cuda: torch sees no CUDA device here; use device=cpu")


def build_goals(config: TrainConfig, scenes: Sequence[Scene]) -> ChosenGoals:
    """Return which goals are trained and which are held out."""
    return choose_goals(scenes, config.goals, config.hold_out, config.seed)


def build_observation(config: TrainConfig, world: World) -> SurroundingViews:
    """Return the transform that computes what agents observe.

    Raises:
        ConfigError: one of your own does not keep its contract, see `dirl.envs.transforms.broken_promise`.
    """
    observation: SurroundingViews = make("observation", config.observation, config.trust, world=world).to(world.device)
    kind = type(observation).__name__
    if type(observation) not in (SurroundingViews, SequentialViews):
        with tried("observation", observation):
            broken = broken_promise(observation)
        if broken:
            raise ConfigError(f"observation: {kind}: {broken}")
    return observation


def build_env(
    config: TrainConfig,
    world: World,
    observation: SurroundingViews,
    policy: nn.Module,
    *,
    agents: int | tuple[int, ...] | None = None,
    seed: int | None = None,
) -> EnvBase:
    """Build the environment of training, with step limit, reward scale, view ids, and the policy's recurrent state.

    ``agents``, how many walk, and the ``seed`` of goals and starts are the configuration's if left out.
    """
    reward, scale = config.reward, config.reward.scale
    stop = stop_table(config, config.stop.training, world)
    if callable(stop):
        raise ConfigError(
            "stop.training=match: in training the stop is a table of states, and in a scene with looks it depends on "
            "them; use stop.training=goal"
        )
    options: Options = config.env
    offered: dict[str, object] = {}
    live = "simulator" in config.env
    if live:
        from dirl.training.simulation import open_live  # late: with it comes all that a navigator needs

        simulator, encode = open_live(config, world, observation)
        options = {**options, "simulator": simulator}
        offered = {"encode": encode, "table": policy.features, "front": observation.goal_view == GoalView.front}
    env: EnvBase = make(
        "env",
        options,
        config.trust,
        world=world,
        num_agents=agents or config.reinforcement.agents_per_scene * len(world.scenes),
        reward=Reward(reward.goal * scale, reward.step * scale, reward.collision * scale),
        stop=stop,
        seed=config.seed if seed is None else seed,
        **offered,
    )
    transforms: list[Transform] = [StepCounter(max_steps=config.reinforcement.max_steps)]
    if not live:  # what is seen live, the environment writes
        transforms.append(observation.clone())
    if recurrent_keys(policy):
        transforms += [InitTracker(), state_primer(policy)]
    return TransformedEnv(env, Compose(*transforms))


def build_demonstrations(config: TrainConfig, world: World, observation: SurroundingViews) -> Demonstrations:
    """Build what the expert shows: rows ``[M]``, see `dirl.evaluation.experts.demonstrations`; or sampled pairs.

    Raises:
        ConfigError: goals of their own, or given by a photo, where there is a table of demonstrations.
        SceneError: a rule for their goals that does not exist, or that leaves a scene without a goal.
    """
    options = config.imitation
    if not options.sampled:
        for name in ("front_only", "goals"):
            if getattr(options, name):
                raise ConfigError(f"imitation.{name}: applies to sampled pairs only; add imitation.sampled=true")
    if options.goals is not None:  # towards goals of their own, but for those that the run holds out
        try:
            chosen: Any = choose_goals(world.scenes, options.goals, seed=config.seed).trained
        except SceneError as error:
            raise SceneError(f"imitation.goals: {error}") from None
        # Which places are held out depends on the run's goals where these are given by number.
        held_out = build_goals(config, world.scenes).held_out
        world = world.with_goals(
            {name: sorted(set(chosen[name]) - set(held_out.get(name, ()))) for name in world.names}
        )
    expert = build_expert(config, world)
    if not options.sampled:
        return demonstrations(world, expert, observation, options.fraction, options.rule, config.seed)
    shown = shown_states(world, options.fraction, options.rule, config.seed)
    return DrawnPairs(world, expert, observation, shown, options.front_only, options.scenes_at_once)


def build_expert(config: TrainConfig, world: World) -> TensorDictModuleBase:
    """Return the expert that labels states with actions; `ConfigError` if it does not give any."""
    expert: TensorDictModuleBase = make("expert", config.expert, config.trust, world=world, seed=config.seed)
    if "expert_action" not in getattr(expert, "out_keys", ()):
        raise ConfigError(f"expert: {type(expert).__name__} is no expert: it writes no expert_action (out_keys)")
    return expert


def build_imitation_loss(config: TrainConfig, policy: ActorCritic) -> nn.Module:
    """Return the loss of the imitation stage: the configured loss named ``imitation``."""
    actor = policy.operator().get_policy_head()
    if "imitation" not in config.losses:
        return ImitationLoss(actor)
    return make("losses.imitation", config.losses["imitation"], config.trust, actor=actor, actor_network=actor)


def build_losses(config: TrainConfig, policy: ActorCritic, world: World, demos: Demonstrations) -> Losses:
    """Return the losses of an update, without imitation losses that have no demonstrations or no weight.

    Raises:
        ConfigError: a policy or loss lacks what training needs, see docs/howto/extend.md.
    """
    if not (hasattr(policy, "trunk") and hasattr(policy, "operator")):
        raise ConfigError(f"policy: {type(policy).__name__} has weights but no trunk() and operator() to train them by")
    operator = policy.operator()
    actor, critic = operator.get_policy_head(), operator.get_value_head()
    offered = {"policy": policy, "actor": actor, "actor_network": actor, "critic_network": critic, "world": world}
    losses = {}
    for full, options in components(config).items():
        group, _, name = full.partition(".")
        if group != "losses":
            continue
        changing = schedules(full, options)
        with torch.random.fork_rng(devices=[]):  # the seed alone decides the weights of a loss's own
            torch.manual_seed(config.seed)
            module = make(full, options, config.trust, **offered)
        kind = type(module).__name__
        if not hasattr(module, "in_keys"):
            raise ConfigError(f"{full}: {kind} has no in_keys; they list what it reads of a batch")
        own_weights = len(trained_parameters(policy, module)) > len(trained_parameters(policy))
        if config.reinforcement.workers > 1 and own_weights:
            raise ConfigError(
                f"{full}: {kind} has weights of its own, which several workers do not share; use one worker"
            )
        loss = ScheduledLoss(module.to(world.device), changing)
        weight = changing["weight"]
        if loss.compares and not len(demos):
            raise ConfigError(f"{full}: {kind} reads demonstrations; use imitation.fraction above 0")
        if not loss.on_demonstrations or (len(demos) and (weight.start or weight.end)):
            losses[name] = loss
    # Of equal losses those on demonstrations come last, whatever the order of the configuration.
    ordered = dict(sorted(losses.items(), key=lambda item: item[1].on_demonstrations))
    return Losses(policy, ordered, demos, config.imitation.batch_size)


def stop_table(config: TrainConfig, rule: Stop, world: World) -> Tensor | StopRule | None:
    """Return where agents stop on the way to each goal, bool ``[P]``, or a `StopRule` if views change; None: at it."""
    if rule == Stop.goal:
        return None
    recogniser = build_recogniser(config.recogniser, world.device, config.trust)
    stop = stop_by(recogniser, config.stop.threshold, config.stop.match)
    return stop(world) if world.looks == 1 else stop.arrived(world)


def build_protocol(
    config: TrainConfig, world: World, observation: SurroundingViews, held_out: Goals = None
) -> EvaluationProtocol:
    """Return the conditions of an evaluation of the world's goals, and apart from them of those ``held_out``, if any.

    Raises:
        ConfigError: the episodic memory cannot serve such a policy.
    """
    options = config.evaluation
    memory = make("episodic_memory", config.episodic_memory, config.trust)
    if isinstance(memory, PlanningMemory | LocalisingMemory) and (observation.history or config.memory[TARGET]):
        raise ConfigError(
            f"episodic_memory: {type(memory).__name__} asks the policy what it would do facing the other views; with "
            "observation=sequential or a memory it depends on earlier steps too: use episodic_memory=none"
        )
    if options.goals is not None:  # so many of each scene, sampled with the seed
        generator = torch.Generator().manual_seed(config.seed)
        some = {}
        for index, name in enumerate(world.names):
            own = world.local_goals(index).cpu()
            some[name] = sorted(own[torch.randperm(len(own), generator=generator)[: options.goals]].tolist())
        world = world.with_goals(some)
    scores = None
    if memory is not None:
        recogniser = build_recogniser(config.recogniser, world.device, config.trust)
        set_memory_threshold(memory, recogniser)
        scores = VisitScores(recogniser, world)
    if isinstance(memory, LocalisingMemory):
        other = torch.nonzero(world.turns != world.turns[0]).flatten().tolist()
        if other:
            first, second = (f"{360 // int(world.turns[index])} in {world.names[index]}" for index in (0, other[0]))
            raise ConfigError(
                f"episodic_memory=localising: turns are of several angles, degrees: {first}, {second}; evaluate scenes "
                "of one angle at a time"
            )
        if config.stop.evaluation == Stop.goal:
            raise ConfigError("stop.evaluation=goal: a LocalisingMemory stops by what it sees; use matching")
        matching = stop_by(recogniser, config.stop.threshold, config.stop.match)
        stop: Tensor | StopRule | ScoreFunction | None = matching.compared(world)
    else:
        stop = stop_table(config, config.stop.evaluation, world)
    return EvaluationProtocol(
        world,
        observation,
        starts=every_start(world)
        if options.starts == Starts.every
        else sampled_starts(world, options.episodes_per_goal, config.seed),
        stop=stop,
        max_steps=options.max_steps,
        seed=config.seed,
        memory=memory,
        scores=scores,
        # Where places change, nothing is seen without errors: neither visits nor goals have the default look.
        looks=range(1, world.looks) if world.looks > 2 else None,
        held_out=build_protocol(config, world.with_goals(held_out), observation) if held_out else None,
    )


def describe(config: TrainConfig, world: World) -> Facts:
    """Return the facts of a run that tables and pictures state: scenes, source, system, preset, seed."""
    names = world.names
    return {
        "scene": names[0] if len(names) == 1 else list(names),
        "source": "+".join(sorted({scene.source for scene in world.scenes})),
        "system": config.system,
        "preset": config.preset,
        "seed": config.seed,
    }


class Trained(NamedTuple):
    """A trained policy."""

    config: TrainConfig
    policy: ActorCritic
    protocol: EvaluationProtocol
    """Where and how it is evaluated."""


def load_trained(
    saved: State,
    origin: str,
    changes: Mapping[str, Any] | None = None,
    trust: Collection[str] = (),
    scenes: Sequence[Scene] | None = None,
) -> Trained:
    """Return the policy of a checkpoint in evaluation mode, and the world of its configuration.

    The ``changes`` are options to replace in its configuration, by dotted name; ``origin`` is where it stood, for
    errors, and ``scenes`` are those of the configuration, if they have been read. For ``trust`` see
    `dirl.config.components.find_class`.

    Raises:
        ConfigError: the configuration, or what it makes, cannot be used; the scenes' features are of another extractor;
            or the weights do not fit.
        SceneError: a scene or goal that does not exist or cannot be used.
    """
    config = saved_config(saved, origin, changes, trust)
    world = build_world(config, saved["extractor"], scenes)
    tell_of_turns(turns_of_training(saved), world.turns.unique().tolist(), origin)
    held_out = build_goals(config, world.scenes).held_out
    if changes and changes.get("seed") is not None:
        config = replace(config, seed=changes["seed"])
    observation = build_observation(config, world)
    check_extractor(saved, world.scenes[0].extractor, origin)
    names = world.names
    if not set(names) <= set(saved["scenes"]) and len(names) == len(saved["scenes"]):
        names = saved["scenes"]  # its heads serve as many others, in order
    table, views = feature_table(config, world, saved["network"], origin), len(observation.order)
    policy = build_policy(config, table, names, world=world, views=views)
    load_weights(policy, saved["network"], origin, names)
    if config.network.cache == Cache.auto and hasattr(policy, "cache"):
        surrounding, front = _seen_of_each(observation, front=False)
        policy.cache(surrounding, views=views, front=front)
    return Trained(config, policy.eval(), build_protocol(config, world, observation, held_out))


def saved_config(saved: State, origin: str, changes: Mapping[str, Any] | None, trust: Collection[str]) -> TrainConfig:
    """Return the configuration of a checkpoint with the changes of `load_trained`, but for the seed.

    Goals are sampled with the seed of the training: with another, trained ones would count as held out.
    """
    given = {name: value for name, value in (changes or {}).items() if name != "seed"}
    if "goals" in given:
        given.setdefault("hold_out", 0.0)
        given.setdefault("evaluation.goals", None)  # all that are named, though the run drew some of its own
    if "scene" in given and collection_folder(given["scene"]) is None:  # else the rooms of the training's split
        # Of other rooms their own goals, from every start, unless something else is said.
        own = {"goals": None, "hold_out": 0.0, "evaluation.goals": None, "evaluation.starts": "every"}
        given = {"split": None, "rooms": None, **own, **given}
    config = read_config(saved["config"], origin, given, trust)
    rooms = None if "scene" in given else collection_folder(config.scene or [])
    if rooms is not None and not rooms.is_dir():
        raise ConfigError(f"{origin}: its training rooms, {rooms}, are not here; say where to evaluate it: scene=...")
    return config


def learning_policy(
    config: TrainConfig,
    world: World,
    observation: SurroundingViews,
    initial: Mapping[str, Tensor] | None = None,
    features: FeatureTable | None = None,
) -> ActorCritic:
    """Return the policy for training; with ``network.cache=auto`` each distinct observation is embedded once.

    It begins with the weights ``initial``, those of another training, or with some sampled with the seed; then it can
    learn in the principal axes of the observations. ``features`` are those of another run in the same world, if there
    is one.
    """
    everywhere = world
    if held_out := build_goals(config, world.scenes).held_out:  # a policy that knows the world walks to all goals
        trained = {name: world.local_goals(index).tolist() for index, name in enumerate(world.names)}
        everywhere = world.with_goals({name: (*trained[name], *held_out[name]) for name in world.names})
    views = len(observation.order)
    live = "simulator" in config.env
    room = config.env["views"] if live else 0  # for views that are not in the world
    table = features or feature_table(config, world, initial, str(config.init), room=room)
    surrounding, front = (None, False) if live else _seen_of_each(observation, front=config.imitation.front_only > 0)
    if (
        features is None
        and config.network.axes == Axes.principal
        and config.network.cache == Cache.auto
        # The encoder itself says which of its layers read a whole observation; what it inherits may not hold.
        and "linear" in vars(find_class("encoder", config.encoder[TARGET], config.trust))
        and initial is None  # given weights would change in the last digit
        and config.imitation.noise == 0  # which is added to features
        and not live
        and not front
        and (surrounding is not None or type(observation) is SequentialViews)  # one's own may hide views at any time
        and len(world) <= world.features.shape[1]  # with more states there is next to nothing to save
    ):
        table = ObservationTable(table, surrounding, views)
    policy: ActorCritic = build_policy(config, table, world.names, world=everywhere, views=views)
    if initial is not None:
        load_weights(policy, initial, str(config.init), world.names)
    if config.network.cache == Cache.auto and hasattr(policy, "cache"):
        policy.cache(surrounding, views=views, front=front)
    return policy


def _seen_of_each(observation: SurroundingViews, *, front: bool) -> tuple[Tensor | None, bool]:
    """Return what is observed in each picture, int64 ``[N, V]``, and whether goals may be given by the front view.

    It is what the transform says, not the world's own: one's own may hide views. None unless the first view id tells
    the others of observation and goal, so that a cache may go by it. ``front`` is whether drawn pairs have such goals,
    see `DrawnPairs`.
    """
    every = torch.arange(observation.pictures, device=observation.surrounding.device)
    seen, goal = observation.reset_view_ids(every), observation.goal_view_ids(every)
    alone = not torch.equal(goal, seen)
    fronts = front or alone
    complete = torch.equal(seen[:, 0], every) and not (alone and not torch.equal(goal, front_only(seen, len(every))))
    if observation.history or not complete or (fronts and bool((seen == len(every)).any())):
        return None, fronts
    return seen, fronts
