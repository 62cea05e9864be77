"""Take, build, convert, encode and check scenes.

    python recipes/scenes.py thor scene=FloorPlan401 out=dumps/FloorPlan401.h5 encoder=resnet50.pth
    python recipes/scenes.py photos folder=my_office out=my_office.h5 encoder=resnet50.pth
    python recipes/scenes.py build description=bathroom_02 out=bathroom.h5 encoder=resnet50.pth
    python recipes/scenes.py sample kind=bedroom seed=7 out=my_bedroom encoder=resnet50.pth
    python recipes/scenes.py encode scene=room.h5 encoder=resnet50.pth out=room_resnet.h5
    python recipes/scenes.py export scene=bathroom_02 layout=icra17 out=icra17/bathroom_02.h5
    python recipes/scenes.py import scene=data/bathroom_02.h5 source=thor out=bathroom_02.h5
    python recipes/scenes.py inspect scene=bathroom_02 out=pictures

All options of each command with their values: conf/scenes/<command>.yaml.
"""

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import hydra
from omegaconf import DictConfig
from tqdm import tqdm

from dirl.backbones import ViewEncoder, encode_scene, encode_views, load_encoder
from dirl.config.command_line import SCHEMAS, choose_command, one_line_errors, prepare, register
from dirl.config.places import CONF
from dirl.config.scene_schemas import (
    BuildConfig,
    EncodeConfig,
    ExportConfig,
    ImportConfig,
    InspectConfig,
    PhotosConfig,
    SampleConfig,
    ThorConfig,
)
from dirl.config.schemas import ConfigError, Match, typed
from dirl.reporting import draw_contact_sheet, draw_distances, draw_false_stops, draw_scene_map
from dirl.rooms import KINDS, RoomDescription, build_room, built_in_rooms, sample_room, write_description
from dirl.rooms.checks import far_apart
from dirl.rooms.sheet import draw_sheet, preview
from dirl.scenes import Scene, load_scenes, write_dump
from dirl.scenes.diagnostics import THRESHOLDS, Inspection, inspect_scene
from dirl.scenes.io.icra17 import export_icra17
from dirl.scenes.io.write import replace_features
from dirl.scenes.sources.photos import encoded_photos, read_photos
from dirl.scenes.sources.thor import start_simulator, take_views
from dirl.scenes.views import decode
from dirl.scenes.views import encode as webp

SHOWN_PAIRS = 10
"""Of the ambiguous ones."""


def thor(options: ThorConfig) -> None:
    """Take a scene from live AI2-THOR, by way of a folder that a stopped run goes on with."""
    out = new_file(options.out)
    if options.scene is None:
        raise ConfigError("name a scene of AI2-THOR: scene=FloorPlan401")
    encoder = chosen_encoder(options)
    settings = {name: getattr(options, name) for name in ("scene", "step", "height", "width", "field_of_view")}
    folder = out.with_suffix(".taken")
    simulator = start_simulator(**settings, headless=options.headless)
    for problem in take_views(simulator, folder, settings=settings):
        print(f"left out: {problem}")
    write_photos(folder, out, options.scene, "thor", (options.height, options.width), encoder)
    print(f"{folder} is no longer needed")


def photos(options: PhotosConfig) -> None:
    """Make a dump from photographs."""
    out = new_file(options.out)
    if options.folder is None:
        raise ConfigError("name the folder of the photographs: folder=<the images and states.csv>")
    shape = (options.height, options.width)
    write_photos(Path(options.folder), out, options.name, "photos", shape, chosen_encoder(options))


def write_photos(
    folder: Path, out: Path, name: str | None, source: str, shape: tuple[int, int], encoder: ViewEncoder | None
) -> None:
    """A dump from a folder with ``states.csv``, with features if there is an encoder."""
    scene, images = read_photos(folder, name=name, source=source)
    views = list(tqdm(encoded_photos(images, *shape), total=len(images), desc="images", disable=None))
    if encoder is not None:
        features = encode_views(encoder, map(decode, views), len(views), str(folder))
        scene = replace(scene, features=features, extractor=encoder.extractor)
    write_dump(out, scene, views, feature_attributes=None if encoder is None else dict(encoder.attributes))
    print(f"{out}: {len(scene)} states (source: {scene.source}), {out.stat().st_size / 1e6:.1f} MB")
    print("no features yet; see the command encode" if encoder is None else f"extractor: {encoder.extractor}")


def build(options: BuildConfig) -> None:
    """Build a synthetic room from its description."""
    out = new_file(options.out)
    if options.description is None:
        raise ConfigError(f"name a room: description=<{' | '.join(built_in_rooms())}, or a .toml file>")
    problems = build_room(
        options.description,
        out,
        size=(options.height, options.width),
        turn=options.turn,
        fine=options.fine,
        quality=options.quality,
        workers=options.workers,
        encoder=chosen_encoder(options),
        provenance=options.provenance or "",
    )
    scene = one_scene(str(out))
    print(f"{out}: {len(scene)} states (source: {scene.source}), {out.stat().st_size / 1e6:.1f} MB")
    print("\n".join(["problems:", *(f"- {problem}" for problem in problems)] if problems else ["no problems found"]))


def sample(options: SampleConfig) -> None:
    """Furnish random rooms and build them, each with its description beside it, and a contact sheet of all."""
    folder = new_file(options.out, ending="")
    if options.kind is None:
        raise ConfigError(f"name a kind of room: kind=<{' | '.join(KINDS)} | all>")
    kinds = list(KINDS) if options.kind == "all" else [options.kind]
    encoder, previews = chosen_encoder(options), []
    for kind in kinds:
        for seed in range(options.seed, options.seed + options.count):
            room = sample_room(kind, seed)
            folder.mkdir(parents=True, exist_ok=True)
            write_description(room, folder / f"{room.name}.toml")
            problems = build_room(
                room,
                folder / f"{room.name}.h5",
                size=(options.height, options.width),
                turn=options.turn,
                fine=options.fine,
                workers=options.workers,
                encoder=encoder,
            )
            previews.append(preview(room))
            if len(previews) == 1:
                print("| room | metres | pieces | places | states | parts | alike: one view | four views | problems |")
                print("|---|---|--:|--:|--:|--:|--:|--:|---|")
            scene = one_scene(str(folder / f"{room.name}.h5"))
            print("| " + " | ".join(sampled(room, scene, problems)), "|", flush=True)
    draw_sheet(previews, folder / "rooms.png")
    print(f"\n{len(previews)} rooms: {folder}")


def sampled(room: RoomDescription, scene: Scene, problems: list[str]) -> list[str]:
    """The table's row of a random room; with features also how many pairs of states that are far apart match."""
    found = {match: inspect_scene(scene, match=match) for match in Match}
    apart = far_apart(scene.positions, scene.headings)
    far = {match: sum(bool(apart[a, b]) for a, b, *_ in one.ambiguous) for match, one in found.items()}
    none = scene.features is None
    problems = problems if none else problems + found[Match.views].problems
    return [
        room.name,
        "{:g} x {:g} x {:g}".format(*room.size),
        f"{len(room.furniture)}",
        f"{room.grid.places}",
        f"{len(scene)}",
        f"{found[Match.views].parts.max() + 1}",
        "-" if none else f"{far[Match.front]}",
        "-" if none else f"{far[Match.views]}",
        "; ".join(problems) or "none",
    ]


def encode(options: EncodeConfig) -> None:
    """Compute the features of a dump anew, from its stored views."""
    out = new_file(options.out)
    scene = one_scene(options.scene)
    if options.encoder is None:
        raise ConfigError("name the encoder: encoder=<weights of ResNet-50>, torchvision, or a Hugging Face model")
    encoder = chosen_encoder(options)
    assert encoder is not None
    features = encode_scene(scene, encoder)
    assert scene.views is not None
    replace_features(scene.views.path, out, features, encoder.attributes)
    print(f"{out}: {len(scene)} states, {features.shape[1]} features each\nextractor: {encoder.extractor}")


def export(options: ExportConfig) -> None:
    """Write a scene in the layout of other navigation code."""
    out = new_file(options.out)
    scene = one_scene(options.scene)
    export_icra17(scene, out)
    print(f"{out}: {len(scene)} states (source: {scene.source}), {out.stat().st_size / 1e6:.1f} MB")


def take_over(options: ImportConfig) -> None:
    """Take over a dump in the published layout."""
    out = new_file(options.out)
    scene = one_scene(options.scene)
    goals = scene.goals if options.goals is None else tuple(options.goals)
    scene = replace(scene, name=options.name or scene.name, source=options.source or scene.source, goals=goals)
    views = scene.views
    stored = views and (views.encoded(state) or webp(views[state], quality=None) for state in range(len(scene)))
    write_dump(out, scene, stored or None)
    print(f"{out}: {len(scene)} states (source: {scene.source}), {out.stat().st_size / 1e6:.1f} MB")


def inspect(options: InspectConfig) -> None:
    """Look at a scene and check it."""
    folder = None if options.out is None else new_file(options.out, ending="")
    scene = one_scene(options.scene)
    found = inspect_scene(scene, threshold=options.threshold, match=options.match)
    print(
        "\n".join([f"| {scene.name} | |", "|---|---|", *(f"| {key} | {text} |" for key, text in found.facts.items())])
    )
    if found.ambiguous:
        print(
            f"\n{len(found.ambiguous)} ambiguous pairs (match={options.match} above {options.threshold:g}), the worst:"
        )
        print("\n| state | state | matching | actions between |\n|--:|--:|--:|--:|")
        for a, b, score, distance in found.ambiguous[:SHOWN_PAIRS]:
            print(f"| {a} | {b} | {score:.3f} | {distance if distance >= 0 else 'unconnected'} |")
    if found.false_stops is not None:
        print("\n| false stops above | every state as a goal | the scene's own goals |\n|--:|--:|--:|")
        own = found.goal_false_stops
        for index in range(0, len(THRESHOLDS), 10):
            cell = "-" if own is None else f"{own[index]:.4%}"
            print(f"| {THRESHOLDS[index]:.2f} | {found.false_stops[index]:.4%} | {cell} |")
    print("\n".join(["", "problems:" if found.problems else "no problems found", *(f"- {p}" for p in found.problems)]))
    if folder is not None:
        draw_inspection(scene, found, folder, options.threshold)


def draw_inspection(scene: Scene, found: Inspection, folder: Path, threshold: float) -> None:
    """The pictures of a scene and of what was found in it."""
    folder.mkdir(parents=True)
    draw_scene_map(scene, found.parts, folder / "map.png")
    draw_distances(scene, folder / "distances.png")
    if scene.views is not None:
        draw_contact_sheet(scene, folder / "contact_sheet.jpg")
    if found.false_stops is not None:
        own = found.goal_false_stops
        draw_false_stops(scene, THRESHOLDS, found.false_stops, own, threshold, folder / "false_stops.png")
    print(f"\npictures: {folder}")


def chosen_encoder(
    options: ThorConfig | PhotosConfig | BuildConfig | SampleConfig | EncodeConfig,
) -> ViewEncoder | None:
    """The encoder that an option ``encoder`` names."""
    return None if options.encoder is None else load_encoder(options.encoder, options.device)


def one_scene(name: str | None) -> Scene:
    """The scene that an option ``scene`` names."""
    if name is None:
        raise ConfigError("name a scene: scene=<a dump (.h5) or a built-in room>")
    if name == "all":
        raise ConfigError("scene=all: one scene at a time")
    return load_scenes(name)[0]


def new_file(name: str | None, ending: str = ".h5") -> Path:
    """Where to write. What is there already is not overwritten."""
    if name is None:
        raise ConfigError(f"say where to write: out=<a new file{ending and f' ({ending})'}>")
    path = Path(name)
    if ending and path.suffix != ending:
        raise ConfigError(f"out={name}: the name must end in {ending}")
    if path.exists():
        raise ConfigError(f"out={name}: there is such a file already; it is not overwritten")
    return path


COMMANDS: dict[str, tuple[str, Callable[[Any], None]]] = {
    "thor": ("take a scene from live AI2-THOR", thor),
    "photos": ("make a scene from photographs of a real place", photos),
    "build": ("build a synthetic room from its description", build),
    "sample": ("furnish random rooms and build them", sample),
    "encode": ("compute the features of a dump anew, with another encoder", encode),
    "export": ("write a scene in the layout of the published navigation code", export),
    "import": ("take over a dump in that layout", take_over),
    "inspect": ("look at a scene and check it", inspect),
}
"""What each command does, and the function that does it with its configuration."""


if __name__ == "__main__":
    register()
    with one_line_errors():
        meanings = {name: meaning for name, (meaning, _) in COMMANDS.items()}
        command, arguments = choose_command(meanings, sys.argv[1:], __doc__ or "")
        arguments = prepare(SCHEMAS[command], arguments)

    @hydra.main(version_base="1.3", config_path=str(CONF / "scenes"), config_name=command)
    def main(composed: DictConfig) -> None:
        """Run the command."""
        with one_line_errors():
            COMMANDS[command][1](typed(composed))

    sys.argv[1:] = arguments
    main()
