"""Take, convert, encode and check scenes.

    python recipes/scenes.py encode scene=room.h5 encoder=resnet50.pth out=room_resnet.h5
    python recipes/scenes.py export scene=bathroom_02 layout=icra17 out=icra17/bathroom_02.h5
    python recipes/scenes.py import scene=data/bathroom_02.h5 source=thor out=bathroom_02.h5

All options of each command with their values: conf/scenes/<command>.yaml.
"""

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import hydra
from omegaconf import DictConfig

from dirl.commandline import SCHEMAS, check_overrides, choose_command, one_line_errors, register
from dirl.config import ConfigError, EncodeConfig, ExportConfig, ImportConfig, typed
from dirl.models import encode_scene, load_encoder
from dirl.scenes import Scene, load_scenes, write_dump
from dirl.scenes.dump import replace_features
from dirl.scenes.interchange import export_icra17
from dirl.scenes.views import encode as webp


def encode(options: EncodeConfig) -> None:
    """Compute the features of a dump anew, from its stored views."""
    out = new_file(options.out)
    scene = one_scene(options.scene)
    if options.encoder is None:
        raise ConfigError("name the encoder: encoder=<weights of ResNet-50>, torchvision, or a Hugging Face model")
    encoder = load_encoder(options.encoder, options.device)
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
    if path.suffix != ending:
        raise ConfigError(f"out={name}: the name must end in {ending}")
    if path.exists():
        raise ConfigError(f"out={name}: there is such a file already; it is not overwritten")
    return path


COMMANDS: dict[str, tuple[str, Callable[[Any], None]]] = {
    "encode": ("compute the features of a dump anew, with another encoder", encode),
    "export": ("write a scene in the layout of the published navigation code", export),
    "import": ("take over a dump in that layout", take_over),
}
"""What each command does, and the function that does it with its configuration."""


if __name__ == "__main__":
    register()
    with one_line_errors():
        meanings = {name: meaning for name, (meaning, _) in COMMANDS.items()}
        command, arguments = choose_command(meanings, sys.argv[1:], __doc__ or "")
        check_overrides(SCHEMAS[command], arguments)

    @hydra.main(version_base="1.3", config_path="../conf/scenes", config_name=command)
    def main(composed: DictConfig) -> None:
        """Run the command."""
        with one_line_errors():
            COMMANDS[command][1](typed(composed))

    sys.argv[1:] = arguments
    main()
