"""What a recipe refuses before it imports torch: paths and names that do not exist, options that contradict others."""

import importlib.util
import os
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from dirl.config.components import TARGET, components, make
from dirl.config.places import command
from dirl.config.schemas import ConfigError, ExperimentName, TrainConfig
from dirl.runs.paths import find_checkpoint, find_unfinished, finished_folders, initial_weights_file


def check_values(recipe: str, options: Any, overrides: Sequence[str] = ()) -> None:
    """Refuse the options, composed and typed, of a recipe or of a command of ``recipes/scenes.py``.

    Of a training the ``overrides`` of the command line, ``name=value``, are used too.

    Raises:
        ValueError: one cannot be used; the message says why in one line.
    """
    match recipe:
        case "train":
            _training(options, overrides)
        case "evaluate":
            _evaluation(options)
        case "report":
            _report(options)
        case "map" | "go":
            _recorded(recipe, options)
        case "sample":
            from dirl.scenes.io.checked import check_choice
            from dirl.sources.rooms.sampling import KINDS

            if options.kind != "all":
                check_choice(options.kind, KINDS, "kind")
            check_writable(options.out)
        case "benchmark":
            if options.out is not None:
                new_file(options.out, ending="")
        case _:
            _scene_command(recipe, options)


def _recorded(recipe: str, options: Any) -> None:
    """Refuse a video, map or photo that does not exist, and where nothing can be written."""
    if recipe == "map" and not os.path.exists(options.video):
        raise ConfigError(f"video={options.video}: there is no such video or folder of images")
    for name in ("map", "photo", "start") if recipe == "go" else ():
        if (file := getattr(options, name)) is not None and not os.path.isfile(file):
            raise ConfigError(f"{name}={file}: there is no such file")
    new_file(options.out, ending=".npz" if recipe == "map" else ".png")


def _scene_command(name: str, options: Any) -> None:
    """Refuse where nothing can be written, and what does not exist."""
    if options.out is not None:
        new_file(options.out, ending="" if name in ("recording", "inspect") else ".h5")
    match name:
        case "encode" | "export" | "import" | "inspect":
            from dirl.scenes.catalogue import find_rooms, find_scenes

            if options.scene == "all":
                raise ConfigError("scene=all: one scene at a time")
            if find_rooms(options.scene, None, None) is None:
                find_scenes(options.scene)
            if name == "encode" and options.encoder is None:
                raise ConfigError("encoder=null: encode needs one")
        case "build":
            from dirl.sources.rooms.build import describe_room

            describe_room(options.description)
        case "photos":
            from dirl.sources.photos import read_photos

            read_photos(Path(options.folder), name=options.name)
        case "recording" if not Path(options.file).is_file():
            raise ConfigError(f"file={options.file}: there is no such file")


def _training(options: TrainConfig, overrides: Sequence[str]) -> None:
    """Refuse a run that cannot be resumed, components without a class, and weights and scenes that do not exist."""
    if options.resume is not None:
        from dirl.runs.locks import finish_cleaning

        finish_cleaning(Path(options.resume))
        find_unfinished(options.resume, overrides)
        return
    components(options)  # each names a class; whether there is such a class is known after the imports
    _scenes(options)
    if options.init is not None:
        initial_weights_file(options.init, overrides)


def _scenes(options: TrainConfig) -> None:
    """Refuse scenes that do not exist, and a goal that is named twice."""
    from dirl.scenes.catalogue import find_rooms, find_scenes
    from dirl.scenes.scene import check_goals_differ

    if find_rooms(options.scene or [], options.split, options.rooms) is not None:
        return
    if not str(options.source[TARGET]).startswith("dirl."):  # it is asked when the run begins
        return
    found = find_scenes(options.scene or [], make("source", options.source))
    goals = options.goals
    if not isinstance(goals, Mapping):
        goals = {found[0].name: goals} if len(found) == 1 else {}
    for name, states in goals.items():  # that of a file is not known yet
        if name is not None and isinstance(states, list) and all(isinstance(state, int) for state in states):
            check_goals_differ(name, states)


def _evaluation(options: Any) -> None:
    """Refuse a checkpoint that does not exist, and options that need others, or exclude them."""
    if options.last_steps is not None and options.map is None:
        raise ConfigError(f"last_steps={options.last_steps}: only where a map leads; give map=2 too")
    if options.simulator is None and (options.slip or options.turn_error):
        raise ConfigError("slip, turn_error: only in a live world; give simulator=dump or a YAML file too")
    if options.simulator is not None and (options.viewer or options.video or options.map is not None):
        raise ConfigError("simulator: a live world has no viewer, no video and no map; leave them out")
    shown = options.simulator is not None or options.viewer or options.video
    for name in ("arrows", "panorama"):
        if getattr(options, name) and shown:
            raise ConfigError(f"{name}: agents see it in evaluation alone; leave out simulator, viewer and video")
    if options.video and importlib.util.find_spec("imageio_ffmpeg") is None:
        raise ConfigError("video=true needs a package that is not installed: pip install imageio-ffmpeg")
    if options.out is not None:
        new_file(options.out, ending="")
    if options.beside is not None:
        if not options.viewer:
            raise ConfigError(f"beside={options.beside}: only the viewer shows two agents; give viewer=true too")
        find_checkpoint(options.beside)
    find_checkpoint(options.checkpoint)


OF_AGENTS = [ExperimentName[name] for name in ("image_graph", "changes", "walked_once", "other_worlds", "sptm")]
"""The experiments on agents instead of runs."""


def _report(options: Any) -> None:
    """Refuse a report without finished runs, or, of agents, without these or without somewhere to test them."""
    if options.experiment not in OF_AGENTS:
        finished_folders(*reported_runs(options))
        return
    if options.experiment == ExperimentName.sptm:
        if options.folder is None or not os.path.isdir(os.path.join(options.folder, "data")):
            raise ConfigError(f"folder={options.folder}: name a folder that github.com/nsavinov/SPTM was cloned to")
        return
    if not options.collections or (options.experiment == "image_graph" and len(options.collections) > 1):
        wanted = "files of scenes" if options.experiment == "other_worlds" else "folders made by scenes.py sample"
        raise ConfigError(f"collections={options.collections}: say where; {wanted}, of image_graph one")
    several = {"changes": range(1, 100), "image_graph": range(2)}.get(options.experiment, range(1, 2))
    if len(options.agents) not in several:
        raise ConfigError(f"agents={options.agents}: must be one; several for changes, [] for image_graph without one")
    for agent in options.agents:
        find_checkpoint(agent)


def reported_runs(options: Any) -> tuple[Path, str]:
    """The folder of the runs that a report is about, and the command that makes them."""
    hint = f"{command('train')} -m experiment={options.experiment} preset={options.preset}"
    return Path(options.runs) / options.preset, hint


def new_file(name: str, ending: str = ".h5") -> Path:
    """Where to write. What is there already is not overwritten, and a folder that cannot be written to is refused."""
    path = Path(name)
    if ending and path.suffix != ending:
        raise ConfigError(f"out={name}: the name must end in {ending}")
    if os.path.exists(name):  # of a name that is too long a Path would raise
        raise ConfigError(f"out={name}: this file exists already; it is not overwritten")
    check_writable(name)
    return path


def check_writable(name: str) -> None:
    """Refuse what cannot be made, and a folder in which nothing can be; a file that is there is refused elsewhere."""
    path = Path(name).absolute()
    try:
        above = path if path.is_dir() else next(folder for folder in path.parents if folder.exists())
        with tempfile.TemporaryFile(dir=above):
            pass
    except OSError as error:
        raise ConfigError(f"out={name}: cannot be written ({error.strerror})") from None
