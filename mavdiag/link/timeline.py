"""One vehicle timeline from many counters: reboots bridged, different clocks laid over each other.

The timeline is the clock of the first stamped message; the others are laid over it by the least transport delay of each
and followed as they drift (`offsets`). The receiver's clock never adds its jitter to a stamp.

A stamp that leaps ahead is left out before it comes here, until others follow it (`clock`). A stamp that is out of line
(over a second old, or hours ahead) is no reboot while others go on: a second path may be
slower, and somebody may send old frames again. Such frames are left out. The vehicle starts anew when its old clock
has been silent, for a second if the new clock is no further than a reboot in that silence can have brought it, else for
ten, and three frames in a row agree on a new clock that goes on. So reboots cannot be counted more often than once a
second.

Everything is a value: state in, state out; cutting the samples into other pieces gives the same times.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum, auto

from mavdiag.link.clock import AGREEING, EPOCH_NS, LATE_NS, SILENT_NS, Clock, Counter, Rival, Run
from mavdiag.link.offsets import NO_CLOCKS, Clocks, followed, lead_ns, placed
from mavdiag.telemetry import IntArray
from mavdiag.units import NS_PER_MS, NS_PER_S

# Choices, not measurements; SILENT_NS is one, too.
GONE_NS = 10 * NS_PER_S  # how long the old clock must be silent before a clock that no reboot explains takes over
UPTIME_SLACK_NS = 10 * NS_PER_S  # how much older than that silence a vehicle may be that has rebooted in it
STEP_NS = 2 * NS_PER_MS  # by at least so much: messages of one instant are rounded differently
REBOOT_GAP_NS = NS_PER_S  # least time that a reboot takes on the timeline, so that nothing is joined across it


class OutOfLine(Enum):
    """What a stamp out of line is taken for."""

    REBOOT = auto()  # the vehicle started anew
    RIVAL = auto()  # maybe so: the next frames must agree; this one is left out
    STRAY = auto()  # a frame to leave out


@dataclass(frozen=True, slots=True)
class Timeline:
    """Where one vehicle's time stands.

    clocks: its clocks and how they are laid over the reference.
    base_ns: what to add to the reference [ns].
    t_ns: latest time known [ns], None before the first stamp.
    host_ns: when the last stamp was received [ns].
    seen_ns: when the last stamp in line was, of the clock since boot and of unix time [ns].
    high_ns: highest stamp, of the clock since boot and of unix time [ns].
    rival: another clock that may take over; None if there is none.
    reboots: how often the vehicle started anew.
    """

    clocks: Clocks = NO_CLOCKS
    base_ns: int = 0
    t_ns: int | None = None
    host_ns: int = 0
    seen_ns: tuple[int, int] = (0, 0)
    high_ns: tuple[int, int] = (0, 0)
    rival: Rival | None = None
    reboots: int = 0

    @property
    def drift_ppm(self) -> float | None:
        """How fast another clock of the vehicle drifts against the reference [ppm]; None if its messages have one."""
        apart = (offset for offset in self.clocks.offsets if offset is not None and not offset.shared)
        return next((-offset.drift_ppm for offset in apart), None)

    def since_boot_ns(self, host_ns: int) -> int | None:
        """The vehicle's time since boot at the receiver's time, to a few milliseconds; None if it is not known."""
        leads = (lead_ns(self.clocks, clock) for clock in (Clock.BOOT_MS, Clock.BOOT_US))
        return next((host_ns - one for one in leads if one is not None), None)


def rebooted(timeline: Timeline) -> Timeline:
    """The vehicle starts anew: its clocks are new, and its time goes on with the receiver's, by a second at least."""
    return Timeline(t_ns=timeline.t_ns, host_ns=timeline.host_ns, reboots=timeline.reboots + 1)


def out_of_line(timeline: Timeline, counter: Counter, raw: int, host_ns: int) -> tuple[Timeline, OutOfLine]:
    """What a stamp out of line, received at `host_ns`, is; raw: its count."""
    clock_ns = raw * counter.tick_ns
    silent_ns = host_ns - timeline.seen_ns[clock_ns >= EPOCH_NS]
    young = clock_ns <= silent_ns + UPTIME_SLACK_NS
    if silent_ns < (SILENT_NS if young else GONE_NS):
        return timeline, OutOfLine.STRAY
    before = timeline.rival
    if before is None:
        return replace(timeline, rival=Rival(clock_ns, host_ns)), OutOfLine.RIVAL
    advance_ns = clock_ns - before.clock_ns
    if abs(advance_ns - (host_ns - before.host_ns)) > LATE_NS:
        return replace(timeline, rival=None), OutOfLine.STRAY
    if advance_ns < STEP_NS:
        return timeline, OutOfLine.RIVAL
    if before.frames + 1 == AGREEING:
        return rebooted(timeline), OutOfLine.REBOOT
    return replace(timeline, rival=Rival(clock_ns, host_ns, before.frames + 1)), OutOfLine.RIVAL


def place(timeline: Timeline, runs: Sequence[Run]) -> tuple[Timeline, list[IntArray]]:
    """Give the samples of several messages their vehicle time.

    runs: none empty, and of a fresh timeline the first one to arrive first. Returns the vehicle times of each run [ns];
    where a clock is not laid over the first yet (one to two seconds), the leading samples have none and are left out.
    """
    before, base_ns = timeline.clocks, timeline.base_ns
    if before.reference is None:
        base_ns = _begun(timeline, runs[0])
    clocks, paths = followed(before, runs)
    received_ns, known_ns, rival = timeline.host_ns, timeline.t_ns, timeline.rival
    seen_ns, high_ns = list(timeline.seen_ns), list(timeline.high_ns)
    times = []
    for run in runs:
        t_ns, on_epoch = run.clock_ns, run.on_epoch
        if run.clock is not clocks.reference:
            t_ns = placed(t_ns, run.host_ns, paths.get(run.clock, ()), before.offsets[run.clock] is not None)
        if base_ns:
            t_ns = t_ns + base_ns
        if len(t_ns):
            latest_ns = run.latest_ns if t_ns is run.clock_ns else int(t_ns.max())
            known_ns = latest_ns if known_ns is None else max(known_ns, latest_ns)
        run_ns = run.reading.host_ns
        received_ns = max(received_ns, run_ns)
        if not run.ambiguous and run.latest_ns >= high_ns[on_epoch] - GONE_NS:  # else a clock of its own
            seen_ns[on_epoch] = max(seen_ns[on_epoch], run_ns)
            high_ns[on_epoch] = max(high_ns[on_epoch], run.latest_ns)
        times.append(t_ns)
    seen, high = (seen_ns[0], seen_ns[1]), (high_ns[0], high_ns[1])
    if rival is not None and seen[rival.clock_ns >= EPOCH_NS] != timeline.seen_ns[rival.clock_ns >= EPOCH_NS]:
        rival = None
    return Timeline(clocks, base_ns, known_ns, received_ns, seen, high, rival, timeline.reboots), times


def _begun(timeline: Timeline, first: Run) -> int:
    """What to add to a fresh reference [ns]."""
    if timeline.t_ns is None:
        return timeline.base_ns
    resume_ns = timeline.t_ns + max(int(first.host_ns[0]) - timeline.host_ns, REBOOT_GAP_NS)
    return resume_ns - int(first.clock_ns[0])
