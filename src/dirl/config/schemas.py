"""Options, with types, bounds and meanings: how a recipe declares them, and those of a training.

A dataclass of options has a field each: value and meaning are in `option`, type and bounds in the annotation, as
``Annotated[int, Ge(1)]`` of ``annotated_types``. The values of a training's are in ``conf/``.
"""

import re
from dataclasses import dataclass, field, fields, is_dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, get_type_hints

from annotated_types import Ge, Interval

MISSING = "???"
"""OmegaConf's mark, whose import would take a tenth of a second."""


def option(meaning: str = "", default: object = MISSING) -> Any:
    """Return the field of an option.

    Args:
        meaning: in words, for ``--help`` and the page of all options.
        default: its value, a list, or a dataclass of options; without one the option must be given, or stands in
            ``conf/``.
    """
    metadata = {"meaning": meaning}
    if isinstance(default, list):
        return field(default_factory=lambda: list(default), metadata=metadata)
    if isinstance(default, type):
        return field(default_factory=default, metadata=metadata)
    return field(default=default, metadata=metadata)


Device = StrEnum("Device", ["cpu", "cuda"])
Axes = StrEnum("Axes", ["features", "principal"])
Cache = StrEnum("Cache", ["auto", "off"])
Precision = StrEnum("Precision", ["float32", "tf32"])
Rule = StrEnum("Rule", ["interval", "interval_pos", "random"])
ExperimentName = StrEnum("ExperimentName", "table1 table2 fig4 fig5 fig6 fig7 fig8")
Existing = StrEnum("Existing", ["refuse", "keep"])
Split = StrEnum("Split", ["train", "validation", "test"])
Reduction = StrEnum("Reduction", ["mean", "sum"])
Stop = StrEnum("Stop", ["goal", "match"])
GoalView = StrEnum("GoalView", ["surrounding", "front"])
Match = StrEnum("Match", ["views", "front"])
Until = StrEnum("Until", ["frames", "stable"])
Starts = StrEnum("Starts", ["every", "sampled"])
LoggerName = StrEnum("LoggerName", ["csv", "wandb"])

Positive = Annotated[int, Ge(1)]
NotNegative = Annotated[float, Ge(0)]
Fraction = Annotated[float, Interval(ge=0, le=1)]
HeldOut = Annotated[float, Interval(ge=0, le=0.99)]
Correlation = Annotated[float, Interval(ge=-1, le=1)]
Reward = Annotated[float, Interval(ge=-(10**6), le=10**6)]
Seed = Annotated[int, Interval(ge=0, le=2**63 - 1)]
Agents = Annotated[int, Interval(ge=1, le=10**6)]
Episodes = Annotated[int, Interval(ge=1, le=10**7)]
Frames = Annotated[int, Interval(ge=1, le=10**12)]
FieldOfView = Annotated[float, Interval(ge=10, le=150)]


Component = Any
"""A class by its ``_target_`` and its options, or losses by name: a mapping, of which OmegaConf knows no type."""


class ConfigError(ValueError):
    """An invalid configuration; the message names the option and its valid values."""


@dataclass
class Schedule:
    """A coefficient that changes linearly from the first frame to the last; constant if both are equal."""

    start: float = option("at the first frame")
    end: float = option("at the last")

    def __call__(self, left: float) -> float:
        """Return the value when a fraction ``left`` of the training, 1 to 0, remains."""
        return self.end + (self.start - self.end) * left


@dataclass
class Weight(Schedule):
    """A schedule that is never negative."""

    start: NotNegative = option("at the first frame")
    end: NotNegative = option("at the last")


@dataclass
class NetworkConfig:
    """How the network sees features."""

    standardise: bool = option("each feature to mean 0 and deviation 1 over the states of the world")
    cache: Cache = option(
        "auto: embed each distinct observation once, if the encoder offers embed and fuse | off, then axes=features too"
    )
    axes: Axes = option(
        "principal: learn the embedding in the span of the observations, far fewer operations | features"
    )
    components: Annotated[int, Interval(ge=1, le=65_536)] | None = option(
        "principal components of a view's features, scaled to deviation 1, that are read; null = features", None
    )
    pixels: Positive | None = option(
        "views that are wider are reduced to so many pixels across before an encoder of the package sees them, but not "
        "in tours, and not where correlation compares them; null = none is",
        None,
    )


@dataclass
class ImitationConfig:
    """Behaviour cloning."""

    fraction: Fraction = option("fraction of the states that the expert demonstrates, for every goal")
    rule: Rule = option("random | interval (every k-th state id, as the paper says) | interval_pos (whole places)")
    lr: NotNegative = option("Adam's")
    max_steps: Positive = option("at most so many optimiser steps")
    loss_threshold: NotNegative = option("stop below this loss")
    bc_coef: Weight = option("weight of the imitation loss during reinforcement; 0 = only before it", Weight)
    batch_size: Positive | None = option(
        "demonstrations sampled for each step; null = all of them, or 512 where there are more than 20,000", None
    )
    sampled: bool = option(
        "false: a table of what the expert shows | true: pairs of a state and a goal, sampled for each step", False
    )
    goals: str | None = option(
        "of sampled pairs: all | every:4 | fraction:0.75, less what is held out; null = the run's", None
    )
    scenes_at_once: Positive | None = option(
        "number of scenes, sampled for each step, that its pairs come from; null = all", None
    )
    front_only: Fraction = option(
        "fraction of sampled pairs whose goal is given by its front view alone (single-view goals)", 0.0
    )
    noise: Annotated[float, Interval(ge=0, le=100)] = option(
        "deviation of the Gaussian noise on the views that are learned from", 0.0
    )
    lr_decay: bool = option("true: the learning rate falls linearly to zero", False)
    rounds: Annotated[int, Ge(0)] = option(
        "of DAgger: the learner walks, the expert labels the states it visits, and all labels are cloned"
    )
    walk_steps: Positive = option("steps of every agent in a round")


@dataclass
class ReinforcementConfig:
    """Actor-critic training."""

    frames_per_scene: Frames = option("training frames for each scene")
    until: Until = option(
        "frames: all of frames_per_scene | stable: end when an evaluation finds every goal stable (bathroom_02: a "
        "fifth of the frames, greedy SR .97 to 1, SPL .87 to .94 instead of .99)",
        Until.frames,
    )
    agents_per_scene: Agents = option("in one batch")
    workers: Annotated[int, Interval(ge=1, le=1024)] = option(
        "1: rollouts and updates alternate | more: processes that update shared weights without a lock"
    )
    n_steps: Agents = option("of every agent between two updates (the paper's t_max)")
    max_steps: Positive = option("an episode is truncated here (and bootstrapped; not a failure)")
    epochs: Positive = option("passes over each rollout")
    minibatches: Positive = option("updates per pass")
    gamma: Fraction = option("discount of a reward one step later")
    lmbda: Fraction = option("of generalised advantage estimation; 1 = the paper's n-step return")
    entropy_coef: Schedule = option("weight of the entropy bonus", Schedule)
    critic_coef: float = option("weight of the squared error of the value")
    reduction: Reduction = option("mean | sum: of the losses over the frames of an update")
    max_grad_norm: NotNegative = option("larger gradients are scaled down to this norm")
    clip_per_variable: bool = option("false: the norm of all variables together | true: of each variable")


@dataclass
class RewardConfig:
    """The reward of a step (paper section 4.2)."""

    goal: Reward = option("stopped at the goal")
    step: Reward = option("any other step")
    collision: Reward = option("a blocked move, instead of step")
    scale: Reward = option("the reward is multiplied by this for learning")


@dataclass
class StopConfig:
    """What decides that the goal has been reached."""

    training: Stop = option("goal: the environment stops the agent at the goal | match: template matching does")
    evaluation: Stop = option("the same for evaluation")
    threshold: Correlation = option("match above this correlation (paper section 3.4)")
    match: Match = option("views: all four | front: only the view ahead")


@dataclass
class EvaluationConfig:
    """How a policy is evaluated."""

    goals: Positive | None = option("number of goals of each scene, sampled with the seed; null = all", None)
    starts: Starts = option("every: each state that reaches the goal (exact) | sampled: random states")
    episodes_per_goal: Episodes = option("how many starts are sampled (sampled only)")
    max_steps: Episodes = option("after so many steps an episode has failed")
    times: Annotated[int, Interval(ge=0, le=10**6)] = option(
        "evaluations during training, evenly spaced (greedy policy)"
    )
    live_episodes: Positive = option("of each evaluation in the simulator, evenly over goals (env=live only)", 100)


@dataclass
class CheckpointConfig:
    """When the state of a run is saved."""

    every_seconds: NotNegative = option("seconds between two checkpoints")
    keep: Positive = option("number of checkpoints that are kept")


@dataclass
class LoggerConfig:
    """Where metrics are sent besides the CSV files of the run folder."""

    name: LoggerName = option("csv (the files that every run writes, nothing else) | wandb")
    project: str = option("only Weights & Biases has projects")
    group: str | None = option("of runs that belong together; null = the parent of the run's folder", None)
    tags: list[str] = option("tags besides system, preset and scenes", [])


@dataclass
class TrainConfig:
    """Everything ``recipes/train.py`` takes."""

    scene: Any = option(
        "a name, a list of names, all (the paper's four), the path of a dump (.h5), or collection:<folder> (scenes.py "
        "sample)",
        None,
    )
    split: Split | None = option("of a collection: train | validation | test; null = all its rooms", None)
    rooms: Positive | None = option("of a collection: the number of rooms, the first ones; null = all", None)
    goals: Any = option(
        "goal states: [26,37] for one scene, {bathroom_02: [26]} for several; null = those of the scene; or a rule, "
        "alone or by scene: all | every:4 (every 4th state) | fraction:0.75 (of the places, sampled)",
        None,
    )
    hold_out: HeldOut = option(
        "fraction of the places, sampled with the seed, that are never goals in training and are evaluated separately; "
        "0 = none",
        0.0,
    )
    seed: Seed = option("determines everything: weights, demonstrations, starts, actions")
    device: Device = option("cpu | cuda")
    precision: Precision = option("float32 | tf32 (GPU only): of the matrix products in learning")
    init: str | None = option(
        "weights to begin with: a run's folder or .pt file, or the agent of the package, general", None
    )
    out: str | None = option("the folder of the run, or of a sweep; null = one named after scene and time", None)
    resume: str | None = option(
        "the folder of a stopped run, which continues to the same result; allows no other option but trust", None
    )
    existing: Existing = option(
        "refuse | keep: if the folder holds this run already, an error | leave a finished run, resume an unfinished one"
    )
    trust: list[str] | None = option(
        "packages whose classes may be used besides dirl's: null = any, but none for resume; e.g. [my_package]", None
    )
    system: str = option("which method of the comparison; its name in tables")
    preset: str = option("fast | paper: which constants")
    observation: Component = option()
    encoder: Component = option()
    memory: Component = option()
    heads: Component = option()
    policy: Component = option()
    episodic_memory: Component = field(default_factory=lambda: {"_target_": None})
    recogniser: Component = field(default_factory=lambda: {"_target_": "dirl.perception.recognition.NCC"})
    expert: Component = option()
    losses: Component = option()
    optimiser: Component = option()
    source: Component = field(default_factory=lambda: {"_target_": "dirl.scenes.catalogue.Rooms"})
    env: Component = field(default_factory=lambda: {"_target_": "dirl.envs.NavigationEnv"})
    network: NetworkConfig = option("", NetworkConfig)
    imitation: ImitationConfig = option("", ImitationConfig)
    reinforcement: ReinforcementConfig = option("", ReinforcementConfig)
    reward: RewardConfig = option("", RewardConfig)
    stop: StopConfig = option("", StopConfig)
    evaluation: EvaluationConfig = option("", EvaluationConfig)
    checkpoint: CheckpointConfig = option("", CheckpointConfig)
    logger: LoggerConfig = option("", LoggerConfig)


def option_types(schema: type, prefix: str = "", *, bounds: bool = False) -> dict[str, Any]:
    """Return the types of all options by their dotted names; with ``bounds`` as they are annotated."""
    types: dict[str, Any] = {}
    for name, kind in get_type_hints(schema, include_extras=bounds).items():
        types[prefix + name] = kind
        if isinstance(kind, type) and is_dataclass(kind):
            types |= option_types(kind, f"{prefix}{name}.", bounds=bounds)
    return types


def meanings(schema: type, prefix: str = "") -> dict[str, str]:
    """Return what the options mean, by their dotted names."""
    texts, kinds = {}, get_type_hints(schema)
    for each in fields(schema):
        texts[prefix + each.name] = each.metadata.get("meaning", "")
        if isinstance(kinds[each.name], type) and is_dataclass(kinds[each.name]):
            texts |= meanings(kinds[each.name], f"{prefix}{each.name}.")
    return texts


def comments(file: Path) -> dict[str, str]:
    """Return the comments beside the options of a component's class in its file of ``conf/``."""
    return dict(re.findall(r"^ *(\w+):[^#\n]*#\s*(.+)$", file.read_text(encoding="utf-8"), re.MULTILINE))
