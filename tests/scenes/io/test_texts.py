import os

import pytest

from dirl.scenes import SceneError
from dirl.scenes.io.bounded import MOST, read_text
from dirl.scenes.io.texts import read_rows
from dirl.sources.photos import read_photos
from dirl.sources.rooms import read_description


def sparse(file, begin=b""):
    """A file of a terabyte that takes no room on the disk."""
    file.write_bytes(begin)
    os.truncate(file, 2**40)
    return file


def test_a_text_and_a_table_are_read(tmp_path):
    file = tmp_path / "a.csv"
    file.write_bytes("a,b\r\n1,\r\nä,3\r\n".encode())
    assert read_text(file) == "a,b\r\n1,\r\nä,3\r\n"
    assert read_rows(file) == [{"a": "1", "b": ""}, {"a": "ä", "b": "3"}]


def test_a_sparse_file_is_refused_by_its_size(tmp_path):
    with pytest.raises(ValueError, match=rf"^{tmp_path}/a\.csv: has more than {MOST} bytes"):
        read_rows(sparse(tmp_path / "a.csv", b"a,b\n1,2\n"))


def test_a_sparse_table_of_photographs_is_refused(tmp_path):
    sparse(tmp_path / "states.csv")
    with pytest.raises(SceneError, match="has more than"):
        read_photos(tmp_path)


def test_a_sparse_description_is_refused(tmp_path):
    with pytest.raises(SceneError, match="has more than"):
        read_description(sparse(tmp_path / "room.toml"))


@pytest.mark.parametrize("text", [b"a,b\n" + b"\0" * 200_000, b'a,b\n"1', b'a,b\n"1"2,3'])
def test_what_is_no_table_is_refused(tmp_path, text):
    file = tmp_path / "a.csv"
    file.write_bytes(text)
    with pytest.raises(ValueError, match="is no table"):
        read_rows(file)


def test_a_cell_of_photographs_that_is_too_long_is_refused(tmp_path):
    (tmp_path / "states.csv").write_bytes(b"image,location,heading,x,z,ahead\n" + b"\0" * 200_000)
    with pytest.raises(SceneError, match=r"states\.csv: line 2: is no line of a table"):
        read_photos(tmp_path)


def test_other_bytes_are_no_text(tmp_path):
    (tmp_path / "a").write_bytes(b"\xff")
    with pytest.raises(ValueError, match="is not UTF-8 text"):
        read_text(tmp_path / "a")
    assert read_text(tmp_path / "a", errors="replace") == "\ufffd"
