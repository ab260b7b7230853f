"""Learning with flights put aside: the same baseline from memory and from disk, and few rows in memory at a time."""

import errno
import io
import json
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flying_telemetry import flying, without
from hypothesis import given, settings
from hypothesis import strategies as st
from made_baselines import FRAME, NOW, healthy

from mavdiag.baseline import Baseline, dump
from mavdiag.errors import UsageError
from mavdiag.learning import LearnOptions, learn
from mavdiag.learning.learn import extend
from mavdiag.storage import Shelf
from mavdiag.telemetry import Log

OPTIONS = LearnOptions(airframe=FRAME)
ARRAYS = (
    np.arange(12.0).reshape(4, 3),
    np.array([True, False, True]),
    np.empty((0, 3)),
    np.arange(7, dtype=np.int64)[::2],
    np.full((20, 2), np.nan),
)


def assert_alike(found: Any, expected: Any) -> None:
    """Equal, but for rounding: numpy's sums may depend on where an array begins, above AVX2 they do."""
    if isinstance(expected, Baseline):
        found, expected = (json.loads(dump(one)) | {"digest": ""} for one in (found, expected))
    if isinstance(expected, dict):
        assert found.keys() == expected.keys()
        found, expected = list(found.values()), list(expected.values())
    if isinstance(expected, list):
        assert len(found) == len(expected)
        for part, other in zip(found, expected, strict=True):
            assert_alike(part, other)
    else:
        assert found == (pytest.approx(expected, rel=1e-6, abs=1e-9) if isinstance(expected, float) else expected)


def on_disk(make: Callable[[], Baseline]) -> Baseline:
    """What is learnt if nothing may stay in memory."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mavdiag.storage.SHELF_BYTES", 0)
        return make()


@settings(max_examples=3)
@given(seed=st.integers(0, 99), count=st.integers(1, 4), gap_s=st.sampled_from([0.0, 0.1, 2.0]))
def test_on_disk_the_same_is_learnt_and_extended(seed: int, count: int, gap_s: float) -> None:
    def made(first: int) -> Iterator[Log]:
        for i in range(first, first + count):
            telemetry = without(flying(2000, 10 * seed + i), (12.0, 12.0 + gap_s))
            yield Log(f"f{i}", f"{i:064x}", "px4", telemetry)

    in_memory = learn(list(made(0)), OPTIONS, created=NOW)
    assert_alike(on_disk(lambda: learn(made(0), OPTIONS, created=NOW)), in_memory)
    assert len(in_memory.monitors) >= 9
    for new in (False, True):
        make = partial(extend, in_memory, new_propellers=new, created=NOW)
        assert_alike(on_disk(lambda make=make: make(made(20))), make(list(made(20))))  # type: ignore[misc]


def test_what_robust_teaching_leaves_out_is_left_out_on_disk_too() -> None:
    flights = healthy(4)
    crash = flying(2600, 9)
    (gyro,) = (one for one in crash.series if one.signal == "body_rate")
    gyro.values[2000:2100] += 20.0
    flights = [*flights, flights[1], Log("crash", "9" * 64, "px4", crash)]
    options = LearnOptions(airframe=FRAME, monitors=("innovation", "rotor_trim"), robust=True)
    found = on_disk(lambda: learn(iter(flights), options, created=NOW))
    assert_alike(found, learn(flights, options, created=NOW))
    assert len(found.provenance.left_out) == 2


@pytest.mark.parametrize("most_bytes", [0, 1 << 20])
def test_what_was_put_aside_comes_back_as_often_as_it_is_asked(most_bytes: int) -> None:
    with Shelf(most_bytes) as shelf:
        kept = [(shelf.put(arrays), arrays) for arrays in (ARRAYS, ARRAYS[::-1], ())]
        for get, arrays in (*kept, *kept):
            for found, expected in zip(get(), arrays, strict=True):
                assert (found.dtype, found.shape) == (expected.dtype, expected.shape)
                np.testing.assert_array_equal(found, expected)
        outlives = kept[0][0]()
    np.testing.assert_array_equal(outlives[0], ARRAYS[0])
    if not most_bytes:
        with pytest.raises(ValueError, match="read-only"):
            outlives[0][0, 0] = 1.0


def test_nothing_is_left_in_the_temporary_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with Shelf(0) as shelf:
        shelf.put(ARRAYS)
        assert list(tmp_path.iterdir()) == []  # not even while it is open


def test_a_full_disk_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    class Full(io.BytesIO):
        def write(self, _: object) -> int:
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(tempfile, "TemporaryFile", lambda **_: Full())
    with Shelf(0) as shelf, pytest.raises(UsageError, match=r"No space left on device.*set TMPDIR"):
        shelf.put(ARRAYS)


def test_arrays_that_begin_at_one_place_are_not_taken_for_one() -> None:
    square = np.arange(9.0).reshape(3, 3)
    with Shelf(0) as shelf:
        first, turned, bits = shelf.put([square, square.T, square.view(np.int64)])()
        np.testing.assert_array_equal(first, square)
        np.testing.assert_array_equal(turned, square.T)
        np.testing.assert_array_equal(bits, square.view(np.int64))
