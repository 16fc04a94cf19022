"""Folders are replaced whole or not at all, and one process at a time holds a
folder."""

import contextlib
import os
import subprocess
import sys

import pytest

from bp2_rl.base import folders
from bp2_rl.base.errors import UserError
from bp2_rl.base.folders import lock_folder, new_folder


def test_a_folder_is_replaced_whole_or_not_at_all(tmp_path):
    folder = tmp_path / "folder"
    for text in ("one", "two"):
        with new_folder(folder) as fresh:
            (fresh / "file").write_text(text)
    with contextlib.suppress(ZeroDivisionError), new_folder(folder) as fresh:
        (fresh / "file").write_text("three")
        raise ZeroDivisionError
    assert (folder / "file").read_text() == "two"
    assert list(tmp_path.iterdir()) == [folder]


def test_a_lock_is_held_by_a_child_that_outlives_its_parent(tmp_path):
    with lock_folder(tmp_path, "busy") as descriptor:
        with pytest.raises(UserError, match="busy"), lock_folder(tmp_path, "busy"):
            pass
        child = subprocess.Popen(
            [sys.executable, "-c", "input()"],
            stdin=subprocess.PIPE,
            pass_fds=(descriptor,),
            env=dict(os.environ),
        )
    try:
        with pytest.raises(UserError, match="busy"), lock_folder(tmp_path, "busy"):
            pass
    finally:
        child.communicate(b"\n", timeout=30)
    with lock_folder(tmp_path, "busy"):
        pass


def test_what_a_killed_replacement_or_removal_leaves_is_found_and_tidied_away(tmp_path):
    for name, content in (
        ("a", "old"),
        (".a.new", "new"),
        (".b.old", "old"),
        (".b.new", "new"),
        (".c.gone", "torn"),
    ):
        (tmp_path / name).mkdir()
        (tmp_path / name / "file").write_text(content)
    assert folders.folder_names(tmp_path) == {"a", "b"}
    for name in ("a", "b"):
        assert (folders.find_folder(tmp_path / name) / "file").read_text() == "old"
    folders.tidy(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b"]
    assert (tmp_path / "b" / "file").read_text() == "old"


def test_a_folder_is_removed_under_another_name(tmp_path, monkeypatch):
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "file").touch()

    def fail(path, **_):
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(folders.shutil, "rmtree", fail)
    with pytest.raises(OSError, match="Input"):
        folders.remove_folder(folder)
    assert folders.folder_names(tmp_path) == set()


def test_a_file_system_without_locks_is_worked_on_without(tmp_path, monkeypatch):
    def none(*_):
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr("fcntl.flock", none)
    with lock_folder(tmp_path, "busy"):
        pass


def test_a_lock_that_is_a_link_or_a_pipe_is_not_followed_or_waited_for(tmp_path):
    lock = tmp_path / ".lock"
    for place, complaint in (
        (lambda: lock.symlink_to("elsewhere"), "is a link to elsewhere: remove it"),
        (lambda: os.mkfifo(lock), "cannot write to"),
    ):
        place()
        with pytest.raises(UserError, match=complaint), lock_folder(tmp_path, "busy"):
            pass
        lock.unlink()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("there", [True, False])
def test_a_link_in_a_folders_place_is_replaced_and_its_target_left_alone(
    tmp_path, there
):
    elsewhere, folder = tmp_path / "elsewhere", tmp_path / "in" / "folder"
    folder.parent.mkdir()
    if there:
        elsewhere.mkdir()
        (elsewhere / "file").write_text("theirs")
    folder.symlink_to(elsewhere)
    for text in ("one", "two"):
        with new_folder(folder) as fresh:
            (fresh / "file").write_text(text)
    assert (folder / "file").read_text() == "two"
    assert [path.name for path in folder.parent.iterdir()] == ["folder"]
    assert elsewhere.exists() is there
    assert not there or (elsewhere / "file").read_text() == "theirs"


def test_of_a_link_to_a_folder_only_the_link_is_removed(tmp_path):
    elsewhere, parent = tmp_path / "elsewhere", tmp_path / "in"
    parent.mkdir()
    elsewhere.mkdir()
    (elsewhere / "file").write_text("theirs")
    for name in ("1", ".2.old", ".3.gone"):
        (parent / name).symlink_to(elsewhere)
    folders.remove_folder(parent / "1")
    folders.tidy(parent)
    # `.2.old` was brought back
    assert [path.name for path in parent.iterdir()] == ["2"]
    assert (elsewhere / "file").read_text() == "theirs"
