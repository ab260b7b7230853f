"""Which messages go out on one link, and when: each at its own rate, changed by SET_MESSAGE_INTERVAL."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from mavdiag.link.messages import MavResult
from mavdiag.telemetry import IntArray

LONGEST_US = 2**31 - 1  # that MESSAGE_INTERVAL can tell
DEFAULT_INTERVAL, NEVER = 0, -1  # what SET_MESSAGE_INTERVAL means by these two intervals


@dataclass(slots=True)
class _Beat:
    """One message's rhythm: beats at origin + k period. A period of 0 is silence."""

    default_ns: int
    period_ns: int
    origin_ns: int = 0
    beats: int = 0

    def rows(self, t_ns: IntArray) -> IntArray:
        """The first sample at or after each beat; several beats between two samples give one row."""
        beats = (int(t_ns[-1]) - self.origin_ns) // self.period_ns + 1
        if beats == self.beats:
            return np.empty(0, dtype=np.int64)
        passed = np.empty(len(t_ns) + 1, dtype=np.int64)  # beats so far: before the block, and at each of its samples
        passed[0], passed[1:] = self.beats, (t_ns - self.origin_ns) // self.period_ns + 1
        self.beats = beats
        return np.flatnonzero(passed[1:] > passed[:-1])


class Schedule:
    """The rhythm of every message that a link can carry. Time is the vehicle's.

    rates_hz: the messages and their default rates, 0 for those that come only on request. ceiling_hz: a faster rhythm
    than this is denied. whole_ms: what is asked for is cut to whole milliseconds. attained_hz: a faster rhythm that is
    asked for is granted, and comes as this one; None if all are met.
    """

    def __init__(
        self, rates_hz: Mapping[int, float], ceiling_hz: float, whole_ms: bool = False, attained_hz: float | None = None
    ) -> None:
        periods = {msgid: round(1e9 / rate) if rate > 0 else 0 for msgid, rate in rates_hz.items()}
        self._beats = {msgid: _Beat(period, period) for msgid, period in periods.items()}
        self._shortest_us = 1e6 / ceiling_hz
        self._grain_us, self._attained_us = (1e3 if whole_ms else 0.0), (1e6 / attained_hz if attained_hz else 0.0)
        self._once: set[int] = set()
        self._now_ns = 0

    def set_interval(self, msgid: int, interval_us: float) -> MavResult:
        """Answer SET_MESSAGE_INTERVAL: an interval [us], `DEFAULT_INTERVAL` or `NEVER`.

        Denied, as ArduPilot does: a message that is not carried, and a rate above the ceiling.
        """
        beat = self._beats.get(msgid)
        if beat is None or (interval_us > 0 and interval_us < self._shortest_us * 0.999):
            return MavResult.DENIED
        if interval_us > 0:
            whole_us = interval_us // self._grain_us * self._grain_us if self._grain_us else interval_us
            interval_us = min(max(whole_us, self._attained_us), LONGEST_US)
        wanted_ns = beat.default_ns if interval_us == DEFAULT_INTERVAL else max(0, round(interval_us * 1e3))
        beat.period_ns, beat.origin_ns, beat.beats = wanted_ns, self._now_ns + 1, 0
        return MavResult.ACCEPTED

    def set_stream(self, messages: Collection[int], rate_hz: float) -> None:
        """Obey REQUEST_DATA_STREAM: carried messages get this rate, or the ceiling; 0 is silence."""
        interval_us = max(1e6 / rate_hz, self._shortest_us) if rate_hz > 0 else NEVER
        for msgid in self._beats.keys() & set(messages):
            self.set_interval(msgid, interval_us)

    def interval_us(self, msgid: int) -> int:
        """The content of MESSAGE_INTERVAL: the interval, `NEVER` if silent, 0 if the message is not carried."""
        beat = self._beats.get(msgid)
        if beat is None:
            return 0
        return beat.period_ns // 1000 if beat.period_ns else NEVER

    def ask_once(self, msgid: int) -> MavResult:
        """Answer REQUEST_MESSAGE: the message comes once with the next block, whatever its rhythm."""
        if msgid not in self._beats:
            return MavResult.DENIED
        self._once.add(msgid)
        return MavResult.ACCEPTED

    def due(self, t_ns: IntArray) -> list[tuple[int, IntArray]]:
        """For a block of sample times (n >= 1, increasing): each message that is due, and the rows it is made from."""
        self._now_ns = int(t_ns[-1])
        due = [(msgid, beat.rows(t_ns)) for msgid, beat in self._beats.items() if beat.period_ns]
        seen = {msgid for msgid, rows in due if len(rows)}
        due += [(msgid, np.array([len(t_ns) - 1])) for msgid in sorted(self._once - seen)]
        self._once.clear()
        return [(msgid, rows) for msgid, rows in due if len(rows)]
