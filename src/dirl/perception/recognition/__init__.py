"""Recognising a place or the goal by what is seen: one recogniser for stop, memories and maps."""

from dirl.perception.recognition.learned import Learned
from dirl.perception.recognition.recogniser import NCC, Recogniser, Thresholds

__all__ = ["NCC", "Learned", "Recogniser", "Thresholds"]
