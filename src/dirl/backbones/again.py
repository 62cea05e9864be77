"""Features of another encoder for scenes that have views: computed when they are needed, and kept."""

import hashlib
import os
from dataclasses import replace
from pathlib import Path

from dirl.backbones.registry import encode_scene, load_encoder, packaged_encoder
from dirl.scenes import Scene, SceneError, read_dump
from dirl.scenes.io.digest import file_digest
from dirl.scenes.io.write import replace_features


def encoded_as(scene: Scene, extractor: str, *, patches: bool) -> Scene:
    """The scene with features of an encoder of the package, from its views; as it is if that is not possible.

    The result is kept in the folder ``dirl`` of the user's cache (``XDG_CACHE_HOME``, else ``~/.cache``), if that can
    be written to.

    Args:
        scene: as it was read.
        extractor: what its features shall be of, see `Scene.extractor`.
        patches: whether they are needed too.
    """
    enough = scene.extractor == extractor and (scene.patches is not None or not patches)
    if enough or scene.views is None:
        return scene
    name = packaged_encoder(extractor)
    if name is None:
        return scene
    wanted = f"{file_digest(scene.views.path)} {extractor} {patches}"
    kept = cache_folder() / f"{scene.name}_{hashlib.sha256(wanted.encode()).hexdigest()[:16]}.h5"
    found = _kept(kept)
    if found is None:
        print(f"{scene.name}: its views are encoded with {name}, once; kept in {kept.parent}", flush=True)
        encoder = load_encoder(name, patches=patches)
        features, parts = encode_scene(scene, encoder)
        try:
            replace_features(scene.views.path, kept, features, encoder.attributes, parts, encoder.patch_attributes)
        except (SceneError, OSError) as error:
            print(f"not kept: {error}", flush=True)
        return replace(scene, features=features, patches=parts, extractor=extractor)
    return replace(scene, features=found.features, patches=found.patches, extractor=extractor)


def cache_folder() -> Path:
    """Where features are kept."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "dirl"


def _kept(path: Path) -> Scene | None:
    """The scene of an earlier command; None if there is none, or a damaged one."""
    try:
        return read_dump(path) if path.is_file() else None
    except SceneError:
        return None
