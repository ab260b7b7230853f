"""Laws of the offsets between clocks: drift is followed without jumps or jitter, however the samples are cut."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_stamps import taken

from mavdiag.link.clock import MS_32, NEVER, US_64, Counter, VehicleTime
from mavdiag.telemetry import IntArray

S = 1_000_000_000
EPOCH_NS = 1_763_000_000 * S
TURN_MS = 1 << 32


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
    assert whole[0] == cut[0]
    assert all(np.array_equal(a, b) for a, b in zip(whole[1:], cut[1:], strict=True))


@pytest.mark.parametrize("ppm", [0.0, 15.0])
def test_clocks_that_start_together_are_one_and_keep_their_stamps(ppm: float) -> None:
    link = Link(3, (MS_32, 3 * S, 0.0), (US_64, 3 * S + 250_000, ppm), 300)
    _, _, laid = link.placed()
    assert laid.tolist() == (link.raw[1] * 1000).tolist()


@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("turns", [1, 3])
def test_a_vehicle_that_is_up_for_longer_than_49_days_has_one_clock(first: int, turns: int) -> None:
    up_ns = turns * TURN_MS * 1_000_000 + 12_345_000_000
    streams = [(MS_32, up_ns, 0.0), (US_64, up_ns, 0.0)]
    link = Link(3, streams[first], streams[1 - first], 20)
    _, reference, laid = link.placed()
    own_ns = up_ns if first else 12_345_000_000
    assert reference[0] == own_ns + link.true[0][0]
    assert laid.tolist() == (own_ns + link.true[1][-len(laid) :]).tolist()


@pytest.mark.parametrize("step_s", [-0.4, 0.3, 40.0])
def test_a_clock_that_is_set_is_laid_anew_within_seconds(step_s: float) -> None:
    """GPS or a network sets the unix time in flight: no drift explains it, and 5 s would take 10,000 s to slew."""
    link = Link(5, (MS_32, 3 * S, 0.0), (US_64, EPOCH_NS, 20.0), 120, step_ns=round(step_s * S))
    _, _, laid = link.placed()
    error = np.abs(link.error_ns(3 * S, 0.0, laid))
    true = link.taken[1][-len(laid) :]
    assert error[true > 65 * S].max() < 3_000_000
    assert error[true < 60 * S].max() < 3_000_000
