"""Walk once, then go to any photo: tours of several rooms joined by doors, their panoramas two metres apart.

    python -m dirl.experiments.buildings general --tours my_tours --out reports/buildings

The argument is a run of ``system=any_goal``; without it only maps are measured. Buildings are sampled with seeds of the
test split, written into the folder as tours of equirectangular images, and read back as tours with 8 headings.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from dirl.backbones import ViewEncoder, encode_all, load_encoder
from dirl.cli.command_line import one_line_errors
from dirl.experiments.image_graph import drawn_goals, measure, program
from dirl.rooms.building import sample_building
from dirl.rooms.building_tour import write_building_tour
from dirl.rooms.description import Camera
from dirl.runs.exits import one_line_exits
from dirl.scenes import load_scenes
from dirl.scenes.io.write import write_dump
from dirl.scenes.views import decode
from dirl.tours import read_tour
from dirl.tours.images import cut_views
from dirl.tours.moves import tour_scene

BUILDINGS = {
    10001: ("bedroom", "bathroom", "kitchen"),
    10101: ("living_room", "kitchen", "bedroom"),
    10201: ("kitchen", "living_room"),
    10301: ("bathroom", "bedroom", "bathroom", "living_room"),
}
"""The rooms of each building, by seed."""

LAST = (3, 1, 0)
"""Steps before the goal from which on the policy decides: as in single rooms, one, and none: the graph leads alone."""

SIZE = (48, 64)
"""Height and width of a view, pixels."""


def make_building(seed: int, folder: Path, encoder: ViewEncoder) -> str:
    """Render and read the tour of a building, and write its dump; the dump's name."""
    out = folder / f"building_{seed}.h5"
    if out.exists():
        return str(out)
    write_building_tour(sample_building(BUILDINGS[seed], seed), folder / out.stem, seed=seed)
    tour, camera = read_tour(folder / out.stem), Camera()
    made = tour_scene(tour)
    print(f"{out.stem}: {len(tour.panoramas)} panoramas", *made.notes, sep="\n- ", flush=True)
    images = [panorama.image for panorama in tour.panoramas]
    views = list(cut_views(images, made.yaws, size=SIZE, field_of_view=camera.fov, pitch=camera.pitch))
    found = encode_all(encoder, map(decode, views), len(views), str(out))
    scene = replace(
        made.scene, features=found.features.astype(np.float16), extractor=encoder.extractor, patches=found.patches
    )
    write_dump(
        out, scene, views, feature_attributes=dict(encoder.attributes), patch_attributes=encoder.patch_attributes
    )
    return str(out)


def main() -> None:
    """The program."""
    parser = program(__doc__)
    parser.add_argument("--tours", type=Path, required=True, help="a folder for the tours and their dumps")
    options = parser.parse_args()
    with one_line_exits(), one_line_errors():
        encoder = load_encoder("resnet50_small", precision="bfloat16", patches=True)
        options.tours.mkdir(parents=True, exist_ok=True)
        dumps = [make_building(seed, options.tours, encoder) for seed in BUILDINGS]
        world = drawn_goals(load_scenes(dumps), options.goals)
        about = f"{len(dumps)} synthetic buildings of two to four rooms, panoramas 2 m apart, 8 headings"
        print(measure(world, {"scene": dumps}, about, options, LAST))


if __name__ == "__main__":
    main()
