"""Random rooms: from a kind and a seed to the description of a room that passes the checks of the built-in ones."""

from dirl.sources.rooms.sampling.sample import KINDS, sample_room

__all__ = ["KINDS", "sample_room"]
