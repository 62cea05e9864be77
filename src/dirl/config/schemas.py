"""The options with their types and bounds; the values are in ``conf/``. The package else takes plain arguments."""

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated, Any

from omegaconf import MISSING

from dirl.config.bounds import Bounds

Device = StrEnum("Device", ["cpu", "cuda"])
Axes = StrEnum("Axes", ["features", "principal"])
Cache = StrEnum("Cache", ["auto", "off"])
Precision = StrEnum("Precision", ["float32", "bfloat16"])
Rule = StrEnum("Rule", ["interval", "interval_pos", "random"])
ExperimentName = StrEnum(
    "ExperimentName",
    "table1 table2 fig4 fig5 fig6 fig7 fig8 stop any_goal unseen_rooms image_graph changes walked_once other_worlds "
    "sptm",
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

Positive = Annotated[int, Bounds(1)]
NotNegative = Annotated[float, Bounds(0)]
Fraction = Annotated[float, Bounds(0, 1)]
HeldOut = Annotated[float, Bounds(0, 0.99)]
Correlation = Annotated[float, Bounds(-1, 1)]
Reward = Annotated[float, Bounds(-(10**6), 10**6)]
Seed = Annotated[int, Bounds(0, 2**63 - 1)]
Agents = Annotated[int, Bounds(1, 10**6)]
Episodes = Annotated[int, Bounds(1, 10**7)]
Frames = Annotated[int, Bounds(1, 10**12)]


class ConfigError(ValueError):
    """An invalid configuration; the message names the option and its valid values."""


@dataclass
class Schedule:
    """A coefficient that changes linearly from the first frame to the last; constant if both are equal."""

    start: float = MISSING
    end: float = MISSING

    def __call__(self, left: float) -> float:
        """The value when a fraction ``left`` of the training, 1 to 0, remains."""
        return self.end + (self.start - self.end) * left


@dataclass
class Weight(Schedule):
    """A schedule that is never negative."""

    start: NotNegative = MISSING
    end: NotNegative = MISSING


@dataclass
class NetworkConfig:
    """How the network sees features."""

    standardise: bool = MISSING
    cache: Cache = MISSING
    axes: Axes = MISSING
    components: Annotated[int, Bounds(1, 65_536)] | None = None


@dataclass
class ImitationConfig:
    """Behaviour cloning."""

    fraction: Fraction = MISSING
    rule: Rule = MISSING
    lr: NotNegative = MISSING
    max_steps: Positive = MISSING
    loss_threshold: NotNegative = MISSING
    bc_coef: Weight = field(default_factory=Weight)
    batch_size: Positive | None = None
    sampled: bool = False
    goals: str | None = None
    scenes_at_once: Positive | None = None
    front_only: Fraction = 0.0
    noise: Annotated[float, Bounds(0, 100)] = 0.0
    lr_decay: bool = False
    rounds: Annotated[int, Bounds(0)] = MISSING
    walk_steps: Positive = MISSING


@dataclass
class ReinforcementConfig:
    """Actor-critic training."""

    frames_per_scene: Frames = MISSING
    until: Until = Until.frames
    agents_per_scene: Agents = MISSING
    workers: Annotated[int, Bounds(1, 1024)] = MISSING
    n_steps: Agents = MISSING
    max_steps: Positive = MISSING
    epochs: Positive = MISSING
    minibatches: Positive = MISSING
    gamma: Fraction = MISSING
    lmbda: Fraction = MISSING
    entropy_coef: Schedule = field(default_factory=Schedule)
    critic_coef: float = MISSING
    reduction: Reduction = MISSING
    max_grad_norm: NotNegative = MISSING
    clip_per_variable: bool = MISSING


@dataclass
class RewardConfig:
    """The reward of a step."""

    goal: Reward = MISSING
    step: Reward = MISSING
    collision: Reward = MISSING
    scale: Reward = MISSING


@dataclass
class StopConfig:
    """What decides that the goal has been reached."""

    training: Stop = MISSING
    evaluation: Stop = MISSING
    threshold: Correlation = MISSING
    match: Match = MISSING


@dataclass
class EvaluationConfig:
    """How a policy is evaluated."""

    goals: Positive | None = None
    starts: Starts = MISSING
    episodes_per_goal: Episodes = MISSING
    max_steps: Episodes = MISSING
    times: Annotated[int, Bounds(0, 10**6)] = MISSING
    live_episodes: Positive = 100


@dataclass
class CheckpointConfig:
    """When the state of a run is saved."""

    every_seconds: NotNegative = MISSING
    keep: Positive = MISSING


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
    rooms: Positive | None = None
    goals: Any = None
    hold_out: HeldOut = 0.0
    seed: Seed = MISSING
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
    recogniser: Any = field(default_factory=lambda: {"_target_": "dirl.perception.recognition.NCC"})
    expert: Any = MISSING
    losses: Any = MISSING
    optimiser: Any = MISSING
    source: Any = field(default_factory=lambda: {"_target_": "dirl.scenes.catalogue.Rooms"})
    env: Any = field(default_factory=lambda: {"_target_": "dirl.envs.NavigationEnv"})
    network: NetworkConfig = field(default_factory=NetworkConfig)
    imitation: ImitationConfig = field(default_factory=ImitationConfig)
    reinforcement: ReinforcementConfig = field(default_factory=ReinforcementConfig)
    reward: RewardConfig = field(default_factory=RewardConfig)
    stop: StopConfig = field(default_factory=StopConfig)
    evaluation: EvaluationConfig = field(default_factory=EvaluationConfig)
    checkpoint: CheckpointConfig = field(default_factory=CheckpointConfig)
    logger: LoggerConfig = field(default_factory=LoggerConfig)
