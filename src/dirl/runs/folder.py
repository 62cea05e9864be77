"""The folder of a run: its metrics, its checkpoints, and how it goes on after it was stopped."""

import contextlib
import csv
import json
import math
import os
import shutil
import signal
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from omegaconf import OmegaConf
from torchrl.record.loggers import Logger, get_logger

from dirl.config.saved import config_text, read_config
from dirl.config.schemas import ConfigError, Existing, LoggerConfig, LoggerName, TrainConfig, leaves
from dirl.scenes import World

SCHEMA = 2
"""Of configurations and checkpoints; 1 was dirl 0.1."""


class RunError(ValueError):
    """A run folder or checkpoint that cannot be used."""


class Run:
    """A run: its folder, its configuration, and the state it goes on from.

    Its metrics are CSV files, one for each stage, one row a moment. (TorchRL's ``CSVLogger`` writes one file a value,
    and cannot forget what a killed run wrote after its last checkpoint.)

    Args:
        folder: everything it writes is in there.
        config: its configuration, saved there as ``config.yaml``.
        saved: the checkpoint it goes on from; None at the beginning.
    """

    def __init__(self, folder: Path, config: TrainConfig, saved: dict[str, Any] | None = None) -> None:
        self.folder = folder
        self.config = config
        self.saved = saved
        self.logger: Logger | None = None
        self._began = time.perf_counter() - (saved["seconds"] if saved else 0.0)
        self._last_save = time.perf_counter()
        self._facts: dict[str, Any] = {}

    def begin(self, world: World, view_order: Sequence[str]) -> None:
        """Write the configuration, and forget metrics that are younger than the checkpoint. Nothing is written before.

        Raises:
            ConfigError: the logger's package is not installed.
        """
        self.logger = make_logger(self.config.logger, self.folder)
        text = config_text(self.config)
        self._facts = {"config": text, "scenes": list(world.names), "extractor": world.scenes[0].extractor}
        self._facts |= {"views": list(view_order), "schema": SCHEMA}
        (self.folder / "config.yaml").write_text(text)
        sizes = self.saved["tables"] if self.saved else {}
        for file in self.folder.glob("*.csv"):
            os.truncate(file, sizes.get(file.name, 0))

    @property
    def finished(self) -> bool:
        """Whether it has come to its end; only one with ``config.existing=keep`` is opened again then."""
        return is_finished(self.folder)

    @property
    def seconds(self) -> float:
        """How long the run has taken, without the time between being stopped and resumed."""
        return time.perf_counter() - self._began

    def write(self, stage: str, step: int, row: Mapping[str, float | int]) -> None:
        """Append a row to ``<stage>.csv``; NaN becomes an empty cell. The columns are those of the first row."""
        file = self.folder / f"{stage}.csv"
        begins = not file.exists() or file.stat().st_size == 0
        cells = [
            "" if math.isnan(value) else f"{value:.6g}" if isinstance(value, float) else value for value in row.values()
        ]
        with file.open("a", newline="") as stream:
            writer = csv.writer(stream)
            if begins:
                writer.writerow(row)
            writer.writerow(cells)
        if self.logger is not None:
            for name, value in row.items():
                if not math.isnan(value):
                    self.logger.log_scalar(f"{stage}/{name}", value, step=step)

    def save_due(self) -> bool:
        """Whether it is time for the next checkpoint."""
        return time.perf_counter() - self._last_save >= self.config.checkpoint.every_seconds

    def save(self, state: Mapping[str, Any]) -> None:
        """Write a checkpoint of the training, and delete old ones.

        Args:
            state: at least ``network`` and ``frames``; ``torch.load`` must be able to read it with ``weights_only``.
        """
        tables = {file.name: file.stat().st_size for file in sorted(self.folder.glob("*.csv"))}
        state = {**state, **self._facts, "tables": tables, "seconds": self.seconds}
        save_checkpoint(self.folder / "checkpoints" / f"{state['frames']:012d}.pt", state)
        for file in training_checkpoints(self.folder)[: -self.config.checkpoint.keep]:
            file.unlink()
        self._last_save = time.perf_counter()

    def finish(self, state: Mapping[str, Any], summary: Mapping[str, Any]) -> None:
        """Write ``network.pt`` and ``summary.json``."""
        save_checkpoint(self.folder / "network.pt", {**state, **self._facts})
        self.write_summary(summary)

    def write_summary(self, summary: Mapping[str, Any]) -> None:
        """Write ``summary.json``."""
        write_json(self.folder / "summary.json", summary)

    def clean_up(self) -> None:
        """Delete the checkpoints of the training; from then on the run counts as finished."""
        shutil.rmtree(self.folder / "checkpoints", ignore_errors=True)
        if self.logger is not None and self.config.logger.name == LoggerName.wandb:
            self.logger.experiment.finish()


def open_run(config: TrainConfig, folder: Path, overrides: Sequence[str]) -> Run:
    """Begin a run in a new folder, or go on with the one that is there, or that ``config.resume`` names.

    Args:
        config: as composed; of a resumed run only ``resume`` is used.
        folder: of a new run.
        overrides: what stood on the command line.

    Raises:
        RunError: the folder holds another run already, is no run's, or its run is finished; or options were given
            together with ``resume``.
        ConfigError: the saved configuration cannot be used.
    """
    if config.resume is None:
        file = folder / "config.yaml"
        if not file.exists():
            return Run(folder, config)
        if config.existing == Existing.refuse:
            raise RunError(f"{folder}: holds a run already; go on with it by resume={folder}, or choose another folder")
        changed = _changes(config, read_config(file.read_text(), origin=str(file), trust=None))
        if changed:
            raise RunError(f"{folder}: holds a run with other options, {', '.join(changed)}; choose another folder")
        checkpoints = training_checkpoints(folder)
        return Run(folder, config, load_checkpoint(checkpoints[-1]) if checkpoints else None)
    others = [text for text in overrides if not text.startswith(("resume=", "trust="))]
    if others:
        raise RunError(f"resume goes on with the saved configuration; leave out {' '.join(others)}")
    folder = Path(config.resume)
    file = folder / "config.yaml"
    if not file.is_file():
        raise RunError(f"{folder}: is not the folder of a run; it has no {file.name}")
    saved_config = read_config(file.read_text(), origin=str(file), trust=config.trust or [])
    checkpoints = training_checkpoints(folder)
    if is_finished(folder):
        raise RunError(f"{folder}: the run is finished; its result is in {folder / 'summary.json'}")
    return Run(folder, saved_config, load_checkpoint(checkpoints[-1]) if checkpoints else None)


def is_finished(folder: Path) -> bool:
    """Whether a folder holds a run that has come to its end."""
    return (folder / "summary.json").exists() and not training_checkpoints(folder)


def _changes(config: TrainConfig, saved: TrainConfig) -> list[str]:
    """What is asked for and is not what was saved, as ``name=saved, not asked``; of what changes a result."""
    asked, before = (leaves(OmegaConf.to_container(OmegaConf.structured(one))) for one in (config, saved))
    same = ("resume", "trust", "existing", "source.root", "checkpoint.", "logger.")
    return [
        f"{name}={before.get(name)} instead of {value}"
        for name, value in asked.items()
        if before.get(name) != value and not name.startswith(same)
    ]


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


def write_json(file: Path, data: Mapping[str, Any]) -> None:
    """Write a JSON file, whole or not at all; NaN, which JSON does not know, becomes null."""

    def plain(value: Any) -> Any:
        if isinstance(value, Mapping):
            return {key: plain(inner) for key, inner in value.items()}
        return None if isinstance(value, float) and math.isnan(value) else value

    unfinished = file.with_suffix(".tmp")
    unfinished.write_text(json.dumps(plain(data), indent=1) + "\n")
    unfinished.replace(file)


def save_checkpoint(file: Path, state: Mapping[str, Any]) -> None:
    """Write a checkpoint so that the file is either whole or not there, whenever the process is killed."""
    file.parent.mkdir(exist_ok=True)
    unfinished = file.with_suffix(".tmp")
    with unfinished.open("wb") as stream:
        torch.save(dict(state), stream)
        stream.flush()
        os.fsync(stream.fileno())
    unfinished.replace(file)


def load_checkpoint(path: str | Path) -> dict[str, Any]:
    """Read a checkpoint.

    Args:
        path: a ``.pt`` file, or the folder of a run for its final weights, or the latest if it is not finished.

    Raises:
        RunError: there is none, or it is damaged.
    """
    path = Path(path)
    file = path / "network.pt" if path.is_dir() else path
    if path.is_dir() and not file.is_file():
        file = (training_checkpoints(path) or [file])[-1]
    if not file.is_file():
        raise RunError(f"{path}: holds no checkpoint; expected the folder of a run or a .pt file")
    try:
        state = torch.load(file, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises many kinds for a damaged file
        reason = f"{type(error).__name__}: {error}".splitlines()[0]
        raise RunError(f"{file}: is damaged or no checkpoint ({reason}); delete it to use the one before it") from None
    if not isinstance(state, dict) or not {"network", "config", "extractor", "frames"} <= set(state):
        raise RunError(f"{file}: is no checkpoint of dirl; it lacks the network, its configuration or its extractor")
    return state


def training_checkpoints(folder: Path) -> list[Path]:
    """The checkpoints that an unfinished run can go on from, oldest first."""
    return sorted((folder / "checkpoints").glob("*.pt"))


@contextlib.contextmanager
def interruptible() -> Iterator[list[int]]:
    """Within this context the first Ctrl-C only fills the list, so that a loop can end where its state is whole."""
    asked: list[int] = []

    def note(number: int, _: Any) -> None:
        asked.append(number)
        signal.signal(signal.SIGINT, before)

    before = signal.signal(signal.SIGINT, note)
    try:
        yield asked
    finally:
        signal.signal(signal.SIGINT, before)
