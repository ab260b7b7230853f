"""Alarms of one monitor: stretches of judged time in which its statistic is strictly above its threshold.

An event opens at the first such value, so its start is the time of detection. It closes when the statistic has come
back and stayed there for `clear_s`; what happens within that time belongs to the same event. The end of a flight closes
it too.
"""

from dataclasses import dataclass, replace

from mavdiag.monitors.base import FaultKind
from mavdiag.rows.statistic import Statistic
from mavdiag.rows.windows import spans
from mavdiag.telemetry import Axis
from mavdiag.units import NS_PER_S

__all__ = ["Event", "EventSpec", "EventState"]


@dataclass(frozen=True, slots=True)
class Event:
    """One alarm of one monitor. Times are of the vehicle's clock.

    monitor, axis: whose alarm it is; axis is None where it concerns the whole vehicle.
    start_ns: first value above the threshold.
    end_ns: last value above it; None while it lasts, or if the data ended first.
    statistic, level: the highest so far.
    threshold: in the statistic's unit.
    rotor: from 1; None while unknown.
    fault_type, severity: "F1" to "F3" and 1 to 3 (T Tables 3.1, 3.2); None while unknown.
    confidence: of the rotor, 0..1.
    kind: of the fault that the alarm belongs to, None while it belongs to none.
    """

    monitor: str
    axis: Axis | None
    start_ns: int
    end_ns: int | None
    statistic: float
    threshold: float
    level: float
    rotor: int | None = None
    fault_type: str | None = None
    severity: int | None = None
    confidence: float | None = None
    kind: FaultKind | None = None

    def __str__(self) -> str:
        """One line for a person.

        >>> print(Event("rotor_trim", None, 19_970_000_000, None, 0.363, 0.145, 0.363, rotor=3))
        rotor_trim 0.363 > 0.145 from 19.97 s, rotor 3
        """
        axis = f" {self.axis}" if self.axis is not None else ""
        end = "" if self.end_ns is None else f" to {self.end_ns / NS_PER_S:.2f} s"
        where = "" if self.rotor is None else f", rotor {self.rotor}"
        start = f"from {self.start_ns / NS_PER_S:.2f} s"
        return f"{self.monitor}{axis} {self.statistic:.3g} > {self.threshold:.3g} {start}{end}{where}"


@dataclass(frozen=True, slots=True)
class EventState:
    """The event that is open, if any.

    above_ns: time of the last value above the threshold.
    touching: whether that was the last value seen.
    """

    open: Event | None = None
    above_ns: int = 0
    touching: bool = False


@dataclass(frozen=True, slots=True)
class EventSpec:
    """Whose events these are, and when one opens and closes."""

    monitor: str
    axis: Axis | None
    threshold: float
    clear_s: float = 0.0

    def step(self, state: EventState, found: Statistic) -> tuple[EventState, tuple[Event, ...]]:
        """Take the next values; return the events that opened (end_ns None) or closed, in order of time.

        >>> import numpy as np
        >>> t, x = np.arange(5) * 1000, np.array([0.0, 3.0, 4.0, 1.0, 1.0])
        >>> found = Statistic(t, 1e-6, x, np.ones(5, dtype=bool), x, x)
        >>> state, seen = EventSpec("fsd", Axis.ROLL, threshold=2.0).step(EventState(), found)
        >>> [(e.start_ns, e.end_ns, e.statistic) for e in seen]
        [(1000, None, 3.0), (1000, 2000, 4.0)]
        """
        if len(found) == 0:
            return state, ()
        above = found.valid & (found.value > self.threshold)
        seen: list[Event] = []
        for first, stop in spans(above):
            if first or not state.touching:
                state, closed = self._close(state, int(found.t_ns[first]))
                seen += closed
            if state.open is None:
                opened = self._event(found, first)
                seen.append(opened)
                state = EventState(opened)
            state = _grow(state, found, first, stop)
        if state.open is not None:
            state = replace(state, touching=bool(above[-1]))
            if not state.touching:
                state, closed = self._close(state, int(found.t_ns[-1]))
                seen += closed
        return state, tuple(seen)

    def end(self, state: EventState) -> tuple[EventState, tuple[Event, ...]]:
        """The flight is over: close what is open."""
        if state.open is None:
            return state, ()
        return EventState(), (replace(state.open, end_ns=state.above_ns),)

    def _event(self, found: Statistic, row: int) -> Event:
        statistic, level = float(found.value[row]), float(found.level[row])
        return Event(self.monitor, self.axis, int(found.t_ns[row]), None, statistic, self.threshold, level)

    def _close(self, state: EventState, now_ns: int) -> tuple[EventState, tuple[Event, ...]]:
        """Close the open event if the statistic has been back for `clear_s` at `now_ns`."""
        if state.open is None or now_ns - state.above_ns < self.clear_s * NS_PER_S:
            return state, ()
        return self.end(state)


def _grow(state: EventState, found: Statistic, first: int, stop: int) -> EventState:
    if state.open is None:
        return state
    highest = float(found.value[first:stop].max()), float(found.level[first:stop].max())
    grown = replace(
        state.open, statistic=max(state.open.statistic, highest[0]), level=max(state.open.level, highest[1])
    )
    return EventState(grown, int(found.t_ns[stop - 1]))
