"""One vehicle's time from the counters of its messages, frame by frame: wraps, late frames, leaps, reboots, drift.

Counters. A vehicle stamps its messages with milliseconds or microseconds since boot, in 32 bits (which wrap after 49.7
days or 71.6 minutes) or 64, and some of them with microseconds of the unix epoch. How often a counter of 71.6 minutes
had wrapped before its first message follows from the vehicle's other messages. The receiver's clock only decides
between a wrap, a reboot and a leap; it never adds its jitter to a stamp. A stamp up to a second older than the highest
is a late frame and keeps its place; one further out of line is left out. A stamp that leaps ahead of all that the
receiver's clock explains is left out until others follow it: a forged or damaged frame must not make the genuine ones
old.

Reboots. A stamp that is out of line is no reboot while others go on: a second path may be slower, and somebody may send
old frames again. The vehicle starts anew when its old clock has been silent, for a second if the new clock is no
further than a reboot in that silence can have brought it, else for ten, and three frames in a row agree on a new clock
that goes on. So reboots cannot be counted more often than once a second.

Clocks. The timeline is the clock of the first stamped message; the others are laid over it. A message that is stamped
c_ns arrives at host_ns = c_ns + (origin of its clock) + delay, with delay >= 0. The least host_ns - c_ns of a window,
the clock's lead, is its origin to within the least delay. So the difference of two leads is the offset of two clocks
without the receiver's jitter; the receiver's own drift is in both and cancels. Quartz drifts by tens of parts in a
million: 50 ppm are 180 ms in an hour. The window slides by whole seconds of the receiver's clock; within a second the
offset goes on a straight line, never faster than `SLEW_NS`. Clocks since boot that are within a second of each other,
but for whole turns of the one of 49.7 days, count as one: their stamps stay exactly as sent until their leads have
moved apart by more than changing delays explain.

Frames are taken one by one, by a compiled loop over one record; so how they are cut into blocks does not matter.
"""

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from mavdiag.telemetry import IntArray
from mavdiag.units import NS_PER_MS, NS_PER_S, NS_PER_US

# Choices, not measurements, but for the drift of quartz: links reorder within less, vehicles take longer to boot, and
# no stream pauses so long.
LATE_NS = NS_PER_S  # a stamp may be this much older than the one before and still be a late frame
WRAP_SLACK_NS = 60 * NS_PER_S  # a wrap must agree with the receiver's clock this well, or it is a reboot
JUMP_SLACK_NS = 3600 * NS_PER_S  # beyond the receiver's clock by more: another clock, not a pause
SILENT_NS = NS_PER_S  # the vehicle's old clock must be silent for so long before a new one is a reboot
LEAP_NS = NS_PER_S // 5  # a stamp so far ahead of the line leaps: links bunch the samples of a stream by less
AGREEING = 3  # samples in a row that must agree on a new clock before it is followed
DRIFT_SHIFT = 11  # the line gives way by one part in 2^11 of the time, ten times the drift of a plain quartz
GONE_NS = 10 * NS_PER_S  # how long the old clock must be silent before a clock that no reboot explains takes over
UPTIME_SLACK_NS = 10 * NS_PER_S  # how much older than that silence a vehicle may be that has rebooted in it
AGREED_STEP_NS = 2 * NS_PER_MS  # by at least so much: messages of one instant are rounded differently
REBOOT_GAP_NS = NS_PER_S  # least time that a reboot takes on the timeline, so that nothing is joined across it
WINDOW = 10  # seconds over which the least lead is taken: 1000 samples at 100 Hz, and 0.5 ms of drift at 50 ppm
SLEW_NS = NS_PER_S // 2000  # by how much an offset changes in a second at most: ten times the drift of a plain quartz
TOGETHER_NS = NS_PER_S  # clocks since boot that begin nearer to each other than this are one
APART_NS = 20 * NS_PER_MS  # so far one clock may seem to move against itself, as the delays of messages change
SET_NS = 100 * NS_PER_MS  # a change of more is no drift: somebody has set a clock
STEPPED = 3  # seconds in a row that must show it

EPOCH_NS = 1_000_000_000 * NS_PER_S  # stamps from here on (year 2001) are unix time, earlier ones time since boot
HIGHEST_NS = (1 << 62) - 1  # year 2116: garbage beyond is held here, so that a stamp and an offset fit 64 bits
NEVER = -(1 << 62)  # stands for "no time known" [ns]
MESSAGES_MAX = 32  # that are stamped, of one vehicle: there are 18
SECONDS = WINDOW + 3  # of leads that there is room for: a window with both its ends, and one more


class Clock(IntEnum):
    """The clocks that a vehicle's messages may be stamped on."""

    BOOT_MS = 0  # milliseconds since boot, 32 bits
    BOOT_US = 1  # microseconds since boot, 64 bits
    BOOT_US_32 = 2  # microseconds since boot, 32 bits
    UNIX = 3  # microseconds since 1970


@dataclass(frozen=True, slots=True)
class Counter:
    """How a message counts time.

    tick_ns: one count [ns].
    turn: counts until it wraps, 0 for never.
    """

    tick_ns: int
    turn: int


MS_32 = Counter(NS_PER_MS, 1 << 32)  # time_boot_ms: wraps after 49.7 days
US_32 = Counter(NS_PER_US, 1 << 32)  # SERVO_OUTPUT_RAW.time_usec: wraps after 71.6 minutes
US_64 = Counter(NS_PER_US, 0)  # time_usec: since boot or since 1970
TURN_NS = MS_32.turn * MS_32.tick_ns

# Where one message's counter stands: the message plus one, 0 for none; whether it has begun; highest count so far, as
# sent; how often it has wrapped; when it was last received in line; the most that it was ahead of the receiver's clock,
# which drift takes back slowly; and the other clock that its latest samples show, with how many in a row agree on it.
_READING = np.dtype(
    [
        (name, "i8")
        for name in ("msgid", "used", "raw", "turns", "host_ns", "line_ns", "rival_ns", "rival_host_ns", "rivals")
    ]
)
# How far the receiver's clock leads one of the vehicle's: in which second it was seen first, with which lead; and the
# latest seconds in which it was seen, ascending, each with its least lead.
_LEADS = np.dtype(
    [("first_s", "i8"), ("first_ns", "i8"), ("count", "i8"), ("seconds", "i8", SECONDS), ("least", "i8", SECONDS)]
)
# What lays a clock over the reference in one second of the receiver's clock: what to add at its beginning and its end;
# whether it counts as one clock with the reference, but for whole turns; the part of its lead that is a delay of its
# messages; seconds in a row in which a shared clock was apart; and when it began, or was set last, and what it was.
_OFFSET = np.dtype(
    [
        (name, "i8")
        for name in (
            "known",
            "second",
            "begin_ns",
            "end_ns",
            "shared",
            "zeroed",
            "zero_ns",
            "odd",
            "since_s",
            "since_ns",
        )
    ]
)
# The vehicle: the clock that the others are laid over, -1 before the first stamp; what to add to it; latest time known;
# when the last stamp was received; when the last stamp in line was, and the highest stamp, of the clock since boot and
# of unix time; another clock that may take over; how often it started anew, and samples left out because they leap.
_MEM = np.dtype(
    [
        *((name, "i8") for name in ("reference", "base_ns", "t_ns", "host_ns")),
        *((name, "i8", 2) for name in ("seen_ns", "high_ns")),
        *((name, "i8") for name in ("rival_ns", "rival_host_ns", "rivals", "reboots", "leaps")),
    ]
)


_KINDS = (_MEM, _READING, _LEADS, _OFFSET)
_SIZES = (1, MESSAGES_MAX, len(Clock), len(Clock))
_ENDS = np.cumsum([count * kind.itemsize // 8 for count, kind in zip(_SIZES, _KINDS, strict=True)]).tolist()


def _fresh() -> IntArray:
    words = np.zeros(_ENDS[-1], np.int64)
    mem = words[: _ENDS[0]].view(_MEM)
    mem["reference"], mem["t_ns"] = -1, NEVER
    return words


@dataclass(frozen=True, slots=True, eq=False)
class VehicleTime:
    """Where one vehicle's time stands. A value: `stamped` returns another one. words: the records above, end to end."""

    words: IntArray = field(default_factory=_fresh)

    @property
    def mem(self) -> NDArray[np.void]:
        """(1,) the vehicle."""
        return self.words[: _ENDS[0]].view(_MEM)

    @property
    def readings(self) -> NDArray[np.void]:
        """(32,) the counters of its messages."""
        return self.words[_ENDS[0] : _ENDS[1]].view(_READING)

    @property
    def leads(self) -> NDArray[np.void]:
        """(4,) by `Clock`."""
        return self.words[_ENDS[1] : _ENDS[2]].view(_LEADS)

    @property
    def offsets(self) -> NDArray[np.void]:
        """(4,) by `Clock`."""
        return self.words[_ENDS[2] :].view(_OFFSET)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, VehicleTime) and np.array_equal(self.words, other.words)

    def __hash__(self) -> int:
        return hash(self.words.tobytes())

    @property
    def t_ns(self) -> int | None:
        """Latest time known [ns], None before the first stamp."""
        latest = int(self.mem["t_ns"][0])
        return None if latest == NEVER else latest

    @property
    def host_ns(self) -> int:
        """When the last stamp was received [ns]."""
        return int(self.mem["host_ns"][0])

    @property
    def reboots(self) -> int:
        """How often the vehicle started anew."""
        return int(self.mem["reboots"][0])

    @property
    def leaps(self) -> int:
        """Samples left out because their stamps leap, so far."""
        return int(self.mem["leaps"][0])

    @property
    def drift_ppm(self) -> float | None:
        """How fast another clock of the vehicle drifts against the reference [ppm]; None if its messages have one."""
        for offset in self.offsets:
            if offset["known"] and not offset["shared"]:
                span_s = max(1, int(offset["second"]) + 1 - int(offset["since_s"]))
                return float(offset["since_ns"] - offset["end_ns"]) / span_s * 1e6 / NS_PER_S
        return None

    def stamped(
        self, messages: IntArray, rows: IntArray, raw: IntArray, host_ns: IntArray
    ) -> tuple["VehicleTime", IntArray, int]:
        """Take the next frames, (n,) each, in order of arrival.

        messages: (k, 3) the messages: number, tick [ns] and turn, as `Counter` has them; a tick of 0 for one without a
        time of its own, which gets the latest time known. rows: which of them each frame is; -1 for a frame that is
        passed over. raw: their counts. host_ns: when they were received [ns].
        Returns the vehicle's time of each [ns], `NEVER` for those that are left out, 0 for those that are passed over;
        and how many were taken: up to the first one of a vehicle that has started anew.
        """
        from mavdiag.link.clock_loop import stamp  # numba, at the first frame

        after, t_ns = VehicleTime(self.words.copy()), np.empty(len(raw), np.int64)
        records = (after.mem, after.readings, after.leads, after.offsets)
        taken = stamp(*records, (messages, rows, raw, host_ns), t_ns)
        return after, t_ns[:taken], taken
