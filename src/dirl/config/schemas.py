"""The options with their types; the values are in ``conf/``. The rest of the package takes plain arguments."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from omegaconf import MISSING, DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from dirl.config.bounds import LIMITS

Device = StrEnum("Device", ["cpu", "cuda"])
SourceName = StrEnum("SourceName", ["rooms", "thor"])
Axes = StrEnum("Axes", ["features", "principal"])
Cache = StrEnum("Cache", ["auto", "off"])
Precision = StrEnum("Precision", ["float32", "bfloat16"])
Rule = StrEnum("Rule", ["interval", "interval_pos", "random"])
ExperimentName = StrEnum(
    "ExperimentName",
    "table1 table2 fig4 fig5 fig6 fig7 fig8 stop any_goal unseen_rooms image_graph changes walked_once other_worlds",
)
Existing = StrEnum("Existing", ["refuse", "keep"])
Split = StrEnum("Split", ["train", "validation", "test"])
Reduction = StrEnum("Reduction", ["mean", "sum"])
Stop = StrEnum("Stop", ["goal", "match"])
GoalView = StrEnum("GoalView", ["surrounding", "front"])
Match = StrEnum("Match", ["views", "front"])
Until = StrEnum("Until", ["frames", "stable"])
Starts = StrEnum("Starts", ["every", "sampled"])
LoggerName = StrEnum("LoggerName", ["csv", "wandb", "tensorboard"])


class ConfigError(ValueError):
    """An invalid configuration; the message names the option and its valid values."""


@dataclass
class SourceConfig:
    """Where scenes are looked up by name."""

    name: SourceName = MISSING
    root: str | None = MISSING


@dataclass
class Schedule:
    """A coefficient that changes linearly from the first frame to the last; constant if both are equal."""

    start: float = MISSING
    end: float = MISSING

    def __call__(self, left: float) -> float:
        """The value when a fraction ``left`` of the training, 1 to 0, remains."""
        return self.end + (self.start - self.end) * left


@dataclass
class NetworkConfig:
    """How the network sees features."""

    standardise: bool = MISSING
    cache: Cache = MISSING
    axes: Axes = MISSING
    components: int | None = None


@dataclass
class ImitationConfig:
    """Behaviour cloning."""

    fraction: float = MISSING
    rule: Rule = MISSING
    lr: float = MISSING
    max_steps: int = MISSING
    loss_threshold: float = MISSING
    bc_coef: Schedule = field(default_factory=Schedule)
    batch_size: int | None = None
    drawn: bool = False
    goals: str | None = None
    scenes_at_once: int | None = None
    front_only: float = 0.0
    noise: float = 0.0
    lr_decay: bool = False
    rounds: int = MISSING
    walk_steps: int = MISSING


@dataclass
class ReinforcementConfig:
    """Actor-critic training."""

    frames_per_scene: int = MISSING
    until: Until = Until.frames
    agents_per_scene: int = MISSING
    workers: int = MISSING
    n_steps: int = MISSING
    max_steps: int = MISSING
    epochs: int = MISSING
    minibatches: int = MISSING
    gamma: float = MISSING
    lmbda: float = MISSING
    entropy_coef: Schedule = field(default_factory=Schedule)
    critic_coef: float = MISSING
    reduction: Reduction = MISSING
    max_grad_norm: float = MISSING
    clip_per_variable: bool = MISSING


@dataclass
class RewardConfig:
    """The reward of a step."""

    goal: float = MISSING
    step: float = MISSING
    collision: float = MISSING
    scale: float = MISSING


@dataclass
class StopConfig:
    """What decides that the goal has been reached."""

    training: Stop = MISSING
    evaluation: Stop = MISSING
    threshold: float = MISSING
    match: Match = MISSING


@dataclass
class EvaluationConfig:
    """How a policy is evaluated."""

    goals: int | None = None
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
    """Where metrics are sent besides the CSV files of the run folder."""

    name: LoggerName = MISSING
    project: str = MISSING
    group: str | None = None
    tags: list[str] = field(default_factory=list)


@dataclass
class TrainConfig:
    """Everything ``recipes/train.py`` takes."""

    scene: Any = None
    split: Split | None = None
    rooms: int | None = None
    goals: Any = None
    hold_out: float = 0.0
    seed: int = MISSING
    device: Device = MISSING
    precision: Precision = MISSING
    init: str | None = None
    resume: str | None = None
    existing: Existing = MISSING
    trust: list[str] | None = None
    system: str = MISSING
    preset: str = MISSING
    observation: Any = MISSING
    encoder: Any = MISSING
    memory: Any = MISSING
    heads: Any = MISSING
    policy: Any = MISSING
    episodic_memory: Any = field(default_factory=lambda: {"_target_": None})
    recogniser: Any = field(default_factory=lambda: {"_target_": "dirl.recognition.NCC"})
    expert: Any = MISSING
    losses: Any = MISSING
    optimiser: Any = MISSING
    source: SourceConfig = field(default_factory=SourceConfig)
    network: NetworkConfig = field(default_factory=NetworkConfig)
    imitation: ImitationConfig = field(default_factory=ImitationConfig)
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
    scene: Any = None
    split: Split | None = None
    rooms: int | None = None
    goals: Any = None
    trust: list[str] = field(default_factory=list)
    root: str | None = None
    device: Device | None = None
    seed: int | None = None
    stop: Stop | None = None
    threshold: float | None = None
    match: Match | None = None
    goal_view: GoalView | None = None
    episodic_memory: str | None = None
    recogniser: str | None = None
    starts: Starts | None = None
    episodes_per_goal: int | None = None
    max_steps: int | None = None
    out: str | None = None
    image_graph: float | None = None
    last_steps: int | None = None
    viewer: bool = False
    video: bool = False
    simulator: str | None = None
    slip: float = 0.0
    turn_error: float = 0.0


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
    encoder: str = MISSING
    agents: list[str] = MISSING
    collections: list[str] = MISSING
    rooms: int | None = None


@dataclass
class BenchmarkConfig:
    """Everything ``benchmarks/benchmark.py`` takes."""

    worlds: list[Any] = MISSING
    frames_per_scene: int = MISSING
    repeats: int = MISSING
    sb3: bool = MISSING
    learning: bool = MISSING
    train: list[str] = MISSING
    out: str | None = None


def typed(config: DictConfig) -> Any:
    """The dataclass of a composed configuration.

    Raises:
        ConfigError: a value is missing, of the wrong type, or outside its limits.
    """
    try:
        made = OmegaConf.to_object(config)
        for name, value in config.items():
            if isinstance(value, DictConfig) and OmegaConf.get_type(value) is dict:  # plain, also what is interpolated
                setattr(made, str(name), OmegaConf.to_container(value, resolve=True, enum_to_str=True))
    except OmegaConfBaseException as error:
        raise ConfigError(f"{error.full_key or 'an option'}: {str(error).splitlines()[0]}") from None
    scene = OmegaConf.select(config, "scene")
    for one in scene if OmegaConf.is_list(scene) else [scene]:
        if one is not None and not isinstance(one, str):
            raise ConfigError(f"scene={scene}: must be a name, a path, or a list of them")
    for name, bounds in LIMITS.items():
        value = OmegaConf.select(config, name)
        if value is not None and value not in bounds:
            raise ConfigError(f"{name}={value}: must be {bounds}")
    for name, value in leaves(OmegaConf.to_container(config, resolve=True)).items():
        if isinstance(value, float) and not math.isfinite(value):
            raise ConfigError(f"{name}={value}: must be a finite number")
    return made


def leaves(config: Any, prefix: str = "") -> dict[str, Any]:
    """The values of a nested configuration by dotted name; goals and lists are values."""
    found: dict[str, Any] = {}
    for name, value in config.items():
        inside = isinstance(value, Mapping) and name != "goals"
        found |= leaves(value, f"{prefix}{name}.") if inside else {f"{prefix}{name}": value}
    return found
