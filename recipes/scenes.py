"""Take, build, convert, encode and check scenes.

    python recipes/scenes.py thor scene=FloorPlan401 out=dumps/FloorPlan401.h5
    python recipes/scenes.py vizdoom map=map01 out=freedoom_01.h5
    python recipes/scenes.py miniworld env=FourRooms out=four_rooms.h5
    python recipes/scenes.py photos folder=my_office out=my_office.h5
    python recipes/scenes.py recording file=robot.h5 positions=positions out=my_corridor
    python recipes/scenes.py tour path=my_tour out=my_tour.h5
    python recipes/scenes.py build description=bathroom_02 out=bathroom.h5
    python recipes/scenes.py sample kind=bedroom seed=7 out=my_bedroom
    python recipes/scenes.py encode scene=room.h5 encoder=facebook/dinov2-small out=room_dino.h5
    python recipes/scenes.py export scene=bathroom_02 layout=icra17 out=icra17/bathroom_02.h5
    python recipes/scenes.py import scene=data/bathroom_02.h5 source=thor out=bathroom_02.h5
    python recipes/scenes.py inspect scene=bathroom_02 out=pictures

All options of each command with their values: conf/scenes/<command>.yaml.
"""

from dirl.cli.start import run_recipe, start

if __name__ == "__main__":
    command = start("scenes", __doc__)  # answers help and refuses options, before the imports below take their time

from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from dirl.config.choices import load_simulator
from dirl.config.places import command as command_of
from dirl.perception.backbones import ViewEncoder, encode_all, encode_scene, load_encoder
from dirl.perception.recognition.build import chosen_stop
from dirl.perception.recognition.diagnostics import Inspection, inspect_scene
from dirl.perception.virtual import VirtualCameras
from dirl.reporting import draw_contact_sheet, draw_distances, draw_false_stops, draw_scene_map
from dirl.scenes import Scene, SceneError, load_scenes, write_dump
from dirl.scenes.collection import Entry
from dirl.scenes.io.icra17 import export_icra17
from dirl.scenes.io.write import replace_features
from dirl.scenes.live import Simulator
from dirl.scenes.views import decode
from dirl.scenes.views import encode as webp
from dirl.sources.miniworld import MiniWorld
from dirl.sources.photos import encoded_photos, read_photos
from dirl.sources.recordings import unpack_recording
from dirl.sources.rooms import build_room, read_description
from dirl.sources.rooms.collect import RoomSettings, make_rooms, missing_rooms
from dirl.sources.rooms.looks import Changes, PhotoCamera
from dirl.sources.rooms.sampling import KINDS
from dirl.sources.rooms.sheet import draw_sheet, preview
from dirl.sources.simulators import take_look, take_scene
from dirl.sources.thor import start_simulator, take_views
from dirl.sources.tours import read_tour
from dirl.sources.tours.images import cut_views
from dirl.sources.tours.moves import tour_scene
from dirl.sources.vizdoom import VizDoom

SHOWN_PAIRS = 10
"""Of the ambiguous ones."""

SHEET = 32
"""Random rooms that are shown on one contact sheet at most; a room takes as long as some ten of its views."""


def thor(options: Any) -> None:
    """Take a scene from live AI2-THOR, by way of a folder that a stopped run can continue from."""
    out = Path(options.out)
    encoder = chosen_encoder(options)
    settings = {name: getattr(options, name) for name in ("scene", "step", "height", "width", "field_of_view")}
    folder = out.with_suffix(".taken")
    simulator = start_simulator(**settings, headless=options.headless)
    for problem in take_views(simulator, folder, settings=settings):
        print(f"left out: {problem}")
    write_photos(folder, out, options.scene, "thor", (options.height, options.width), encoder)
    print(f"{folder} is no longer needed")


def vizdoom(options: Any) -> None:
    """Take a scene from a map of VizDoom."""
    settings = {"wad": options.wad, "height": options.height, "width": options.width}
    write_simulated(lambda: VizDoom(options.map, **settings), options, "vizdoom")


def miniworld(options: Any) -> None:
    """Take a scene from an environment of MiniWorld."""
    camera = {name: getattr(options, name) for name in ("seed", "height", "width", "field_of_view")}
    write_simulated(lambda: MiniWorld(options.env, **camera), options, "miniworld")


def simulator(options: Any) -> None:
    """Take a scene from a simulator of the user's own."""
    write_simulated(lambda: load_simulator(options.simulator), options, "simulator")


def write_simulated(begin: Callable[[], Simulator], options: Any, source: str) -> None:
    """A dump of the scene that a simulator starts with."""
    if options.looks < 0 or (options.looks and options.encoder is None):
        raise SceneError(f"looks={options.looks}: at least 0; their views are encoded and not stored: give an encoder")
    simulator, encoder = begin(), chosen_encoder(options)
    scene, views = take_scene(simulator, source=source, step=options.step, turn=options.turn, most=options.places)
    for seed in tqdm(range(options.looks), desc="looks", disable=None):
        views += take_look(simulator, scene, seed, **vars(options.changes))
    write_encoded(Path(options.out), scene, views, encoder)


def photos(options: Any) -> None:
    """Make a dump from photographs."""
    shape = (options.height, options.width)
    write_photos(Path(options.folder), Path(options.out), options.name, "photos", shape, chosen_encoder(options))


def recording(options: Any) -> None:
    """Unpack a robot's recording into a folder of photographs."""
    names = ("images", "positions", "step", "first_heading", "clockwise")
    chosen = {name: getattr(options, name) for name in names}
    folder = Path(options.out)
    print(unpack_recording(options.file, folder, axes=list(options.axes), **chosen))
    print(f"go on with: {command_of('scenes')} photos folder={folder} out={folder}.h5")


def write_photos(
    folder: Path, out: Path, name: str | None, source: str, shape: tuple[int, int], encoder: ViewEncoder | None
) -> None:
    """A dump from a folder with ``states.csv``, with features if there is an encoder."""
    scene, images = read_photos(folder, name=name, source=source)
    if len(images) > len(scene) and encoder is None:
        raise SceneError(f"{folder}: of further shots only features are stored; give an encoder")
    views = list(tqdm(encoded_photos(images, *shape), total=len(images), desc="images", disable=None))
    write_encoded(out, scene, views, encoder)


def tour(options: Any) -> None:
    """Make a dump from a 360-degree tour."""
    out = Path(options.out)
    found = read_tour(options.path, reach=options.reach, skip=options.skip)
    chosen = {name: getattr(options, name) for name in ("headings", "compare_images", "tolerance", "step", "name")}
    made = tour_scene(found, **chosen)
    encoder = chosen_encoder(options)
    print(
        "\n".join([f"{found.origin}: {len(found.panoramas)} panoramas", *(f"- {note}" for note in made.notes)]),
        flush=True,
    )
    camera: dict[str, Any] = {"field_of_view": options.field_of_view, "pitch": options.pitch}
    images = [panorama.image for panorama in found.panoramas]
    cutting = cut_views(images, made.yaws, size=(options.height, options.width), **camera)
    views = list(tqdm(cutting, total=len(made.scene), desc="views", disable=None))
    write_encoded(out, made.scene, views, encoder, {**camera, "positions": "layout" if made.layout else "given"})


def write_encoded(
    out: Path,
    scene: Scene,
    views: list[bytes],
    encoder: ViewEncoder | None,
    attributes: dict[str, Any] | None = None,
) -> None:
    """A dump of a scene with its views, and with features if there is an encoder; of further looks with those alone."""
    states, about, about_patches = len(scene), dict[str, str](), dict[str, str]()
    if encoder is not None:
        features, patches = encode_all(encoder, map(decode, views), len(views), scene.origin)
        scene = replace(
            scene,
            extractor=encoder.extractor,
            features=features[:states],
            patches=None if patches is None else patches[:states],
            look_features=_looks(features.astype(np.float16), states),
            look_patches=None if patches is None else _looks(patches, states),
        )
        about, about_patches = dict(encoder.attributes), dict(encoder.patch_attributes)
    write_dump(
        out, scene, views[:states], attributes=attributes, feature_attributes=about, patch_attributes=about_patches
    )
    print(f"{out}: {len(scene)} states (source: {scene.source}), {out.stat().st_size / 1e6:.1f} MB")
    print("no features yet; see the command encode" if encoder is None else f"extractor: {encoder.extractor}")


def _looks(values: np.ndarray, states: int) -> np.ndarray | None:
    """Of values ``[(K + 1) N, ...]`` of N states those of the K further looks, ``[K, N, ...]``; None without any."""
    return values[states:].reshape(-1, states, *values.shape[1:]) if len(values) > states else None


def build(options: Any) -> None:
    """Build a synthetic room from its description."""
    out = Path(options.out)
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
    scene = load_scenes(str(out))[0]
    print(f"{out}: {len(scene)} states (source: {scene.source}), {out.stat().st_size / 1e6:.1f} MB")
    print("\n".join(["problems:", *(f"- {problem}" for problem in problems)] if problems else ["no problems found"]))


def sample(options: Any) -> None:
    """Furnish random rooms and build them into a collection, each with its description; those that are there stay."""
    folder, kinds = Path(options.out), [kind for kind in KINDS if options.kind in (kind, "all")]
    values = {field.name: getattr(options, field.name) for field in fields(RoomSettings)}
    values |= {"changes": Changes(**vars(options.changes)), "photo": PhotoCamera(**vars(options.photo))}
    fov, yaws = options.virtual.fov, tuple(options.virtual.yaws)
    if fov and not options.fine_patches:
        raise SceneError(f"virtual.fov={fov:g}: the patches of virtual views need fine_patches=true")
    values["virtual"] = VirtualCameras(fov, yaws) if fov else None
    settings = RoomSettings(**values)
    seeds = range(options.seed, options.seed + options.count)
    wanted = [(kind, seed) for seed in seeds for kind in kinds]
    todo = missing_rooms(folder, wanted, settings.stored(settings.load_encoder()))
    print(f"{folder}: {len(wanted) - len(todo)} of {len(wanted)} rooms are there", flush=True)
    if todo:
        print("| room | split | metres | pieces | places | states | parts | alike: one view | four views | problems |")
        print("|---|---|---|--:|--:|--:|--:|--:|--:|---|", flush=True)
    left_out = []
    for made in make_rooms(folder, todo, settings, options.workers) if todo else ():
        if isinstance(made, Entry):
            print("| " + " | ".join(sampled(made)), "|", flush=True)
        else:
            left_out.append(made)
    for error in left_out:
        print(f"left out: {error}")
    print(f"\n{len(wanted) - len(left_out)} rooms: {folder}")
    if todo and options.sheet and len(wanted) <= SHEET:
        made_of = [folder / f"{kind}_{seed}.toml" for kind, seed in wanted]
        draw_sheet([preview(read_description(path)) for path in made_of if path.is_file()], folder / "rooms.png")


def sampled(entry: Entry) -> list[str]:
    """The table's row of a random room."""
    found = entry.checks
    return [
        entry.name,
        entry.split or "-",
        "{:g} x {:g} x {:g}".format(*found["size"]),
        *(str(found[key]) for key in ("pieces", "places")),
        f"{entry.states}",
        *(str(found.get(key, "-")) for key in ("parts", "alike_front", "alike_views")),
        "; ".join(found["problems"]) or "none",
    ]


def encode(options: Any) -> None:
    """Compute the features of a dump anew, from its stored views."""
    out = Path(options.out)
    scene = load_scenes(options.scene)[0]
    encoder = chosen_encoder(options)
    assert encoder is not None
    features, patches = encode_scene(scene, encoder)
    assert scene.views is not None
    replace_features(scene.views.path, out, features, encoder.attributes, patches, encoder.patch_attributes)
    of_each = f"{features.shape[1]} features each" + ("" if patches is None else f", patches {patches.shape[1:]}")
    print(f"{out}: {len(scene)} states, {of_each}\nextractor: {encoder.extractor}")


def export(options: Any) -> None:
    """Write a scene in the layout of other navigation code."""
    out = Path(options.out)
    scene = load_scenes(options.scene)[0]
    export_icra17(scene, out)
    print(f"{out}: {len(scene)} states (source: {scene.source}), {out.stat().st_size / 1e6:.1f} MB")


def take_over(options: Any) -> None:
    """Take over a dump in the published layout."""
    out = Path(options.out)
    scene = load_scenes(options.scene)[0]
    goals = scene.goals if options.goals is None else tuple(options.goals)
    scene = replace(scene, name=options.name or scene.name, source=options.source or scene.source, goals=goals)
    views = scene.views
    stored = views and (views.encoded(state) or webp(views[state], quality=None) for state in range(len(scene)))
    write_dump(out, scene, stored or None)
    print(f"{out}: {len(scene)} states (source: {scene.source}), {out.stat().st_size / 1e6:.1f} MB")


def inspect(options: Any) -> None:
    """Look at a scene and check it."""
    scene = load_scenes(options.scene)[0]
    stop = chosen_stop(options.recogniser, options.threshold, options.match)
    found = inspect_scene(scene, stop)
    print(
        "\n".join([f"| {scene.name} | |", "|---|---|", *(f"| {key} | {text} |" for key, text in found.facts.items())])
    )
    if found.ambiguous:
        print(f"\n{len(found.ambiguous)} ambiguous pairs (match={stop.match} above {stop.threshold:g}), the worst:")
        print("\n| state | state | matching | actions between |\n|--:|--:|--:|--:|")
        for a, b, score, distance in found.ambiguous[:SHOWN_PAIRS]:
            print(f"| {a} | {b} | {score:.3f} | {distance if distance >= 0 else 'unconnected'} |")
    if found.errors:
        print("\n| false stops above |", *(f"{name} |" for name in found.errors))
        print("|--:" * (len(found.errors) + 1) + "|")
        for index in range(0, len(found.thresholds), 10):
            cells = ("-" if one is None else f"{one[index]:.4%}" for one in found.errors.values())
            print(f"| {found.thresholds[index]:.2f} |", *(f"{cell} |" for cell in cells))
    print("\n".join(["", "problems:" if found.problems else "no problems found", *(f"- {p}" for p in found.problems)]))
    if options.out is not None:
        draw_inspection(scene, found, Path(options.out), stop.threshold)


def draw_inspection(scene: Scene, found: Inspection, folder: Path, threshold: float) -> None:
    """The pictures of a scene and of what was found in it."""
    folder.mkdir(parents=True)
    draw_scene_map(scene, found.parts, folder / "map.png")
    draw_distances(scene, folder / "distances.png")
    if scene.views is not None:
        draw_contact_sheet(scene, folder / "contact_sheet.jpg")
    if found.errors:
        draw_false_stops(scene, found, threshold, folder / "false_stops.png")
    print(f"\npictures: {folder}")


def chosen_encoder(options: Any) -> ViewEncoder | None:
    """The encoder that an option ``encoder`` names, as far as the command's other options describe it."""
    if options.encoder is None:
        return None
    others = [name for name in ("precision", "patches", "fine_patches") if hasattr(options, name)]
    return load_encoder(options.encoder, options.device, **{name: getattr(options, name) for name in others})


COMMANDS: dict[str, Callable[[Any], None]] = {
    "thor": thor,
    "vizdoom": vizdoom,
    "miniworld": miniworld,
    "simulator": simulator,
    "photos": photos,
    "recording": recording,
    "tour": tour,
    "build": build,
    "sample": sample,
    "encode": encode,
    "export": export,
    "import": take_over,
    "inspect": inspect,
}
"""The function that does it, with its configuration."""


if __name__ == "__main__":
    run_recipe("scenes", COMMANDS[command], command)
