"""Where metrics go besides the CSV files of a run."""

import os
from pathlib import Path

from torchrl.record.loggers import Logger, get_logger

from dirl.config.schemas import ConfigError, LoggerConfig, LoggerName


def make_logger(options: LoggerConfig, folder: Path) -> Logger | None:
    """TorchRL's logger of that name, or None for ``csv``. Weights & Biases is offline where nobody is logged in.

    Raises:
        ConfigError: the package it needs is not installed.
    """
    if options.name == LoggerName.csv:
        return None
    try:
        if options.name == LoggerName.tensorboard:
            return get_logger("tensorboard", str(folder), "tensorboard")
        import wandb

        kwargs = {"project": options.project, "id": f"{folder.parent.name}-{folder.name}"}
        if "WANDB_MODE" not in os.environ:
            try:
                known = wandb.login(prompt=False)
            except wandb.errors.Error:  # there is a key, but the service is away or refuses it
                known = False
            kwargs["mode"] = "online" if known else "offline"
        return get_logger("wandb", str(folder), folder.name, wandb_kwargs=kwargs)
    except ImportError as error:
        hint = f"pip install 'dirl[{options.name}]'"
        raise ConfigError(f"logger={options.name} needs a package that is not installed ({error}): {hint}") from None
