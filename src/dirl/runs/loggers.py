"""Loggers besides the files in a run's folder: Weights & Biases, TensorBoard.

Both log the configuration, every row of the CSV files, the summary and the pictures; the first also the weights.
"""

import json
import math
import os
import secrets
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from dirl.config.saved import config_text
from dirl.config.schemas import ConfigError, LoggerName, TrainConfig
from dirl.config.values import leaves, plain
from dirl.scenes.io.atomic import write_text


def make_logger(config: TrainConfig, folder: Path, frames: int = 0) -> "Logger | None":
    """The logger that the configuration of a run names, which continues at ``frames``; None for ``csv``.

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

    The run's folder stores its random id in the service.
    """

    def __init__(self, config: TrainConfig, folder: Path) -> None:
        import wandb

        options, known = config.logger, folder / "wandb_id.txt"
        if not known.exists():
            write_text(known, secrets.token_hex(8))
        scenes = config.scene if isinstance(config.scene, list) else [config.scene]
        tags = [*options.tags, config.system, config.preset, *(Path(str(scene)).stem for scene in scenes)]
        self.run = wandb.init(
            project=options.project,
            group=options.group or folder.resolve().parent.name,
            tags=[tag[:64] for tag in dict.fromkeys(tags)],  # the service takes no longer ones
            name=folder.name,
            id=known.read_text(encoding="utf-8").strip(),
            resume="allow",
            config=plain(config),
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
        pictures = {f"pictures/{name}": wandb.Image(pixels) for name, pixels in _pictures(folder, "*.png")}
        moving = {f"pictures/{file.stem}": wandb.Video(str(file), format="gif") for file in folder.glob("*.gif")}
        self.run.log(pictures | moving)
        facts = {name: value for name, value in summary.items() if not isinstance(value, Mapping)}
        artifact = wandb.Artifact(f"dirl-{self.run.id}", type="model", metadata=facts)
        for name in ("config.yaml", "summary.json", "network.pt"):
            if (folder / name).is_file():
                artifact.add_file(str(folder / name))
        self.run.log_artifact(artifact)
        self.run.finish()


class TensorBoardLogger:
    """Event files in ``<folder>/tensorboard``; what was logged after the ``frames`` where a run continues is hidden."""

    def __init__(self, config: TrainConfig, folder: Path, frames: int) -> None:
        from torch.utils.tensorboard import SummaryWriter

        self.writer = SummaryWriter(str(folder / "tensorboard"), purge_step=frames + 1 if frames else None)
        self.config = config
        self.writer.add_text("config", f"```yaml\n{config_text(config)}```")

    def log(self, stage: str, step: int, row: Mapping[str, float | int]) -> None:
        """Log a row."""
        for name, value in _finite(row).items():
            self.writer.add_scalar(f"{stage}/{name}", value, step)

    def finish(self, summary: Mapping[str, Any], folder: Path) -> None:
        """Log the summary as text and as metrics of the hyperparameters, and the pictures."""
        frames = int(summary["frames"])
        self.writer.add_text("summary", f"```json\n{json.dumps(summary, indent=1)}\n```", frames)
        measured = {f"summary/{name}": value for name, value in _finite(leaves(dict(summary))).items()}
        numbers = {name: value for name, value in leaves(plain(self.config)).items() if isinstance(value, int | float)}
        self.writer.add_hparams(numbers, measured, run_name=".", global_step=frames)
        for name, pixels in [*_pictures(folder, "*.png"), *_pictures(folder, "*.gif")]:
            self.writer.add_image(f"pictures/{name}", pixels, frames, dataformats="HWC")
        self.writer.close()


def _wandb_mode() -> Any:
    """``WANDB_MODE`` if it is set; else ``offline`` where nobody is logged in or the service is away."""
    import wandb

    if "WANDB_MODE" in os.environ:
        return os.environ["WANDB_MODE"]  # which the package itself reads only once a process
    try:
        return "online" if wandb.login(prompt=False) else "offline"
    except wandb.errors.Error:  # there is a key, but the service is away or refuses it
        return "offline"


def _finite(row: Mapping[str, Any]) -> dict[str, float | int]:
    """The numbers of a row that are finite."""
    return {name: value for name, value in row.items() if isinstance(value, int | float) and math.isfinite(value)}


def _pictures(folder: Path, pattern: str) -> Iterator[tuple[str, NDArray[np.uint8]]]:
    """Names and pixels of pictures; of an animation the first."""
    for file in sorted(folder.glob(pattern)):
        with Image.open(file) as image:
            yield file.stem, np.array(image.convert("RGB"))


Logger = WandbLogger | TensorBoardLogger
