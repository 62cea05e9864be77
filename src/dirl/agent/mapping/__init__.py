"""Topological maps: maps made of what a walk saw and did, to find the path to any photograph of the place."""

from dirl.agent.mapping.graph_policy import GraphMemory, GuidedPolicy
from dirl.agent.mapping.image_graph import ImageGraph, MapError
from dirl.agent.mapping.places import PlaceMap
from dirl.agent.mapping.storage import load_graph, save_graph

__all__ = ["GraphMemory", "GuidedPolicy", "ImageGraph", "MapError", "PlaceMap", "load_graph", "save_graph"]
