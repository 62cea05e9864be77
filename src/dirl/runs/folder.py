"""The folder of a run: its metrics, its checkpoints, and how it is resumed."""

import csv
import math
import os
import shutil
import sys
import time
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from dirl.config.components import packages_to_trust
from dirl.config.files import config_text, leaves, read_config
from dirl.config.folders import command
from dirl.config.schemas import Existing, LoggerName, TrainConfig
from dirl.runs.checkpoints import (
    CONFIG_FILE,
    SCHEMA,
    TABLES,
    RunError,
    State,
    Summary,
    is_finished,
    latest_checkpoint,
    save_checkpoint,
    training_checkpoints,
)
from dirl.runs.locks import TIME, FolderLock, claim
from dirl.scenes.io.files import PREFIX, read_text, write_json, write_text
from dirl.scenes.world import World

if TYPE_CHECKING:
    from dirl.runs.loggers import WandbLogger


@dataclass(eq=False)
class Run:
    """A run: its folder, its configuration, and the checkpoint that it continues from.

    Its metrics are CSV files, one for each stage, with one row for each record. (TorchRL's ``CSVLogger`` writes one
    file for each metric, and cannot remove what a killed run wrote after its last checkpoint.)
    """

    folder: Path
    """For everything that it writes."""
    config: TrainConfig
    """Saved there as ``config.yaml``."""
    saved: State | None = None
    """The checkpoint that it continues from; None at the beginning."""
    lock: FolderLock | None = None
    """Of the folder, for a run that is in it already; without, `begin` makes sure that the folder holds none."""
    unusable: Sequence[Path] = ()
    """Damaged checkpoints, which `begin` sets aside."""
    logger: "WandbLogger | None" = None
    """Beside the tables, if the configuration names it."""
    facts: State = field(default_factory=dict)
    """What every checkpoint says beside its weights, see `checkpoint_facts`."""
    tables: dict[Path, list[str]] = field(default_factory=dict)
    """Columns of each that has been begun; none before its first row."""
    began: float = field(default_factory=time.perf_counter)
    """When this process began it."""
    last_save: float = field(default_factory=time.perf_counter)
    """When it last wrote a checkpoint, as is ``began`` by ``time.perf_counter``."""

    def begin(self, world: World, view_order: Sequence[str]) -> None:
        """Lock the folder, write the configuration, and remove what is newer than the checkpoint.

        Nothing is written before. If the folder is named after the second and belongs to another run, this run gets a
        folder with a number after its name.

        Raises:
            RunError: the folder holds another run, or another process writes to it.
            ConfigError: the logger cannot begin.
            OSError: the folder cannot be written to.
        """
        asked = self.folder
        if self.lock is None and self.saved is None:
            self.folder, self.lock = claim(asked)
        elif self.lock is None:
            self.lock = FolderLock(self.folder)
        try:
            if self.config.logger.name == LoggerName.wandb:
                from dirl.runs.loggers import WandbLogger  # late: wandb takes a second

                self.logger = WandbLogger(self.config, self.folder)
            self.facts = checkpoint_facts(self.config, world, view_order)
            # Files of a killed process that this run does not continue from.
            for file in self.unusable:
                file.replace(file.with_name(f"{file.name}.damaged"))
            for file in (*self.folder.glob(f"{PREFIX}*"), *(self.folder / "checkpoints").glob(f"{PREFIX}*")):
                file.unlink(missing_ok=True)
            sizes = self.saved["tables"] if self.saved else {}
            for file in (self.folder / name for name in TABLES):
                if file.exists():
                    os.truncate(file, sizes.get(file.name, 0))
                    with file.open(encoding="utf-8", errors="replace") as stream:
                        self.tables[file] = next(csv.reader([stream.readline(2**16)]))
            if not (self.folder / CONFIG_FILE).exists():
                write_text(self.folder / CONFIG_FILE, self.facts["config"])
        except BaseException:
            self.close()
            if self.folder != asked:
                with suppress(OSError):
                    self.folder.rmdir()
            raise

    def close(self) -> None:
        """Release the folder; the end of the process does so at the latest."""
        if self.lock is not None:
            self.lock.release()
            self.lock = None

    def how_to_go_on(self) -> str:
        """Return what is safe and how to continue, for the message of a stopped run."""
        if not (self.folder / CONFIG_FILE).exists():
            return "nothing of this run was saved"
        if is_finished(self.folder):
            return f"the run is finished: {self.folder}"
        safe = "its last checkpoint is safe" if training_checkpoints(self.folder) else "it has no checkpoint yet"
        return f"{safe}; resume with: {command('train', running=True)} resume={self.folder}"

    @property
    def seconds(self) -> float:
        """Return the duration of the run, without the time between a stop and its resumption."""
        before = self.saved["seconds"] if self.saved is not None else 0.0
        return before + time.perf_counter() - self.began

    def write(self, stage: str, step: int, row: Mapping[str, float | int]) -> None:
        """Append a row to ``<stage>.csv``; NaN becomes an empty cell. The columns are those of the first row."""
        file = self.folder / f"{stage}.csv"
        cells = {
            name: "" if math.isnan(value) else f"{value:.6g}" if isinstance(value, float) else value
            for name, value in row.items()
        }
        if file in self.tables:
            file.stat()  # if somebody has deleted it, a file without its first rows must not take its place
        begins = not self.tables.get(file)
        if begins:
            self.tables[file] = list(row)
        with file.open("a", newline="") as stream:
            writer = csv.DictWriter(stream, self.tables[file], restval="", extrasaction="ignore")
            if begins:
                writer.writeheader()
            writer.writerow(cells)
        if self.logger is not None:
            self.logger.log(stage, step, row)

    def save_due(self, runs: int) -> bool:
        """Return True if it is time for the next checkpoint; the more runs are saved together, the longer it takes."""
        return time.perf_counter() - self.last_save >= runs * self.config.checkpoint.every_seconds

    def save(self, state: State) -> None:
        """Write a checkpoint of the training, and delete old ones.

        The state has at least ``network`` and ``frames``; ``torch.load`` must be able to read it with ``weights_only``.
        """
        (self.folder / CONFIG_FILE).stat()  # if somebody has deleted the folder, a part of it must not come back
        tables = {}
        for file in sorted(self.tables):
            with file.open("rb") as stream:
                os.fsync(stream.fileno())  # a checkpoint must not reach the disk before the rows that it counts
                tables[file.name] = os.fstat(stream.fileno()).st_size
        state = {**state, **self.facts, "tables": tables, "seconds": self.seconds}
        save_checkpoint(self.folder / "checkpoints" / f"{state['frames']:012d}.pt", state)
        for file in training_checkpoints(self.folder)[: -self.config.checkpoint.keep]:
            file.unlink()
        self.last_save = time.perf_counter()

    def finish(self, state: State, summary: Summary) -> None:
        """Write ``network.pt`` and ``summary.json``."""
        for file in (self.folder / CONFIG_FILE, *self.tables):
            file.stat()  # see `save`
        save_checkpoint(self.folder / "network.pt", {**state, **self.facts})
        write_json(self.folder / "summary.json", summary)

    def clean_up(self, summary: Summary) -> None:
        """Delete the checkpoints of the training; the run then counts as finished, and the folder is released."""
        if (self.folder / "checkpoints").exists():
            shutil.rmtree(self.folder / "checkpoints")
        self.close()
        if self.logger is not None:
            self.logger.finish(summary, self.folder)


def checkpoint_facts(config: TrainConfig, world: World, view_order: Sequence[str]) -> State:
    """Return what a checkpoint says beside its weights, for everyone who uses them."""
    scenes = {"scenes": list(world.names), "extractor": world.scenes[0].extractor}
    seen = {"views": list(view_order), "turns": world.turns.unique().tolist()}
    return {"config": config_text(config), **scenes, **seen, "schema": SCHEMA}


def open_run(config: TrainConfig, folder: Path, overrides: Sequence[str]) -> Run:
    """Begin a run in a new folder, or continue the existing one, or that which ``config.resume`` names.

    A run that is continued locks its folder here; a new one does so in `Run.begin`. Of a resumed run only
    ``config.resume`` is used; ``overrides`` are those of the command line.

    Raises:
        RunError: the folder holds another run already, is no run's, its run is finished, or another process writes to
            it; its checkpoints are damaged; or options were given together with ``resume``.
        ConfigError: the saved configuration cannot be used.
    """
    if config.resume is None:
        if not (folder / CONFIG_FILE).exists():
            return Run(folder, config)
        if config.existing == Existing.refuse and any(map(TIME.fullmatch, folder.parts[-2:])):
            return Run(folder, config)
        if config.existing == Existing.refuse:
            raise RunError(f"{folder}: holds a run already; continue it with resume={folder}, or choose another folder")
        changed = _changes(config, _saved_config(folder, packages_to_trust(config)))
        if changed:
            raise RunError(f"{folder}: holds a run with other options, {', '.join(changed)}; choose another folder")
        return Run(folder, config) if is_finished(folder) else _go_on(folder, config)
    if others := [text for text in overrides if not text.startswith(("resume=", "trust="))]:
        raise RunError(f"resume uses the saved configuration; leave out {' '.join(others)}")
    folder = Path(config.resume)
    if not (folder / CONFIG_FILE).is_file():
        raise RunError(f"{folder}: is not the folder of a run; it has no {CONFIG_FILE}")
    return _go_on(folder, _saved_config(folder, config.trust or []))


def _go_on(folder: Path, config: TrainConfig) -> Run:
    """Return the run in a folder at its latest usable checkpoint, or at its beginning if it has saved none yet."""
    lock = FolderLock(folder)
    if is_finished(folder):
        raise RunError(f"{folder}: the run is finished; its result is in {folder / 'summary.json'}")
    if not training_checkpoints(folder):
        return Run(folder, config, lock=lock)

    try:
        saved, unusable = latest_checkpoint(folder, check_tables)
    except ValueError:
        lock.release()  # the error's traceback would keep it, in a notebook for ever
        raise
    return Run(folder, config, saved, lock=lock, unusable=unusable)


def check_tables(file: Path, state: State) -> None:
    """Raise `RunError` unless the tables of a run have at least the rows that its checkpoint counts."""
    if "tables" not in state:
        raise RunError(f"{file}: is no checkpoint of a training; it lacks tables")
    for name, size in state["tables"].items():
        table = file.parent.parent / name
        if not table.is_file() or table.stat().st_size < size:
            raise RunError(f"{file}: does not fit {table}, which is shorter than it was, or missing")


def _saved_config(folder: Path, trust: Collection[str]) -> TrainConfig:
    """Return the configuration of a run."""
    file = folder / CONFIG_FILE
    return read_config(read_text(file, errors="replace"), origin=str(file), trust=trust)


def _changes(config: TrainConfig, saved: TrainConfig) -> list[str]:
    """Return the options that differ from the saved ones and change a result: ``name=saved instead of requested``."""
    asked, before = leaves(asdict(config)), leaves(asdict(saved))
    same = ("out", "resume", "trust", "existing", "source.root", "checkpoint.", "logger.")
    return [
        f"{name}={before.get(name)} instead of {value}"
        for name, value in asked.items()
        if before.get(name) != value and not name.startswith(same)
    ]


def peak_memory_mb() -> float | None:
    """Return the most memory this process has held, MB; None where the system does not say, as on Windows."""
    status = Path("/proc/self/status")
    if status.exists():  # on Linux `getrusage` would include the memory of the parent before the fork
        return int(status.read_text().split("VmHWM:")[1].split()[0]) * 1024 / 1e6
    try:
        import resource
    except ImportError:  # on Windows
        return None
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024) / 1e6
