"""Arrays that are put aside: in memory while they are few, in a file without a name beyond that."""

import errno
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mavdiag.errors import UsageError
from mavdiag.storage import Shelf

ARRAYS = (
    np.arange(12.0).reshape(4, 3),
    np.array([True, False, True]),
    np.empty((0, 3)),
    np.arange(7, dtype=np.int64)[::2],
    np.full((2, 2), np.nan),
)


def same(found: tuple[np.ndarray[Any, Any], ...], expected: tuple[np.ndarray[Any, Any], ...]) -> None:
    for one, other in zip(found, expected, strict=True):
        assert (one.dtype, one.shape) == (other.dtype, other.shape)
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("most_bytes", [0, 1 << 20])
def test_what_was_put_aside_comes_back_as_often_as_it_is_asked(most_bytes: int) -> None:
    with Shelf(most_bytes) as shelf:
        first, second = shelf.put(ARRAYS), shelf.put(ARRAYS[::-1])
        for _ in range(2):
            same(first.get(), ARRAYS)
            same(second.get(), ARRAYS[::-1])


def test_arrays_of_the_file_cannot_be_written_to_and_outlive_the_shelf() -> None:
    with Shelf(0) as shelf:
        found = shelf.put(ARRAYS).get()
    with pytest.raises(ValueError, match="read-only"):
        found[0][0, 0] = 1.0
    same(found, ARRAYS)


def test_empty_arrays_alone_take_no_place() -> None:
    with Shelf(-1) as shelf:
        same(shelf.put((np.empty((0, 2)),)).get(), (np.empty((0, 2)),))


def test_the_same_array_twice_takes_one_place() -> None:
    big = np.arange(100_000.0)
    with Shelf(0) as shelf:
        kept = shelf.put((big, big))
        same(kept.get(), (big, big))
        assert kept.length < 1.5 * big.nbytes


def test_nothing_is_left_in_the_temporary_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    shelf = Shelf(0)
    kept = shelf.put(ARRAYS)
    assert list(tmp_path.iterdir()) == []  # not even while it is open
    same(kept.get(), ARRAYS)
    shelf.close()


def test_a_full_disk_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    class Full:
        def write(self, _: memoryview) -> int:
            raise OSError(errno.ENOSPC, "No space left on device")

        def close(self) -> None:
            """Nothing to close."""

    monkeypatch.setattr(tempfile, "TemporaryFile", lambda **_: Full())
    with Shelf(0) as shelf, pytest.raises(UsageError, match=r"No space left on device.*set TMPDIR"):
        shelf.put(ARRAYS)
