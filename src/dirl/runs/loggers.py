"""Loggers besides the files in a run's folder: Weights & Biases, TensorBoard.

Both log the configuration, every row of the CSV files, the summary and the pictures; the first also the weights.
"""

import json
import math
import os
import secrets
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from omegaconf import OmegaConf
from PIL import Image

from dirl.config.schemas import ConfigError, LoggerName, TrainConfig, leaves
from dirl.scenes.io.atomic import write_text

PICTURES = ("*.png", "*.gif")


class Logger(Protocol):
    """The interface of a logger."""

    def log(self, stage: str, step: int, row: Mapping[str, float | int]) -> None:
        """Log a row of ``<stage>.csv``; values that are not finite are left out."""

    def finish(self, summary: Mapping[str, Any], folder: Path) -> None:
        """Log the summary, and the files of the finished run."""


def make_logger(config: TrainConfig, folder: Path, frames: int = 0) -> Logger | None:
    """The logger that a configuration names; None for ``csv``.

    Args:
        config: of the run.
        folder: of the run.
        frames: at which the run continues.

    Raises:
        ConfigError: the package it needs is not installed.
    """
    name = config.logger.name
    if name == LoggerName.csv:
        return None
    try:
        return WandbLogger(config, folder) if name == LoggerName.wandb else TensorBoardLogger(config, folder, frames)
    except ImportError as error:
        hint = "pip install wandb" if name == LoggerName.wandb else f"pip install 'dirl[{name}]'"
        raise ConfigError(f"logger={name} needs a package that is not installed ({error}): {hint}") from None


class WandbLogger:
    """A run in Weights & Biases, offline if nobody is logged in; a resumed run continues there too.

    Args:
        config: of the run.
        folder: of the run; stores its random id in the service.
    """

    def __init__(self, config: TrainConfig, folder: Path) -> None:
        import wandb

        options, known = config.logger, folder / "wandb_id.txt"
        if not known.exists():
            write_text(known, secrets.token_hex(8))
        tags = [*options.tags, config.system, config.preset, *_scene_names(config)]
        self.run = wandb.init(
            project=options.project,
            group=options.group or folder.resolve().parent.name,
            tags=[tag[:64] for tag in dict.fromkeys(tags)],  # the service takes no longer ones
            name=folder.name,
            id=known.read_text(encoding="utf-8").strip(),
            resume="allow",
            config=_values(config),
            dir=str(folder),
            mode=_wandb_mode(),
        )
        self._stages: set[str] = set()

    def log(self, stage: str, step: int, row: Mapping[str, float | int]) -> None:
        """Log a row; every stage counts its own steps, because the service refuses decreasing ones."""
        if stage not in self._stages:
            self._stages.add(stage)
            self.run.define_metric(f"{stage}/step", hidden=True)
            self.run.define_metric(f"{stage}/*", step_metric=f"{stage}/step")
        self.run.log({f"{stage}/{name}": value for name, value in _finite(row).items()} | {f"{stage}/step": step})

    def finish(self, summary: Mapping[str, Any], folder: Path) -> None:
        """Log summary, pictures, and as an artifact of type ``model`` the configuration, summary and weights."""
        import wandb

        self.run.summary.update(_finite(leaves(dict(summary))))
        self.run.log({f"pictures/{file.stem}": _wandb_picture(file) for file in _pictures(folder)})
        facts = {name: value for name, value in summary.items() if not isinstance(value, Mapping)}
        artifact = wandb.Artifact(f"dirl-{self.run.id}", type="model", metadata=facts)
        for name in ("config.yaml", "summary.json", "network.pt"):
            if (folder / name).is_file():
                artifact.add_file(str(folder / name))
        self.run.log_artifact(artifact)
        self.run.finish()


class TensorBoardLogger:
    """Event files in ``<folder>/tensorboard``.

    Args:
        config: of the run.
        folder: of the run.
        frames: at which the run continues; what was logged after them is hidden.
    """

    def __init__(self, config: TrainConfig, folder: Path, frames: int) -> None:
        from torch.utils.tensorboard import SummaryWriter

        self.writer = SummaryWriter(str(folder / "tensorboard"), purge_step=frames + 1 if frames else None)
        self.config = config
        self.writer.add_text("config", f"```yaml\n{OmegaConf.to_yaml(OmegaConf.create(_values(config)))}```")

    def log(self, stage: str, step: int, row: Mapping[str, float | int]) -> None:
        """Log a row."""
        for name, value in _finite(row).items():
            self.writer.add_scalar(f"{stage}/{name}", value, step)

    def finish(self, summary: Mapping[str, Any], folder: Path) -> None:
        """Log the summary as text and as metrics of the hyperparameters, and the pictures."""
        frames = int(summary["frames"])
        self.writer.add_text("summary", f"```json\n{json.dumps(summary, indent=1)}\n```", frames)
        measured = {f"summary/{name}": value for name, value in _finite(leaves(dict(summary))).items()}
        plain = {name: value for name, value in leaves(_values(self.config)).items() if isinstance(value, int | float)}
        self.writer.add_hparams(plain, measured, run_name=".", global_step=frames)
        for file in _pictures(folder):
            with Image.open(file) as image:
                pixels = np.array(image.convert("RGB"))
            self.writer.add_image(f"pictures/{file.stem}", pixels, frames, dataformats="HWC")
        self.writer.close()


def _wandb_picture(file: Path) -> Any:
    """A picture or animation; given the file of one, ``wandb.Image`` would leave it open."""
    import wandb
    from PIL import Image

    if file.suffix == ".gif":
        return wandb.Video(str(file), format="gif")
    with Image.open(file) as picture:
        return wandb.Image(picture.convert("RGB"))


def _wandb_mode() -> Any:
    """``WANDB_MODE`` if it is set; else ``offline`` where nobody is logged in or the service is away."""
    import wandb

    if "WANDB_MODE" in os.environ:
        return os.environ["WANDB_MODE"]  # which the package itself reads only once a process
    try:
        return "online" if wandb.login(prompt=False) else "offline"
    except wandb.errors.Error:  # there is a key, but the service is away or refuses it
        return "offline"


def _values(config: TrainConfig) -> dict[str, Any]:
    values = OmegaConf.to_container(OmegaConf.structured(config), resolve=True, enum_to_str=True)
    assert isinstance(values, dict)
    return {str(name): value for name, value in values.items() if name not in ("resume", "trust")}


def _scene_names(config: TrainConfig) -> list[str]:
    names = config.scene if isinstance(config.scene, list) else [config.scene]
    return [Path(str(name)).stem for name in names]


def _finite(row: Mapping[str, Any]) -> dict[str, float | int]:
    """The numbers of a row that are finite."""
    return {name: value for name, value in row.items() if isinstance(value, int | float) and math.isfinite(value)}


def _pictures(folder: Path) -> list[Path]:
    return sorted(file for pattern in PICTURES for file in folder.glob(pattern))
