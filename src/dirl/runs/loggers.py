"""Loggers besides the files in a run's folder: Weights & Biases, TensorBoard.

Both log the configuration, every row of the CSV files, the summary and the pictures; the first also the weights.
"""

import json
import math
import os
import secrets
from collections.abc import Iterator, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from dirl.config.saved import config_text
from dirl.config.schemas import ConfigError, LoggerName, TrainConfig
from dirl.config.values import leaves, plain
from dirl.runs.schema import Summary
from dirl.scenes.io.atomic import write_text
from dirl.scenes.io.bounded import read_text

PACKAGES = {
    LoggerName.wandb: ("wandb", "pip install wandb"),
    LoggerName.tensorboard: ("tensorboard", "pip install 'dirl[tensorboard]'"),
}
"""What loggers need, and how it is installed."""


def check_logger(config: TrainConfig) -> None:
    """Raise `ConfigError` if the package that a run's logger needs is not installed; loads nothing."""
    package, hint = PACKAGES.get(config.logger.name, ("", ""))
    if package and find_spec(package) is None:
        raise ConfigError(f"logger={config.logger.name} needs a package that is not installed: {hint}")


def make_logger(config: TrainConfig, folder: Path, frames: int = 0) -> "Logger | None":
    """Return the logger that the configuration of a run names, which continues at ``frames``; None for ``csv``.

    Raises:
        ConfigError: the package it needs is not installed, or the service refuses the run.
    """
    name = config.logger.name
    if name == LoggerName.csv:
        return None
    check_logger(config)
    return WandbLogger(config, folder) if name == LoggerName.wandb else TensorBoardLogger(config, folder, frames)


class WandbLogger:
    """A run in Weights & Biases, offline if nobody is logged in; a resumed run continues there too.

    The run's folder stores its id in the service: a random one, or that which an agent of a sweep gives it.
    """

    def __init__(self, config: TrainConfig, folder: Path) -> None:
        import wandb

        options, known = config.logger, folder / "wandb_id.txt"
        if not known.exists():
            write_text(known, os.environ.get("WANDB_RUN_ID") or secrets.token_hex(8))
        scenes = config.scene if isinstance(config.scene, list) else [config.scene]
        tags = [*options.tags, config.system, config.preset, *(Path(str(scene)).stem for scene in scenes)]
        try:
            self.run = wandb.init(
                project=options.project,
                group=options.group or folder.resolve().parent.name,
                tags=[tag[:64] for tag in dict.fromkeys(tags)],  # the service takes no longer ones
                name=folder.name,
                id=read_text(known).strip(),
                resume="allow",
                config=plain(config),
                dir=str(folder),
                mode=_wandb_mode(),
                settings=wandb.Settings(silent=True),  # the last line of a run is its own: how to resume it
            )
        except wandb.errors.Error as error:
            reason = " ".join(str(error).split())
            raise ConfigError(f"logger=wandb: {reason}; or log offline: WANDB_MODE=offline") from None
        sync = f"offline; upload it by: wandb sync {Path(self.run.dir).parent}"
        print(f"Weights & Biases: {sync if self.run.offline else self.run.url}")
        self._stages: set[str] = set()

    def log(self, stage: str, step: int, row: Mapping[str, float | int]) -> None:
        """Log a row; every stage counts its own steps, because the service refuses decreasing ones."""
        if stage not in self._stages:
            self._stages.add(stage)
            self.run.define_metric(f"{stage}/step", hidden=True)
            self.run.define_metric(f"{stage}/*", step_metric=f"{stage}/step")
        self.run.log({f"{stage}/{name}": value for name, value in _finite(row).items()} | {f"{stage}/step": step})

    def finish(self, summary: Summary, folder: Path) -> None:
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

    def finish(self, summary: Summary, folder: Path) -> None:
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
    """Return ``WANDB_MODE`` if it is set; else ``offline`` where nobody is logged in or the service is away.

    Raises:
        ConfigError: the mode is ``online``, and nobody is logged in.
    """
    import wandb

    asked = os.environ.get("WANDB_MODE")  # which the package itself reads only once a process
    if asked not in (None, "online"):
        return asked
    try:
        known = wandb.login(prompt=False)
    except wandb.errors.Error:  # there is a key, but the service is away or refuses it
        known = False
    if asked == "online" and not known:
        raise ConfigError("WANDB_MODE=online: nobody is logged in; run: wandb login, or leave WANDB_MODE out")
    return "online" if known else "offline"


def _finite(row: Mapping[str, Any]) -> dict[str, float | int]:
    """Return the numbers of a row that are finite."""
    return {name: value for name, value in row.items() if isinstance(value, int | float) and math.isfinite(value)}


def _pictures(folder: Path, pattern: str) -> Iterator[tuple[str, NDArray[np.uint8]]]:
    """Yield names and pixels of pictures; of an animation the first."""
    for file in sorted(folder.glob(pattern)):
        with Image.open(file) as image:
            yield file.stem, np.array(image.convert("RGB"))


Logger = WandbLogger | TensorBoardLogger
