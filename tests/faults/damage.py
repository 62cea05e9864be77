"""Ways to damage a dump: each is given a generator of random numbers and the path of a good file, and changes it."""

import h5py
import numpy as np

NUMBERS = ("i1", "u1", "<i2", ">i4", "u4", "i8", "u8", "f2", "f4", ">f8", "?", "S3", "c8")


def flip_bits(rng, path):
    content = bytearray(path.read_bytes())
    for _ in range(rng.integers(1, 5)):
        content[rng.integers(len(content))] ^= 1 << rng.integers(8)
    path.write_bytes(content)


def flip_bits_of_metadata(rng, path):
    """Damage where HDF5 keeps its tables: around the signatures of its structures."""
    content = bytearray(path.read_bytes())
    signs = [b"\x89HDF", b"TREE", b"HEAP", b"SNOD", b"GCOL", b"graph", b"digest", b"name", b"goals"]
    places = [at for sign in signs if (at := content.find(sign)) >= 0]
    for _ in range(rng.integers(1, 4)):
        at = min(int(rng.choice(places)) + int(rng.integers(-64, 512)), len(content) - 1)
        content[max(at, 0)] ^= 1 << rng.integers(8)
    path.write_bytes(content)


def flip_bits_of_a_header(rng, path):
    """Damage the header of one dataset: its type, shape, storage and attributes."""
    with h5py.File(path) as file:
        start = h5py.h5o.get_info(file[str(rng.choice(list(file)))].id).addr
    content = bytearray(path.read_bytes())
    for _ in range(rng.integers(1, 3)):
        content[min(start + int(rng.integers(300)), len(content) - 1)] ^= 1 << rng.integers(8)
    path.write_bytes(content)


def overwrite(rng, path):
    content = bytearray(path.read_bytes())
    length = int(rng.integers(1, 65))
    at = int(rng.integers(max(1, len(content) - length)))
    content[at : at + length] = rng.bytes(length) if rng.random() < 0.5 else bytes([rng.choice([0, 255])]) * length
    path.write_bytes(content)


def zero_a_sector(rng, path):
    content = bytearray(path.read_bytes())
    at = 512 * int(rng.integers(max(1, len(content) // 512)))
    content[at : at + 512] = bytes(len(content[at : at + 512]))
    path.write_bytes(content)


def truncate(rng, path):
    content = path.read_bytes()
    path.write_bytes(content[: rng.integers(len(content))])


def lose_bytes(rng, path):
    content = path.read_bytes()
    at, length = rng.integers(len(content)), rng.integers(1, 1000)
    path.write_bytes(content[:at] + content[at + length :])


def swap_sectors(rng, path):
    content = bytearray(path.read_bytes())
    a, b = (512 * int(at) for at in rng.integers(max(1, len(content) // 512), size=2))
    content[a : a + 512], content[b : b + 512] = content[b : b + 512], content[a : a + 512]
    path.write_bytes(content)


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


WAYS = (
    flip_bits,
    flip_bits,
    flip_bits_of_metadata,
    flip_bits_of_metadata,
    flip_bits_of_a_header,
    flip_bits_of_a_header,
    overwrite,
    zero_a_sector,
    truncate,
    lose_bytes,
    swap_sectors,
    change_attribute,
    change_type,
    change_shape,
    change_values,
    change_a_view,
    damage_a_chunk,
    lose_a_dataset,
)
"""Those of one kind twice that find most."""
