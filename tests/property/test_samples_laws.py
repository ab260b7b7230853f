"""Laws of the conversion: cutting does not matter, whatever the clocks do; and nothing that arrives can raise."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from made_telemetry import ROUNDING

from mavdiag.link.codec import Decoder, Encoder, Frame, frames_of
from mavdiag.link.messages import MavType, MessageId
from mavdiag.link.profiles import PROFILES, Evidence, detect_profile
from mavdiag.link.samples import SampleDecoder, SampleState, joined
from mavdiag.telemetry import Signal, Telemetry

EPOCH_US = 1_763_000_000_000_000
WRAP_US = 1 << 32


def flight(seed: int, epoch_imu: bool) -> list[Frame]:
    """Five seconds round the wrap of 32-bit microseconds: late frames, lost ones, a reboot; IMU maybe on unix time."""
    rng, encoder, decoder = np.random.default_rng(seed), Encoder(1, 1), Decoder()
    reboot, frames, host_ns = int(rng.integers(100, 400)), [], 10**18
    for k in range(500):
        boot_us = WRAP_US - 2_000_000 + 10_000 * k if k < reboot else 4_000_000 + 10_000 * (k - reboot)
        late_us = int(rng.integers(0, 3)) * 10_000
        host_ns += int(rng.integers(1_000_000, 19_000_000)) + (3_000_000_000 if k == reboot else 0)
        data = b""
        if rng.random() < 0.95:
            data += encoder.encode(MessageId.ATTITUDE_TARGET, (boot_us - late_us) // 1000, 0, (1.0, 0.1, 0.0, 0.0))
        stamp_us = EPOCH_US + 10_000 * k if epoch_imu else boot_us
        data += encoder.encode(MessageId.RAW_IMU, stamp_us, k, -k)
        if k % 7 == 0:
            data += encoder.encode(MessageId.SERVO_OUTPUT_RAW, boot_us % WRAP_US, 0, 1500)
        if k % 11 == 0:
            data += encoder.encode(MessageId.HEARTBEAT, MavType.QUADROTOR, 3, 128)
        frames += decoder.feed(data, host_ns)
    return frames


def two_paths(seed: int) -> list[Frame]:
    """A flight over two paths, the second up to 3 s behind, with a reboot that both show."""
    rng = np.random.default_rng(seed)
    behind_ns, frames = int(rng.integers(0, 3_000_000_000)), flight(seed, epoch_imu=False)
    late = [frame._replace(host_ns=frame.host_ns + behind_ns) for frame in frames]
    return sorted(frames + late, key=lambda frame: frame.host_ns)


def same(one: Telemetry, other: Telemetry) -> bool:
    return {s.signal for s in one.series} == {s.signal for s in other.series} and all(
        np.array_equal(series.t_ns, other.need(series.signal).t_ns)
        and np.array_equal(series.host_ns, other.need(series.signal).host_ns)
        and np.allclose(series.values, other.need(series.signal).values, rtol=0.0, atol=ROUNDING, equal_nan=True)
        for series in one.series
    )


def held(state: SampleState) -> tuple[bytes, bytes]:
    return state.timeline.words.tobytes(), state.memory.tobytes()


@given(st.integers(0, 10**6), st.booleans(), st.lists(st.integers(1, 300), min_size=1, max_size=8))
def test_how_frames_are_cut_does_not_matter(seed: int, epoch_imu: bool, sizes: list[int]) -> None:
    frames, converter = flight(seed, epoch_imu), SampleDecoder(PROFILES["qdrone2"])
    whole_state = SampleState()
    whole = converter.step(whole_state, frames)
    state, pieces, at, k = SampleState(), [], 0, 0
    while at < len(frames):
        size = sizes[k % len(sizes)]
        pieces.append(converter.step(state, frames[at : at + size]))
        at, k = at + size, k + 1
    assert held(state) == held(whole_state)
    assert state.timeline.reboots == 1
    assert same(joined(pieces), whole)


@settings(max_examples=30)
@given(st.integers(0, 10**6), st.integers(1, 300))
def test_b9_how_two_paths_are_cut_does_not_matter(seed: int, size: int) -> None:
    frames, converter = two_paths(seed), SampleDecoder(PROFILES["qdrone2"])
    whole_state = SampleState()
    whole = converter.step(whole_state, frames)
    state = SampleState()
    pieces = [converter.step(state, frames[k : k + size]) for k in range(0, len(frames), size)]
    assert held(state) == held(whole_state)
    assert same(joined(pieces), whole)


ids = st.sampled_from(sorted(frozenset().union(*(SampleDecoder(profile).wanted for profile in PROFILES.values()))))


@settings(max_examples=100)
@given(st.lists(ids, max_size=40), st.integers(0, 2**32))
def test_no_payload_raises(messages: list[int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    sizes = {msgid: len(Decoder().feed(Encoder(1, 1).encode(msgid), 0)[0].payload) for msgid in messages}
    hosts = np.sort(rng.integers(0, 1 << 62, len(messages))).tolist()
    frames = [Frame(m, 1, 1, 0, rng.bytes(sizes[m]), host_ns) for m, host_ns in zip(messages, hosts, strict=True)]
    for profile in PROFILES.values():
        state = SampleState()
        telemetry = SampleDecoder(profile).step(state, frames)
        assert state.dropped >= 0
        assert all(np.isfinite(s.values).all() for s in telemetry.series if s.signal is not Signal.ROTOR_SPEED)
    found, reason = detect_profile(Evidence().take(frames_of(frames)))
    assert (found is None) == (reason != "")
