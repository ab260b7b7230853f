"""Files that grow: rotation keeps whole entries and a bounded number of files, and alerts are written through."""

import os
from pathlib import Path

import pytest

from detector.journal import MB, Appender, Journal
from mavdiag.errors import UsageError


def appender(path: Path, limit: int, keep: int) -> tuple[Appender, list[str]]:
    said: list[str] = []
    return Appender(path, "--journal", said.append, None if limit is None else limit / MB, keep), said


def test_a_file_that_is_full_is_numbered_and_so_are_those_before(tmp_path: Path) -> None:
    file, said = appender(tmp_path / "j.jsonl", limit=10, keep=2)
    for number in range(6):
        file.append(f"line{number}\n".encode())  # 6 bytes: one in each file
    file.close()
    found = {path.name: path.read_text() for path in tmp_path.iterdir()}
    assert found == {"j.jsonl": "line5\n", "j.1.jsonl": "line4\n", "j.2.jsonl": "line3\n"}
    assert said == []


def test_a_rotation_that_fails_half_way_is_told_once_and_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, said = appender(tmp_path / "j", limit=4, keep=1)
    file.append(b"old.")

    def full(path: Path, *args: object, **kwargs: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "open", full)
        file.append(b"lost")
        file.append(b"lost")
    file.append(b"new.")
    file.close()
    assert file.lost == 2
    assert [one.partition("j: ")[2] for one in said] == [
        "cannot be written (No space left on device); watching goes on without it",
        "writing again; 2 entries were lost",
    ]
    assert (tmp_path / "j").read_bytes() == b"new."
    assert (tmp_path / "j.1").read_bytes() == b"old."


def test_alerts_are_written_through_to_the_disk_once_a_look(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    journal = Journal(tmp_path / "j", warn=lambda text: None)
    calls: list[int] = []
    monkeypatch.setattr(os, "fsync", calls.append)
    for alerts, synced in ((0, 0), (2, 1), (0, 1)):
        journal.write("a note")
        for _ in range(alerts):
            journal.write("an alarm", urgent=True)
        journal.flush()
        assert len(calls) == synced
    journal.close()


def test_a_pipe_whose_reader_stops_loses_entries_and_never_waits(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    file, said = appender(tmp_path / "pipe", limit=10, keep=0)
    for _ in range(300):
        file.append(b"x" * 1000)
    assert len(os.read(reader, 1 << 20)) + 1000 * file.lost >= 300_000
    assert file.lost > 200
    file.append(b"again")
    os.close(reader)
    file.append(b"nobody is there")
    file.close()
    assert [("cannot" in one, "again" in one) for one in said] == [(True, False), (False, True), (True, False)]


def test_a_file_has_one_writer_through_all_rotations(tmp_path: Path) -> None:
    first, _ = appender(tmp_path / "j.jsonl", limit=10, keep=2)
    for number in range(4):
        with pytest.raises(UsageError, match="another program writes it"):
            appender(tmp_path / "j.jsonl", limit=10, keep=2)
        first.append(f"line{number}\n".encode())
    first.close()
    second, _ = appender(tmp_path / "j.jsonl", limit=10, keep=2)
    second.close()
