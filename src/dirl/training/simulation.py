"""Training and evaluation in a simulator (``env=live``): what they share, made once."""

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

from torch import nn

from dirl.agent.loading import image_encoder, load_parts
from dirl.agent.navigator import Navigator
from dirl.config.components import packages_to_trust
from dirl.config.files import load_simulator
from dirl.config.schemas import ConfigError, GoalView, Stop, TrainConfig
from dirl.envs import SurroundingViews
from dirl.evaluation.episodes import Episodes, sampled_starts
from dirl.evaluation.live_episodes import Remembered, evaluate_live
from dirl.models import plain_weights
from dirl.models.build import reads_patches
from dirl.perception.backbones.registry import packaged_encoder
from dirl.runs.folder import checkpoint_facts
from dirl.scenes import Scene
from dirl.scenes.graph import turns_per_circle
from dirl.scenes.live import Noisy, Simulated, Simulator, shortest_move
from dirl.scenes.world import World


class Live(NamedTuple):
    """A simulator, and what encodes the views in it."""

    simulator: Simulator
    encode: Remembered


def open_live(config: TrainConfig, world: World, observation: SurroundingViews) -> Live:
    """Return the simulator of a run, the same at each call.

    Raises:
        ConfigError: an option that is impossible in a simulator, or another simulator than the scene's.
        SceneError: the simulator does not start.
    """
    options = config.reinforcement
    agents = options.agents_per_scene
    needed = 8 * agents * (options.n_steps + 2)
    for refused, reason in (
        (len(world.scenes) > 1, "one simulator is one scene; name it: scene=..."),
        (world.looks > 1, "the scene has several looks; a simulator has its own"),
        (type(observation) is not SurroundingViews, "agents see four views around them; use observation=surrounding"),
        (options.workers > 1, "one simulator serves all agents; use reinforcement.workers=1"),
        (config.imitation.rounds > 0, "labels of DAgger outlive the views they were given to; use imitation.rounds=0"),
        (config.stop.training != Stop.goal, "agents are stopped by their poses; use stop.training=goal"),
        (config.env["views"] < needed, f"{agents} agents see up to {needed} views between updates; give env.views"),
    ):
        if refused:
            raise ConfigError(f"env=live: {reason}")
    trust = None if config.trust is None else tuple(config.trust)
    return _opened(config.env["simulator"], trust, world.scenes[0], str(config.device), reads_patches(config))


@lru_cache(maxsize=1)
def _opened(file: str, trust: tuple[str, ...] | None, scene: Scene, device: str, patches: bool) -> Live:
    simulator: Simulator = load_simulator(file, trust)
    check_simulator(simulator, scene, file)
    name = packaged_encoder(scene.extractor)
    if name is None:
        raise ConfigError(f"{scene.origin}: its features are of no encoder of the package; encode it again")
    facts = {"extractor": scene.extractor}
    return Live(simulator, Remembered(image_encoder(name, None, facts, scene.origin, device, patches=patches)))


def check_simulator(simulator: Simulator, scene: Scene, file: str) -> None:
    """Raise `ConfigError` unless a scene is a dump of the simulator."""
    if simulator.name != scene.name:
        raise ConfigError(f"simulator={file}: is of {simulator.name}; {scene.origin} is of {scene.name}")


def live_protocol(
    config: TrainConfig, live: Live, world: World, observation: SurroundingViews
) -> Callable[..., Episodes]:
    """Return the evaluation of policies by the navigator's own code in the simulator, with the errors of the training.

    These are the same in each evaluation. What is returned is called as ``live(policy, told=False)``.
    """
    scene = world.scenes[0]
    turns = turns_per_circle(scene.graph)
    beside = checkpoint_facts(config, world, observation.order)
    trust, device = packages_to_trust(config), str(config.device)
    each = max(1, config.evaluation.live_episodes // len(world.goals))
    goal, start = sampled_starts(world, each, config.seed)
    errors = {name: config.env[name] for name in ("slip", "turn_error")}

    def walk(policy: nn.Module, told: bool = False) -> Episodes:
        saved = {**beside, "network": plain_weights(policy)}
        simulated = Simulated(live.simulator, step=shortest_move(scene), turns=turns)
        # What its checkpoint would hold makes the navigator of a policy that is still being trained.
        parts = load_parts(saved, "env=live", live.encode, saved["extractor"], None, {}, device, trust)
        return evaluate_live(
            Navigator(**parts, turns=turns),
            Noisy(simulated, **errors, seed=config.seed),
            scene,
            (world.goals[goal].cpu(), start.cpu()),
            max_steps=config.evaluation.max_steps,
            one_photo=observation.goal_view == GoalView.front,
            told=told,
        )

    return walk
