"""Scenes as files: HDF5 dumps, read and written, and the layout of the published code."""
