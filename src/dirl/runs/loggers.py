"""A run in Weights & Biases: configuration, every row of the CSV files, summary, pictures and weights."""

import math
import os
import secrets
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Literal

import wandb

from dirl.config.files import leaves
from dirl.config.schemas import ConfigError, TrainConfig
from dirl.runs.checkpoints import Summary
from dirl.scenes.io.files import read_text, write_text


class WandbLogger:
    """A run in Weights & Biases, offline if nobody is logged in; a resumed run continues there too.

    The run's folder stores its id in the service: a random one, or that which an agent of a sweep gives it.

    Raises:
        ConfigError: the service refuses the run, or nobody is logged in and ``WANDB_MODE=online``.
    """

    def __init__(self, config: TrainConfig, folder: Path) -> None:
        options, known, mode = config.logger, folder / "wandb_id.txt", _mode()
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
                config=asdict(config),
                dir=str(folder),
                mode=mode,
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
        self.run.summary.update(_finite(leaves(dict(summary))))
        pictures = {f"pictures/{file.stem}": wandb.Image(str(file)) for file in folder.glob("*.png")}
        moving = {f"pictures/{file.stem}": wandb.Video(str(file), format="gif") for file in folder.glob("*.gif")}
        self.run.log(pictures | moving)
        facts = {name: value for name, value in summary.items() if not isinstance(value, Mapping)}
        artifact = wandb.Artifact(f"dirl-{self.run.id}", type="model", metadata=facts)
        for name in ("config.yaml", "summary.json", "network.pt"):
            if (folder / name).is_file():
                artifact.add_file(str(folder / name))
        self.run.log_artifact(artifact)
        self.run.finish()


def _mode() -> Literal["online", "offline"] | None:
    """Return the mode of a run: that of ``WANDB_MODE``, or offline where nobody is logged in or the service is away."""
    asked = os.environ.get("WANDB_MODE")  # which the package itself reads only once a process
    if asked not in (None, "online"):
        return asked  # type: ignore[return-value]  # wandb checks it
    try:
        known = wandb.login(prompt=False)
    except wandb.errors.Error:  # there is a key, but the service is away or refuses it
        known = False
    if asked == "online" and not known:
        raise ConfigError("WANDB_MODE=online: nobody is logged in; run: wandb login, or leave WANDB_MODE out")
    return "online" if known else "offline"


def _finite(row: Mapping[str, object]) -> dict[str, float | int]:
    """Return the numbers of a row that are finite."""
    return {name: value for name, value in row.items() if isinstance(value, int | float) and math.isfinite(value)}
