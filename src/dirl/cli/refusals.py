"""What a recipe refuses before it imports torch: options that are missing, and paths and names that do not exist.

The recipes call the functions below for what they take; `check_values` calls them beforehand.
"""

import importlib.util
import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from dirl.config.components import check_sources
from dirl.config.places import command
from dirl.config.scene_schemas import (
    BuildConfig,
    EncodeConfig,
    ExportConfig,
    ImportConfig,
    InspectConfig,
    MiniworldConfig,
    PhotosConfig,
    RecordingConfig,
    SampleConfig,
    SimulatorConfig,
    ThorConfig,
    TourConfig,
    VizdoomConfig,
)
from dirl.config.schemas import ConfigError, EvaluateConfig, ExperimentName, ReportConfig, TrainConfig

ARCHITECTURE = ("observation", "encoder", "memory", "heads", "policy", "network")
"""The options that decide which weights a policy has, and what they read."""


def check_values(options: Any, overrides: Sequence[str]) -> None:
    """Refuse the options of a recipe that cannot be used.

    Args:
        options: composed and typed.
        overrides: of the command line, as ``name=value``.

    Raises:
        ValueError: one cannot be used; the message says why in one line.
    """
    for kind, check in CHECKS.items():
        if isinstance(options, kind):
            check(options, overrides)


def training(options: TrainConfig, overrides: Sequence[str]) -> None:
    """Refuse a run that cannot be resumed, weights and scenes that do not exist, unknown options of components."""
    if options.resume is not None:
        from dirl.runs.finding import find_unfinished
        from dirl.runs.locks import finish_cleaning

        if os.environ.get("RANK", "0") == "0":  # other ranks need not see the folder
            finish_cleaning(Path(options.resume))
            find_unfinished(options.resume, overrides)
        return
    check_sources(options)
    scenes(options)
    if options.init is not None:
        initial_weights_file(options.init, overrides)


def scenes(options: TrainConfig) -> None:
    """Refuse scenes that do not exist, and a goal that is named twice."""
    from dirl.scenes.catalogue import find_rooms, find_scenes
    from dirl.scenes.scene import check_goals_differ

    if find_rooms(options.scene or [], options.split, options.rooms) is not None:
        return
    found = find_scenes(options.scene or [], source=options.source.name, root=options.source.root)
    goals = options.goals
    if not isinstance(goals, Mapping):
        goals = {found[0].name: goals} if len(found) == 1 else {}
    for name, states in goals.items():  # that of a file is not known yet
        if name is not None and isinstance(states, list) and all(isinstance(state, int) for state in states):
            check_goals_differ(name, states)


def initial_weights_file(init: str, overrides: Sequence[str]) -> Path:
    """The checkpoint that ``init`` names.

    Raises:
        ConfigError: an option of the architecture is given beside ``init``.
        RunError: there is no such checkpoint.
    """
    from dirl.runs.finding import find_checkpoint

    texts = [text.lstrip("+") for text in overrides]
    given = [text for text in texts if text.partition("=")[0].partition(".")[0] in ARCHITECTURE]
    if given:
        raise ConfigError(f"init={init}: its checkpoint decides the architecture; leave out {' '.join(given)}")
    return find_checkpoint(init)


def checkpoint_file(options: EvaluateConfig) -> str:
    """The checkpoint to evaluate, as the user names it.

    Raises:
        RunError: none is named, there is none, or ``last_steps`` is given without a map.
        ConfigError: ``out`` exists, or cannot be written.
    """
    from dirl.runs.checks import RunError
    from dirl.runs.finding import find_checkpoint

    if options.checkpoint is None:
        raise RunError("name what to evaluate: checkpoint=<the folder of a run, or a .pt file in one>")
    if options.last_steps is not None and options.image_graph is None:
        raise RunError(f"last_steps={options.last_steps}: only where a map leads; give image_graph=2 too")
    if options.simulator is None and (options.slip or options.turn_error):
        raise RunError("slip, turn_error: only in a live world; give simulator=dump or a YAML file too")
    if options.simulator is not None and (options.viewer or options.video or options.image_graph is not None):
        raise RunError("simulator: a live world has no viewer, no video and no image_graph; leave them out")
    if options.video and importlib.util.find_spec("imageio_ffmpeg") is None:
        raise RunError("video=true needs a package that is not installed: pip install imageio-ffmpeg")
    if options.out is not None:
        new_file(options.out, ending="")
    find_checkpoint(options.checkpoint)
    return options.checkpoint


OF_AGENTS = [ExperimentName[name] for name in ("image_graph", "changes", "walked_once", "other_worlds")]
"""The experiments on agents instead of runs."""


def tested_agents(options: ReportConfig) -> bool:
    """Whether a report is about agents, and not about runs.

    Raises:
        ConfigError: no experiment is named, or not the agents and collections that it needs.
        RunError: an agent is not found.
    """
    from dirl.runs.finding import find_checkpoint

    if options.experiment is None:
        raise ConfigError(f"name what to report: experiment=<one of {', '.join(ExperimentName)}>")
    if options.experiment not in OF_AGENTS:
        return False
    if not options.collections or (options.experiment == "image_graph" and len(options.collections) > 1):
        wanted = "files of scenes" if options.experiment == "other_worlds" else "folders made by scenes.py sample"
        raise ConfigError(f"collections={options.collections}: say where; {wanted}, of image_graph one")
    several = {"changes": range(1, 100), "image_graph": range(2)}.get(options.experiment, range(1, 2))
    if len(options.agents) not in several:
        raise ConfigError(f"agents={options.agents}: must be one; several for changes, [] for image_graph without one")
    for agent in options.agents:
        find_checkpoint(agent)
    return True


def reported_runs(options: ReportConfig) -> tuple[Path, str]:
    """The folder of the runs that a report is about, and the command that makes them.

    Raises:
        RunError: the folder holds no finished run.
    """
    from dirl.runs.finding import finished_folders

    folder = Path(options.runs) / options.preset
    hint = f"{command('train')} -m experiment={options.experiment} preset={options.preset}"
    finished_folders(folder, hint)
    return folder, hint


def new_file(name: str | None, ending: str = ".h5") -> Path:
    """Where to write. What is there already is not overwritten, and a folder that cannot be written to is refused."""
    if name is None:
        raise ConfigError(f"say where to write: out=<a new file{ending and f' ({ending})'}>")
    path = Path(name)
    if ending and path.suffix != ending:
        raise ConfigError(f"out={name}: the name must end in {ending}")
    try:
        if path.exists():
            raise ConfigError(f"out={name}: this file exists already; it is not overwritten")
        above = next(folder for folder in path.absolute().parents if folder.exists())
        with tempfile.TemporaryFile(dir=above):
            pass
    except OSError as error:
        raise ConfigError(f"out={name}: cannot be written ({error.strerror})") from None
    return path


def named(value: str | None, wanted: str) -> str:
    """The value of an option that must be given; ``wanted`` is the message if it is not."""
    if value is None:
        raise ConfigError(wanted)
    return value


def simulated_scene(options: ThorConfig | VizdoomConfig | MiniworldConfig | SimulatorConfig) -> str:
    """The simulator's scene that an option names, or the file of a simulator."""
    if isinstance(options, SimulatorConfig):
        return named(options.simulator, "name the simulator: simulator=<a YAML file with its class, _target_>")
    if isinstance(options, VizdoomConfig):
        return named(options.map, "name a map: map=map01 to map32 of Freedoom 2, E1M1 to E4M9 of Freedoom 1")
    if isinstance(options, MiniworldConfig):
        return named(options.env, "name an environment of MiniWorld: env=FourRooms")
    return named(options.scene, "name a scene of AI2-THOR: scene=FloorPlan401")


def photo_folder(options: PhotosConfig) -> str:
    """The folder of photographs that an option ``folder`` names."""
    return named(options.folder, "name the folder of the photographs: folder=<the images and states.csv>")


def tour_path(options: TourConfig) -> str:
    """The tour that an option ``path`` names."""
    return named(options.path, "name the tour: path=<its folder, or the file that describes it>")


def room_description(options: BuildConfig) -> str:
    """The description of a room that an option ``description`` names."""
    from dirl.rooms.build import built_in_rooms, describe_room

    name = named(options.description, f"name a room: description=<{' | '.join(built_in_rooms())}, or a .toml file>")
    describe_room(name)
    return name


def sampled_kinds(options: SampleConfig) -> tuple[Path, list[str]]:
    """Where random rooms are written, and which kinds."""
    from dirl.rooms.options import check_keys
    from dirl.rooms.sampling import KINDS

    folder = Path(named(options.out, "say where to write: out=<a folder>"))
    kind = named(options.kind, f"name a kind of room: kind=<{' | '.join(KINDS)} | all>")
    check_keys({} if kind == "all" else {kind: 0}, KINDS, "kind")
    return folder, [one for one in KINDS if kind in (one, "all")]


def one_scene(name: str | None) -> str:
    """The scene that an option ``scene`` names."""
    from dirl.scenes.catalogue import find_rooms, find_scenes

    if name is None:
        raise ConfigError("name a scene: scene=<a dump (.h5) or a built-in room>")
    if name == "all":
        raise ConfigError("scene=all: one scene at a time")
    if find_rooms(name, None, None) is None:
        find_scenes(name)
    return name


def encoder_name(options: EncodeConfig) -> str:
    """The encoder that an option ``encoder`` names."""
    return named(
        options.encoder, "name the encoder: encoder=resnet50, weights of one, torchvision, or a Hugging Face model"
    )


def recording_file(options: RecordingConfig) -> str:
    """The recording that an option ``file`` names."""
    file = named(options.file, "name the recording: file=<an HDF5 file>")
    if not Path(file).is_file():
        raise ConfigError(f"file={file}: there is no such file")
    return file


def photo_table(options: PhotosConfig) -> None:
    """Refuse a folder of photographs whose table is missing or invalid."""
    from dirl.sources.photos import read_photos

    new_file(options.out)
    read_photos(photo_folder(options), name=options.name)


CHECKS: dict[type, Callable[[Any, Sequence[str]], object]] = {
    TrainConfig: training,
    EvaluateConfig: lambda options, _: checkpoint_file(options),
    ReportConfig: lambda options, _: tested_agents(options) or reported_runs(options),
    ThorConfig: lambda options, _: (new_file(options.out), simulated_scene(options)),
    VizdoomConfig: lambda options, _: (new_file(options.out), simulated_scene(options)),
    MiniworldConfig: lambda options, _: (new_file(options.out), simulated_scene(options)),
    SimulatorConfig: lambda options, _: (new_file(options.out), simulated_scene(options)),
    PhotosConfig: lambda options, _: photo_table(options),
    RecordingConfig: lambda options, _: (new_file(options.out, ending=""), recording_file(options)),
    TourConfig: lambda options, _: (new_file(options.out), tour_path(options)),
    BuildConfig: lambda options, _: (new_file(options.out), room_description(options)),
    SampleConfig: lambda options, _: sampled_kinds(options),
    EncodeConfig: lambda options, _: (new_file(options.out), one_scene(options.scene), encoder_name(options)),
    ExportConfig: lambda options, _: (new_file(options.out), one_scene(options.scene)),
    ImportConfig: lambda options, _: (new_file(options.out), one_scene(options.scene)),
    InspectConfig: lambda options, _: (options.out and new_file(options.out, ending=""), one_scene(options.scene)),
}
"""What is checked, by the type of the options."""
