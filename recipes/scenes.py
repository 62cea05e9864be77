"""Take, build, convert, encode and check scenes.

    python recipes/scenes.py thor scene=FloorPlan401 out=dumps/FloorPlan401.h5
    python recipes/scenes.py vizdoom map=map01 out=freedoom_01.h5
    python recipes/scenes.py miniworld env=FourRooms out=four_rooms.h5
    python recipes/scenes.py draft folder=my_office
    python recipes/scenes.py photos folder=my_office out=my_office.h5
    python recipes/scenes.py tour path=my_tour out=my_tour.h5
    python recipes/scenes.py build description=bathroom_02 out=bathroom.h5
    python recipes/scenes.py sample kind=bedroom seed=7 out=my_bedroom
    python recipes/scenes.py encode scene=room.h5 encoder=efficientnet_lite0 out=room_lite0.h5
    python recipes/scenes.py export scene=bathroom_02 out=icra17/bathroom_02.h5
    python recipes/scenes.py import scene=data/bathroom_02.h5 source=thor out=bathroom_02.h5
    python recipes/scenes.py inspect scene=bathroom_02 out=pictures

The options of each command stand in its dataclass below, whose docstring is its help.
"""

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, Interval

from dirl.cli.start import check_writable, new_file, run, start
from dirl.config.schemas import Correlation, Device, FieldOfView, Fraction, Match, Positive, Seed, option

Pixels = Annotated[int, Interval(ge=16, le=4096)]
Step = Annotated[float, Interval(ge=0.05, le=10)]
Turn = Annotated[float, Interval(ge=1, le=360)]
Headings = Annotated[int, Interval(ge=4, le=360)]
Places = Annotated[int, Ge(2)]
Looks = Annotated[int, Interval(ge=0, le=1000)]

DUMP = "the dump to write (.h5)"
STEP = "metres between neighbouring places"
TURN = "degrees of a turn: 90, 45 or 30"
PLACES = "at most so many places, the nearest to the start; null = all that can be walked to and fro"
OF_VIEW = "of a view, pixels"
LOOKS = (
    "further looks of each state, as visits that differ a little show it; only their features are stored; see changes"
)
CHANGES = "by how much, in standard deviations; all views from a place share the error of a visit"
FINER = "false: coarser light and textures, for a first look"


@dataclass
class Encoded:
    """The encoder of a command that makes features."""

    encoder: str | None = option("what makes the features, see encode; null = none yet", "resnet50")
    device: Device = option("cpu | cuda, of the encoder", Device.cpu)


@dataclass
class EncodedPatches(Encoded):
    """The encoder of a command that makes features of the parts of views too."""

    patches: bool = option(
        "also features of the parts of each view, as `general` reads them and recogniser=learned compares them; with "
        "encoder=efficientnet_lite0",
        False,
    )
    fine_patches: bool = option(
        "six times as many, by which recogniser=learned compares single photos; with encoder=efficientnet_lite0", False
    )


@dataclass
class EncodedForGeneral(EncodedPatches):
    """The encoder of a command that takes photographs: that of the agent `general`."""

    encoder: str | None = option("what makes the features, see encode; null = none yet", "efficientnet_lite0")
    patches: bool = option("also features of the parts of each view, as `general` reads them", True)


@dataclass
class SimulatedOptions(EncodedPatches):
    """The options of every command that takes a scene from a simulator."""

    out: str = option(DUMP)
    step: Step = option(STEP, 1.0)
    turn: Turn = option(TURN, 90)
    places: Places | None = option(PLACES, None)


@dataclass
class ThorOptions(SimulatedOptions):
    """Take a scene dump from live AI2-THOR.

    Examples:
        python recipes/scenes.py thor scene=FloorPlan401 out=dumps/FloorPlan401.h5
        python recipes/scenes.py thor scene=FloorPlan201 out=living.h5 headless=true step=0.25
    docs/howto/make_scenes.md tells more.
    """

    scene: str = option("e.g. FloorPlan401; list: https://ai2thor.allenai.org/ithor/documentation/scenes")
    step: Step = option(STEP, 0.5)
    height: Pixels = option(OF_VIEW, 300)
    width: Pixels = option(OF_VIEW, 400)
    field_of_view: FieldOfView = option("vertical, degrees", 90)
    headless: bool = option("true: without a display (AI2-THOR's CloudRendering platform, which needs Vulkan)", False)


@dataclass
class VizdoomOptions(SimulatedOptions):
    """Take a scene dump from a map of VizDoom, without monsters and things to take. No display is needed.

    Examples:
        python recipes/scenes.py vizdoom map=map01 out=freedoom_01.h5
        python recipes/scenes.py vizdoom map=E1M1 out=e1m1.h5 turn=45 places=100
    docs/howto/simulators.md tells more.
    """

    map: str = option("map01 to map32 of Freedoom 2, E1M1 to E4M9 of Freedoom 1, or one of the file wad")
    wad: str | None = option("a file with other maps (.wad); null = Freedoom, which comes with VizDoom", None)
    step: Step = option(f"{STEP}; 32 units of a map are a metre", 2.0)
    height: Pixels = option(f"{OF_VIEW}; views are rendered at 240 x 320 and scaled", 120)
    width: Pixels = option(OF_VIEW, 160)


@dataclass
class MiniworldOptions(SimulatedOptions):
    """Take a scene dump from an environment of MiniWorld. No display is needed, but EGL.

    Examples:
        python recipes/scenes.py miniworld env=FourRooms out=four_rooms.h5
        python recipes/scenes.py miniworld env=MazeS3 seed=7 out=maze.h5 turn=30
    docs/howto/simulators.md tells more.
    """

    env: str = option("e.g. FourRooms, which is MiniWorld-FourRooms-v0; a wrong name lists all")
    seed: Seed = option("of walls, things, and where the agent stands first", 0)
    height: Pixels = option(OF_VIEW, 120)
    width: Pixels = option(OF_VIEW, 160)
    field_of_view: FieldOfView = option("vertical, degrees", 60)


@dataclass
class SimulatorOptions(SimulatedOptions):
    """Take a scene dump from a simulator of your own.

    Examples:
        python recipes/scenes.py simulator simulator=my_simulator.yaml out=my_world.h5
    docs/howto/simulators.md tells more.
    """

    simulator: str = option("a YAML file: _target_, the class, and its arguments")


@dataclass
class DraftOptions:
    """Draft states.csv for a folder of photographs, by their names, and the times and compass in their EXIF.

    What the camera did not write down is assumed: places in a straight row, each with the same number of photos. The
    answer says what was assumed; correct the table, then make the scene by photos.

    Examples:
        python recipes/scenes.py draft folder=my_office
        python recipes/scenes.py draft folder=my_office headings=8
    docs/howto/make_scenes.md tells more.
    """

    folder: str = option("holds the images")
    headings: Headings = option("photos of each place, all around: 4 of 90 degrees, 8 of 45, 12 of 30", 4)


@dataclass
class PhotosOptions(EncodedForGeneral):
    """Make a scene dump from photographs: a folder of images with states.csv, which says where each was taken.

    states.csv has a row for each image: image,location,heading,x,z,ahead (and back,goal,shot if needed).

    Examples:
        python recipes/scenes.py photos folder=my_office out=my_office.h5
        python recipes/scenes.py photos folder=my_office out=my_office.h5 height=224 width=224
    docs/howto/make_scenes.md tells more.
    """

    folder: str = option("holds states.csv and the images that it names")
    out: str = option(DUMP)
    name: str | None = option("name of the scene; null = the folder's name", None)
    height: Pixels = option("pixels; images are cropped at the centre to this aspect ratio and scaled", 300)
    width: Pixels = option("likewise", 400)


@dataclass
class TourOptions(EncodedForGeneral):
    """Make a scene dump from a 360-degree tour: Marzipano, krpano, Pannellum, panoramas with links.csv.

    Examples:
        python recipes/scenes.py tour path=my_tour out=my_tour.h5
        python recipes/scenes.py tour path=panoramas out=office.h5 headings=12
    docs/howto/tours.md tells more.
    """

    path: str = option(
        "the folder of the tour, or its data.js, tour.xml, links.csv or configuration of Pannellum (JSON, JavaScript, "
        "HTML)"
    )
    out: str = option(DUMP)
    name: str | None = option("name of the scene; null = the tour's", None)
    skip: list[str] = option("panoramas that are left out, by name: [hall, stairs]", [])
    headings: Annotated[int, Interval(ge=4, le=36)] = option(
        "of each panorama, a multiple of 4: 4, 8 and 12 are turns of 90, 45 and 30 degrees", 8
    )
    compare_images: bool = option(
        "headings that links do not give, or contradict, come from what the panoramas show", True
    )
    height: Pixels = option(OF_VIEW, 224)
    width: Pixels = option(OF_VIEW, 224)
    field_of_view: FieldOfView = option("horizontal, degrees", 75)


@dataclass
class BuildOptions(Encoded):
    """Build a synthetic room from its description: light it, take the view of every state, write a dump.

    Examples:
        python recipes/scenes.py build description=bathroom_02 out=bathroom.h5
        python recipes/scenes.py build description=my_room.toml out=my_room.h5 height=75 width=100 fine=false
        python recipes/scenes.py build description=kitchen_02 turn=30 out=kitchen_30.h5
    docs/howto/rooms.md tells more.
    """

    description: str = option("bathroom_02 | bedroom_04 | kitchen_02 | living_room_08, or a .toml file")
    out: str = option(DUMP)
    height: Pixels = option(OF_VIEW, 300)
    width: Pixels = option(OF_VIEW, 400)
    turn: Turn = option(TURN, 90)
    fine: bool = option(FINER, True)


@dataclass
class LookChanges:
    """How visits of a place differ."""

    position: Fraction = option("metres, along each axis", 0.05)
    heading: Annotated[float, Interval(ge=0, le=45)] = option("degrees", 5.0)
    exposure: Fraction = option("of the logarithm of the brightness: 0.05 is about 5 %", 0.15)


@dataclass
class SampleOptions(EncodedPatches):
    """Furnish random rooms and build them. Each passes the checks of the built-in rooms.

    Examples:
        python recipes/scenes.py sample kind=bedroom seed=7 out=my_bedroom
        python recipes/scenes.py sample kind=all count=8 out=many height=48 width=64 fine=false
        python recipes/scenes.py sample kind=all seed=30000 count=50 out=rooms encoder=efficientnet_lite0 patches=true
    docs/howto/rooms.md tells more.
    """

    kind: str = option("bathroom | bedroom | kitchen | living_room | all")
    seed: Seed = option(
        "kind and seed determine the room; from 10000 test, from 20000 validation, from 30000 training rooms", 0
    )
    count: Positive = option("rooms of each kind, with this seed and those after it", 1)
    out: str = option("the collection: a dump (.h5) and a description (.toml) for each room; existing rooms are kept")
    height: Pixels = option(OF_VIEW, 300)
    width: Pixels = option(OF_VIEW, 400)
    turn: Turn = option(TURN, 90)
    fine: bool = option(FINER, True)
    workers: Positive | None = option("processes, one room each; null = all cores", None)
    looks: Looks = option(LOOKS, 0)
    changes: LookChanges = option(CHANGES, LookChanges)


@dataclass
class EncodeOptions(EncodedPatches):
    """Compute the features of a dump anew, from its stored views, with another encoder.

    Examples:
        python recipes/scenes.py encode scene=room.h5 out=room_resnet.h5
        python recipes/scenes.py encode scene=bathroom_02 encoder=efficientnet_lite0 out=bathroom_lite0.h5
    docs/howto/make_scenes.md tells more.
    """

    scene: str = option("a dump (.h5) with views, or a built-in room")
    source: str = option("rooms | a YAML file of your own, which names a class that finds scenes", "rooms")
    out: str = option("the dump to write: the same one with new features (.h5)")
    encoder: str | None = option(
        "resnet50 (as the built-in rooms) | resnet50_small (96x128 pixels) | efficientnet_lite0 (Apache 2.0) | "
        "weights of a ResNet-50 (.pth) | a YAML file of your own",
        "resnet50",
    )


@dataclass
class ExportOptions:
    """Write a scene in the layout of the published navigation code: raw views, float32 features, -1 marks.

    Examples:
        python recipes/scenes.py export scene=bathroom_02 out=icra17/bathroom_02.h5
        python recipes/scenes.py export scene=my_office.h5 out=my_office_icra17.h5
    docs/howto/make_scenes.md tells more.
    """

    scene: str = option("a dump (.h5), or a built-in room")
    source: str = option("rooms | a YAML file of your own, which names a class that finds scenes", "rooms")
    out: str = option("the file to write (.h5)")


@dataclass
class ImportOptions:
    """Take over a dump in the published layout; graph, features and views stay exactly what they are.

    Examples:
        python recipes/scenes.py import scene=data/bathroom_02.h5 out=bathroom_02.h5 source=thor 'goals=[26,37]'
    docs/howto/make_scenes.md tells more.
    """

    scene: str = option("a dump (.h5) in the published layout")
    out: str = option("the dump to write in ours (.h5): smaller, with losslessly compressed views")
    name: str | None = option("name of the scene; null = as in the file, else the file's name", None)
    source: str | None = option("origin, e.g. thor; null = as in the file", None)
    goals: list[int] | None = option("goal states to store, e.g. [26,37]; null = as in the file", None)


@dataclass
class InspectOptions:
    """Look at a scene and check it: contents, ambiguous states, problems; map and contact sheet.

    Examples:
        python recipes/scenes.py inspect scene=bathroom_02
        python recipes/scenes.py inspect scene=rooms_5cm/kitchen_10100.h5 recogniser=learned match=front
        python recipes/scenes.py inspect scene=my_office.h5 out=my_office_pictures threshold=0.8
    docs/howto/make_scenes.md tells more.
    """

    scene: str = option("a dump (.h5), or a built-in room")
    source: str = option("rooms | a YAML file of your own, which names a class that finds scenes", "rooms")
    out: str | None = option("a new folder for the pictures; null = only print the tables", None)
    threshold: Correlation = option("of ncc: pairs of states that match better are ambiguous", 0.9)
    recogniser: str = option("ncc: correlation | learned, with thresholds of its own | a YAML file of your own", "ncc")
    match: Match = option("views: all four | front: only the view ahead", Match.views)


OPTIONS: dict[str, type] = {
    "thor": ThorOptions,
    "vizdoom": VizdoomOptions,
    "miniworld": MiniworldOptions,
    "simulator": SimulatorOptions,
    "draft": DraftOptions,
    "photos": PhotosOptions,
    "tour": TourOptions,
    "build": BuildOptions,
    "sample": SampleOptions,
    "encode": EncodeOptions,
    "export": ExportOptions,
    "import": ImportOptions,
    "inspect": InspectOptions,
}

if __name__ == "__main__":
    options = start(__doc__, OPTIONS)  # "loading ...", or help; the imports below take their time

import textwrap
from collections.abc import Callable
from dataclasses import fields, replace
from itertools import chain, repeat
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from dirl.config.components import make
from dirl.config.files import group_options, load_simulator
from dirl.config.folders import command as command_of
from dirl.perception.backbones import EncoderError, ViewEncoder, encode_all, load_encoder
from dirl.perception.bearings import ALONG, FIELD_OF_VIEW, SIZE, toward
from dirl.perception.matching import Matcher
from dirl.perception.recognition.diagnostics import inspect_scene
from dirl.perception.recognition.recogniser import build_recogniser, stop_by
from dirl.reporting import draw_contact_sheet, draw_scene_map
from dirl.scenes import Scene, SceneError, load_scenes, write_dump
from dirl.scenes.io.files import check_choice
from dirl.scenes.io.write import MOST_WITH_DISTANCES, export_icra17
from dirl.scenes.live import Simulator
from dirl.scenes.views import decode, encoded_view
from dirl.sources.miniworld import MiniWorld
from dirl.sources.photos import draft_table, encoded_photos, read_photos
from dirl.sources.rooms import build_room
from dirl.sources.rooms.collect import MadeRoom, RoomSettings, make_rooms, missing_rooms
from dirl.sources.rooms.dump import Changes
from dirl.sources.rooms.sampling import KINDS
from dirl.sources.simulators import take_scene
from dirl.sources.thor import Thor, start_controller
from dirl.sources.tours import read_tour
from dirl.sources.tours.conversion import Converted, tour_scene
from dirl.sources.tours.pixels import Cube, Equirectangular, cut_views
from dirl.sources.vizdoom import VizDoom

COLUMNS, KEY = 80, 13
"""Of a terminal, and of the names of facts."""

SHOWN_PAIRS = 10
"""Of the ambiguous ones."""


def thor(options: ThorOptions) -> None:
    """Take a scene from live AI2-THOR."""
    settings = {
        name: getattr(options, name) for name in ("scene", "step", "height", "width", "field_of_view", "headless")
    }
    write_simulated(lambda: Thor(start_controller(**settings), options.scene), options, "thor")


def vizdoom(options: VizdoomOptions) -> None:
    """Take a scene from a map of VizDoom."""
    size = {"height": options.height, "width": options.width}
    write_simulated(lambda: VizDoom(options.map, wad=options.wad, **size), options, "vizdoom")


def miniworld(options: MiniworldOptions) -> None:
    """Take a scene from an environment of MiniWorld."""
    camera = {name: getattr(options, name) for name in ("seed", "height", "width", "field_of_view")}
    write_simulated(lambda: MiniWorld(options.env, **camera), options, "miniworld")


def simulator(options: SimulatorOptions) -> None:
    """Take a scene from a simulator of the user's own."""
    write_simulated(lambda: load_simulator(options.simulator), options, "simulator")


def write_simulated(begin: Callable[[], Simulator], options: SimulatedOptions, source: str) -> None:
    """A dump of the scene that a simulator starts with."""
    out, simulator, encoder = new_file(options.out), begin(), chosen_encoder(options)
    scene, views = take_scene(simulator, source=source, step=options.step, turn=options.turn, most=options.places)
    write_encoded(out, scene, views, encoder)


def draft(options: DraftOptions) -> None:
    """Draft the table of a folder of photographs."""
    print(draft_table(options.folder, options.headings))
    out = f"{options.folder}.h5"
    print(f"then go on with: {command_of('scenes')} photos folder={options.folder} out={out}")


def photos(options: PhotosOptions) -> None:
    """Make a dump from photographs: a folder with ``states.csv``, with features if there is an encoder."""
    out, encoder = new_file(options.out), chosen_encoder(options)
    scene, images = read_photos(Path(options.folder), name=options.name)
    if len(images) > len(scene) and encoder is None:
        raise SceneError(f"{options.folder}: of further shots only features are stored; give an encoder")
    encoded = encoded_photos(images, options.height, options.width)
    views = list(tqdm(encoded, total=len(images), desc="images", disable=None))
    write_encoded(out, scene, views, encoder)


def tour(options: TourOptions) -> None:
    """Make a dump from a 360-degree tour."""
    out = new_file(options.out)
    found = read_tour(options.path, skip=options.skip)
    chosen = {name: getattr(options, name) for name in ("headings", "compare_images", "name")}
    made = tour_scene(found, **chosen)
    encoder = chosen_encoder(options)
    print(
        "\n".join([f"{found.origin}: {len(found.panoramas)} panoramas", *(f"- {note}" for note in made.notes)]),
        flush=True,
    )
    images = [panorama.image for panorama in found.panoramas]
    size = (options.height, options.width)
    cutting = cut_views(images, list(made.yaws), size=size, field_of_view=options.field_of_view)
    views = list(tqdm(cutting, total=len(made.scene), desc="views", disable=None))
    scene, along = made.scene, None
    if encoder is not None:
        shown = np.isfinite(made.arrows)
        arrows = [yaws[seen] for yaws, seen in zip(made.arrows, shown, strict=True)]
        cutting = cut_views(images, arrows, size=size, field_of_view=ALONG)
        features, _ = encode_all(encoder, map(decode, cutting), int(shown.sum()), found.origin)
        along = np.zeros((len(made.scene), features.shape[1]), np.float16)
        along[shown.ravel()] = features
        scene = replace(scene, toward=toward_goals(images, made))
    about = {"field_of_view": options.field_of_view, "positions": "layout" if made.layout else "given"}
    write_encoded(out, scene, views, encoder, about, along)


def toward_goals(images: list[Equirectangular | Cube], made: Converted) -> np.ndarray | None:
    """Return how clearly each arrow of a tour leads to each state, see `Scene`; None where points cannot be matched."""
    if len(made.scene) > MOST_WITH_DISTANCES:
        print(f"- where arrows lead is not told by matched points: these are more than {MOST_WITH_DISTANCES} states")
        return None
    try:
        matcher = Matcher()
    except EncoderError as error:
        print(f"- where arrows lead is not told by matched points: {error}")
        return None
    cutting = cut_views(images, list(made.yaws), size=(SIZE, SIZE), field_of_view=FIELD_OF_VIEW)
    tables = toward(matcher, map(decode, cutting), made.yaws, made.arrows)
    return np.concatenate(list(tqdm(tables, total=len(images), desc="where arrows lead", disable=None)), 1)


def write_encoded(
    out: Path,
    scene: Scene,
    views: list[bytes],
    encoder: ViewEncoder | None,
    attributes: dict[str, Any] | None = None,
    along: np.ndarray | None = None,
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
            along=along,
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


def build(options: BuildOptions) -> None:
    """Build a synthetic room from its description."""
    out = new_file(options.out)
    problems = build_room(
        options.description,
        out,
        size=(options.height, options.width),
        turn=options.turn,
        fine=options.fine,
        encoder=chosen_encoder(options),
    )
    scene = load_scenes(str(out))[0]
    print(f"{out}: {len(scene)} states (source: {scene.source}), {out.stat().st_size / 1e6:.1f} MB")
    print("\n".join(["problems:", *(f"- {problem}" for problem in problems)] if problems else ["no problems found"]))


def sample(options: SampleOptions) -> None:
    """Furnish random rooms and build them into a collection, each with its description; those that are there stay."""
    if options.kind != "all":
        check_choice(options.kind, KINDS, "kind")
    check_writable(options.out)
    folder, kinds = Path(options.out), [kind for kind in KINDS if options.kind in (kind, "all")]
    values = {field.name: getattr(options, field.name) for field in fields(RoomSettings)}
    settings = RoomSettings(**{**values, "changes": Changes(**vars(options.changes))})
    seeds = range(options.seed, options.seed + options.count)
    wanted = [(kind, seed) for seed in seeds for kind in kinds]
    todo = missing_rooms(folder, wanted, settings.stored(settings.load_encoder()))
    print(f"{folder}: {len(wanted) - len(todo)} of {len(wanted)} rooms are there", flush=True)
    if todo:
        print("| room | split | metres | pieces | places | states | problems |")
        print("|---|---|---|--:|--:|--:|---|", flush=True)
    left_out = []
    for made in make_rooms(folder, todo, settings, options.workers) if todo else ():
        if isinstance(made, MadeRoom):
            print("| " + " | ".join(sampled(made)), "|", flush=True)
        else:
            left_out.append(made)
    for error in left_out:
        print(f"left out: {error}")
    print(f"\n{len(wanted) - len(left_out)} rooms: {folder}")


def sampled(made: MadeRoom) -> list[str]:
    """The table's row of a random room."""
    counts = [f"{made.pieces}", f"{made.places}", f"{made.states}"]
    size = "{:g} x {:g} x {:g}".format(*made.size)
    return [made.name, made.split or "-", size, *counts, "; ".join(made.problems) or "none"]


def encode(options: EncodeOptions) -> None:
    """Compute the features of a dump anew, from its stored views."""
    out = new_file(options.out)
    scene = one_scene(options.scene, options.source)
    encoder = chosen_encoder(options)
    if encoder is None:
        raise SceneError("encoder=null: encode needs one")
    if scene.views is None:
        raise SceneError(f"{scene.origin}: has no views to encode; their dataset is observation or observation_webp")
    write_encoded(out, scene, [encoded_view(scene.views, state) for state in range(len(scene))], encoder)


def export(options: ExportOptions) -> None:
    """Write a scene in the layout of other navigation code."""
    out = new_file(options.out)
    scene = one_scene(options.scene, options.source)
    export_icra17(scene, out)
    print(f"{out}: {len(scene)} states (source: {scene.source}), {out.stat().st_size / 1e6:.1f} MB")


def take_over(options: ImportOptions) -> None:
    """Take over a dump in the published layout."""
    out = new_file(options.out)
    scene = one_scene(options.scene)
    goals = scene.goals if options.goals is None else tuple(options.goals)
    scene = replace(scene, name=options.name or scene.name, source=options.source or scene.source, goals=goals)
    views = scene.views
    write_dump(out, scene, None if views is None else (encoded_view(views, state) for state in range(len(scene))))
    print(f"{out}: {len(scene)} states (source: {scene.source}), {out.stat().st_size / 1e6:.1f} MB")


def inspect(options: InspectOptions) -> None:
    """Look at a scene and check it."""
    folder = None if options.out is None else new_file(options.out, ending="")
    scene = one_scene(options.scene, options.source)
    recogniser = build_recogniser(group_options("recogniser", options.recogniser) or {})
    stop = stop_by(recogniser, options.threshold, options.match)
    found = inspect_scene(scene, stop)
    print(f"| {scene.name} | |\n|---|---|")
    for key, text in found.facts.items():
        for shown, line in zip(chain([key], repeat("")), textwrap.wrap(text, COLUMNS - 7 - KEY) or [""], strict=False):
            print(f"| {shown:<{KEY}} | {line} |")
    if found.ambiguous:
        print(f"\n{len(found.ambiguous)} ambiguous pairs (match={stop.match} above {stop.threshold:g}), the worst:")
        print("\n| state | state | matching | actions between |\n|--:|--:|--:|--:|")
        for a, b, score, distance in found.ambiguous[:SHOWN_PAIRS]:
            print(f"| {a} | {b} | {score:.3f} | {distance if distance >= 0 else 'unconnected'} |")
    print("\nproblems:" if found.problems else "\nno problems found")
    for problem in found.problems:
        print(textwrap.fill(problem, COLUMNS, initial_indent="- ", subsequent_indent="  "))
    if folder is not None:
        folder.mkdir(parents=True)
        draw_scene_map(scene, found.parts, folder / "map.png")
        if scene.views is not None:
            draw_contact_sheet(scene, folder / "contact_sheet.jpg")
        print(f"\npictures: {folder}")


def one_scene(name: str, source: str = "rooms") -> Scene:
    """The scene that an option names, of a source of the user's own if that is given."""
    if name == "all":
        raise SceneError("scene=all: one scene at a time")
    options = group_options("source", source)
    return load_scenes(name, source=None if options is None else make("source", options))[0]


def chosen_encoder(options: Encoded) -> ViewEncoder | None:
    """The encoder that an option ``encoder`` names, as far as the command's other options describe it."""
    if options.encoder is None:
        return None
    others = [name for name in ("patches", "fine_patches") if hasattr(options, name)]
    return load_encoder(options.encoder, options.device, **{name: getattr(options, name) for name in others})


COMMANDS: dict[type, Callable[[Any], None]] = {
    ThorOptions: thor,
    VizdoomOptions: vizdoom,
    MiniworldOptions: miniworld,
    SimulatorOptions: simulator,
    DraftOptions: draft,
    PhotosOptions: photos,
    TourOptions: tour,
    BuildOptions: build,
    SampleOptions: sample,
    EncodeOptions: encode,
    ExportOptions: export,
    ImportOptions: take_over,
    InspectOptions: inspect,
}
"""What each command does, by the class of its options."""


if __name__ == "__main__":
    run(lambda: COMMANDS[type(options)](options), options)
