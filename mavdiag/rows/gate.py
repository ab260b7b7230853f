"""Judge only what flies: `GateSpec.start`, `.step`, `.finish` cut the flying spans out of the aligned rows.

A landing gives gyro spikes many times the size of a fault's trace (8-11 rad/s, METHOD section 5). Flying spans are
segments, and a `Border` follows each. Its first `trim_start_s` are invalid, its last `trim_end_s` are dropped: so long
rows are held back. So they are from an impact on, and while thrust or height is below its limit (*low*), until the
matter is decided:

    disarmed, or QUIET_S low and no loud row    it was the landing: the rows are dropped and the span ends
    neither low nor an impact for BACK_S        it was flight: the rows come out and are judged
    loud for LOUD_S, later than QUIET_S         it tumbles: the rows come out, and the next low ones are not held back

A row is loud above QUIET_RAD_S. At the end of the data what was loud for LOUD_S, and in its last CALM_S, was flight.
At an impact more than the rotors carries the vehicle: f = EMA(-f_z) > IMPACT f0 max(r, r^2), with r = u/u0, u: thrust,
f0 and u0: usual force and thrust, slow EMAs. A rotor's force grows as r or r^2. They follow an impact too: none lasts.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, TypeAlias

import numpy as np
from pydantic import Field

import mavdiag.rows.block as col
from mavdiag.jit import cached_loop, jit
from mavdiag.rows.block import Block
from mavdiag.rows.quality import DOUBTS, Doubt, LinkQuality, believed
from mavdiag.rows.windows import window_mean, window_rows
from mavdiag.telemetry import BoolArray, FloatArray, IntArray, Series, Signal, Telemetry
from mavdiag.units import NS_PER_S

QUIET_RAD_S = 1.0  # of any axis; a landed vehicle turns at less than a tenth of it, one that tumbles at 5 (our choice)
QUIET_S = 1.0  # spikes of a touch-down end 0.8 s after height or thrust is low (recorded Crazyflies; our choice)
BACK_S = 0.5  # a touch-down's blips of thrust last up to 0.2 s (recorded ArduCopter; our choice)
CALM_S = 0.5  # of a touch-down whose QUIET_S the data did not wait for (our choice)
LOUD_S = 0.1  # so that one wrong sample decides nothing (our choice)
START_NS = NS_PER_S  # of any data no row is valid yet (`align.SETTLE_START_S`)
IMPACT = 1.35  # emulated landings reach 1.46 to 2.8, flight 1.21, for moments 1.5 in ArduCopter's gusts (our choice)
IMPACT_S, USUAL_S = 0.02, 5.0  # time constants: shorter than half a rate filter; longer than a landing (our choice)
KNOWN_S = 1.0  # of the usual ones before an impact is believed (our choice)
SHAKE_S = 0.5  # of one figure of the noise (our choice)
THRUST_LOST_NS = 2 * NS_PER_S  # a thrust that was known and is not for longer is lost (our choice)
HIDDEN_S = 3.0  # shorter stretches may be a touch-down, or motors that run down (our choice)
HIDDEN_BIN_NS = NS_PER_S // 2
SHOWS_FLIGHT = (Signal.BODY_RATE, Signal.THRUST_SETPOINT, Signal.ACTUATOR, Signal.HEIGHT, Signal.ARMED)
FLIES = 0.5  # of the outputs, or of the motion, that are usual in the flight (our choice)
HELD_BINS = 2  # for so long the last thrust and outputs hold
IDLE_OUTPUT = 0.15  # ArduPilot's MOT_SPIN_MIN by default: a motor that carries is above it
THRUST_CODE, NEVER_NS = DOUBTS.index(Doubt.THRUST), -(2**62)

ALL_TELL = np.empty(0, dtype=np.bool_)
# What some vehicle may fly by, where a file tells it [m, share of full thrust, s].
Height: TypeAlias = Annotated[float, Field(ge=-100, le=1000)]
Share: TypeAlias = Annotated[float, Field(ge=0, le=1)]
Span: TypeAlias = Annotated[float, Field(ge=0, le=600)]

# The segment of the rows before the gate, its first row; whether it is in the air; whether the data broke off in the
# air, so that what flies next has not taken off; number of the flying span; when thrust was known last; until when rows
# are invalid; until when it takes off, or the data begin; the last row that flew; rows that are held back, and how many
# of them were flight.
SOURCE, SOURCE_NS, AIRBORNE, RESUMES, SPAN, THRUST_NS, BLANK_NS, SETTLED_NS, LAST_NS, QUEUED, KEPT = range(11)
# Whether a vehicle in the air hit something (1), or thrust or height is low (2), since when; the last loud row, or the
# first such one; since when they are back; how many were loud later than QUIET_S, and at all; whether it tumbles.
LOW, BEGUN_NS, LOUD_NS, UP_NS, LATE, LOUD, TUMBLES = range(11, 18)


@dataclass(frozen=True, slots=True)
class Border:
    """A flying span has ended. t_ns: vehicle time of the last row that flew. landed: else the data broke off.

    Where they broke off, and what comes next does not fly, a second one tells of the landing.
    """

    t_ns: int
    landed: bool = True


class GateState:
    """The rows held back, the gyro of the last SHAKE_S, and `SOURCE` ...; changed in place."""

    def __init__(self, limits: tuple[float, float, bool, int]) -> None:
        self.limits = limits
        self.rows: list[Block] = []
        self.tail: FloatArray = np.empty((0, 3))
        self.now: IntArray = np.zeros(TUMBLES + 1, dtype=np.int64)
        self.now[[SOURCE, SPAN, THRUST_NS]] = -1, -1, NEVER_NS
        self.memory = self.now, np.zeros(4)  # settled rows of the span, f0, u0, f

    def release(self, until_ns: int) -> list[Block]:
        """Give away what flew up to a time."""
        out: list[Block] = []
        kept = flown = int(self.now[KEPT])
        while kept and self.rows:
            block = self.rows.pop(0)
            stop = min(kept, int(block.t_ns.searchsorted(until_ns, side="right")))
            out += [block.rows(0, stop)] if stop else []
            kept -= stop
            if stop < len(block):
                self.rows.insert(0, block.rows(stop, len(block)))
                break
        self.now[QUEUED] -= flown - kept
        self.now[KEPT] = kept
        return out

    def land(self, *, resumes: bool) -> None:
        """What is held back is dropped."""
        self.rows, self.now[[QUEUED, KEPT, LOW, AIRBORNE]] = [], 0
        self.now[RESUMES] = resumes

    def flew(self) -> bool:
        """Whether low rows that nothing follows were flight."""
        now = self.now
        if now[TUMBLES] or now[UP_NS] > NEVER_NS:
            return True
        last = self.rows[-1]
        return bool(now[LOUD] * last.dt_s >= LOUD_S and last.t_ns[-1] - now[LOUD_NS] < CALM_S * NS_PER_S)


@dataclass(frozen=True, slots=True)
class GateSpec:
    """What counts as flying. A limit of None is not asked for.

    A signal that is unknown passes, but rows 2 s after a known thrust was lost are doubtful, unless height shows the
    landing. In place of an unknown thrust the outputs are asked: while all of them idle, nothing flies.
    min_height_m: above take-off. min_thrust: collective set-point, 0..1. need_armed: HEARTBEAT says armed.
    trim_start_s, trim_end_s: start of a span that is marked invalid, end of it that is dropped.
    least_shake: where thrust and height are not known a take-off begins with this gyro noise (`shake`) [rad/s].
    """

    min_height_m: Height | None = None
    min_thrust: Share | None = None
    need_armed: bool = True
    trim_start_s: Span = 0.0
    trim_end_s: Span = 0.0
    least_shake: Annotated[float, Field(ge=0, le=10)] | None = None

    def start(self) -> GateState:
        """A fresh state: nothing flies yet."""
        height = -math.inf if self.min_height_m is None else float(self.min_height_m)
        thrust = -math.inf if self.min_thrust is None else float(self.min_thrust)
        return GateState((height, thrust, self.need_armed, round(self.trim_start_s * NS_PER_S)))

    def step(self, state: GateState, block: Block) -> list[Block | Border]:
        """The next rows that fly, renumbered by flying span, held back by `trim_end_s`."""
        out: list[Block | Border] = []
        now, first, n = state.now, 0, len(block)
        if block.segment != now[SOURCE]:
            if now[AIRBORNE]:
                out += [*self._break_off(state), Border(int(now[LAST_NS]), landed=False)]
            now[[SOURCE, SOURCE_NS]], state.tail = (block.segment, block.t_ns[0]), state.tail[:0]
        trim_ns, told, place = round(self.trim_end_s * NS_PER_S), self._told(state, block), (block.whole, block.first)
        how = state.limits, block.dt_s, block.outputs
        while first < n:
            took, stop, landed = _follow(state.memory, how, block.t_ns, place, told, first)
            if took < stop:
                state.rows.append(block.rows(took, stop, int(now[SPAN]), int(now[SETTLED_NS])))
            out += state.release(int(now[LAST_NS]) - trim_ns)
            if landed:
                state.land(resumes=False)
                out.append(Border(int(now[LAST_NS])))
            first = stop + 1
        return out

    def finish(self, state: GateState) -> list[Block]:
        """The end of the data. What was held back was still flying, so it is judged, but for a landing that began."""
        lands = state.now[LOW] and not state.flew()
        return self._break_off(state, self.trim_end_s if lands else 0.0) if state.now[AIRBORNE] else []

    def _break_off(self, state: GateState, trim_s: float = 0.0) -> list[Block]:
        """The data end, or break off: all that flew comes out."""
        if state.now[LOW] and state.rows and state.flew():
            state.now[KEPT], state.now[LAST_NS] = state.now[QUEUED], state.rows[-1].t_ns[-1]
        out = state.release(int(state.now[LAST_NS]) - round(trim_s * NS_PER_S))
        state.land(resumes=True)
        return out

    def _told(self, state: GateState, block: Block) -> BoolArray:
        """(n,) the rows that tell of flight: by thrust, height or the shaking of the gyro in the half second before.

        Empty where all do.
        """
        if self.least_shake is None:
            return ALL_TELL
        told = np.isfinite(block.thrust)
        if self.min_height_m is not None:
            told |= np.isfinite(block.height)
        rates = np.concatenate((state.tail, block.rate))
        noise = shake(rates, block.dt_s)
        known = min(len(noise), len(block))
        told[len(block) - known :] |= noise[len(noise) - known :] >= self.least_shake
        state.tail = rates[-(window_rows(SHAKE_S, block.dt_s) + 1) :]
        return told


@jit
def _idle(x: FloatArray, outputs: int, i: int) -> bool:
    for row in range(col.OUTPUTS, col.OUTPUTS + outputs):
        if not x[row, i] <= IDLE_OUTPUT:
            return False
    return outputs > 0


@jit
def _hits(carried: FloatArray, force: float, thrust: float, dt_s: float) -> bool:
    """Whether a row is of an impact."""
    carried[3] += min(dt_s / IMPACT_S, 1.0) * (force - carried[3])
    r = thrust / carried[2] if carried[2] > 0.0 else 0.0
    hits = carried[0] * dt_s >= KNOWN_S and 0.0 < IMPACT * carried[1] * r * max(r, 1.0) < carried[3]
    carried[0] += 1.0
    share = max(dt_s / USUAL_S, 1.0 / carried[0])
    carried[1] += share * (force - carried[1])
    carried[2] += share * (thrust - carried[2])
    return bool(hits)


@cached_loop
def _follow(memory: Any, how: Any, t_ns: IntArray, place: Any, told: BoolArray, first: int) -> tuple[int, int, bool]:
    """Follow rows from the first on, up to a landing or their end; returns which may be flight, and if it landed.

    place: x, and the first of the columns that belong to t_ns.
    """
    (now, carried), (limits, dt_s, outputs), took, (x, at) = memory, how, first, place
    least_height, least_thrust, need_armed, trim_ns = limits
    height, thrust, armed = x[col.HEIGHT, at:], x[col.THRUST, at:], x[col.ARMED, at:]
    valid, doubt = x[col.VALID, at:], x[col.DOUBT, at:]
    p, q, r = x[col.RATE, at:], x[col.RATE + 1, at:], x[col.RATE + 2, at:]
    for i in range(first, len(t_ns)):
        t, low = t_ns[i], height[i] < least_height or thrust[i] < least_thrust
        if math.isfinite(thrust[i]):
            now[THRUST_NS] = t
        elif least_thrust > -math.inf:
            low = low or _idle(x, outputs, at + i)
            unseen = not math.isfinite(height[i]) or least_height == -math.inf
            if unseen and now[THRUST_NS] > NEVER_NS and t - now[THRUST_NS] > THRUST_LOST_NS:
                valid[i], doubt[i] = 0.0, doubt[i] if doubt[i] > 0.0 else THRUST_CODE
        disarmed = need_armed and armed[i] < 0.5
        if not now[AIRBORNE]:
            took = i + 1
            if disarmed or low:
                if now[RESUMES]:
                    return took, i, True
                continue
            if not (now[RESUMES] or len(told) == 0 or told[i]):
                continue
            took = i
            if now[RESUMES]:  # within a take-off that goes on, or after it
                now[BLANK_NS], now[SETTLED_NS] = max(now[BLANK_NS], t), max(now[SETTLED_NS], t)
            else:
                now[BLANK_NS] = t + trim_ns
                now[SETTLED_NS] = max(now[SOURCE_NS] + START_NS, now[BLANK_NS])
                carried[:] = 0.0
            now[AIRBORNE], now[RESUMES], now[SPAN] = 1, 0, now[SPAN] + 1
        held, up = 2 if low else 0, -x[col.FORCE + 2, at + i]
        if not low and t >= now[BLANK_NS] and math.isfinite(up + thrust[i]):
            held = int(_hits(carried, up, thrust[i], dt_s))
        loud = max(abs(p[i]), abs(q[i]), abs(r[i])) > QUIET_RAD_S and math.isfinite(p[i] + q[i] + r[i])
        if held > now[LOW] and not (now[LOW] and now[TUMBLES]):
            now[LOW], now[BEGUN_NS], now[LOUD_NS], now[LATE], now[LOUD], now[TUMBLES] = held, t, t, 0, 0, 0
        if disarmed or (low and not loud and t - now[LOUD_NS] >= QUIET_S * NS_PER_S):
            return took, i, True
        if held:
            now[UP_NS] = NEVER_NS
        elif now[LOW]:
            now[UP_NS] = t if now[UP_NS] == NEVER_NS else now[UP_NS]
            now[LOW] *= t - now[UP_NS] < BACK_S * NS_PER_S
        now[QUEUED] += 1
        valid[i] = valid[i] if t >= now[BLANK_NS] else 0.0
        if now[LOW] and loud:
            now[LATE] += t - now[BEGUN_NS] > QUIET_S * NS_PER_S
            now[LOUD], now[LOUD_NS] = now[LOUD] + 1, t
            now[TUMBLES] = now[LATE] * dt_s >= LOUD_S
        if not now[LOW] or now[TUMBLES]:
            now[KEPT], now[LAST_NS] = now[QUEUED], t
    return took, len(t_ns), False


def shake(rate: FloatArray, dt_s: float) -> FloatArray:
    """Noise of the gyro in each half second: rms of its second differences, (n, 3) -> (m,) [rad/s]; 0 if unknown."""
    squares = np.nan_to_num(np.square(np.diff(rate, n=2, axis=0)).mean(axis=1))
    return np.sqrt(np.maximum(window_mean(squares[:, None], window_rows(SHAKE_S, dt_s))[:, 0], 0.0))


@dataclass(frozen=True, slots=True)
class Hidden:
    """A part of a log in which the vehicle flew and nobody could judge it [s of the vehicle's clock]."""

    begin_s: float
    end_s: float
    reason: str


def hidden_flight(
    telemetry: Telemetry, gate: GateSpec, quality: LinkQuality, spans: Sequence[tuple[int, int]]
) -> tuple[Hidden, ...]:
    """Where a vehicle that had taken off flew on though the gate passed no rows, in order of time.

    The gyro ends, the thrust reads low, or it reads disarmed, while the other signals are what they were in flight.
    spans: first and last row of what flew [ns].
    """
    shows = [one for one in telemetry if one.signal in SHOWS_FLIGHT and len(one)]
    begins_ns = [*(begin for begin, _ in spans[1:]), max((int(one.t_ns.max()) for one in shows), default=0)]
    between_ns = sum(max(begin - end, 0) for (_, end), begin in zip(spans, begins_ns, strict=False))
    if 2 * between_ns < HIDDEN_S * NS_PER_S:
        return ()  # nor with what flew in between
    telemetry = believed(quality, Telemetry(tuple(shows)))
    numbers = (one.t_ns // HIDDEN_BIN_NS for one in telemetry)
    changes = (number[np.append(True, number[1:] != number[:-1])] for number in numbers if len(number))
    bins: IntArray = np.unique(np.concatenate([np.empty(0, np.int64), *changes]))
    bins = bins[bins > spans[0][0] // HIDDEN_BIN_NS] if spans else bins[:0]
    if not len(bins):
        return ()
    flown = np.zeros(len(bins), dtype=np.bool_)
    for first, last in spans:
        flown |= (bins >= first // HIDDEN_BIN_NS) & (bins <= last // HIDDEN_BIN_NS)
    thrust, outputs, height = (_mean(telemetry.get(signal), bins, HELD_BINS) for signal in SHOWS_FLIGHT[1:4])
    armed, motion = _mean(telemetry.get(Signal.ARMED), bins, len(bins)), _motion(telemetry.get(Signal.BODY_RATE), bins)
    dead, moves = ~np.isfinite(motion), motion >= FLIES * _median(motion[flown])
    told = _mean(Telemetry(tuple(shows)).get(Signal.ACTUATOR), bins, HELD_BINS)  # of motors that idle steady, not 0
    down = (told < FLIES * _median(told[flown])) & ((told > 0.0) | np.isfinite(outputs))
    low, off = thrust < (gate.min_thrust or 0.0), (armed < 0.5) & gate.need_armed
    reasons = {
        "it reads disarmed while its thrust says that it flies": off & (thrust > 0) & ~low & ~down & (moves | dead),
        "no gyro": ~off & dead & ~low & ~down & ~(height < (gate.min_height_m or -np.inf)),
        "its thrust reads 0 while it flies": ~off & ~dead & low & ~down & (np.isfinite(outputs) | moves),
    }
    found = []
    for reason, where in reasons.items():
        at = bins[where & ~flown]
        for part in np.split(at, np.flatnonzero(np.diff(at) > HELD_BINS) + 1):
            if len(part) and (part[-1] + 1 - part[0]) * HIDDEN_BIN_NS >= HIDDEN_S * NS_PER_S:
                begin_ns, end_ns = int(part[0]) * HIDDEN_BIN_NS, int(part[-1] + 1) * HIDDEN_BIN_NS
                before = [last for _, last in spans if 0 < begin_ns - last < HELD_BINS * HIDDEN_BIN_NS]
                found.append(Hidden(max(before, default=begin_ns) / NS_PER_S, end_ns / NS_PER_S, reason))
    return tuple(sorted(found, key=lambda one: one.begin_s))


def _summed(series: Series, bins: IntArray, *columns: FloatArray) -> list[FloatArray]:
    """(bins,) sums of each of some columns (n,) beside a series."""
    number = series.t_ns // HIDDEN_BIN_NS
    place = bins.searchsorted(number).clip(0, len(bins) - 1)
    inside = bins[place] == number
    return [np.asarray(np.bincount(place[inside], column[inside], len(bins)), np.float64) for column in columns]


def _mean(series: Series | None, bins: IntArray, most: int) -> FloatArray:
    """(bins,) mean of the finite values of each bin, else the last known one, for so many bins; else nan."""
    if series is None:
        return np.full(len(bins), np.nan)
    finite = np.isfinite(series.values)
    values = np.where(finite, series.values, 0.0)
    count, total = _summed(series, bins, finite.sum(axis=1, dtype=np.float64), values.sum(axis=1))
    number = np.arange(len(bins))
    place = np.maximum.accumulate(np.where(count > 0, number, -1))
    return np.where((place >= 0) & (number - place <= most), (total / np.maximum(count, 1.0))[place], np.nan)


def _motion(gyro: Series | None, bins: IntArray) -> FloatArray:
    """(bins,) standard deviation of the body rates, nan where the gyro has no two stamps [rad/s]."""
    if gyro is None:
        return np.full(len(bins), np.nan)
    once = gyro.where(np.append(True, gyro.t_ns[1:] != gyro.t_ns[:-1]))
    rates = once.values[:, :3].T
    count, *sums = _summed(once, bins, np.ones(len(once)), np.square(rates).sum(axis=0), *rates)
    square, *means = (total / np.maximum(count, 1.0) for total in sums)
    variance = np.maximum(square - np.square(means).sum(axis=0), 0.0) / 3.0
    return np.where(count > 1, np.sqrt(variance), np.nan)


def _median(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else np.nan
