"""Readers with a bound: what is inside a folder, and what is no text or no file."""

import os

import pytest

from dirl.scenes import SceneError
from dirl.scenes.io.files import inside, read_text


@pytest.mark.parametrize("name", ["../secret.png", "/abs/secret.png", "link.png"])
def test_what_leads_out_of_a_folder_is_not_inside(tmp_path, name):
    (tmp_path / "secret.png").touch()
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "link.png").symlink_to(tmp_path / "secret.png")
    with pytest.raises(SceneError, match=r"^table: line 1: '.*' (lies outside of|is a link that leads out of) "):
        inside(folder, name, "table: line 1")


def test_links_within_a_folder_and_a_folder_that_is_a_link_are_inside(tmp_path, monkeypatch):
    folder = tmp_path / "folder"
    (folder / "a").mkdir(parents=True)
    (folder / "a" / "b.png").touch()
    (folder / "c.png").symlink_to("a/b.png")
    (tmp_path / "other").symlink_to(folder)
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
