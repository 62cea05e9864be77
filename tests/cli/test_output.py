"""Files that a recipe cannot write are refused before any work."""

import pytest

from dirl.cli.output import new_file
from dirl.config.schemas import ConfigError


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("/proc/x.h5", "cannot be written ("),
        ("x" * 300 + ".h5", "cannot be written (File name too long)"),
        ("there.h5", "this file exists already; it is not overwritten"),
        ("there.h5/inside.h5", "cannot be written (Not a directory)"),
        ("other.txt", "the name must end in .h5"),
    ],
)
def test_a_file_that_cannot_be_written_is_refused(tmp_path, monkeypatch, name, says):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there.h5").touch()
    with pytest.raises(ConfigError) as error:
        new_file(name)
    assert str(error.value).startswith(f"out={name}: {says}")


def test_a_new_file_may_be_in_a_folder_that_is_not_there_yet(tmp_path):
    assert new_file(str(tmp_path / "a" / "b.h5")) == tmp_path / "a" / "b.h5"
    assert not list(tmp_path.iterdir())
