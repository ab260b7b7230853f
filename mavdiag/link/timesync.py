"""TIMESYNC: what the vehicle's clock shows now, asked rarely and answered whenever the vehicle asks.

A request has tc1 = 0 and the sender's time in ts1; the answer repeats ts1 and has the answerer's time in tc1, both in
nanoseconds. The answer is read at a look at the link, so a round trip is known to within a tick, and the offset to
within half of it. It is shown and not used: stamps are laid over each other by `offsets`, which does better.

Message 111: https://mavlink.io/en/services/timesync.html
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

from mavdiag.link.codec import Frame, field_index
from mavdiag.link.messages import Component, MessageId
from mavdiag.units import NS_PER_S

EVERY_NS = 10 * NS_PER_S  # our choice: it is only a figure

_TC1, _TS1 = (field_index(MessageId.TIMESYNC, name) for name in ("tc1", "ts1"))


@dataclass(frozen=True, slots=True)
class TimesyncMessage:
    """One TIMESYNC to send. tc1_ns: our time in an answer, 0 in a request; ts1_ns: the asker's time."""

    tc1_ns: int
    ts1_ns: int


@dataclass(frozen=True, slots=True)
class Timesync:
    """What is known by it.

    asked_ns: when a request was sent last (host), None for never.
    open: it has not been answered.
    round_trip_s: of the latest answer; None if none came.
    offset_s: the vehicle's clock less ours at that time; None if none came.
    """

    asked_ns: int | None = None
    open: bool = False
    round_trip_s: float | None = None
    offset_s: float | None = None


def exchanged(
    state: Timesync, frames: Iterable[Frame], now_ns: int, *, alive: bool
) -> tuple[Timesync, tuple[TimesyncMessage, ...]]:
    """Read the autopilot's TIMESYNCs among its frames; returns what to send: at most one answer and one request.

    now_ns: on the host's clock. alive: the vehicle sent something, so that asking it makes sense.
    """
    wanted: int | None = None
    for frame in frames:
        if frame.msgid != MessageId.TIMESYNC or frame.compid != Component.AUTOPILOT1:
            continue
        fields = frame.fields
        tc1_ns, ts1_ns = int(fields[_TC1]), int(fields[_TS1])
        if tc1_ns == 0:
            wanted = ts1_ns
        elif state.open and ts1_ns == state.asked_ns:
            took_ns = max(0, frame.host_ns - ts1_ns)
            offset_s = (tc1_ns - ts1_ns - took_ns / 2) / NS_PER_S
            state = replace(state, open=False, round_trip_s=took_ns / NS_PER_S, offset_s=offset_s)
    answers = () if wanted is None else (TimesyncMessage(now_ns, wanted),)
    if not alive or (state.asked_ns is not None and now_ns - state.asked_ns < EVERY_NS):
        return state, answers
    return replace(state, asked_ns=now_ns, open=True), (*answers, TimesyncMessage(0, now_ns))
