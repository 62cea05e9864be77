"""Files that are not whole HDF5 files: refused by one `SceneError` that names the file."""

import h5py
import pytest
from malformed import refused

BROKEN = "not a readable HDF5 file, perhaps a broken download"


def test_what_is_no_file_is_refused(tmp_path):
    assert refused(tmp_path / "none.h5") == refused(tmp_path) == "there is no such file"


@pytest.mark.parametrize("content", [b"", b"not HDF5", b"\x89HDF\r\n\x1a\n" + bytes(2000)])
def test_a_file_that_is_not_hdf5_is_refused(tmp_path, content):
    path = tmp_path / "room.h5"
    path.write_bytes(content)
    assert refused(path).startswith(BROKEN)


@pytest.mark.parametrize("share", [0.1, 0.99])
def test_a_truncated_file_is_refused(dump, share):
    whole = dump.read_bytes()
    dump.write_bytes(whole[: int(share * len(whole))])
    assert refused(dump).startswith(BROKEN)


def damaged(path, name, place):
    """Overwrite four bytes of a dataset: of its values or of the header that describes them."""
    with h5py.File(path, "a") as file:
        values = file[name][:]
        del file[name]
        dataset = file.create_dataset(name, data=values, chunks=values.shape, compression="gzip")
        header = h5py.h5o.get_info(dataset.id).addr
        offset = header if place == "header" else dataset.id.get_chunk_info(0).byte_offset
    with open(path, "r+b") as file:
        file.seek(offset)
        file.write(b"\xff" * 4)


@pytest.mark.parametrize("place", ["values", "header"])
@pytest.mark.parametrize("name", ["graph", "resnet_feature"])
def test_a_damaged_file_is_refused(dump, name, place):
    damaged(dump, name, place)
    assert refused(dump).startswith(BROKEN)
