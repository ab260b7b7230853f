"""Judge only what flies: `GateSpec.start`, `.step`, `.finish` cut the flying spans out of the aligned rows.

Take-off, touch-down and the ground are no healthy reference: a landing gives gyro spikes many times the size of a
fault's trace (8-11 rad/s, METHOD section 5). Every flying span becomes a segment of its own, and a `Border` follows it.
Its first `trim_start_s` are marked invalid; its last `trim_end_s` are dropped, which needs the rows to be held back by
that long, so it is zero where the alert must not wait.

A vehicle in the air lands by disarming or by quiet, never by a dip of its thrust. While thrust or height is below its
limit (*low*) the rows are held back until the matter is decided:

    disarmed, or QUIET_S without a loud row     it was the landing: the rows are dropped and the span ends
    thrust and height back for BACK_S           it was flight: the rows come out and are judged
    loud for LOUD_S, later than QUIET_S         it tumbles: the rows come out, and the next low ones are not held back

A row is loud above QUIET_RAD_S. At the end of the data what was loud for LOUD_S, and in its last CALM_S, was flight.

What the gate cannot see as flight, since its own inputs fail, `hidden_flight` finds in a whole log: nobody judged it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from mavdiag.jit import cached_loop
from mavdiag.rows.block import Block
from mavdiag.rows.quality import DOUBTS, Doubt
from mavdiag.rows.windows import window_mean, window_rows
from mavdiag.telemetry import BoolArray, FloatArray, IntArray, Series, Signal, Telemetry
from mavdiag.units import NS_PER_S

QUIET_RAD_S = 1.0  # of any axis; a landed vehicle turns at less than a tenth of it, one that tumbles at 5 (our choice)
QUIET_S = 1.0  # spikes of a touch-down end 0.8 s after height or thrust is low (recorded Crazyflies; our choice)
BACK_S = 0.5  # a touch-down's blips of thrust last up to 0.2 s (recorded ArduCopter; our choice)
CALM_S = 0.5  # of a touch-down whose QUIET_S the data did not wait for (our choice)
LOUD_S = 0.1  # so that one wrong sample decides nothing (our choice)
START_NS = NS_PER_S  # of any data no row is valid yet (`AlignSpec.settle_start_s`)
DISARMED, LOW, UP = 0, 1, 2  # what a row is
SHAKE_S = 0.5  # of one figure of the noise (our choice)
THRUST_LOST_NS = 2 * NS_PER_S  # a thrust that was known and is not for longer is lost (our choice)
HIDDEN_S = 3.0  # shorter stretches may be a touch-down, or motors that run down (our choice)
HIDDEN_BIN_NS = NS_PER_S // 2
SHOWS_FLIGHT = (Signal.BODY_RATE, Signal.THRUST_SETPOINT, Signal.ACTUATOR, Signal.HEIGHT, Signal.ARMED)
FLIES = 0.5  # of the outputs, or of the motion, that are usual in the flight (our choice)
HELD_BINS = 2  # for so long the last thrust and outputs hold
IDLE_OUTPUT = 0.15  # ArduPilot's MOT_SPIN_MIN by default: a motor that carries is above it


@dataclass(frozen=True, slots=True)
class Border:
    """A flying span has ended, by a landing or a break; the next rows have another segment.

    t_ns: vehicle time of the last row that flew.
    """

    t_ns: int


@dataclass(slots=True, eq=False)
class GateState:
    """The rows held back, and the present flying span; changed in place."""

    held: list[Block] = field(default_factory=list)  # flight, held back by `trim_end_s`
    source: int = -1  # segment of the rows before the gate
    source_ns: int = 0  # its first row
    airborne: bool = False
    resumes: bool = False  # the data broke off in the air: what flies next has not taken off
    span: int = -1  # number of the flying span
    thrust_ns: int | None = None  # when the thrust was known last
    blank_ns: int = 0  # until then rows are invalid
    settled_ns: int = 0  # until then it takes off, or the data begin
    last_ns: int = 0  # time of the last row that flew
    low: "_Low | None" = None  # since thrust or height is low
    tail: FloatArray = field(default_factory=lambda: np.empty((0, 3)))  # gyro of the last SHAKE_S, for `least_shake`


@dataclass(slots=True, eq=False)
class _Low:
    """A vehicle in the air with low thrust or height."""

    begun_ns: int
    loud_ns: int  # time of the last loud row, or of the first low one
    up_ns: int | None = None  # since when they are back, but not for BACK_S
    rows: list[Block] = field(default_factory=list)  # undecided
    loud: int = 0  # loud rows
    late: int = 0  # those later than QUIET_S
    tumbles: bool = False


@dataclass(frozen=True, slots=True)
class GateSpec:
    """What counts as flying. A limit of None is not asked for.

    A signal that is unknown passes, be it never sent or too old: its lack must not stop the judging of a flight. But
    where a thrust that was known is lost for 2 s the landing is not seen, unless the height shows it: those rows are
    doubtful. In place of an unknown thrust the outputs are asked: while all of them idle, nothing flies. A vehicle that
    sends neither thrust nor height takes off when its gyro begins to shake.

    min_height_m: above take-off.
    min_thrust: collective set-point, 0..1.
    need_armed: HEARTBEAT says armed.
    trim_start_s: start of a span that is marked invalid.
    trim_end_s: end of a span that is dropped.
    least_shake: where thrust and height are not known a take-off begins with this gyro noise (`shake`) [rad/s].
    """

    min_height_m: float | None = None
    min_thrust: float | None = None
    need_armed: bool = True
    trim_start_s: float = 0.0
    trim_end_s: float = 0.0
    least_shake: float | None = None

    def start(self) -> GateState:
        """A fresh state: nothing flies yet."""
        return GateState()

    def step(self, state: GateState, block: Block) -> list[Block | Border]:
        """The next rows that fly, renumbered by flying span, held back by `trim_end_s`."""
        out: list[Block | Border] = []
        if block.segment != state.source:
            out += self._interrupted(state)
            state.source, state.source_ns, state.tail = block.segment, int(block.t_ns[0]), state.tail[:0]
        kinds = self._kinds(block)
        block = self._without_thrust(state, block)
        shakes = self._shakes(state, block)
        for first, stop in _runs(kinds):
            if kinds[first] == UP:
                if not (state.airborne or state.resumes):
                    first += _first(shakes[first:stop])
                if first < stop:
                    self._fly(state, block, first, stop)
            elif not state.airborne:
                state.resumes = False
            elif kinds[first] == DISARMED:
                out += self._land(state)
            else:
                out += self._sink(state, block, first, stop)
        return [*out, *self._release(state)]

    def finish(self, state: GateState) -> list[Block]:
        """The end of the data. What was held back was still flying, so it is judged, but for a landing that began."""
        if state.low is not None and not _flew(state.low):
            parts = self._land(state)
            state.resumes = True
            return [part for part in parts if isinstance(part, Block)]
        return _break_off(state)

    def _interrupted(self, state: GateState) -> Iterator[Block | Border]:
        if state.airborne:
            yield from _break_off(state)
            yield Border(state.last_ns)

    def _kinds(self, block: Block) -> IntArray:
        """(n,) DISARMED, LOW or UP."""
        kinds = np.empty(len(block), dtype=np.int64)
        height, thrust = (-np.inf if one is None else float(one) for one in (self.min_height_m, self.min_thrust))
        outputs = np.ascontiguousarray(block.actuator.T)
        _classify(height, thrust, self.need_armed, block.height, block.thrust, block.armed, outputs, kinds)
        return kinds

    def _without_thrust(self, state: GateState, block: Block) -> Block:
        """Rows whose thrust was known before and is lost must not be judged, for their landing is not seen."""
        known = np.isfinite(block.thrust)
        if self.min_thrust is None or (state.thrust_ns is None and not known.any()):
            return block
        if np.count_nonzero(known) == len(known):
            state.thrust_ns = int(block.t_ns[-1])
            return block
        first_ns = int(block.t_ns[0]) if state.thrust_ns is None else state.thrust_ns
        last_ns = np.maximum.accumulate(np.where(known, block.t_ns, first_ns))
        state.thrust_ns = int(last_ns[-1])
        lost = block.t_ns - last_ns > THRUST_LOST_NS
        if self.min_height_m is not None:
            lost &= np.isnan(block.height)
        if not lost.any():
            return block
        doubt = np.where(lost & (block.doubt == 0), DOUBTS.index(Doubt.THRUST), block.doubt)
        return replace(block, valid=block.valid & ~lost, doubt=doubt)

    def _shakes(self, state: GateState, block: Block) -> BoolArray:
        """(n,) the rows that tell of flight: by thrust, height or the shaking of the gyro in the half second before."""
        if self.least_shake is None:
            return np.ones(len(block), dtype=np.bool_)
        told = np.isfinite(block.thrust)
        if self.min_height_m is not None:
            told |= np.isfinite(block.height)
        rates = np.concatenate((state.tail, block.rate))
        noise = shake(rates, block.dt_s)
        known = min(len(noise), len(block))
        told[len(block) - known :] |= noise[len(noise) - known :] >= self.least_shake
        state.tail = rates[-(window_rows(SHAKE_S, block.dt_s) + 1) :]
        return told

    def _fly(self, state: GateState, block: Block, first: int, stop: int) -> None:
        if not state.airborne:
            state.blank_ns = state.settled_ns = int(block.t_ns[first])
            if not state.resumes:
                state.blank_ns += round(self.trim_start_s * NS_PER_S)
                state.settled_ns = max(state.source_ns + START_NS, state.blank_ns)
            state.airborne, state.resumes, state.span = True, False, state.span + 1
        low = state.low
        if low is not None:
            low.up_ns = int(block.t_ns[first]) if low.up_ns is None else low.up_ns
            if not (block.t_ns[first:stop] - low.up_ns >= BACK_S * NS_PER_S).any():
                _hold(state, low, block, first, stop)
                return
            _keep(state, low.rows)
            state.low = None
        _keep(state, [_cut(state, block, first, stop)])

    def _sink(self, state: GateState, block: Block, first: int, stop: int) -> list[Block | Border]:
        """Low rows of a vehicle in the air: hold them back, let them out or end the span."""
        t_ns = block.t_ns[first:stop]
        low = state.low = state.low or _Low(int(t_ns[0]), int(t_ns[0]))
        loud_ns = np.maximum.accumulate(np.where(_loud(block, first, stop), t_ns, low.loud_ns))
        over = _first(t_ns - loud_ns >= QUIET_S * NS_PER_S)
        if over:
            low.up_ns = None
            _hold(state, low, block, first, first + over)
        return self._land(state) if over < len(t_ns) else []

    def _land(self, state: GateState) -> list[Block | Border]:
        """The span is over: its last `trim_end_s` are dropped, and what was held back undecided."""
        done = self._release(state)
        state.low, state.held, state.airborne = None, [], False
        return [*done, Border(state.last_ns)]

    def _release(self, state: GateState) -> list[Block]:
        """Let go of the rows that are `trim_end_s` older than the newest."""
        held, state.held = state.held, []
        if not held or self.trim_end_s == 0:
            return held
        safe_ns, done = int(held[-1].t_ns[-1]) - round(self.trim_end_s * NS_PER_S), []
        for block in held:
            stop = int(np.searchsorted(block.t_ns, safe_ns, side="right"))
            done += [block.rows(0, stop)] if stop else []
            state.held += [block.rows(stop, len(block))] if stop < len(block) else []
        return done


@cached_loop
def _classify(
    least_height: float,
    least_thrust: float,
    need_armed: bool,
    height: FloatArray,
    thrust: FloatArray,
    armed: FloatArray,
    outputs: FloatArray,
    kinds: IntArray,
) -> None:
    """What each row is. Where no thrust set-point is known, outputs that all idle are those of a vehicle on the ground.

    outputs: (k, n). kinds: (n,) DISARMED, LOW or UP.
    """
    for i in range(len(kinds)):
        low = height[i] < least_height or thrust[i] < least_thrust
        if least_thrust > -np.inf and thrust[i] != thrust[i] and len(outputs):
            idle = True
            for k in range(len(outputs)):
                idle = idle and outputs[k, i] <= IDLE_OUTPUT
            low = low or idle
        kinds[i] = DISARMED if need_armed and armed[i] < 0.5 else LOW if low else UP


def shake(rate: FloatArray, dt_s: float) -> FloatArray:
    """Noise of the gyro in each half second: rms of its second differences, (n, 3) -> (m,) [rad/s]; 0 if unknown."""
    squares = np.nan_to_num(np.square(np.diff(rate, n=2, axis=0)).mean(axis=1))
    return np.sqrt(np.maximum(window_mean(squares[:, None], window_rows(SHAKE_S, dt_s))[:, 0], 0.0))


def _runs(kinds: IntArray) -> list[tuple[int, int]]:
    """Spans [first, stop) of equal values."""
    if np.count_nonzero(kinds == kinds[0]) == len(kinds):
        return [(0, len(kinds))]
    edges: IntArray = np.flatnonzero(kinds[1:] != kinds[:-1]) + 1
    starts = [0, *edges.tolist()]
    return list(zip(starts, [*edges.tolist(), len(kinds)], strict=True))


def _hold(state: GateState, low: _Low, block: Block, first: int, stop: int) -> None:
    """Keep more undecided rows; all of them come out as soon as it tumbles."""
    t_ns, loud = block.t_ns[first:stop], _loud(block, first, stop)
    low.late += int(np.count_nonzero(loud & (t_ns - low.begun_ns > QUIET_S * NS_PER_S)))
    low.loud += int(np.count_nonzero(loud))
    low.loud_ns = int(t_ns[loud][-1]) if loud.any() else low.loud_ns
    low.rows.append(_cut(state, block, first, stop))
    low.tumbles = low.tumbles or low.late * block.dt_s >= LOUD_S
    if low.tumbles:
        _keep(state, low.rows)
        low.rows = []


def _loud(block: Block, first: int, stop: int) -> BoolArray:
    return np.asarray(np.maximum.reduce(np.abs(block.rate[first:stop]), axis=1) > QUIET_RAD_S, dtype=np.bool_)


def _first(flags: BoolArray) -> int:
    """Place of the first that is True; their number if none is."""
    return int(flags.argmax()) if flags.any() else len(flags)


def _cut(state: GateState, block: Block, first: int, stop: int) -> Block:
    """Rows of the present span, invalid while it takes off."""
    rows = block.rows(first, stop, state.span, state.settled_ns)
    if rows.t_ns[0] < state.blank_ns:
        rows = replace(rows, valid=rows.valid & (rows.t_ns >= state.blank_ns))
    return rows


def _keep(state: GateState, rows: Sequence[Block]) -> None:
    """Take rows that flew."""
    if rows:
        state.held, state.last_ns = [*state.held, *rows], int(rows[-1].t_ns[-1])


def _break_off(state: GateState) -> list[Block]:
    """The data end, or break off: all that flew comes out."""
    if not state.airborne:
        return []
    if state.low is not None and _flew(state.low):
        _keep(state, state.low.rows)
    held = state.held
    state.held, state.low, state.airborne, state.resumes = [], None, False, True
    return held


def _flew(low: _Low) -> bool:
    """Whether undecided rows that nothing follows were flight."""
    if low.tumbles or low.up_ns is not None or not low.rows:
        return low.tumbles or low.up_ns is not None
    calm_ns = int(low.rows[-1].t_ns[-1]) - low.loud_ns
    return low.loud * low.rows[0].dt_s >= LOUD_S and calm_ns < CALM_S * NS_PER_S


@dataclass(frozen=True, slots=True)
class Hidden:
    """A part of a log in which the vehicle flew and nobody could judge it. begin_s, end_s: of the vehicle's clock."""

    begin_s: float
    end_s: float
    reason: str

    @property
    def span_s(self) -> float:
        """How long it is [s]."""
        return self.end_s - self.begin_s


def hidden_flight(telemetry: Telemetry, gate: GateSpec, spans: Sequence[tuple[int, int]]) -> tuple[Hidden, ...]:
    """Where a vehicle that had taken off flew on though the gate passed no rows, in order of time.

    The gyro ends while thrust, outputs, height and HEARTBEAT say that it flies; the thrust reads low while the outputs
    (or the gyro's motion, where no output is known) are what they were in flight; it reads disarmed while its thrust is
    up and it moves. telemetry: what is believed. spans: first and last row of what flew [ns].
    """
    tallies = {one.signal: _tally(one) for one in telemetry.series if one.signal in SHOWS_FLIGHT and len(one)}
    bins: IntArray = np.unique(np.concatenate([np.empty(0, np.int64), *(numbers for numbers, _ in tallies.values())]))
    bins = bins[bins > spans[0][0] // HIDDEN_BIN_NS] if spans else bins[:0]
    if not len(bins):
        return ()
    flown = np.zeros(len(bins), dtype=np.bool_)
    for first, last in spans:
        flown |= (bins >= first // HIDDEN_BIN_NS) & (bins <= last // HIDDEN_BIN_NS)
    sums = {signal: _gathered(*tallies[signal], bins) if signal in tallies else None for signal in SHOWS_FLIGHT}
    thrust, outputs, height = (_mean(sums[signal], HELD_BINS, len(bins)) for signal in SHOWS_FLIGHT[1:4])
    armed, motion = _mean(sums[Signal.ARMED], len(bins), len(bins)), _motion(sums[Signal.BODY_RATE], len(bins))
    dead, moves = ~np.isfinite(motion), motion >= FLIES * _median(motion[flown])
    down = outputs < FLIES * _median(outputs[flown])
    low = thrust < (gate.min_thrust or 0.0)
    off = (armed < 0.5) & gate.need_armed
    driven = np.where(np.isfinite(outputs), ~down, moves)
    reasons = {
        "it reads disarmed while its thrust says that it flies": off & (thrust > 0) & ~low & ~down & (moves | dead),
        "no gyro": ~off & dead & ~low & ~down & ~(height < (gate.min_height_m or -np.inf)),
        "its thrust reads 0 while it flies": ~off & ~dead & low & driven,
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


def _tally(series: Series) -> tuple[IntArray, FloatArray]:
    """Numbers of the bins of a signal, one may come again, and the sums of `_tally_runs` in each."""
    t_ns = np.ascontiguousarray(series.t_ns)
    runs = 1 + int(np.count_nonzero(np.diff(t_ns // HIDDEN_BIN_NS)))
    numbers, sums = np.empty(runs, dtype=np.int64), np.zeros((runs, 7))
    _tally_runs(t_ns, np.ascontiguousarray(series.values, dtype=np.float64), numbers, sums)
    return numbers, sums


@cached_loop
def _tally_runs(t_ns: IntArray, values: FloatArray, bins: IntArray, sums: FloatArray) -> None:
    """Number and sum of all values that are known; then stamps, and of the first three columns squares and sums."""
    run, last = -1, 0
    for i in range(len(t_ns)):
        number = t_ns[i] // HIDDEN_BIN_NS
        if i == 0 or number != last:
            run, last = run + 1, number
            bins[run] = number
        for column in range(values.shape[1]):
            value = values[i, column]
            if np.isfinite(value):
                sums[run, 0] += 1.0
                sums[run, 1] += value
        if i == 0 or t_ns[i] != t_ns[i - 1]:
            sums[run, 2] += 1.0
            for column in range(min(values.shape[1], 3)):
                sums[run, 3] += values[i, column] ** 2
                sums[run, 4 + column] += values[i, column]


def _gathered(numbers: IntArray, sums: FloatArray, bins: IntArray) -> FloatArray:
    """(bins, 7) sums of all runs in each bin."""
    found, place = np.zeros((len(bins), 7)), bins.searchsorted(numbers).clip(0, len(bins) - 1)
    inside = bins[place] == numbers
    np.add.at(found, place[inside], sums[inside])
    return found


def _mean(sums: FloatArray | None, most: int, count: int) -> FloatArray:
    """(count,) mean of the finite values of each bin, else the last known one, for so many bins; else nan."""
    if sums is None:
        return np.full(count, np.nan)
    known, number = sums[:, 0] > 0, np.arange(count)
    place = np.maximum.accumulate(np.where(known, number, -1))
    means = sums[:, 1] / np.maximum(sums[:, 0], 1.0)
    return np.where((place >= 0) & (number - place <= most), means[place], np.nan)


def _motion(sums: FloatArray | None, count: int) -> FloatArray:
    """(count,) standard deviation of the body rates, nan where the gyro has no two stamps [rad/s]."""
    motion = np.full(count, np.nan)
    if sums is not None:
        several = sums[:, 2] > 1
        means = sums[several, 3:] / sums[several, 2:3]
        motion[several] = np.sqrt(np.maximum(means[:, 0] - np.square(means[:, 1:]).sum(axis=1), 0.0) / 3.0)
    return motion


def _median(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else np.nan
