"""Files are replaced only where that is safe, and every refusal is one line that says what to do."""

import os
from pathlib import Path

import pytest

from mavdiag.errors import InputError, UsageError
from mavdiag.storage import check_output, read_text, write_atomically


def test_r5_nothing_but_a_regular_file_is_replaced(tmp_path: Path) -> None:
    target, link, pipe = tmp_path / "target", tmp_path / "link", tmp_path / "pipe"
    target.write_text("kept")
    link.symlink_to(target)
    os.mkfifo(pipe)
    for path, kind in ((Path(os.devnull), "not a regular file"), (link, "symbolic link"), (pipe, "not a regular")):
        with pytest.raises(UsageError, match=kind):
            write_atomically(path, "text")
    assert link.is_symlink()
    assert pipe.is_fifo()
    assert target.read_text() == "kept"
    assert Path(os.devnull).is_char_device()


def test_r4_a_folder_is_called_a_folder(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="is a folder; name a file"):
        write_atomically(tmp_path, "text")
    with pytest.raises(InputError, match="is a folder; name a file"):
        read_text(tmp_path)
    with pytest.raises(UsageError, match="there is no folder"):
        check_output(tmp_path / "absent" / "b.json")


def test_a_file_is_replaced_whole_and_nothing_is_left_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "b.json"
    for text in ("first", "second"):
        write_atomically(path, text)
        assert read_text(path) == text
    assert [one.name for one in tmp_path.iterdir()] == ["b.json"]


def test_what_is_no_text_is_refused(tmp_path: Path) -> None:
    (tmp_path / "b").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not UTF-8"):
        read_text(tmp_path / "b")
    with pytest.raises(InputError, match="no such file"):
        read_text(tmp_path / "absent")
