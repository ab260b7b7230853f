"""TIMESYNC: asked rarely, answered always, and what came of it."""

import pytest

from mavdiag.link.clock import Timesync, exchanged
from mavdiag.link.codec import Decoder, Encoder, Frame
from mavdiag.link.messages import MessageId

S = 1_000_000_000


def timesync(tc1_ns: int, ts1_ns: int, host_ns: int, compid: int = 1) -> Frame:
    [frame] = Decoder().feed(Encoder(1, compid).encode(MessageId.TIMESYNC, tc1_ns, ts1_ns), host_ns)
    return frame


def test_the_round_trip_follows_from_the_answer() -> None:
    state, _ = exchanged(Timesync(), (), 100 * S, alive=True)
    answer = timesync(5 * S + 10_000_000, 100 * S, 100 * S + 30_000_000)
    state, messages = exchanged(state, (answer, answer), 100 * S + 30_000_000, alive=True)
    assert state.round_trip_s == pytest.approx(0.03)
    assert messages == ()
