"""Files are replaced only where that is safe, and every refusal is one line that says what to do."""

import os
import threading
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


@pytest.mark.parametrize(("umask", "mode"), [(0o022, 0o644), (0o077, 0o600), (0o002, 0o664)])
def test_a_new_file_has_the_users_mode_and_one_that_is_replaced_keeps_its_own(
    tmp_path: Path, umask: int, mode: int
) -> None:
    before = os.umask(umask)
    try:
        write_atomically(tmp_path / "new.json", "1")
        (tmp_path / "old.json").touch()
        (tmp_path / "old.json").chmod(0o640)
        write_atomically(tmp_path / "old.json", "2")
    finally:
        os.umask(before)
    assert (tmp_path / "new.json").stat().st_mode & 0o777 == mode
    assert (tmp_path / "old.json").stat().st_mode & 0o777 == 0o640


def test_writers_of_one_name_do_not_mix(tmp_path: Path) -> None:
    path = tmp_path / "kept.json"
    texts = [str(k) * 100_000 for k in range(4)]

    def write(text: str) -> None:
        for _ in range(10):
            write_atomically(path, text, durable=False)

    threads = [threading.Thread(target=write, args=(text,)) for text in texts]
    for one in threads:
        one.start()
    while any(one.is_alive() for one in threads):
        assert not path.exists() or path.read_text() in texts
    assert path.read_text() in texts
    assert [one.name for one in tmp_path.iterdir()] == ["kept.json"]
