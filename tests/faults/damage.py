"""Ways to damage a dump: each is given a generator of random numbers and the path of a good file, and changes it."""

import h5py
import numpy as np

NUMBERS = ("i1", "u1", "<i2", ">i4", "u4", "i8", "u8", "f2", "f4", ">f8", "?", "S3", "c8")


def of_bytes(change):
    """A way by a function of a generator and the bytes of the file, which it changes in place."""

    def way(rng, path):
        content = bytearray(path.read_bytes())
        change(rng, content)
        path.write_bytes(content)

    way.__name__ = change.__name__
    return way


def flip(rng, content, start, stop):
    """Flip a bit between two places, which may lie outside of the file."""
    content[min(max(start + int(rng.integers(stop - start)), 0), len(content) - 1)] ^= 1 << rng.integers(8)


@of_bytes
def flip_bits(rng, content):
    for _ in range(rng.integers(1, 5)):
        flip(rng, content, 0, len(content))


@of_bytes
def flip_bits_of_metadata(rng, content):
    """Damage where HDF5 keeps its tables: around the signatures of its structures."""
    signs = [b"\x89HDF", b"TREE", b"HEAP", b"SNOD", b"GCOL", b"graph", b"digest", b"name", b"goals"]
    places = [at for sign in signs if (at := content.find(sign)) >= 0]
    for _ in range(rng.integers(1, 4)):
        at = int(rng.choice(places))
        flip(rng, content, at - 64, at + 512)


def flip_bits_of_a_header(rng, path):
    """Damage the header of one dataset: its type, shape, storage and attributes."""
    with h5py.File(path) as file:
        start = h5py.h5o.get_info(file[str(rng.choice(list(file)))].id).addr
    content = bytearray(path.read_bytes())
    for _ in range(rng.integers(1, 3)):
        flip(rng, content, start, start + 300)
    path.write_bytes(content)


@of_bytes
def overwrite(rng, content):
    length = int(rng.choice([rng.integers(1, 65), 512]))
    at = int(rng.integers(max(1, len(content) - length)))
    content[at : at + length] = rng.bytes(length) if rng.random() < 0.5 else bytes([rng.choice([0, 255])]) * length


@of_bytes
def lose_bytes(rng, content):
    """A thousand bytes at most, or all to the end."""
    at, length = rng.integers(len(content)), rng.integers(1, 1000)
    del content[at : at + length if rng.random() < 0.5 else None]


@of_bytes
def swap_sectors(rng, content):
    a, b = (512 * int(at) for at in rng.integers(max(1, len(content) // 512), size=2))
    content[a : a + 512], content[b : b + 512] = content[b : b + 512], content[a : a + 512]


def change_attribute(rng, path):
    values = [
        rng.integers(-5, 30, size=rng.integers(0, 50)),
        rng.random(3),
        rng.bytes(20),
        np.bytes_(rng.bytes(8)),
        "".join(map(chr, rng.integers(1, 0x2000, size=rng.integers(0, 300)))),
        ["ahead", "right", "left"] * int(rng.integers(0, 3)),
        list(rng.permutation(["ahead", "right", "left", "back"])),
        np.zeros(3, [("a", "i4"), ("b", "f8")]),
        h5py.Empty("f4"),
        np.arange(20_000),
    ]
    with h5py.File(path, "a") as file:
        holder = file["resnet_feature"] if rng.random() < 0.3 else file
        name = str(rng.choice(["name", "source", "goals", "actions", "extractor", "preprocessing", "weights"]))
        if rng.random() < 0.2:
            holder.attrs.pop(name, None)
        else:
            holder.attrs[name] = values[rng.integers(len(values))]


def change_type(rng, path):
    with h5py.File(path, "a") as file:
        name = str(rng.choice([name for name in file if file[name].dtype.kind != "O"]))
        values = file[name][:]
        del file[name]
        with np.errstate(all="ignore"):
            file[name] = values.astype(str(rng.choice(NUMBERS)))


def change_shape(rng, path):
    with h5py.File(path, "a") as file:
        name = str(rng.choice(list(file)))
        kind = file[name].dtype
        del file[name]
        shape = tuple(rng.choice([0, 1, 3, 4, 23, 24, 25], size=rng.integers(0, 5)).tolist())
        chunks = tuple(max(1, size // 2) for size in shape) if shape and rng.random() < 0.5 else None
        file.create_dataset(name, shape, kind, chunks=chunks, fletcher32=chunks is not None and rng.random() < 0.5)


def change_values(rng, path):
    with h5py.File(path, "a") as file:
        name = str(rng.choice([name for name in file if file[name].dtype.kind != "O"]))
        values = file[name][:]
        for _ in range(rng.integers(1, 4)):
            where = tuple(rng.integers(size) for size in values.shape)
            special = [-1, 0, 1, 23, 24, 127] if values.dtype.kind in "iu" else [-1, 0, np.nan, np.inf, 1e30, 0.25]
            with np.errstate(all="ignore"):
                values[where] = np.array(rng.choice(special)).astype(values.dtype)
        file[name][...] = values


def change_a_view(rng, path):
    with h5py.File(path, "a") as file:
        if "observation_webp" not in file:
            file["observation"][rng.integers(24)] += 1
            return
        state = int(rng.integers(24))
        view = bytearray(file["observation_webp"][state].tobytes())
        if rng.random() < 0.5:
            view = view[: rng.integers(len(view))]
        else:
            view[rng.integers(len(view))] ^= 1 << rng.integers(8)
        file["observation_webp"][state] = np.frombuffer(bytes(view) or b"%!PS", np.uint8)


def damage_a_chunk(rng, path):
    """A chunk that is shorter than its filters expect, or filled with noise."""
    with h5py.File(path, "a") as file:
        name = str(rng.choice(["graph", "location", "rotation", "resnet_feature"]))
        values = file[name][:]
        del file[name]
        options = [{"compression": "gzip"}, {"shuffle": True}, {"fletcher32": True}, {"compression": "lzf"}]
        chosen = {key: value for option in options if rng.random() < 0.5 for key, value in option.items()}
        dataset = file.create_dataset(name, data=values, chunks=values.shape, **chosen)
        length = int(rng.integers(1, 40)) if rng.random() < 0.5 else values.nbytes
        dataset.id.write_direct_chunk((0,) * values.ndim, rng.bytes(length), filter_mask=int(rng.integers(0, 4)))


def lose_a_dataset(rng, path):
    with h5py.File(path, "a") as file:
        name = str(rng.choice(list(file)))
        if rng.random() < 0.5:
            del file[name]
        else:
            file.move(name, name + "_")


WAYS = (flip_bits, flip_bits_of_metadata, flip_bits_of_a_header) * 2
WAYS += (overwrite, lose_bytes, swap_sectors, change_attribute, change_type, change_shape)
WAYS += (change_values, change_a_view, damage_a_chunk, lose_a_dataset)
"""Those that find most twice."""
