"""Malformed dumps: each is refused by one `SceneError` that names the file, the dataset and the first bad state."""

import tracemalloc

import h5py
import numpy as np
import pytest
from malformed import hollow, instead, make, picture, refused, views
from rooms import grid_scene, read_here

from dirl.scenes.io import hdf5
from dirl.scenes.io.hdf5 import write_digest

HUGE = 2**40
"""More states than any machine can hold; a chunked dataset of that size takes no room on the disk."""

GRAPH = grid_scene().graph
POSTSCRIPT = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 8 8\nshowpage\n"


def attribute(name, value):
    return lambda file: file.attrs.update({name: value})


def linked(name, kind):
    """The dataset's values lie in another (existing, good) file."""

    def spoil(file):
        values, another = file[name][:], f"{file.filename}.other"
        del file[name]
        with h5py.File(another, "w") as other:
            other[name] = values
        if kind == "virtual":
            layout = h5py.VirtualLayout(values.shape, values.dtype)
            layout[:] = h5py.VirtualSource(another, name, values.shape)
            file.create_virtual_dataset(name, layout)
        elif kind == "storage":
            external = [(another, 0, h5py.h5f.UNLIMITED)]  # as bytes
            file.create_dataset(name, values.shape, values.dtype, external=external)
        else:
            file[name] = h5py.ExternalLink(another, name)

    return spoil


def as_group(file):
    del file["graph"]
    file.create_group("graph")


def half_written(file):
    """Only the first chunk of four has been written."""
    del file["resnet_feature"]
    file.create_dataset("resnet_feature", (24, 8), "f4", chunks=(6, 8))[:6] = 1.0


def patches_in_chunks(file):
    file.create_dataset("patches", data=np.zeros((24, 8, 6), np.float16), chunks=(24, 8, 6))


def half_signed(file):
    write_digest(file)
    del file["graph"].attrs["digest"]


CASES = [
    (instead("graph", None), "the dataset 'graph' is missing; the file holds ['location', "),
    (instead("graph", np.zeros((24, 6), int)), "graph: expected shape (any, 4), found (24, 6)"),
    (as_group, "graph: is a group; expected a dataset"),
    (instead("graph", np.where(GRAPH == -1, -2, GRAPH)), "graph: state 0: back leads to state -2, but states are 0..2"),
    (instead("graph", GRAPH.astype("u8")), "graph: state 0: back leads to state 9223372036854775807, but states are"),
    (instead("rotation", np.where(np.arange(24) == 8, np.nan, 0)), "rotation: state 8 holds a value that is not finit"),
    (instead("resnet_feature", np.full((24, 8), 1e38)), "resnet_feature: state 0 holds a value that is not finite, or"),
    (instead("observation", np.zeros((24, 3, 4, 3), "u2")), "observation: expected uint8, 1 to 16777216 pixels a v"),
    (views(POSTSCRIPT), "observation_webp: state 23: not a readable image (it is not WebP, PNG or JPEG)"),
    (views(picture("PNG", (4096, 4097), "1")), "observation_webp: state 23: not a readable image (4096x4097 pixels ar"),
    (attribute("goals", [3, 4, 3]), "attribute 'goals': names state 3 twice"),
    (attribute("goals", np.arange(8000)), "attribute 'goals': names 8000 goals of 24 states"),
    (attribute("goals", "abc"), "attribute 'goals': expected a list of states (integers), found 'abc'"),
    (attribute("goals", h5py.Empty("f4")), "attribute 'goals': expected a list of states (integers), found Empty"),
    (attribute("actions", ["ahead", "right", "left"]), "attribute 'actions': expected ['ahead', 'right', 'left', 'bac"),
    (attribute("name", np.bytes_(b"\xff\xfe")), "attribute 'name': expected text, found b'"),
    (attribute("source", "thor\nrooms"), "attribute 'source': expected one line of text, found 'thor"),
    (linked("graph", "external"), "graph: is a link to elsewhere; a dump must hold its own data"),
    (linked("graph", "virtual"), "graph: its data lies in other files; a dump must hold its own data"),
    (linked("resnet_feature", "storage"), "resnet_feature: its data lies in other files; a dump must hold its own dat"),
    (half_written, "resnet_feature: some of its values were never written; was its making stopped?"),
    (patches_in_chunks, "patches: are not stored in one piece (h5repack"),
    (instead("patches", np.zeros((24, 8, 6), np.float32)), "patches: expected float16 values"),
    (half_signed, "does not hold what was written to it: it is damaged, or was changed without dirl"),
    (hollow("graph", (HUGE, 4), "i4"), "graph: 1099511627776 states are more than the 50000 this package can hold"),
    (hollow("resnet_feature", (24, HUGE)), "resnet_feature: expected shape (states, features) or (states, crops, feat"),
    (hollow("observation", (24, HUGE, 4, 3), "u1"), "observation: expected uint8, 1 to 16777216 pixels a view, found "),
]
"""How a file is spoiled, and how its one line begins."""


@pytest.mark.parametrize(("spoil", "says"), CASES)
def test_a_malformed_dump_is_refused_in_one_line_before_memory_is_taken(tmp_path, spoil, says):
    path = make(tmp_path / "room.h5", spoil)
    tracemalloc.start()
    try:
        assert refused(path).startswith(says)
        assert tracemalloc.get_traced_memory()[1] < 10 * 2**20
    finally:
        tracemalloc.stop()


def test_the_limit_itself_is_allowed(dump, monkeypatch):
    monkeypatch.setattr(hdf5, "MAX_STATES", 24)
    assert len(read_here(dump)) == 24


def test_what_is_no_whole_hdf5_file_is_refused(dump, tmp_path):
    assert refused(tmp_path / "none.h5") == refused(tmp_path) == "there is no such file"
    whole = dump.read_bytes()
    for content in (b"not HDF5", whole[: int(0.99 * len(whole))]):
        dump.write_bytes(content)
        assert refused(dump).startswith("not a readable HDF5 file, perhaps a broken download")
