"""Healthy flights before anything is learnt: the link they came over, and their rows of flight.

Signals and rows are put on a shelf, which is a file if they are many: a flight is read once, its rows are mapped anew
for each look (guards, fits, scores), and of many flights one is in memory at a time.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from mavdiag.baseline import SESSION_GAP_NS, SourceLog
from mavdiag.errors import InputError
from mavdiag.link.samples import joined
from mavdiag.logs import gate_for
from mavdiag.monitors.base import ROOM
from mavdiag.rows.align import USED, AlignSpec, Grid, measure_grid
from mavdiag.rows.block import Block, in_rotor_order, with_outputs
from mavdiag.rows.front import Front, Rows, in_pieces
from mavdiag.rows.gate import Border, GateSpec, shake
from mavdiag.rows.grid import median_step, rate_tolerance
from mavdiag.rows.rates import RateSpec
from mavdiag.rows.savgol import window_samples
from mavdiag.storage import Arrays, Shelf
from mavdiag.telemetry import EARLIEST_NS, Log, Series, Signal, Telemetry
from mavdiag.thresholds.heldout import Looks
from mavdiag.units import NS_PER_S

MIN_FLIGHT_S = 2.0  # less airborne flight than this teaches nothing (our choice)
MAX_GAP_S = 0.035  # METHOD section 4: gaps up to 35 ms may be interpolated
SHAKE_SHARE = 0.2  # of the usual noise of the gyro in flight; at rest it has a fiftieth (our choice)
SLOW_SETPOINT_PERIODS = 2.5  # a set-point stream slower than the gyro has gaps by nature (our choice)
PIECE_ROWS = 40_000  # that are made and looked at together (our choice: 20 MB)
IN_MEMORY = 1 << 62  # bytes
LEAVE_OUT = ", or leave it out with --robust"  # a remedy where `learn` has that option
KEPT_BYTES = 32 << 20  # holds the columns of 40 s at 1 kHz (our choice; the most that glibc takes)


@dataclass(frozen=True, slots=True, eq=False)
class HeldLog:
    """A log whose signals are on a shelf: the log without them, which they are, and what gives its pieces, in order.

    dt_s, grid: mean gyro period [s], and how rows are placed. setpoint_s: period of the set-points [s]; 0 without any.
    """

    label: Log
    dt_s: float
    grid: Grid
    setpoint_s: float
    signals: tuple[Signal, ...]
    parts: tuple[Callable[[], Telemetry], ...]
    shelf: Shelf

    def pieces(self) -> Iterator[Telemetry]:
        """The signals, some thousand rows at a time. The vehicle's clock stands for the recorder's."""
        return (make() for make in self.parts)

    def open(self, signal: Signal) -> Telemetry:
        """One signal, whole."""
        pieces = (Telemetry(tuple(one for one in piece if one.signal is signal)) for piece in self.pieces())
        return next(pieces) if len(self.parts) == 1 else joined(pieces)

    def without(self, from_s: float | None, to_s: float | None) -> "HeldLog":
        """The log without what lies between two times [s of the vehicle's clock]; None for its start or its end."""
        low, high = -np.inf if from_s is None else from_s, np.inf if to_s is None else to_s
        kept = (
            Telemetry(tuple(series.where((series.t_s < low) | (series.t_s >= high)) for series in piece))
            for piece in self.pieces()
        )
        return replace(self, parts=_put_aside(kept, self.shelf))


def hold(log: Log | HeldLog, shelf: Shelf | None = None) -> HeldLog:
    """The log, its signals put aside, without a shelf in memory. Raises InputError, naming it, if it lacks the gyro."""
    if isinstance(log, HeldLog):
        return log
    try:
        dt_s, grid = measure_grid(log.telemetry)
    except InputError as error:
        raise InputError(f"{log.name}: {error}; see `mavdiag look`") from error
    used = Telemetry(tuple(one for one in log.telemetry.series if one.signal in USED))
    setpoint_s = median_step([one.t_ns for one in used if one.signal is Signal.ATTITUDE_SETPOINT]) / NS_PER_S
    shelf, label = shelf or Shelf(IN_MEMORY), replace(log, telemetry=Telemetry())
    parts = _put_aside(in_pieces(used, PIECE_ROWS), shelf)
    return HeldLog(label, dt_s, grid, setpoint_s, tuple(one.signal for one in used), parts, shelf)


def _put_aside(pieces: Iterable[Telemetry], shelf: Shelf) -> tuple[Callable[[], Telemetry], ...]:
    parts = []
    for piece in pieces:
        get = shelf.put([array for one in piece for array in (one.t_ns, one.values)])
        parts.append(partial(_piece, tuple(one.signal for one in piece), get))
    return tuple(parts)


def _piece(signals: Sequence[Signal], get: Callable[[], Arrays]) -> Telemetry:
    arrays = get()
    pairs = zip(signals, arrays[::2], arrays[1::2], strict=True)
    return Telemetry(tuple(Series(one, t_ns, t_ns, values) for one, t_ns, values in pairs))


@dataclass(frozen=True, slots=True, eq=False)
class LearntFlight:
    """A flight, its rows of flying in order, and how long of them may be judged [s]."""

    held: HeldLog
    rows: Looks
    judged_s: float

    @property
    def label(self) -> Log:
        """The log without its signals."""
        return self.held.label

    def by_rotor(self, outputs: tuple[int, ...] | None) -> "LearntFlight":
        """The flight with its outputs by rotor; a log that has them by motor already stays as it is."""
        if outputs is None or self.label.motor_order:
            return self
        return replace(self, rows=Looks(partial(_in_order, outputs, make) for make in self.rows.makers))


def airborne(front: Front, flight: Log | HeldLog, outputs: int | None = None) -> LearntFlight:
    """The flying part of a flight, put aside where its log is.

    outputs: columns of outputs and of rotor speeds that are kept, None for all. Raises InputError, naming the flight,
    if there is hardly any.
    """
    held, makers, judged, flown = hold(flight), list[Callable[[], Rows]](), 0, 0
    for rows in pieces_of(front, held.pieces()):
        judged, flown = judged + int(np.count_nonzero(rows.rates.rated)), flown + len(rows.block)
        sent, speeds = rows.block.actuator.T[:outputs], rows.block.rotor_speed.T[:outputs]
        block = with_outputs(rows.block, sent, speeds, ROOM)
        get = held.shelf.put([block.t_ns, block.whole.T, rows.rates_ns])
        makers.append(partial(_rows, block.segment, block.dt_s, block.outputs, get))
    judged_s = judged * front.align.dt_s
    if judged_s < MIN_FLIGHT_S:
        start = f" (without the first {front.gate.trim_start_s:g} s after a take-off or start)"
        why = start * (front.gate.trim_start_s > 0) if flown else " (never armed, or no thrust)"
        raise InputError(f"{held.label.name}: only {judged_s:.1f} s of airborne flight{why}, too short to learn from")
    return LearntFlight(held, Looks(makers), judged_s)


def outputs_in_use(flights: Sequence[HeldLog]) -> int:
    """How many columns of outputs and rotor speeds the flights use: behind them all outputs are 0, no speed is told."""
    most = 0
    for series in (one for flight in flights for piece in flight.pieces() for one in piece):
        if series.signal in (Signal.ACTUATOR, Signal.ROTOR_SPEED):
            used = np.isfinite(series.values) & (series.values != 0.0)
            used |= np.isnan(series.values) & (series.signal is Signal.ACTUATOR)
            most = max(most, *(np.flatnonzero(used.any(axis=0)) + 1).tolist(), 0)
    return most


def _rows(segment: int, dt_s: float, outputs: int, get: Callable[[], Arrays]) -> Rows:
    t_ns, columns, rates_ns = get()
    return Rows(Block(segment, dt_s, t_ns, columns.T, outputs, first=ROOM), rates_ns)


def _in_order(outputs: tuple[int, ...], make: Callable[[], Rows]) -> Rows:
    rows = make()
    return Rows(in_rotor_order(rows.block, outputs), rows.rates_ns)


def pieces_of(front: Front, pieces: Iterable[Telemetry]) -> Iterator[Rows]:
    """The rows of a whole flight, some thousand at a time."""
    return (part for part in front.pieces(pieces) if not isinstance(part, Border))


def rows_of(front: Front, telemetry: Telemetry) -> tuple[Rows, ...]:
    """All rows of a whole flight."""
    return tuple(pieces_of(front, in_pieces(telemetry, PIECE_ROWS)))


def front_for(flights: Iterable[Log | HeldLog], window_s: float, gate: GateSpec | None = None) -> Front:
    """The front that suits all the flights. gate: what counts as flying, None for what their profile has.

    Raises InputError, naming the flight, if one lacks the gyro, or is of another link or rate.
    """
    held = [hold(flight) for flight in flights]
    profiles = sorted({flight.label.profile for flight in held})
    if len(profiles) != 1:
        raise InputError(f"the flights come over different links ({', '.join(profiles)}); learn from one kind")
    if (odd := odd_rate(held, window_s)) is not None:
        raise InputError(f"{odd[1]}; learn from flights of one rate{LEAVE_OUT if len(held) > 2 else ''}")
    dt_s, grid = _common_grid(held)
    setpoint_s = float(np.median([flight.setpoint_s for flight in held if flight.setpoint_s] or [0.0]))
    align = AlignSpec(dt_s, grid, max_gap_s=max(MAX_GAP_S, SLOW_SETPOINT_PERIODS * setpoint_s))
    front = Front(align, gate or gate_for(profiles[0]), RateSpec.of(dt_s, window_samples(dt_s, window_s)))
    silent = [flight for flight in held if Signal.THRUST_SETPOINT not in flight.signals]
    if front.gate.min_thrust is None or len(silent) < len(held):
        return front
    levels = []  # where no thrust does, a fifth of what the gyro shakes in the calmest flight tells flight from ground
    for flight in silent:
        noise = [shake(rows.block.rate, dt_s) for rows in pieces_of(front, flight.pieces())]
        found = np.concatenate([np.empty(0), *noise])
        levels += [float(np.quantile(found, 0.75))] if len(found) else []
    least_shake = min(levels, default=0.0) * SHAKE_SHARE or None
    return replace(front, gate=replace(front.gate, least_shake=least_shake))


def _common_grid(flights: Sequence[HeldLog]) -> tuple[float, Grid]:
    """Median of the flights' mean gyro periods [s], and the grid that suits all."""
    grid = Grid.NATIVE if all(flight.grid is Grid.NATIVE for flight in flights) else Grid.RESAMPLED
    return float(np.median([flight.dt_s for flight in flights])), grid


def odd_rate(flights: Sequence[HeldLog], window_s: float) -> tuple[int, str] | None:
    """Number of the flight whose gyro rate differs most from the others', and a sentence; None if a model bears all."""
    dt_s, grid = _common_grid(flights)
    apart = [abs(flight.dt_s / dt_s - 1) for flight in flights]
    tolerance, odd = rate_tolerance(grid, dt_s, window_s), int(np.argmax(apart))
    if apart[odd] <= tolerance:
        return None
    name, others_s = flights[odd].label.name, _common_grid([*flights[:odd], *flights[odd + 1 :]])[0]
    rates = f"a gyro rate of {1 / flights[odd].dt_s:.1f} Hz, the others have {1 / others_s:.1f} Hz"
    return odd, f"{name} has {rates}, more than {100 * tolerance:.0f} % apart"


def sessions_of(flights: Sequence[Log | SourceLog], told: int | None = None) -> list[int]:
    """The session of each flight, numbered from 0: flights an hour apart by the wall clock are of two sessions.

    told: how many sessions there were, in equal parts and in the order of the flights. Without it a flight whose time
    is not known, or was never set, counts as a session of its own.
    """
    if told is not None:
        return [i * min(told, len(flights)) // len(flights) for i in range(len(flights))]
    order = sorted(range(len(flights)), key=lambda i: flights[i].started_ns)
    found, number, last_ns = [0] * len(flights), -1, 0
    for i in order:
        started_ns = flights[i].started_ns
        number += last_ns <= EARLIEST_NS or started_ns - last_ns > SESSION_GAP_NS
        found[i], last_ns = number, started_ns
    return found
