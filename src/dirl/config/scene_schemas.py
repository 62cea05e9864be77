"""The options of the commands of ``recipes/scenes.py`` with their types; the values are in ``conf/scenes/``."""

from dataclasses import dataclass, field
from enum import StrEnum

from omegaconf import MISSING

from dirl.config.schemas import Device, Match

Layout = StrEnum("Layout", ["icra17"])
Precision = StrEnum("Precision", ["float32", "bfloat16"])


@dataclass
class ThorConfig:
    """Everything ``recipes/scenes.py thor`` takes."""

    scene: str | None = None
    out: str | None = None
    step: float = MISSING
    height: int = MISSING
    width: int = MISSING
    field_of_view: float = MISSING
    headless: bool = MISSING
    encoder: str | None = None
    device: Device = MISSING


@dataclass
class PhotosConfig:
    """Everything ``recipes/scenes.py photos`` takes."""

    folder: str | None = None
    out: str | None = None
    name: str | None = None
    height: int = MISSING
    width: int = MISSING
    encoder: str | None = None
    patches: bool = MISSING
    device: Device = MISSING


@dataclass
class RecordingConfig:
    """Everything ``recipes/scenes.py recording`` takes."""

    file: str | None = None
    out: str | None = None
    images: str = MISSING
    axes: list[str] = MISSING
    positions: str | None = None
    step: float | None = None
    first_heading: float = MISSING
    clockwise: bool = MISSING


@dataclass
class VizdoomConfig:
    """Everything ``recipes/scenes.py vizdoom`` takes."""

    map: str | None = None
    wad: str | None = None
    out: str | None = None
    step: float = MISSING
    turn: float = MISSING
    places: int | None = None
    height: int = MISSING
    width: int = MISSING
    encoder: str | None = None
    device: Device = MISSING


@dataclass
class MiniworldConfig:
    """Everything ``recipes/scenes.py miniworld`` takes."""

    env: str | None = None
    seed: int = MISSING
    out: str | None = None
    step: float = MISSING
    turn: float = MISSING
    places: int | None = None
    height: int = MISSING
    width: int = MISSING
    field_of_view: float = MISSING
    encoder: str | None = None
    device: Device = MISSING


@dataclass
class SimulatorConfig:
    """Everything ``recipes/scenes.py simulator`` takes."""

    simulator: str | None = None
    out: str | None = None
    step: float = MISSING
    turn: float = MISSING
    places: int | None = None
    encoder: str | None = None
    device: Device = MISSING


@dataclass
class TourConfig:
    """Everything ``recipes/scenes.py tour`` takes."""

    path: str | None = None
    out: str | None = None
    name: str | None = None
    skip: list[str] = field(default_factory=list)
    headings: int = MISSING
    tolerance: float | None = None
    step: float = MISSING
    reach: float = MISSING
    height: int = MISSING
    width: int = MISSING
    field_of_view: float = MISSING
    pitch: float = MISSING
    encoder: str | None = None
    patches: bool = MISSING
    device: Device = MISSING


@dataclass
class BuildConfig:
    """Everything ``recipes/scenes.py build`` takes."""

    description: str | None = None
    out: str | None = None
    height: int = MISSING
    width: int = MISSING
    turn: float = MISSING
    fine: bool = MISSING
    quality: int = MISSING
    workers: int | None = None
    encoder: str | None = None
    provenance: str | None = None
    device: Device = MISSING


@dataclass
class ChangesConfig:
    """By how much further looks differ, see `dirl.rooms.looks.Changes`."""

    position: float = MISSING
    heading: float = MISSING
    exposure: float = MISSING
    white_balance: float = MISSING
    camera_height: float = MISSING
    lamps: float = MISSING
    daylight: float = MISSING
    furniture: float = MISSING
    objects: float = MISSING
    vary: float = MISSING


@dataclass
class SampleConfig:
    """Everything ``recipes/scenes.py sample`` takes."""

    kind: str | None = None
    seed: int = MISSING
    count: int = MISSING
    out: str | None = None
    height: int = MISSING
    width: int = MISSING
    turn: float = MISSING
    fine: bool = MISSING
    workers: int | None = None
    encoder: str | None = None
    precision: Precision = MISSING
    patches: bool = MISSING
    device: Device = MISSING
    looks: int = MISSING
    changes: ChangesConfig = field(default_factory=ChangesConfig)
    sheet: bool = MISSING


@dataclass
class EncodeConfig:
    """Everything ``recipes/scenes.py encode`` takes."""

    scene: str | None = None
    out: str | None = None
    encoder: str | None = None
    precision: Precision = MISSING
    patches: bool = MISSING
    device: Device = MISSING


@dataclass
class ExportConfig:
    """Everything ``recipes/scenes.py export`` takes."""

    scene: str | None = None
    out: str | None = None
    layout: Layout = MISSING


@dataclass
class ImportConfig:
    """Everything ``recipes/scenes.py import`` takes."""

    scene: str | None = None
    out: str | None = None
    name: str | None = None
    source: str | None = None
    goals: list[int] | None = None


@dataclass
class InspectConfig:
    """Everything ``recipes/scenes.py inspect`` takes."""

    scene: str | None = None
    out: str | None = None
    threshold: float = MISSING
    match: Match = MISSING


MEANINGS = {
    "thor": "take a scene from live AI2-THOR",
    "vizdoom": "take a scene from a map of VizDoom",
    "miniworld": "take a scene from an environment of MiniWorld",
    "simulator": "take a scene from a simulator of your own",
    "photos": "make a scene from photographs of a real place",
    "recording": "unpack a robot's recording into photographs for photos",
    "tour": "make a scene from a 360-degree tour",
    "build": "build a synthetic room from its description",
    "sample": "furnish random rooms and build them",
    "encode": "compute the features of a dump anew, with another encoder",
    "export": "write a scene in the layout of the published navigation code",
    "import": "take over a dump in that layout",
    "inspect": "look at a scene and check it",
}
"""What each command does."""
