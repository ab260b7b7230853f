"""Counters that wrap, restart and disagree, seen as one vehicle timeline."""

from itertools import pairwise

import numpy as np
import pytest

from mavdiag.link.clock import MS_32, US_32, US_64, ClockReading, Counter, Run, unwrap
from mavdiag.link.timeline import OutOfLine, Timeline, out_of_line, place, rebooted
from mavdiag.telemetry import IntArray

S = 1_000_000_000
EPOCH_US = 1_763_000_000_000_000  # a day in November 2025


def ints(values: object) -> IntArray:
    return np.asarray(values, dtype=np.int64)


def run_of(counter: Counter, raw: object, host_ns: object) -> Run:
    return unwrap(counter, None, ints(raw), ints(host_ns))


@pytest.mark.parametrize("counter", [MS_32, US_32])
@pytest.mark.parametrize("split", [1, 3, 5, 7])
def test_a_wrap_is_undone_wherever_the_samples_are_cut(counter: Counter, split: int) -> None:
    true = (1 << 32) - 5 + np.arange(10)
    raw, host = true % (1 << 32), true * counter.tick_ns
    first = unwrap(counter, None, raw[:split], host[:split])
    second = unwrap(counter, first.reading, raw[split:], host[split:])
    assert np.concatenate([first.clock_ns, second.clock_ns]).tolist() == (true * counter.tick_ns).tolist()
    assert second.reading[:3] == (4, 1, int(host[-1]))


def test_a_late_frame_across_the_wrap_keeps_its_place() -> None:
    top = 1 << 32
    true = ints([top - 2, top, top - 1, top + 1])
    run = run_of(US_32, true % top, true * 1000)
    assert run.clock_ns.tolist() == (true * 1000).tolist()


def test_a_late_frame_is_no_reboot() -> None:
    run = run_of(MS_32, [10_000, 10_020, 10_010, 10_030], [0, 1, 2, 3])
    assert run.clock_ns.tolist() == [10_000_000_000, 10_020_000_000, 10_010_000_000, 10_030_000_000]


def test_a_reboot_breaks_the_run_off() -> None:
    run = run_of(MS_32, [90_000, 90_010, 4_000, 4_010], [0, 10**7, 5 * S, 5 * S + 10**7])
    assert run.clock_ns.tolist() == [90_000_000_000, 90_010_000_000]
    again = unwrap(MS_32, run.reading, ints([4_000, 4_010]), ints([5 * S, 5 * S + 10**7]))
    assert len(again.clock_ns) == 0
    assert again.reading == run.reading


def test_a_reboot_after_an_hour_is_not_taken_for_a_wrap() -> None:
    hour_us = 3_600_000_000  # the short way round the 71.6-minute counter leads forward by 11 minutes
    run = run_of(US_32, [hour_us, hour_us + 20_000, 5_000_000], [0, 20_000_000, 30 * S])
    assert len(run.clock_ns) == 2


def test_a_pause_that_the_receiver_saw_is_no_break_and_one_it_did_not_see_is() -> None:
    day_ms = 86_400_000
    assert len(run_of(MS_32, [0, day_ms], [0, 86_400 * S]).clock_ns) == 2
    assert len(run_of(MS_32, [0, day_ms], [0, S]).clock_ns) == 1


def test_a_change_to_unix_time_breaks_the_run_off() -> None:
    run = run_of(US_64, [5_000_000, 5_010_000, EPOCH_US], [0, 1, 2])
    assert len(run.clock_ns) == 2
    assert not run.on_epoch
    assert run_of(US_64, [EPOCH_US], [0]).on_epoch


def test_a_counter_full_of_garbage_stays_within_64_bits() -> None:
    raw = np.array([2**64 - 1, 0, 2**63], dtype=np.uint64).astype(np.int64)
    run = unwrap(US_64, None, raw, ints([0, 1, 2]))
    timeline, times = place(Timeline(), [run])
    assert timeline.t_ns is not None
    assert len(times[0]) == len(run.clock_ns) >= 1


def test_streams_since_boot_keep_their_stamps_exactly() -> None:
    setpoint = run_of(MS_32, [5_000, 5_005], [100 * S, 100 * S + 7])
    imu = run_of(US_64, [5_001_250, 5_002_250], [100 * S + 3, 100 * S + 9])
    timeline, times = place(Timeline(), [setpoint, imu])
    assert [t.tolist() for t in times] == [[5_000_000_000, 5_005_000_000], [5_001_250_000, 5_002_250_000]]
    assert timeline.t_ns == 5_005_000_000
    assert timeline.host_ns == 100 * S + 9


def delayed(seed: int) -> tuple[IntArray, IntArray]:
    """True times of 500 samples at 100 Hz, and when they arrive: 2 ms later plus an exponential delay of 4 ms."""
    true = np.arange(500) * 10_000_000
    jitter = np.random.default_rng(seed).exponential(4e6, 500).astype(np.int64)
    return true, np.maximum.accumulate(77 * S + true + 2_000_000 + jitter)


@pytest.mark.parametrize("pieces", [1, 4, 500])
def test_unix_stamps_are_laid_over_boot_stamps(pieces: int) -> None:
    true, host = delayed(1)
    _, other_host = delayed(2)
    boot_raw, epoch_raw = 3_000 + true // 1_000_000, EPOCH_US + true // 1000
    timeline, placed = Timeline(), []
    last: tuple[ClockReading | None, ClockReading | None] = (None, None)
    cuts = np.linspace(0, 500, pieces + 1).astype(int)
    for a, b in pairwise(cuts.tolist()):
        boot = unwrap(MS_32, last[0], boot_raw[a:b], host[a:b])
        epoch = unwrap(US_64, last[1], epoch_raw[a:b], other_host[a:b])
        last = (boot.reading, epoch.reading)
        timeline, times = place(timeline, [boot, epoch])
        assert times[0].tolist() == (3 * S + true[a:b]).tolist()
        placed.append(times[1])
    laid = np.concatenate(placed)
    assert 290 <= len(laid) <= 401  # the first one to two seconds are held back
    error = laid - (3 * S + true[-len(laid) :])
    assert np.ptp(error) < 50_000  # as more is known of the least delay, slewed
    assert np.abs(error).max() < 1_000_000  # 100 samples of each find the least delay to well under a millisecond


def test_time_goes_on_over_a_reboot() -> None:
    before = run_of(MS_32, [60_000, 60_010], [S, S + 10_000_000])
    timeline, _ = place(Timeline(), [before])
    after = run_of(MS_32, [2_000, 2_010], [6 * S, 6 * S + 10_000_000])
    timeline, times = place(rebooted(timeline), [after])
    assert times[0].tolist() == [60_010_000_000 + 5 * S - 10_000_000, 60_020_000_000 + 5 * S - 10_000_000]
    assert timeline.reboots == 1


def test_a_reboot_takes_a_second_at_least() -> None:
    timeline, _ = place(Timeline(), [run_of(MS_32, [60_000], [S])])
    _, times = place(rebooted(timeline), [run_of(MS_32, [0], [S])])
    assert times[0].tolist() == [61_000_000_000]


def test_a_clock_never_seen_together_with_another_is_the_timeline() -> None:
    _, times = place(Timeline(), [run_of(US_64, [EPOCH_US, EPOCH_US + 1], [0, 1])])
    assert times[0].tolist() == [EPOCH_US * 1000, EPOCH_US * 1000 + 1000]


@pytest.mark.parametrize("turns", [0, 1, 2, 7])
@pytest.mark.parametrize("error_s", [-1800, 0, 1800])
def test_b7_the_turns_of_a_first_reading_are_chosen_by_the_time_since_boot(turns: int, error_s: int) -> None:
    true_us = turns * (1 << 32) + 2_000_000_000
    since_boot_ns = true_us * 1000 + error_s * S
    run = unwrap(US_32, None, ints([true_us % (1 << 32)]), ints([0]), since_boot_ns)
    assert run.clock_ns.tolist() == [true_us * 1000]
    assert run.reading.turns == turns


def test_b9_what_is_out_of_line_while_others_go_on_is_left_out() -> None:
    raw, host = ints([10_000, 8_000, 10_010, 8_010, 90_000_000, 10_020]), ints(range(6)) * 10_000_000
    run = unwrap(MS_32, None, raw, host)
    assert (run.clock_ns // 1_000_000).tolist() == [10_000, 10_010, 10_020]
    assert run.used == 6
    assert run.kept is not None
    assert run.kept.tolist() == [True, False, True, False, False, True]


@pytest.mark.parametrize(
    ("silent_s", "uptime_s", "anew"),
    [(0.5, 0, False), (1.0, 0, True), (1.0, 11, True), (1.0, 12, False), (9.0, 500, False), (10.0, 500, True)],
)
def test_b9_a_vehicle_starts_anew_after_silence(silent_s: float, uptime_s: float, anew: bool) -> None:
    timeline, _ = place(Timeline(), [run_of(MS_32, [900_000], [5 * S])])
    found = []
    for k in range(3):
        raw, host_ns = int(1000 * uptime_s) + 10 * k, 5 * S + int(silent_s * S) + 10_000_000 * k
        timeline, what = out_of_line(timeline, MS_32, raw, host_ns)
        found.append(what)
    assert found == ([OutOfLine.RIVAL, OutOfLine.RIVAL, OutOfLine.REBOOT] if anew else [OutOfLine.STRAY] * 3)
    assert timeline.reboots == anew


def test_b9_stamps_that_do_not_agree_are_no_reboot() -> None:
    timeline, _ = place(Timeline(), [run_of(MS_32, [900_000], [5 * S])])
    for k, raw in enumerate((0, 5_000, 0, 5_000, 0, 5_000)):
        timeline, _ = out_of_line(timeline, MS_32, raw, 8 * S + 10_000_000 * k)
    assert timeline.reboots == 0


def stream(seconds: float, rate_hz: int = 100) -> tuple[IntArray, IntArray]:
    """Counts [ms] and times of arrival [ns] of a steady stream, some milliseconds on the way."""
    true_ms = np.arange(round(seconds * rate_hz)) * 1000 // rate_hz
    way_ns = np.random.default_rng(5).integers(2, 9, len(true_ms)) * 1_000_000
    return 60_000 + true_ms, 77 * S + true_ms * 1_000_000 + way_ns


@pytest.mark.parametrize("ahead_ms", [300, 10_000, 25_000, 120_000, 3_600_000, 36_000_000])
@pytest.mark.parametrize("size", [1, 4, 10_000])
def test_a_stamp_that_leaps_is_left_out_and_the_stream_goes_on(ahead_ms: int, size: int) -> None:
    raw, host = stream(10.0)
    forged = np.arange(200, 1000, 20)
    raw, host = np.insert(raw, forged, raw[forged] + ahead_ms), np.insert(host, forged, host[forged])
    last, kept, leaps = None, list[int](), 0
    for at in range(0, len(raw), size):
        run = unwrap(MS_32, last, raw[at : at + size], host[at : at + size])
        assert run.used == len(raw[at : at + size])
        last, leaps = run.reading, leaps + run.leaps
        kept += (run.clock_ns // 1_000_000).tolist()
    assert kept == stream(10.0)[0].tolist()
    assert leaps == len(forged)


@pytest.mark.parametrize("size", [1, 7, 10_000])
def test_a_clock_that_was_set_is_followed_when_the_old_one_is_silent_for_a_second(size: int) -> None:
    raw, host = stream(10.0)
    raw[500:] += 40_000
    last, kept = None, list[int]()
    for at in range(0, len(raw), size):
        run = unwrap(MS_32, last, raw[at : at + size], host[at : at + size])
        last = run.reading
        kept += (run.clock_ns // 1_000_000).tolist()
    assert kept[:500] == raw[:500].tolist()
    assert 1.0 <= (kept[500] - raw[500]) / 1000 < 1.1
    assert kept[500:] == raw[-len(kept[500:]) :].tolist()


def test_samples_that_waited_together_do_not_leap() -> None:
    raw, host = stream(10.0, 4)
    host[8:14] = host[13]  # nobody read for a second and a half
    assert run_of(MS_32, raw, host).kept is None
    whole = raw % 1000 == 0
    assert run_of(MS_32, raw, np.where(whole, host, host + 400_000_000)).kept is None  # less late now and then


def test_a_receiver_whose_clock_is_set_back_drops_nothing() -> None:
    raw, host = stream(10.0)
    host[500:] -= 7200 * S
    assert run_of(MS_32, raw, host).kept is None


def test_the_first_stamp_of_a_message_is_compared_with_the_others() -> None:
    raw, host = stream(2.0)
    lead_ns = int(host[0]) - 60_000_000_000
    ahead = unwrap(MS_32, None, np.concatenate([raw[:1] + 3_600_000, raw]), np.insert(host, 0, host[0]), None, lead_ns)
    assert ahead.clock_ns.tolist() == (raw * 1_000_000).tolist()
    assert ahead.leaps == 1
    own = unwrap(MS_32, None, raw + 3_600_000, host, None, lead_ns)  # a clock of its own, which goes on
    assert len(own.clock_ns) >= 90
