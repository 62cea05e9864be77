"""Recognising a place or the goal by what is seen: one recogniser for stop, memories and maps."""

from dirl.recognition.learned import Learned
from dirl.recognition.patches import Patches
from dirl.recognition.recogniser import NCC, Recogniser, Thresholds

__all__ = ["NCC", "Learned", "Patches", "Recogniser", "Thresholds"]
