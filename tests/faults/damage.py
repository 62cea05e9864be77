"""Ways to damage a dump: each is given a generator of random numbers and the path of a good file, and changes it."""

import h5py
import numpy as np

NUMBERS = ("i1", "u1", "<i2", ">i4", "u4", "i8", "u8", "f2", "f4", ">f8", "?", "S3", "c8")


def flip_bits(path, rng, start=0, stop=None):
    """Flip up to four bits between two places of the file."""
    content = bytearray(path.read_bytes())
    stop = min(stop or len(content), len(content))
    for _ in range(rng.integers(1, 5)):
        content[int(rng.integers(max(start, 0), stop))] ^= 1 << rng.integers(8)
    path.write_bytes(content)


def anywhere(rng, path):
    flip_bits(path, rng)


def in_the_metadata(rng, path):
    """Where HDF5 keeps its tables: around the signatures of its structures."""
    content = path.read_bytes()
    signs = [b"\x89HDF", b"TREE", b"HEAP", b"SNOD", b"GCOL", b"graph", b"digest", b"name", b"goals"]
    at = int(rng.choice([at for sign in signs if (at := content.find(sign)) >= 0]))
    flip_bits(path, rng, at - 64, at + 512)


def in_a_header(rng, path):
    """The header of one dataset: its type, shape, storage and attributes."""
    with h5py.File(path) as file:
        start = h5py.h5o.get_info(file[str(rng.choice(list(file)))].id).addr
    flip_bits(path, rng, start, start + 300)


def overwrite(rng, path):
    """Up to 512 bytes with noise or with one value; or they are lost, or all to the end."""
    content = bytearray(path.read_bytes())
    at, length = int(rng.integers(len(content))), int(rng.choice([rng.integers(1, 65), 512]))
    other = [rng.bytes(length), bytes([rng.choice([0, 255])]) * length, b"", b""][rng.integers(4)]
    content[at : at + length if other or rng.random() < 0.5 else None] = other
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


def change_dataset(rng, path):
    """Another type or shape, a value that is none, a chunk that is shorter than its filters expect; or none at all."""
    with h5py.File(path, "a") as file:
        name = str(rng.choice([name for name in file if file[name].dtype.kind != "O"]))
        values, how = file[name][:], rng.choice(["type", "shape", "values", "chunks", "lost"])
        del file[name]
        with np.errstate(all="ignore"):
            if how == "type":
                file[name] = values.astype(str(rng.choice(NUMBERS)))
            elif how == "shape":
                shape = tuple(rng.choice([0, 1, 3, 4, 23, 24, 25], size=rng.integers(0, 5)).tolist())
                file.create_dataset(name, shape, values.dtype)
            elif how == "values":
                special = [-1, 0, 1, 23, 24, 127] if values.dtype.kind in "iu" else [-1, 0, np.nan, np.inf, 1e30]
                where = tuple(rng.integers(size) for size in values.shape)
                values[where] = np.array(rng.choice(special)).astype(values.dtype)
                file[name] = values
            elif how == "chunks":
                filters = [{"compression": "gzip"}, {"shuffle": True, "fletcher32": True}, {"compression": "lzf"}]
                dataset = file.create_dataset(name, data=values, chunks=values.shape, **filters[rng.integers(3)])
                length = int(rng.integers(1, 40)) if rng.random() < 0.5 else values.nbytes
                dataset.id.write_direct_chunk((0,) * values.ndim, rng.bytes(length), int(rng.integers(4)))


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


WAYS = (
    anywhere,
    in_the_metadata,
    in_a_header,
    overwrite,
    change_attribute,
    change_dataset,
    change_dataset,
    change_a_view,
)
