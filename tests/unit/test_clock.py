"""Counters that wrap, restart, drift and disagree, seen as one vehicle's time, however they are cut; and TIMESYNC."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from mavdiag.jit import cached
from mavdiag.link.clock import (
    _BOOT_US_32,
    MS_32,
    NEVER,
    REBOOT,
    US_32,
    US_64,
    Counter,
    VehicleTime,
    stamp,
)
from mavdiag.telemetry import IntArray

Stream = tuple[Counter, IntArray, IntArray]  # counts and times of arrival [ns]


@cached
def _stamped(time: tuple[Any, Any, Any, Any], counters: IntArray, frames: IntArray, t_ns: IntArray) -> None:
    for k in range(frames.shape[1]):
        number, count, host_ns = frames[0, k], frames[1, k], frames[2, k]
        t_ns[k] = REBOOT
        while t_ns[k] == REBOOT:
            tick, turn = counters[number, 0], counters[number, 1]
            t_ns[k] = stamp(time, number, tick, turn, count, host_ns)


def taken(*streams: Stream, time: VehicleTime | None = None, size: int = 1 << 30) -> tuple[VehicleTime, list[IntArray]]:
    """The time after these streams, a message each, in order of arrival, and the time of each stamp or `NEVER`.

    size: stamps at a time.
    """
    counters = np.array([(c.tick_ns, c.turn) for c, _, _ in streams], np.int64)
    columns = [np.stack([np.full(len(raw), number), raw, host]) for number, (_, raw, host) in enumerate(streams)]
    frames: NDArray[Any] = np.concatenate(columns, axis=1)
    order = np.argsort(frames[2], kind="stable")
    time, times = time or VehicleTime(), np.empty(len(order), np.int64)
    for at in range(0, len(order), size):
        some = order[at : at + size]
        found = np.empty(len(some), np.int64)
        _stamped(time.records, counters, np.ascontiguousarray(frames[:, some]), found)
        times[some] = found
    ends = np.cumsum([len(raw) for _, raw, _ in streams])
    return time, np.split(times, ends[:-1])


S = 1_000_000_000
MS = 1_000_000
EPOCH_US = 1_763_000_000_000_000  # a day in November 2025


def ints(values: object) -> IntArray:
    return np.asarray(values, dtype=np.int64)


@pytest.mark.parametrize("size", [1, 3, 5, 7])
def test_a_wrap_is_undone_wherever_the_samples_are_cut(size: int) -> None:
    true = (1 << 32) - 5 + np.arange(10)
    _, (t_ns,) = taken((MS_32, true % (1 << 32), true * MS), size=size)
    assert t_ns.tolist() == (true * MS).tolist()


def test_a_message_that_changes_to_unix_time_is_laid_over_its_old_clock() -> None:
    true = np.arange(400) * 10 * MS
    raw = np.where(true < 2 * S, 5_000_000, EPOCH_US) + true // 1000
    time, (t_ns,) = taken((US_64, raw, 77 * S + true))
    assert t_ns[:200].tolist() == (5 * S + true[:200]).tolist()
    assert t_ns[200] == NEVER
    assert time.reboots == 0


def rebooted(silent_s: float, uptime_s: float, frames: int = 4) -> tuple[VehicleTime, IntArray]:
    """A vehicle that is up for 900 s, silent for so long, and then up for `uptime_s`."""
    later = np.arange(frames)
    raw = np.concatenate([[900_000], round(1000 * uptime_s) + 10 * later])
    host = np.concatenate([[5 * S], 5 * S + round(silent_s * S) + 10 * MS * later])
    time, (t_ns,) = taken((MS_32, raw, host))
    return time, t_ns


@pytest.mark.parametrize("turns", [0, 1, 2, 7])
@pytest.mark.parametrize("error_s", [-1800, 0, 1800])
def test_b7_the_turns_of_a_first_reading_are_chosen_by_the_time_since_boot(turns: int, error_s: int) -> None:
    true_us = turns * (1 << 32) + 2_000_000_000
    boot = (US_64, ints([true_us + error_s * 1_000_000]), ints([0]))
    time, _ = taken(boot, (US_32, ints([true_us % (1 << 32)]), ints([1])))
    lead = time.records[2][_BOOT_US_32]
    assert lead["first_ns"] == 1 - true_us * 1000


@pytest.mark.parametrize(
    ("silent_s", "uptime_s", "anew"),
    [(0.5, 0, False), (1.0, 0, True), (1.0, 11, True), (1.0, 12, False), (9.0, 500, False), (10.0, 500, True)],
)
def test_b9_a_vehicle_starts_anew_after_silence(silent_s: float, uptime_s: float, anew: bool) -> None:
    time, t_ns = rebooted(silent_s, uptime_s, 3)
    assert time.reboots == anew
    assert (t_ns > NEVER).tolist() == [True, False, False, anew]


def stream(seconds: float, rate_hz: int = 100) -> tuple[IntArray, IntArray]:
    """Counts [ms] and times of arrival [ns] of a steady stream, some milliseconds on the way."""
    true_ms = np.arange(round(seconds * rate_hz)) * 1000 // rate_hz
    way_ns = np.random.default_rng(5).integers(2, 9, len(true_ms)) * MS
    return 60_000 + true_ms, np.sort(77 * S + true_ms * MS + way_ns)


@pytest.mark.parametrize("ahead_ms", [300, 10_000, 25_000, 120_000, 3_600_000, 36_000_000])
@pytest.mark.parametrize("size", [1, 4, 10_000])
def test_a_stamp_that_leaps_is_left_out_and_the_stream_goes_on(ahead_ms: int, size: int) -> None:
    raw, host = stream(10.0)
    forged = np.arange(200, 1000, 20)
    mixed = (MS_32, np.insert(raw, forged, raw[forged] + ahead_ms), np.insert(host, forged, host[forged]))
    time, (t_ns,) = taken(mixed, size=size)
    assert t_ns[t_ns > NEVER].tolist() == (raw * MS).tolist()
    assert time.leaps == len(forged)


@pytest.mark.parametrize("size", [1, 7, 10_000])
def test_a_clock_that_was_set_is_followed_when_the_old_one_is_silent_for_a_second(size: int) -> None:
    raw, host = stream(10.0)
    raw[500:] += 40_000
    _, (t_ns,) = taken((MS_32, raw, host), size=size)
    kept = t_ns[t_ns > NEVER] // MS
    assert kept[:500].tolist() == raw[:500].tolist()
    assert 1.0 <= (kept[500] - raw[500]) / 1000 < 1.1
    assert kept[500:].tolist() == raw[-len(kept[500:]) :].tolist()


EPOCH_NS = 1_763_000_000 * S


class Link:
    """Two streams of one vehicle over a link with jitter and loss, and the true time of each sample that arrives.

    reference, other: counter, its time at the start [ns] and its drift [ppm]; step_ns: of the other, after 60 s.
    """

    def __init__(
        self,
        seed: int,
        reference: tuple[Counter, int, float],
        other: tuple[Counter, int, float],
        seconds: int,
        rate_hz: int = 50,
        jitter_ms: float = 4.0,
        loss: float = 0.05,
        step_ns: int = 0,
    ) -> None:
        rng, true = np.random.default_rng(seed), np.arange(seconds * rate_hz, dtype=np.int64) * (S // rate_hz)
        self.true, self.raw, self.host, self.counters = [], [], [], (reference[0], other[0])
        for k, (counter, start_ns, ppm) in enumerate((reference, other)):
            here = true[(rng.random(len(true)) >= loss) & (true >= k * S // 2)]  # the reference comes first
            clock_ns = start_ns + here + np.rint(here * ppm * 1e-6).astype(np.int64)
            clock_ns += np.where(here > 60 * S, k * step_ns, 0)
            raw = clock_ns // counter.tick_ns
            delay = 2_000_000 + rng.exponential(1e6 * jitter_ms, len(here)).astype(np.int64)
            self.true.append(here)
            self.raw.append(raw % counter.turn if counter.turn else raw)
            self.host.append(np.maximum.accumulate(77 * S + here + delay))

    def placed(self, size: int = 1 << 30) -> tuple[VehicleTime, IntArray, IntArray]:
        """The time after both streams, and the times of those samples of each that have one, taken in blocks."""
        streams = [(self.counters[k], self.raw[k], self.host[k]) for k in (0, 1)]
        time, times = taken(*streams, size=size)
        self.taken = [true[t_ns > NEVER] for true, t_ns in zip(self.true, times, strict=True)]
        reference, laid = (t_ns[t_ns > NEVER] for t_ns in times)
        return time, reference, laid

    def error_ns(self, start_ns: int, ppm: float, laid: IntArray) -> IntArray:
        """How far the other stream's samples lie from where the reference clock says that they were."""
        true = self.taken[1][-len(laid) :]
        error: IntArray = laid - (start_ns + true + np.rint(true * ppm * 1e-6).astype(np.int64))
        return error


@pytest.mark.parametrize("ppm", [-80.0, 50.0])
def test_a_drift_of_an_hour_is_followed(ppm: float) -> None:
    """50 ppm are 180 ms in an hour; a fixed offset was that wrong."""
    link = Link(11, (MS_32, 3 * S, 0.0), (US_64, EPOCH_NS, ppm), 3600)
    time, reference, laid = link.placed()
    error = link.error_ns(3 * S, 0.0, laid)
    assert np.abs(error).max() < 3_000_000
    assert np.abs(np.diff(laid - link.true[1][-len(laid) :])).max() < 100_000  # no jump
    assert time.drift_ppm == pytest.approx(ppm, abs=1.0)
    assert reference.tolist() == (3 * S + link.true[0]).tolist()  # the reference's own stamps stay


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.booleans(), st.floats(-200, 200), st.sampled_from([1, 7, 400]))
def test_how_drifting_clocks_are_cut_does_not_matter(seed: int, unix: bool, ppm: float, size: int) -> None:
    other = (US_64, EPOCH_NS if unix else 9000 * S, ppm)
    link = Link(seed, (MS_32, 3 * S, 0.0), other, 40)
    whole, cut = link.placed(), link.placed(size)
    assert whole[0].words.tolist() == cut[0].words.tolist()
    assert all(np.array_equal(a, b) for a, b in zip(whole[1:], cut[1:], strict=True))


@pytest.mark.parametrize("step_s", [-0.4, 0.3, 40.0])
def test_a_clock_that_is_set_is_laid_anew_within_seconds(step_s: float) -> None:
    """GPS or a network sets the unix time in flight: no drift explains it, and 5 s would take 10,000 s to slew."""
    link = Link(5, (MS_32, 3 * S, 0.0), (US_64, EPOCH_NS, 20.0), 120, step_ns=round(step_s * S))
    _, _, laid = link.placed()
    error = np.abs(link.error_ns(3 * S, 0.0, laid))
    true = link.taken[1][-len(laid) :]
    assert error[true > 65 * S].max() < 3_000_000
    assert error[true < 60 * S].max() < 3_000_000
