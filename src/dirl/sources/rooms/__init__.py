"""Synthetic furnished rooms: described in TOML or sampled at random, lit and seen on a CPU, written as scene dumps.

The built-in rooms were made with it.
"""

from dirl.sources.rooms.checks import check_room
from dirl.sources.rooms.description import RoomDescription, description_text, read_description
from dirl.sources.rooms.dump import build_room, built_in_rooms, describe_room
from dirl.sources.rooms.sampling import KINDS, sample_room

__all__ = [
    "KINDS",
    "RoomDescription",
    "build_room",
    "built_in_rooms",
    "check_room",
    "describe_room",
    "description_text",
    "read_description",
    "sample_room",
]
