"""Scenes from 360-degree tours: Marzipano, krpano, Pannellum, a folder of panoramas."""

from dirl.sources.tours.formats import FORMATS, read_tour
from dirl.sources.tours.tour import Link, Panorama, Tour

__all__ = ["FORMATS", "Link", "Panorama", "Tour", "read_tour"]
