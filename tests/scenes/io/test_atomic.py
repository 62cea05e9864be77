import json
import math
import os
import stat

import pytest

from dirl.scenes.io.files import atomic_path, write_json, write_text


def test_a_file_appears_whole_with_usual_permissions_and_nothing_beside_it(tmp_path):
    file = tmp_path / "a.txt"
    write_text(file, "äöü\n")
    assert file.read_text(encoding="utf-8") == "äöü\n"
    (tmp_path / "usual").touch()
    assert stat.S_IMODE(file.stat().st_mode) == stat.S_IMODE((tmp_path / "usual").stat().st_mode)
    assert {entry.name for entry in tmp_path.iterdir()} == {"a.txt", "usual"}


def test_data_is_on_the_disk_before_the_file_has_its_name_and_then_the_name_is(tmp_path, monkeypatch):
    done, fsync, replace = [], os.fsync, os.replace
    is_folder = lambda descriptor: stat.S_ISDIR(os.fstat(descriptor).st_mode)  # noqa: E731
    monkeypatch.setattr(os, "fsync", lambda file: done.append("folder" if is_folder(file) else "file") or fsync(file))
    monkeypatch.setattr(os, "replace", lambda *names: done.append("name") or replace(*names))
    write_text(tmp_path / "a.txt", "new")
    assert done == ["file", "name", "folder"]


@pytest.mark.parametrize("problem", [KeyboardInterrupt(), OSError(28, "No space left on device")])
def test_if_anything_fails_the_old_file_stays_and_no_temporary_one(tmp_path, problem):
    file = tmp_path / "a.txt"
    write_text(file, "old")

    def half(path):
        path.write_text("half")
        raise problem

    with pytest.raises(type(problem)) as caught, atomic_path(file) as temporary:
        half(temporary)
    assert file.read_text() == "old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.txt"]
    if isinstance(problem, OSError):
        assert caught.value.filename == str(file)


def test_json_knows_no_nan(tmp_path):
    write_json(tmp_path / "a.json", {"a": math.nan, "b": {"c": [1, math.inf]}})
    assert json.loads((tmp_path / "a.json").read_text()) == {"a": None, "b": {"c": [1, None]}}
    with pytest.raises(TypeError):
        write_json(tmp_path / "b.json", {"a": object()})
    assert not (tmp_path / "b.json").exists()
