"""Files: written whole or not at all; what is inside a folder, and what is no text or no file."""

import json
import math
import os
import stat

import pytest
from refusals import refused

from dirl.scenes.io.files import atomic_path, inside, read_text, write_json, write_text


def test_a_file_appears_whole_with_usual_permissions_and_nothing_beside_it_and_is_on_the_disk(tmp_path, monkeypatch):
    file, usual = tmp_path / "a.txt", tmp_path / "usual"
    usual.touch()
    done, fsync, replace = [], os.fsync, os.replace
    is_folder = lambda descriptor: stat.S_ISDIR(os.fstat(descriptor).st_mode)  # noqa: E731
    monkeypatch.setattr(os, "fsync", lambda file: done.append("folder" if is_folder(file) else "file") or fsync(file))
    monkeypatch.setattr(os, "replace", lambda *names: done.append("name") or replace(*names))
    write_text(file, "äöü\n")
    assert done == ["file", "name", "folder"]  # on the disk is first what it holds, then its name
    assert file.read_text(encoding="utf-8") == "äöü\n"
    assert stat.S_IMODE(file.stat().st_mode) == stat.S_IMODE(usual.stat().st_mode)
    assert {entry.name for entry in tmp_path.iterdir()} == {"a.txt", "usual"}


@pytest.mark.parametrize("problem", [KeyboardInterrupt(), OSError(28, "No space left on device")])
def test_if_anything_fails_the_old_file_stays_and_no_temporary_one(tmp_path, problem):
    file = tmp_path / "a.txt"
    write_text(file, "old")
    with pytest.raises(type(problem)) as caught, atomic_path(file) as temporary:  # noqa: PT012
        temporary.write_text("half")
        raise problem
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


def test_what_leads_out_of_a_folder_is_not_inside_but_links_within_are_and_a_folder_may_be_one(tmp_path, monkeypatch):
    folder = tmp_path / "folder"
    (folder / "a").mkdir(parents=True)
    for file in (tmp_path / "secret.png", folder / "a" / "b.png"):
        file.touch()
    (folder / "link.png").symlink_to(tmp_path / "secret.png")
    (folder / "c.png").symlink_to("a/b.png")
    (tmp_path / "other").symlink_to(folder)
    for name in ("../secret.png", "/abs/secret.png", "link.png"):
        told = r"^table: line 1: .* (lies outside of|is a link that leads out of) "
        refused(told, inside, folder, name, "table: line 1")
    monkeypatch.chdir(tmp_path)
    for where in (folder, tmp_path / "other", folder.relative_to(tmp_path)):
        assert inside(where, "c.png", "") == where / "c.png"
        assert inside(where, "a\\b.png", "") == where / "a" / "b.png"


def test_bytes_that_are_no_text_and_pipes_are_refused(tmp_path):
    file = tmp_path / "a.csv"
    file.write_bytes(b"\xff")
    with pytest.raises(ValueError, match="is not UTF-8 text"):
        read_text(file)
    file.unlink()
    os.mkfifo(file)  # which may never end
    with pytest.raises(ValueError, match=r"a\.csv: is no regular file"):
        read_text(file)
