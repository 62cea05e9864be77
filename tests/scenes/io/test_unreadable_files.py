"""Files that are not whole HDF5 files: refused by one `SceneError` that names the file."""

import pytest
from malformed import refused

BROKEN = "not a readable HDF5 file, perhaps a broken download"


def test_what_is_no_file_is_refused(tmp_path):
    assert refused(tmp_path / "none.h5") == refused(tmp_path) == "there is no such file"


@pytest.mark.parametrize("content", [b"not HDF5"])
def test_a_file_that_is_not_hdf5_is_refused(tmp_path, content):
    path = tmp_path / "room.h5"
    path.write_bytes(content)
    assert refused(path).startswith(BROKEN)


@pytest.mark.parametrize("share", [0.99])
def test_a_truncated_file_is_refused(dump, share):
    whole = dump.read_bytes()
    dump.write_bytes(whole[: int(share * len(whole))])
    assert refused(dump).startswith(BROKEN)
