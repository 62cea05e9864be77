"""What can be set, with its type; the values are in ``conf/``. The rest of the package takes plain arguments."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from omegaconf import MISSING, DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError  # PyYAML comes with OmegaConf

Device = StrEnum("Device", ["cpu", "cuda"])
SourceName = StrEnum("SourceName", ["rooms", "thor"])
Observation = StrEnum("Observation", ["surrounding", "sequential"])
Axes = StrEnum("Axes", ["features", "principal"])
Precision = StrEnum("Precision", ["float32", "bfloat16"])
Heads = StrEnum("Heads", ["scene", "shared"])
Rule = StrEnum("Rule", ["interval", "interval_pos", "random"])
Objective = StrEnum("Objective", ["a2c", "ppo", "none"])
PolicyName = StrEnum("PolicyName", ["network", "random", "shortest_path"])
ExperimentName = StrEnum("ExperimentName", ["table1", "table2", "fig4", "fig5", "fig6", "fig7", "fig8", "stop"])
Existing = StrEnum("Existing", ["refuse", "keep"])
Optimiser = StrEnum("Optimiser", ["adam", "tf_rmsprop"])
Reduction = StrEnum("Reduction", ["mean", "sum"])
Stop = StrEnum("Stop", ["goal", "match"])
Match = StrEnum("Match", ["views", "front"])
Starts = StrEnum("Starts", ["every", "sampled"])
LoggerName = StrEnum("LoggerName", ["csv", "wandb", "tensorboard"])


class ConfigError(ValueError):
    """A configuration that cannot be run; the message says which option, and what it may be."""


@dataclass
class SourceConfig:
    """Where scenes are looked up by name."""

    name: SourceName = MISSING
    root: str | None = MISSING


@dataclass
class NetworkConfig:
    """The network."""

    heads: Heads = MISSING
    width: int = MISSING
    standardise: bool = MISSING
    axes: Axes = MISSING


@dataclass
class ImitationConfig:
    """Behaviour cloning."""

    share: float = MISSING
    rule: Rule = MISSING
    lr: float = MISSING
    max_steps: int = MISSING
    enough: float = MISSING
    keep: float = MISSING
    rounds: int = MISSING
    walk: int = MISSING


@dataclass
class ObjectiveConfig:
    """The actor-critic loss."""

    name: Objective = MISSING
    epochs: int = MISSING
    minibatches: int = MISSING
    clip: float = MISSING


@dataclass
class OptimiserConfig:
    """How reinforcement changes the weights."""

    name: Optimiser = MISSING
    lr: float = MISSING
    eps: float = MISSING
    max_norm: float = MISSING
    clip_each: bool = MISSING


@dataclass
class ReinforcementConfig:
    """Actor-critic training."""

    frames_per_scene: int = MISSING
    agents_per_scene: int = MISSING
    workers: int = MISSING
    steps: int = MISSING
    max_steps: int = MISSING
    gamma: float = MISSING
    lmbda: float = MISSING
    entropy: float = MISSING
    final_entropy: float = MISSING
    value: float = MISSING
    reduction: Reduction = MISSING


@dataclass
class RewardConfig:
    """What a step earns."""

    goal: float = MISSING
    step: float = MISSING
    collision: float = MISSING
    scale: float = MISSING


@dataclass
class StopConfig:
    """Who says that the goal has been reached."""

    training: Stop = MISSING
    evaluation: Stop = MISSING
    threshold: float = MISSING
    match: Match = MISSING


@dataclass
class EvaluationConfig:
    """How a policy is measured."""

    starts: Starts = MISSING
    episodes_per_goal: int = MISSING
    max_steps: int = MISSING
    times: int = MISSING


@dataclass
class CheckpointConfig:
    """When the state of a run is saved."""

    every_seconds: float = MISSING
    keep: int = MISSING


@dataclass
class LoggerConfig:
    """Where metrics go besides the CSV files of the run folder."""

    name: LoggerName = MISSING
    project: str = MISSING


@dataclass
class TrainConfig:
    """Everything ``recipes/train.py`` takes."""

    scene: Any = None
    goals: Any = None
    seed: int = MISSING
    device: Device = MISSING
    precision: Precision = MISSING
    resume: str | None = None
    existing: Existing = MISSING
    system: str = MISSING
    preset: str = MISSING
    policy: PolicyName = MISSING
    observation: Observation = MISSING
    source: SourceConfig = field(default_factory=SourceConfig)
    network: NetworkConfig = field(default_factory=NetworkConfig)
    imitation: ImitationConfig = field(default_factory=ImitationConfig)
    objective: ObjectiveConfig = field(default_factory=ObjectiveConfig)
    optimiser: OptimiserConfig = field(default_factory=OptimiserConfig)
    reinforcement: ReinforcementConfig = field(default_factory=ReinforcementConfig)
    reward: RewardConfig = field(default_factory=RewardConfig)
    stop: StopConfig = field(default_factory=StopConfig)
    evaluation: EvaluationConfig = field(default_factory=EvaluationConfig)
    checkpoint: CheckpointConfig = field(default_factory=CheckpointConfig)
    logger: LoggerConfig = field(default_factory=LoggerConfig)


@dataclass
class EvaluateConfig:
    """Everything ``recipes/evaluate.py`` takes."""

    checkpoint: str | None = None
    goals: Any = None
    root: str | None = None
    device: Device | None = None
    seed: int | None = None
    stop: Stop | None = None
    threshold: float | None = None
    match: Match | None = None
    starts: Starts | None = None
    episodes_per_goal: int | None = None
    max_steps: int | None = None
    out: str | None = None
    viewer: bool = False


@dataclass
class ReportConfig:
    """Everything ``recipes/report.py`` takes."""

    experiment: ExperimentName | None = None
    runs: str = MISSING
    preset: str = MISSING
    out: str | None = None
    scene: str = MISSING
    goal: int = MISSING
    starts: int = MISSING
    encoder: str | None = None


@dataclass
class BenchmarkConfig:
    """Everything ``benchmarks/benchmark.py`` takes."""

    worlds: list[Any] = MISSING
    frames_per_scene: int = MISSING
    repeats: int = MISSING
    sb3: bool = MISSING
    learning: bool = MISSING
    growth: bool = MISSING
    train: list[str] = MISSING
    out: str | None = None


# The least and the most a number may be; None = no upper limit.
LIMITS: Mapping[str, tuple[float, float | None]] = {
    "seed": (0, 2**63 - 1),
    "network.width": (1, None),
    "imitation.share": (0, 1),
    "imitation.max_steps": (1, None),
    "imitation.keep": (0, None),
    "imitation.rounds": (0, None),
    "imitation.walk": (1, None),
    "objective.epochs": (1, None),
    "objective.minibatches": (1, None),
    "optimiser.lr": (0, None),
    "optimiser.max_norm": (0, None),
    "reinforcement.frames_per_scene": (1, None),
    "reinforcement.agents_per_scene": (1, None),
    "reinforcement.workers": (1, None),
    "reinforcement.steps": (1, None),
    "reinforcement.max_steps": (1, None),
    "reinforcement.gamma": (0, 1),
    "reinforcement.lmbda": (0, 1),
    "evaluation.episodes_per_goal": (1, None),
    "evaluation.max_steps": (1, None),
    "evaluation.times": (0, None),
    "checkpoint.keep": (1, None),
    "episodes_per_goal": (1, None),
    "max_steps": (1, None),
    "frames_per_scene": (1, None),
    "repeats": (1, None),
    "goal": (0, None),
    "count": (1, None),
    "step": (0.05, 10),
    "height": (16, 4096),
    "width": (16, 4096),
    "field_of_view": (10, 150),
    "threshold": (-1, 1),
}


def typed(config: DictConfig) -> Any:
    """The dataclass of a composed configuration.

    Raises:
        ConfigError: a value is missing, of the wrong type, or outside its limits.
    """
    try:
        made = OmegaConf.to_object(config)
    except OmegaConfBaseException as error:
        raise ConfigError(str(error)) from None
    for name, (least, most) in LIMITS.items():
        value = OmegaConf.select(config, name)
        if value is None:
            continue
        if value < least or (most is not None and value > most):
            wanted = f"at least {least}" if most is None else f"between {least} and {most}"
            raise ConfigError(f"{name}={value}: must be {wanted}")
    return made


def parse_config(text: str, origin: str, changes: Mapping[str, Any] | None = None) -> TrainConfig:
    """A configuration that a run saved.

    Args:
        text: YAML.
        origin: where it stood, for the error.
        changes: values to replace in it, by dotted name.

    Raises:
        ConfigError: it is not one of this version, or cannot be changed so.
    """
    try:
        config = OmegaConf.merge(OmegaConf.structured(TrainConfig), OmegaConf.create(text))
        for name, value in (changes or {}).items():
            OmegaConf.update(config, name, value)
        return typed(config)  # type: ignore[arg-type]
    except (OmegaConfBaseException, YAMLError, ConfigError) as error:
        raise ConfigError(f"{origin}: holds no configuration of this version of dirl: {error}") from None
