"""Recognising a place or the goal by what is seen."""
