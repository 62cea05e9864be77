import os

import pytest

from dirl.scenes.io.bounded import MOST, read_text
from dirl.scenes.io.texts import read_rows


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


@pytest.mark.parametrize("text", [b"a,b\n" + b"\0" * 200_000])
def test_what_is_no_table_is_refused(tmp_path, text):
    file = tmp_path / "a.csv"
    file.write_bytes(text)
    with pytest.raises(ValueError, match="is no table"):
        read_rows(file)


def test_other_bytes_are_no_text(tmp_path):
    (tmp_path / "a").write_bytes(b"\xff")
    with pytest.raises(ValueError, match="is not UTF-8 text"):
        read_text(tmp_path / "a")
    assert read_text(tmp_path / "a", errors="replace") == "\ufffd"
