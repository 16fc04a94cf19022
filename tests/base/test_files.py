"""Files are written whole or not at all, and strangers' damaged files end in a one-line
error."""

import contextlib
import io
import json
import os
import subprocess
import sys
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest
from damage import flipped_bits

from bp2_rl.base import files
from bp2_rl.base.errors import UserError
from bp2_rl.base.files import (
    ArraySpec,
    BadFileError,
    read_npz,
    write_npz,
    write_text,
)

WANTED = {
    "a": ArraySpec(np.floating, ("n", 3)),
    "b": ArraySpec(np.dtype(np.float32), ("n",)),
}


@pytest.fixture
def archive(tmp_path):
    path = tmp_path / "arrays.npz"
    rng = np.random.default_rng(0)
    arrays = {
        "a": rng.normal(size=(5, 3)),
        "b": rng.normal(size=5).astype(np.float32),
        "other": np.zeros(9),
    }
    write_npz(path, arrays, compressed=True)
    return path, arrays


def test_a_write_that_fails_leaves_what_was_there(tmp_path, monkeypatch):
    path = tmp_path / "file"
    write_text(path, "old")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(files.os, "replace", full)
    with pytest.raises(OSError, match="space"):
        write_text(path, "new")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_arrays_come_back_as_they_were_and_only_those_wanted(archive):
    path, arrays = archive
    found = read_npz(path, WANTED)
    assert set(found) == set(WANTED)
    for name, array in found.items():
        np.testing.assert_array_equal(array, arrays[name])


@pytest.mark.parametrize(
    ("wanted", "complaint"),
    [
        ({"c": ArraySpec(np.floating, (5,))}, "lacks the array c"),
        (
            {"a": ArraySpec(np.floating, (5, 4))},
            r"holds a as float64\[5, 3\], expected floating\[5, 4\]",
        ),
        ({"b": ArraySpec(np.dtype(np.float64), (5,))}, "holds b as float32"),
        (
            {
                "a": ArraySpec(np.floating, ("n", 3)),
                "other": ArraySpec(np.floating, ("n",)),
            },
            r"expected floating\[5\]",
        ),
    ],
)
@pytest.mark.attack
def test_other_arrays_than_wanted_are_refused_by_name(archive, wanted, complaint):
    with pytest.raises(BadFileError, match=complaint):
        read_npz(archive[0], wanted)


def test_any_flipped_bit_ends_in_the_arrays_or_in_one_line(archive, tmp_path):
    path = tmp_path / "flipped.npz"
    for content in flipped_bits(archive[0].read_bytes(), 400):
        path.write_bytes(content)
        with contextlib.suppress(UserError):  # anything else fails the test
            assert read_npz(path, WANTED)["a"].shape == (5, 3)


def header(shape):
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        file, {"descr": "<f8", "fortran_order": False, "shape": shape}
    )
    return file.getvalue()


@pytest.mark.parametrize(
    ("head", "shape", "complaint"),
    [
        (header((1 << 24, 3)), (5, 3), "expected floating"),
        (header((1 << 24, 3)), ("n", 3), "at most are read"),
        (
            np.lib.format.magic(2, 0) + (1 << 28).to_bytes(4, "little"),
            (5, 3),
            "array format",
        ),
    ],
    ids=["another shape", "too large", "a header of gigabytes"],
)
def test_a_small_file_cannot_fill_the_memory(tmp_path, head, shape, complaint):
    path = tmp_path / "bomb.npz"
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("a.npy", "w") as member,
    ):
        member.write(head)
        for _ in range(48):
            member.write(b" " * (8 << 20))
    assert path.stat().st_size < 1 << 20
    tracemalloc.start()
    with pytest.raises(BadFileError, match=complaint):
        read_npz(path, {"a": ArraySpec(np.floating, shape)}, largest=1 << 20)
    assert tracemalloc.get_traced_memory()[1] < 16 << 20
    tracemalloc.stop()


@pytest.mark.parametrize("method", [zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2])
def test_what_numpy_does_not_compress_so_is_not_unpacked(archive, tmp_path, method):
    """LZMA has errors of its own, and takes gigabytes for a few bytes that say so."""
    path = tmp_path / "other.npz"
    with (
        zipfile.ZipFile(archive[0]) as whole,
        zipfile.ZipFile(path, "w", method) as other,
    ):
        for name in whole.namelist():
            other.writestr(name, whole.read(name))
    with pytest.raises(BadFileError, match="lacks the array a"):
        read_npz(path, WANTED)
    content = bytearray(path.read_bytes())
    for k in range(30, 200):
        path.write_bytes(content[:k] + bytes([content[k] ^ 255]) + content[k + 1 :])
        with pytest.raises(BadFileError):
            read_npz(path, WANTED)


def test_no_pickle_is_opened(tmp_path):
    path, buffer = tmp_path / "pickle.npz", io.BytesIO()
    np.savez(buffer, a=np.array([print], dtype=object))
    path.write_bytes(buffer.getvalue())
    with pytest.raises(BadFileError, match="holds a as object"):
        read_npz(path, {"a": ArraySpec(np.dtype(object), (1,))})


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"{",
        b"\xff\xfe",
        b"[" * 100_000,
        b"1" * 10_000,
        '{"a": "\\ud800"}',
        "[" * 51 + "]" * 51,
    ],
    ids=range(7),
)
def test_what_is_no_json_that_could_be_shown_or_walked_ends_in_one_line(content):
    with pytest.raises(BadFileError, match=r"^here is "):
        files.parse_json(content, "here")
    files.parse_json("[" * 50 + "]" * 50, "here")  # as deeply as we read


@pytest.mark.parametrize(
    "character", ["\0", "\x1b", "\r", "\x7f", "\x9b", "\u202e", "\u2066"]
)
def test_json_whose_texts_would_steer_a_terminal_is_refused(character):
    for value in ([{"a": f"b{character}"}], {f"a{character}": 1}):
        with pytest.raises(
            BadFileError,
            match=r"^here is damaged or not JSON: a text holds the control character '",
        ):
            files.parse_json(json.dumps(value), "here")
    files.parse_json(json.dumps("tab\tline\nbreak, 10 m/s² \u00a0 ä 犬"), "here")


def test_two_processes_that_write_the_same_file_do_not_meet(tmp_path):
    path = tmp_path / "file"
    with files.new_file(path) as ours:
        ours.write(b"ours")
        child = "import sys, pathlib; from bp2_rl.base import files; files.write_text(pathlib.Path(sys.argv[1]), 'theirs')"
        subprocess.run([sys.executable, "-c", child, str(path)], check=True)
        assert path.read_bytes() == b"theirs"
    assert path.read_bytes() == b"ours"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("length", [250, 252, 255, 256])
def test_a_name_that_is_too_long_to_be_written_safely_is_refused(tmp_path, length):
    with pytest.raises(UserError, match="no file or folder can be called"):
        files.require_name(tmp_path / ("x" * length))
    files.require_name(tmp_path / ("x" * 230))
    write_text(tmp_path / ("x" * 230), "")


def test_what_is_written_in_place_is_appended_and_stays_in_its_folder(tmp_path):
    """A link, to a file that is there or not, a pipe with and without a reader, a
    device, a folder."""
    own, victim = tmp_path / "own.txt", tmp_path / "victim"
    for line in ("one\n", "two\n"):
        with files.open_in_place(own) as file:
            file.write(line)
    assert own.read_text() == "one\ntwo\n"
    victim.write_text("theirs")
    for target in (victim, tmp_path / "not there", Path("/dev/null")):
        link = tmp_path / "link"
        link.symlink_to(target)
        with pytest.raises(
            BadFileError, match=r"link is a link to elsewhere: remove it$"
        ):
            files.open_in_place(link)
        link.unlink()
    assert victim.read_text() == "theirs"
    assert not (tmp_path / "not there").exists()
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(OSError, match="No such device"):
        files.open_in_place(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    with pytest.raises(BadFileError, match="is a device or a pipe, not a file"):
        files.open_in_place(pipe)
    os.close(reader)
    with pytest.raises(BadFileError, match="is a folder, not a file"):
        files.open_in_place(tmp_path)


def test_a_file_that_takes_anothers_place_is_not_written_through_a_link(tmp_path):
    victim, path = tmp_path / "victim", tmp_path / "file"
    victim.write_text("theirs")
    path.symlink_to(victim)
    write_text(path, "ours")
    assert (path.read_text(), path.is_symlink(), victim.read_text()) == (
        "ours",
        False,
        "theirs",
    )
    (tmp_path / f".file.{os.getpid()}.tmp").symlink_to(victim)
    with pytest.raises(BadFileError, match="is a link to elsewhere"):
        write_text(path, "ours")
    assert victim.read_text() == "theirs"


def test_a_pipe_is_not_waited_for_and_a_file_without_an_end_is_not_read(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(BadFileError, match="is a device or a pipe, not a file"):
        files.read_bytes(pipe)
    link = tmp_path / "link"
    link.symlink_to("/dev/zero")
    with pytest.raises(BadFileError, match="is a device or a pipe, not a file"):
        files.read_bytes(link)
    with (tmp_path / "long").open("wb") as file:
        file.truncate(1 << 40)  # a terabyte of which nothing is on disk
    with pytest.raises(
        BadFileError, match=r"long has 1,099,511,627,776 bytes, 100 at most are read"
    ):
        files.read_bytes(tmp_path / "long", 100)
    with pytest.raises(BadFileError, match="cannot be read: embedded null byte"):
        files.read_bytes(Path("a\0b"))
