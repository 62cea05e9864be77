"""Files that a recipe cannot write are refused before any work."""

import pytest
from refusals import refused

from dirl.cli.output import new_file


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("there.h5", "this file exists already; it is not overwritten"),
        ("there.h5/inside.h5", "cannot be written (Not a directory)"),
        ("x" * 300 + ".h5", "cannot be written (File name too long)"),
        ("other.txt", "the name must end in .h5"),
        ("a/b.h5", None),
    ],
)
def test_a_file_is_new_and_can_be_written_or_is_refused(tmp_path, monkeypatch, name, says):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there.h5").touch()
    if says is None:
        assert str(new_file(name)) == name
    else:
        assert refused(".", new_file, name).startswith(f"out={name}: {says}")
    assert [file.name for file in tmp_path.iterdir()] == ["there.h5"]
