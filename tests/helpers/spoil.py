"""Ways to spoil a good dump of 24 states: each returns a function that is given the open file."""

import h5py
import numpy as np
import pytest

from dirl.scenes import SceneError, read_dump


def without(name):
    return lambda file: file.pop(name)


def instead(name, value):
    def spoil(file):
        file.pop(name, None)
        file[name] = value

    return spoil


def cell(name, where, value):
    def spoil(file):
        values = file[name][:]
        values[where] = value
        instead(name, values)(file)

    return spoil


def attribute(name, value):
    return lambda file: file.attrs.update({name: value})


def hollow(name, shape, dtype="f4"):
    """A dataset of that shape that was never filled."""

    def spoil(file):
        file.pop(name, None)
        file.create_dataset(name, shape, dtype, chunks=tuple(min(size, 64) for size in shape))

    return spoil


def elsewhere(name, kind):
    """The dataset's values lie in another (existing, good) file or under another name."""

    def spoil(file):
        shape, dtype = file[name].shape, file[name].dtype
        another = file.filename + ".other"
        with h5py.File(another, "w") as other:
            other[name] = file[name][:]
        file.move(name, "hidden")
        if kind == "virtual":
            layout = h5py.VirtualLayout(shape, dtype)
            layout[:] = h5py.VirtualSource(another, name, shape)
            file.create_virtual_dataset(name, layout)
        elif kind == "storage":
            with open(file.filename + ".raw", "wb") as raw:
                raw.write(file["hidden"][:].tobytes())
            file.create_dataset(name, shape, dtype, external=[(file.filename + ".raw", 0, h5py.h5f.UNLIMITED)])
        else:
            file[name] = h5py.SoftLink("/hidden") if kind == "soft" else h5py.ExternalLink(another, name)

    return spoil


def dangling(name):
    return instead(name, h5py.ExternalLink("/nowhere/at/all.h5", "graph"))


def group(name):
    def spoil(file):
        del file[name]
        file.create_group(name)

    return spoil


def no_states(file):
    for name in ("resnet_feature", "observation", "shortest_path_distance"):
        del file[name]
    for name, shape in (("graph", (0, 4)), ("location", (0, 2)), ("rotation", (0,))):
        instead(name, np.zeros(shape, int))(file)


def webp(dtype):
    return lambda file: file.create_dataset("observation_webp", (24,), dtype)


def feature_attribute(name, value):
    return lambda file: file["resnet_feature"].attrs.update({name: value})


def named_type(name):
    return instead(name, np.dtype("i4"))


def of_states(graph):
    """The graph instead of the file's own, and everything else of as many states as it has."""

    def spoil(file):
        no_states(file)
        for name, value in (
            ("graph", graph),
            ("location", np.zeros((len(graph), 2))),
            ("rotation", np.arange(len(graph)) % 360),
        ):
            instead(name, value)(file)

    return spoil


def partly_written(name):
    """Only the first chunk of four has been written."""

    def spoil(file):
        del file[name]
        dataset = file.create_dataset(name, (24, 8), "f4", chunks=(6, 8))
        dataset[:6] = 1.0

    return spoil


def squeezed(name, shape):
    """Zeros, packed as well as gzip can."""

    def spoil(file):
        del file[name]
        file.create_dataset(name, data=np.zeros(shape, "f4"), compression="gzip", chunks=(shape[0], 2**14))

    return spoil


def unknown_filter(name):
    """The values are packed by a filter that this machine has never heard of."""

    def spoil(file):
        values = file[name][:]
        del file[name]
        properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        properties.set_chunk(values.shape)
        properties.set_filter(32123, h5py.h5z.FLAG_OPTIONAL, ())
        space, kind = h5py.h5s.create_simple(values.shape), h5py.h5t.py_create(values.dtype)
        dataset = h5py.h5d.create(file.id, name.encode(), kind, space, properties)
        dataset.write_direct_chunk((0,) * values.ndim, values.tobytes(), filter_mask=0)

    return spoil


def refused(path):
    """What the one `SceneError` says after the name of the file."""
    with pytest.raises(SceneError) as caught:
        read_dump(path, isolated=False)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert caught.value.__cause__ is None
    assert caught.value.__context__ is None or caught.value.__suppress_context__  # one error, not a chain
    assert "\n" not in message
    return message.removeprefix(f"{path}: ")
