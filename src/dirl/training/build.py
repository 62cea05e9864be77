"""The components of a run, built from its configuration by one function each."""

from collections.abc import Sequence
from typing import Any

import torch
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torch.optim import Optimizer
from torchrl.envs import Compose, EnvBase, InitTracker, StepCounter, TransformedEnv

from dirl.config.components import TARGET, components, make, schedules
from dirl.config.schemas import ConfigError, Device, GoalView, Starts, Stop, TrainConfig
from dirl.config.user_code import CODE, describe_error
from dirl.envs import Reward, SequentialViews, SurroundingViews
from dirl.envs.transforms import broken_promise
from dirl.evaluation.episodes import every_start, sampled_starts
from dirl.evaluation.experts import demonstrations, shown_states
from dirl.evaluation.protocol import EvaluationProtocol
from dirl.models import LocalisingMemory, PlanningMemory, recurrent_keys, state_primer
from dirl.models.build import reads_patches
from dirl.perception.backbones.registry import encoded_as
from dirl.perception.recognition.build import build_recogniser, matching, set_memory_threshold
from dirl.perception.recognition.matching import ScoreFunction, StopRule
from dirl.perception.recognition.tables import VisitScores
from dirl.scenes import Scene, SceneError, World, load_scenes, make_world
from dirl.scenes.goals import ChosenGoals, choose_goals
from dirl.scenes.world import Goals
from dirl.training.live import open_live
from dirl.training.losses import Losses, ScheduledLoss, trained_parameters
from dirl.training.objectives import ImitationLoss
from dirl.training.pairs import Demonstrations, DrawnPairs
from dirl.training.trials import try_expert


def build_world(config: TrainConfig, extractor: str | None = None) -> World:
    """Read the scenes and join them into a world, on the configured device.

    Scenes with views get the features of ``extractor``, on which a checkpoint was trained, see `encoded_as`.

    Raises:
        SceneError: a scene or goal that does not exist or cannot be used.
        ConfigError: the device is not available, or so many workers are impossible.
    """
    if config.device == Device.cuda and not torch.cuda.is_available():
        raise ConfigError("device=cuda: torch sees no CUDA device here; use device=cpu")
    source = make("source", config.source, config.trust)
    scenes = load_scenes(config.scene or [], source=source, split=config.split, rooms=config.rooms)
    if extractor is not None:
        scenes = [encoded_as(scene, extractor, patches=reads_patches(config)) for scene in scenes]
    workers, agents = config.reinforcement.workers, config.reinforcement.agents_per_scene * len(scenes)
    if workers > agents:
        raise ConfigError(f"reinforcement.workers={workers}: there are only {agents} agents to share among them")
    if workers > 1 and config.device != Device.cpu:
        raise ConfigError(f"reinforcement.workers={workers}: several workers learn on the CPU only; use device=cpu")
    return make_world(scenes, build_goals(config, scenes).trained).to(config.device)


def build_goals(config: TrainConfig, scenes: Sequence[Scene]) -> ChosenGoals:
    """Which goals are trained and which are held out."""
    return choose_goals(scenes, config.goals, config.hold_out, config.seed)


def build_observation(config: TrainConfig, world: World) -> SurroundingViews:
    """The transform that computes what agents observe.

    Raises:
        ConfigError: one of your own does not keep its contract, see `dirl.envs.transforms.broken_promise`.
    """
    made: SurroundingViews = make("observation", config.observation, config.trust, world=world).to(world.device)
    kind = type(made).__name__
    if type(made) not in (SurroundingViews, SequentialViews):
        try:
            broken = broken_promise(made)
        except CODE as error:
            broken = f"cannot be asked what is seen: {describe_error(error, type(made))}"
        if broken:
            raise ConfigError(f"observation: {kind}: {broken}")
    return made


def build_env(
    config: TrainConfig,
    world: World,
    observation: SurroundingViews,
    policy: nn.Module,
    *,
    agents: int | tuple[int, ...] | None = None,
    seed: int | None = None,
) -> EnvBase:
    """The environment of training, with step limit, reward scale, view ids, and the policy's recurrent state if any.

    ``agents``, how many walk, and the ``seed`` of goals and starts are the configuration's if left out.
    """
    reward, scale = config.reward, config.reward.scale
    stop = stop_table(config, config.stop.training, world)
    if callable(stop):
        raise ConfigError(
            "stop.training=match: in training the stop is a table of states, and in a scene with looks it depends on "
            "them; use stop.training=goal"
        )
    live = open_live(config, world, observation)
    offered: dict[str, Any] = {}
    if live is not None:
        front = observation.goal_view == GoalView.front
        offered = {"encode": live.encode, "table": policy.features, "front": front}
    env: EnvBase = make(
        "env",
        config.env if live is None else {**config.env, "simulator": live.simulator},
        config.trust,
        world=world,
        num_agents=agents or config.reinforcement.agents_per_scene * len(world.scenes),
        reward=Reward(reward.goal * scale, reward.step * scale, reward.collision * scale),
        stop=stop,
        seed=config.seed if seed is None else seed,
        **offered,
    )
    transforms: list[Any] = [StepCounter(max_steps=config.reinforcement.max_steps)]
    transforms += [observation.clone()] if live is None else []  # what is seen live, the environment writes
    if recurrent_keys(policy):
        transforms += [InitTracker(), state_primer(policy)]
    return TransformedEnv(env, Compose(*transforms))


def build_demonstrations(config: TrainConfig, world: World, observation: SurroundingViews) -> Demonstrations:
    """What the expert shows: rows ``[M]``, see `dirl.evaluation.experts.demonstrations`; or pairs that are sampled.

    Raises:
        ConfigError: goals of their own, or given by a photo, where there is a table of demonstrations.
        SceneError: a rule for their goals that does not exist, or that leaves a scene without a goal.
    """
    options = config.imitation
    if not options.sampled:
        for name in ("front_only", "goals"):
            if getattr(options, name):
                raise ConfigError(f"imitation.{name}: applies to sampled pairs only; add imitation.sampled=true")
    if options.goals is not None:
        world = _towards(config, world, options.goals)
    expert = build_expert(config, world)
    if not options.sampled:
        return demonstrations(world, expert, observation, options.fraction, options.rule, config.seed)
    shown = shown_states(world, options.fraction, options.rule, config.seed)
    return DrawnPairs(world, expert, observation, shown, options.front_only, options.scenes_at_once)


def _towards(config: TrainConfig, world: World, rule: str) -> World:
    """The world with the goals that the expert walks to: those of a rule without those held out."""
    try:
        chosen: Any = choose_goals(world.scenes, rule, seed=config.seed).trained
    except SceneError as error:
        raise SceneError(f"imitation.goals: {error}") from None
    # Which places are held out depends on the run's goals where these are given by number.
    held_out = build_goals(config, world.scenes).held_out
    return world.with_goals({name: sorted(set(chosen[name]) - set(held_out.get(name, ()))) for name in world.names})


def build_expert(config: TrainConfig, world: World) -> TensorDictModuleBase:
    """The expert that labels states with actions."""
    made: TensorDictModuleBase = make("expert", config.expert, config.trust, world=world, seed=config.seed)
    if "expert_action" not in getattr(made, "out_keys", ()):
        raise ConfigError(f"expert: {type(made).__name__} is no expert: it writes no expert_action (out_keys)")
    if not type(made).__module__.startswith("dirl."):  # another one is tried, as it may draw from a generator
        try_expert(make("expert", config.expert, config.trust, world=world, seed=config.seed), world)
    return made


def build_imitation_loss(config: TrainConfig, policy: Any) -> Any:
    """The loss of the imitation stage: the configured loss named ``imitation``."""
    actor = policy.operator().get_policy_head()
    if "imitation" not in config.losses:
        return ImitationLoss(actor)
    return make("losses.imitation", config.losses["imitation"], config.trust, actor=actor, actor_network=actor)


def build_losses(config: TrainConfig, policy: Any, world: World, demos: Demonstrations) -> Losses:
    """The losses of an update, without imitation losses that have no demonstrations or no weight.

    Raises:
        ConfigError: a policy or loss lacks what training needs, see docs/howto/extend.md.
    """
    if not (hasattr(policy, "trunk") and hasattr(policy, "operator")):
        raise ConfigError(f"policy: {type(policy).__name__} has weights but no trunk() and operator() to train them by")
    operator = policy.operator()
    actor, critic = operator.get_policy_head(), operator.get_value_head()
    offered = {"policy": policy, "actor": actor, "actor_network": actor, "critic_network": critic, "world": world}
    found = {}
    for full, options in components(config).items():
        group, _, name = full.partition(".")
        if group != "losses":
            continue
        changing = schedules(full, options)
        with torch.random.fork_rng(devices=[]):  # the seed alone decides the weights of a loss's own
            torch.manual_seed(config.seed)
            module = make(full, options, config.trust, **offered)
        _check_loss(full, module, policy, config.reinforcement.workers)
        loss = ScheduledLoss(module.to(world.device), changing)
        weight = changing["weight"]
        if loss.compares and not len(demos):
            raise ConfigError(f"{full}: {type(module).__name__} reads demonstrations; use imitation.fraction above 0")
        if not loss.on_demonstrations or (len(demos) and (weight.start or weight.end)):
            found[name] = loss
    # Of equal losses those on demonstrations come last, whatever the order of the configuration.
    ordered = dict(sorted(found.items(), key=lambda item: item[1].on_demonstrations))
    return Losses(policy, ordered, demos, config.imitation.batch_size)


def _check_loss(name: str, module: Any, policy: nn.Module, workers: int) -> None:
    """Raise `ConfigError` if a loss does not say what it reads, or has weights that workers do not share."""
    kind = type(module).__name__
    if not hasattr(module, "in_keys"):
        raise ConfigError(f"{name}: {kind} has no in_keys; they list what it reads of a batch")
    if workers > 1 and len(trained_parameters(policy, module)) > len(trained_parameters(policy)):
        raise ConfigError(f"{name}: {kind} has weights of its own, which several workers do not share; use one worker")


def build_optimiser(config: TrainConfig, policy: nn.Module, losses: nn.Module | None = None) -> Optimizer:
    """The optimiser of the policy's weights, and of the losses' own."""
    return make("optimiser", config.optimiser, config.trust, params=trained_parameters(policy, losses))


def stop_table(config: TrainConfig, rule: Stop, world: World) -> Tensor | StopRule | None:
    """Where an agent stops on its way to each goal, bool ``[P]``, in a world that changes a `StopRule`; None: at it."""
    if rule == Stop.goal:
        return None
    stop = matching(config, world.device)
    return stop(world) if world.looks == 1 else stop.arrived(world)


def build_protocol(
    config: TrainConfig, world: World, observation: SurroundingViews, held_out: Goals = None
) -> EvaluationProtocol:
    """The conditions of an evaluation of the world's goals, and apart from them of those ``held_out``, if any.

    Raises:
        ConfigError: the episodic memory cannot serve such a policy.
    """
    options = config.evaluation
    memory = make("episodic_memory", config.episodic_memory, config.trust)
    recogniser = build_recogniser(config, world.device)
    set_memory_threshold(memory, recogniser)
    if isinstance(memory, PlanningMemory | LocalisingMemory) and (observation.history or config.memory[TARGET]):
        raise ConfigError(
            f"episodic_memory: {type(memory).__name__} asks the policy what it would do facing the other views; with "
            "observation=sequential or a memory it depends on earlier steps too: choose episodic_memory=counts or none"
        )
    if options.goals is not None:
        world = world.with_goals(_some_goals(world, options.goals, config.seed))
    if isinstance(memory, LocalisingMemory):
        other = torch.nonzero(world.turns != world.turns[0]).flatten().tolist()
        if other:
            first, second = (f"{360 // int(world.turns[one])} in {world.names[one]}" for one in (0, other[0]))
            raise ConfigError(
                f"episodic_memory=localising: turns are of several angles, degrees: {first}, {second}; evaluate scenes "
                "of one angle at a time"
            )
        if config.stop.evaluation == Stop.goal:
            raise ConfigError("stop.evaluation=goal: a LocalisingMemory stops by what it sees; use matching")
        stop: Tensor | StopRule | ScoreFunction | None = matching(config, world.device).compared(world)
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
        scores=None if memory is None else VisitScores(recogniser, world),
        # Where places change, nothing is seen without errors: neither visits nor goals have the default look.
        looks=range(1, world.looks) if world.looks > 2 else None,
        held_out=build_protocol(config, world.with_goals(held_out), observation) if held_out else None,
    )


def _some_goals(world: World, count: int, seed: int) -> dict[str, list[int]]:
    """Up to so many goals of each scene, sampled with the seed."""
    generator = torch.Generator().manual_seed(seed)
    chosen = {}
    for index, name in enumerate(world.names):
        own = world.local_goals(index).cpu()
        chosen[name] = sorted(own[torch.randperm(len(own), generator=generator)[:count]].tolist())
    return chosen


def describe(config: TrainConfig, world: World) -> dict[str, Any]:
    """The facts of a run that tables and pictures state: scenes, source, system, preset, seed."""
    names = world.names
    return {
        "scene": names[0] if len(names) == 1 else list(names),
        "source": world.source,
        "system": config.system,
        "preset": config.preset,
        "seed": config.seed,
    }
