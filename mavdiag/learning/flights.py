"""Healthy flights before anything is learnt: the link they came over, and their rows of flight."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mavdiag.baseline import SESSION_GAP_NS
from mavdiag.errors import InputError
from mavdiag.learning.held import HeldLog, HeldRows, of_memory
from mavdiag.logs import gate_for
from mavdiag.rows.align import AlignSpec, Grid
from mavdiag.rows.front import Front, Rows
from mavdiag.rows.gate import Border, GateSpec, shake
from mavdiag.rows.rates import RateSpec
from mavdiag.rows.savgol import window_samples
from mavdiag.rows.tolerance import rate_tolerance
from mavdiag.storage import Shelf
from mavdiag.telemetry import IntArray, Log, Signal, Telemetry
from mavdiag.units import NS_PER_S

__all__ = [
    "LearntFlight",
    "airborne",
    "airborne_of",
    "front_for",
    "front_of_held",
    "odd_rate",
    "rows_of",
    "sessions_of",
]

MIN_FLIGHT_S = 2.0  # less airborne flight than this teaches nothing (our choice)
MAX_GAP_S = 0.035  # METHOD section 4: gaps up to 35 ms may be interpolated
SHAKE_SHARE = 0.2  # of the usual noise of the gyro in flight; at rest it has a fiftieth (our choice)
SLOW_SETPOINT_PERIODS = 2.5  # a set-point stream slower than the gyro has gaps by nature (our choice)


@dataclass(frozen=True, slots=True, eq=False)
class LearntFlight:
    """A flight, its rows of flying in order, and how long of them may be judged [s]."""

    held: HeldLog
    rows: Sequence[Rows]
    judged_s: float

    @property
    def label(self) -> Log:
        """The log without its signals."""
        return self.held.label

    @property
    def flight(self) -> Log:
        """The log with its signals."""
        return self.held.open()

    @property
    def spans_ns(self) -> list[tuple[int, int]]:
        """First and last time of each span of flight that may be judged [ns]."""
        spans: dict[int, tuple[int, int]] = {}
        for block in (one.block for one in self.rows):
            t_ns = block.t_ns[block.valid]
            if len(t_ns):
                first_ns, _ = spans.get(block.segment, (int(t_ns[0]), 0))
                spans[block.segment] = first_ns, int(t_ns[-1])
        return list(spans.values())


def front_for(flights: Iterable[Log], window_s: float, gate: GateSpec | None = None) -> Front:
    """The front that suits all the flights. gate: what counts as flying, None for what their profile has.

    Raises InputError, naming the flight, if one lacks the gyro or comes over another kind of link or at another rate.
    """
    return front_of_held([of_memory(flight) for flight in flights], window_s, gate)


def front_of_held(flights: Sequence[HeldLog], window_s: float, gate: GateSpec | None = None) -> Front:
    """As `front_for`, for flights that were measured when they were put aside."""
    profiles = sorted({flight.label.profile for flight in flights})
    if len(profiles) != 1:
        raise InputError(f"the flights come over different links ({', '.join(profiles)}); learn from one kind")
    dt_s, grid, odd = _common_grid(flights, window_s)
    if odd is not None:
        raise InputError(f"{odd[1]}; learn from flights of one rate, or leave this log out with --robust")
    align = AlignSpec(dt_s, grid, max_gap_s=_gap_limit(flights))
    front = Front(align, gate or gate_for(profiles[0]), RateSpec.of(dt_s, window_samples(dt_s, window_s)))
    silent = [flight for flight in flights if Signal.THRUST_SETPOINT not in flight.signals]
    if front.gate.min_thrust is None or len(silent) < len(flights):
        return front
    return replace(front, gate=replace(front.gate, least_shake=_least_shake(front, silent)))


def _least_shake(front: Front, flights: Sequence[HeldLog]) -> float | None:
    """What a gyro shakes in flight at least, where no thrust tells flight from ground [rad/s].

    A fifth of what it does for most of the calmest flight: the motors' vibration makes tens of the noise at rest.
    """
    levels = []
    for flight in flights:
        noise = [shake(rows.block.rate, front.align.dt_s) for rows in rows_of(front, flight.open().telemetry)]
        found = np.concatenate([np.empty(0), *noise])
        levels += [float(np.quantile(found, 0.75))] if len(found) else []
    return min(levels, default=0.0) * SHAKE_SHARE or None


def odd_rate(flights: Sequence[HeldLog], window_s: float) -> tuple[int, str] | None:
    """Number of the flight whose gyro rate differs most from the others', and a sentence; None if a model bears all."""
    return _common_grid(flights, window_s)[2]


def _common_grid(flights: Sequence[HeldLog], window_s: float) -> tuple[float, Grid, tuple[int, str] | None]:
    """Median of the flights' mean gyro periods [s], the grid that suits all, and the flight that it does not suit."""
    native = all(flight.measure.grid is Grid.NATIVE for flight in flights)
    grid = Grid.NATIVE if native else Grid.RESAMPLED
    periods = np.array([flight.measure.dt_s for flight in flights])
    dt_s = float(np.median(periods))
    apart = np.abs(periods / dt_s - 1)
    tolerance, odd = rate_tolerance(grid, dt_s, window_s), int(apart.argmax())
    if apart[odd] <= tolerance:
        return dt_s, grid, None
    text = (
        f"{flights[odd].label.name} has a gyro rate of {1 / periods[odd]:.1f} Hz, the others have {1 / dt_s:.1f} Hz, "
        f"more than {100 * tolerance:.0f} % apart"
    )
    return dt_s, grid, (odd, text)


def rows_of(front: Front, telemetry: Telemetry) -> tuple[Rows, ...]:
    """All rows of a whole flight."""
    return tuple(part for part in front.whole(telemetry) if not isinstance(part, Border))


def airborne(front: Front, flight: Log) -> LearntFlight:
    """The flying part of a flight, in memory. Raises InputError, naming it, if there is hardly any."""
    rows = rows_of(front, flight.telemetry)
    return LearntFlight(of_memory(flight), rows, _judged_s(front, flight, rows))


def airborne_of(front: Front, flight: HeldLog, shelf: Shelf) -> LearntFlight:
    """The flying part of a flight, put aside as the flight is. Raises as `airborne`."""
    rows = rows_of(front, flight.open().telemetry)
    judged_s = _judged_s(front, flight.label, rows)
    return LearntFlight(flight, HeldRows.of(rows, shelf), judged_s)


def _judged_s(front: Front, flight: Log, rows: Sequence[Rows]) -> float:
    judged_s = float(sum(int(one.rates.valid.sum()) for one in rows)) * front.align.dt_s
    if judged_s < MIN_FLIGHT_S:
        never = "" if judged_s else " (never armed, or no thrust)"
        raise InputError(f"{flight.name}: only {judged_s:.1f} s of airborne flight{never}, too short to learn from")
    return judged_s


def sessions_of(flights: Sequence[Log], told: int | None = None) -> list[int]:
    """The session of each flight, numbered from 0: flights an hour apart by the wall clock are of two sessions.

    told: how many sessions there were, in equal parts and in the order of the flights. Without it a flight whose time
    is not known counts as a session of its own.
    """
    if told is not None:
        return [i * min(told, len(flights)) // len(flights) for i in range(len(flights))]
    order = sorted(range(len(flights)), key=lambda i: flights[i].started_ns)
    found, number, last_ns = [0] * len(flights), -1, 0
    for i in order:
        started_ns = flights[i].started_ns
        number += not started_ns or not last_ns or started_ns - last_ns > SESSION_GAP_NS
        found[i], last_ns = number, started_ns
    return found


def _gap_limit(flights: Sequence[HeldLog]) -> float:
    """35 ms, or a few periods of a set-point stream that is slower than that."""
    steps_ns = np.concatenate([flight.measure.steps_ns for flight in flights])
    counts = np.concatenate([flight.measure.counts for flight in flights])
    period_s = _median(steps_ns, counts) / NS_PER_S if len(steps_ns) else 0.0
    return max(MAX_GAP_S, SLOW_SETPOINT_PERIODS * period_s)


def _median(values: IntArray, counts: IntArray) -> float:
    """Median of values that occur so often each."""
    order = np.argsort(values)
    reached, total = np.cumsum(counts[order]), int(counts.sum())
    low, high = np.searchsorted(reached, [(total - 1) // 2, total // 2], side="right")
    return 0.5 * float(values[order[low]] + values[order[high]])
