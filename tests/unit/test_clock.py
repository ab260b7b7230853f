"""Counters that wrap, restart and disagree, seen as one vehicle's time."""

import numpy as np
import pytest
from made_stamps import taken

from mavdiag.link.clock import MS_32, NEVER, US_32, US_64, Clock, VehicleTime
from mavdiag.telemetry import IntArray

S, MS = 1_000_000_000, 1_000_000
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
    lead = time.records[2][Clock.BOOT_US_32]
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


def test_the_first_stamp_of_a_message_is_compared_with_the_others() -> None:
    raw, host = stream(2.0)
    other = (MS_32, raw, host)
    ahead = (MS_32, np.concatenate([raw[:1] + 3_600_000, raw]), np.insert(host, 0, host[0]) + 1)
    time, (_, t_ns) = taken(other, ahead)
    assert t_ns.tolist() == [NEVER, *(raw * MS).tolist()]
    assert time.leaps == 1
