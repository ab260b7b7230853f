"""Learning with flights put aside: the same baseline, and one flight in memory at a time."""

import gc
import json
import weakref
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
import pytest
from flying_telemetry import flying, flying_rows, without
from hypothesis import given, settings
from hypothesis import strategies as st
from made_baselines import FRAME, NOW, healthy

from mavdiag.airframe.detect import detect_layout
from mavdiag.airframe.layout import LAYOUTS
from mavdiag.baseline import Baseline, dump
from mavdiag.learning import LearnOptions, learn
from mavdiag.learning import held as held_module
from mavdiag.learning.extend import extend
from mavdiag.learning.flights import airborne, airborne_of, front_for
from mavdiag.learning.held import HeldRows, held
from mavdiag.rows.align import USED
from mavdiag.rows.block import COLUMNS
from mavdiag.storage import Shelf
from mavdiag.telemetry import Log
from mavdiag.units import NS_PER_S

OPTIONS = LearnOptions(airframe=FRAME)


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


def on_disk(monkeypatch: pytest.MonkeyPatch, make: Callable[[], Baseline]) -> Baseline:
    """What is learnt if nothing may stay in memory."""
    with monkeypatch.context() as patch:
        patch.setattr("mavdiag.storage.SHELF_BYTES", 0)
        return make()


@settings(max_examples=3)
@given(seed=st.integers(0, 99), count=st.integers(1, 4), gap_s=st.sampled_from([0.0, 0.1, 2.0]))
def test_on_disk_the_same_is_learnt(seed: int, count: int, gap_s: float) -> None:
    def made() -> Iterator[Log]:
        for i in range(count):
            telemetry = without(flying(2000, 10 * seed + i), (12.0, 12.0 + gap_s))
            yield Log(f"f{i}", f"{i:064x}", "px4", telemetry)

    in_memory = learn(list(made()), OPTIONS, created=NOW)
    with pytest.MonkeyPatch.context() as patch:
        assert_alike(on_disk(patch, lambda: learn(made(), OPTIONS, created=NOW)), in_memory)
    assert len(in_memory.monitors) >= 9


def test_what_robust_teaching_leaves_out_is_left_out_on_disk_too(monkeypatch: pytest.MonkeyPatch) -> None:
    flights = healthy(4)
    crash = flying(2600, 9)
    (gyro,) = (one for one in crash.series if one.signal == "body_rate")
    gyro.values[2000:2100] += 20.0
    flights = [*flights, flights[1], Log("crash", "9" * 64, "px4", crash)]
    options = LearnOptions(airframe=FRAME, monitors=("innovation", "rotor_trim"), robust=True)
    expected = learn(flights, options, created=NOW)
    found = on_disk(monkeypatch, lambda: learn(iter(flights), options, created=NOW))
    assert_alike(found, expected)
    assert len(found.provenance.left_out) == 2


def test_a_baseline_is_extended_from_disk_to_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    before = learn(healthy(2), OPTIONS, created=NOW)
    later = 1_777_600_000 * NS_PER_S
    more = [Log(f"m{i}", f"{50 + i:064x}", "px4", flying(2600, 300 + i), started_ns=later) for i in range(2)]
    for new in (False, True):
        make = partial(extend, before, new_propellers=new, created=NOW)
        assert_alike(on_disk(monkeypatch, partial(make, iter(more))), make(more))


def test_a_held_flight_has_the_rows_of_the_flight() -> None:
    log = Log("f", "", "px4", without(flying(2000, 3), (5.0, 8.0)))
    front = front_for([log], 0.1)
    with Shelf(0) as shelf:
        aside = held(log, shelf)
        back = aside.open()
        assert {one.signal for one in back.telemetry} == {one.signal for one in log.telemetry} & USED
        expected, found = airborne(front, log), airborne_of(front, aside, shelf)
        assert found.judged_s == expected.judged_s
        assert len(found.rows) == len(expected.rows)
        for one, other in zip(found.rows, expected.rows, strict=True):
            for name in COLUMNS:
                np.testing.assert_array_equal(getattr(one.block, name), getattr(other.block, name))
            np.testing.assert_array_equal(one.rates.u, other.rates.u)
            assert (one.block.segment, one.rates.dt_s) == (other.block.segment, other.rates.dt_s)
        assert isinstance(found.rows, HeldRows)
        turned = found.rows.by_rotor((2, 1, 3, 4))[0].block.actuator
        np.testing.assert_array_equal(turned[:, :2], found.rows[0].block.actuator[:, 1::-1])
        assert [len(one.block) for one in found.rows[:1]] == [len(expected.rows[0].block)]


def test_one_flight_s_signals_are_in_memory_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    alive: list[weakref.ref[Any]] = []
    most = 0

    def flights() -> Iterator[Log]:
        nonlocal most
        for i in range(4):
            telemetry = flying(2000, i)
            alive.append(weakref.ref(telemetry.series[1].values))
            most = max(most, sum(one() is not None for one in alive))
            yield Log(f"f{i}", f"{i:064x}", "px4", telemetry)
            del telemetry
            gc.collect()

    on_disk(monkeypatch, lambda: learn(flights(), OPTIONS, created=NOW))
    assert most <= 2  # the one that is taken in, and the next


def test_few_flights_rows_are_in_memory_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    alive: dict[int, list[weakref.ref[Any]]] = {}
    most = 0

    def watched(self: Any, outputs: tuple[int, ...] | None, make: Any) -> Any:
        nonlocal most
        rows = make(self, outputs)
        alive.setdefault(id(self), []).append(weakref.ref(rows.block.rate))
        flights = [one for one, looks in alive.items() if any(look() is not None for look in looks)]
        most = max(most, len(flights))
        return rows

    make = held_module._Chunk.rows
    monkeypatch.setattr(held_module._Chunk, "rows", lambda self, outputs: watched(self, outputs, make))
    on_disk(monkeypatch, lambda: learn(healthy(5), OPTIONS, created=NOW))
    assert len(alive) >= 5
    assert most <= 4  # two chunks for a flight, of the one that is looked at and of the next


def test_layouts_are_found_from_blocks_that_come_once() -> None:
    blocks = [rows.block for rows in flying_rows(flying(3000, 4))]
    known = tuple(LAYOUTS.values())
    assert detect_layout(iter(blocks), known) == detect_layout(blocks, known)
    assert detect_layout(iter(blocks), known).layout == LAYOUTS["x"]
