"""The conditions of flight (`rows.conditions`) from the columns of rows: a running figure like a monitor's.

Rows are put into the bins of their times as they come. The rates of a bin come half a window later; with the first rate
of the next one a bin is whole. What is commanded counts from the rate on that shows it.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

import mavdiag.rows.block as col
from mavdiag.jit import cached, jit
from mavdiag.monitors.base import ROOM, Flights, parted
from mavdiag.monitors.fitting import of_each
from mavdiag.rows.conditions import BIN_S, Condition
from mavdiag.rows.front import Rows
from mavdiag.telemetry import FloatArray, IntArray
from mavdiag.thresholds.envelope import Covered, covered_from
from mavdiag.units import NS_PER_S

TILT_BINS = 50  # 5 s: longer than a manoeuvre of a hall, shorter than a change of the wind (our choice)
TURN_BINS = 20  # 2 s: so long may a vehicle turn after a step of its commanded heading (our choice)
BIN_NS = round(BIN_S * NS_PER_S)
COUNT = len(Condition)
OPEN_BINS = 64  # whose rows have come while their rates have not: twelve times the longest filter (our choice)
COMMANDS = slice(2, 5)  # the conditions that the rates tell: the largest so far in their bin
# Places in the memory: number of the bin of the newest rate; in it what `COMMANDS` are, and the newest three rates;
# these and the heading at the end of the bin before; bins so far; of each of the last bins the mean roll and pitch
# set-point and the slope of the heading; of each open bin its number, sums and counts of roll, pitch, thrust and yaw
# rate, the least height and the newest heading.
BIN, MOST, NEWEST, EDGE, BINS, PAST = 0, 1, 4, 7, 11, 12
SUMS, COUNTS, LOW, HEADED, WIDTH = 1, 5, 9, 10, 11
ROWS = PAST + 3 * TILT_BINS
MEMORY = ROWS + OPEN_BINS * WIDTH


def conditions_memory() -> FloatArray:
    """No row yet."""
    mem = np.full(MEMORY, np.nan)
    mem[[BIN, BINS]] = -1.0, 0.0
    mem[ROWS::WIDTH] = -1.0
    return mem


@jit
def _add(mem: FloatArray, at: int, value: float, j: int) -> None:
    if math.isfinite(value):
        mem[at + SUMS + j] += value
        mem[at + COUNTS + j] += 1.0


@jit
def _take_row(mem: FloatArray, number: int, x: FloatArray, i: int) -> None:
    """Put a row into its bin."""
    at = ROWS + number % OPEN_BINS * WIDTH
    if mem[at] != number:
        mem[at] = number
        for j in range(SUMS, LOW):
            mem[at + j] = 0.0
        mem[at + LOW] = math.nan
    mem[at + HEADED] = math.nan
    if x[col.VALID, i] < 0.5:
        return
    if x[col.SETPOINT, i] > 0.5:
        _add(mem, at, x[col.LEAN, i], 0)
        _add(mem, at, x[col.LEAN + 1, i], 1)
        mem[at + HEADED] = x[col.HEADING, i]
    _add(mem, at, x[col.THRUST, i], 2)
    _add(mem, at, x[col.RATE + 2, i], 3)
    if not x[col.HEIGHT, i] >= mem[at + LOW]:  # the first, or a lower one
        mem[at + LOW] = x[col.HEIGHT, i] if math.isfinite(x[col.HEIGHT, i]) else mem[at + LOW]


@jit
def _finish(mem: FloatArray, values: FloatArray, k: int) -> None:
    """The conditions of the bin of the newest rate, to row k."""
    at, past = ROWS + int(mem[BIN]) % OPEN_BINS * WIDTH, PAST
    known = mem[at] == mem[BIN]
    place = past + 3 * (int(mem[BINS]) % TILT_BINS)
    mem[BINS] += 1.0
    heading = mem[at + HEADED] if known else math.nan
    turned = abs(heading - mem[EDGE + 3]) / BIN_S
    mem[place + 2] = turned
    for j in range(2):
        mem[place + j] = mem[at + SUMS + j] / mem[at + COUNTS + j] if known else math.nan  # 0/0 is nan
    roll, pitch, most = 0.0, 0.0, -1.0
    for back in range(TILT_BINS):
        one = past + 3 * ((int(mem[BINS]) - 1 - back + TILT_BINS) % TILT_BINS)
        roll, pitch = roll + mem[one], pitch + mem[one + 1]
        if back < TURN_BINS and mem[one + 2] > most:
            most = mem[one + 2]
    values[k, 0] = math.hypot(roll / TILT_BINS, pitch / TILT_BINS)
    values[k, 1] = mem[at + SUMS + 2] / mem[at + COUNTS + 2] if known else math.nan
    for j in range(3):
        values[k, COMMANDS.start + j], mem[EDGE + j] = mem[MOST + j], mem[NEWEST + j]
    turning = abs(mem[at + SUMS + 3] / mem[at + COUNTS + 3]) if known else math.nan
    values[k, 5] = min(turning, most) if most >= 0.0 and math.isfinite(turning) else turning
    values[k, 6] = mem[at + LOW] if known else math.nan
    mem[EDGE + 3] = heading


@jit
def _take_rate(mem: FloatArray, x: FloatArray, i: int) -> None:
    """Put the commanded rates of a row into the bin of the newest rate."""
    for j in range(3):
        rate = x[col.U + j, i] if x[col.COMMANDED, i] > 0.5 else math.nan
        mem[NEWEST + j], step = rate, abs(rate - mem[EDGE + j]) / BIN_S
        if j < 2 and not mem[MOST] >= abs(rate) and math.isfinite(rate):
            mem[MOST] = abs(rate)
        for place in range(MOST + 1, MOST + 2 if j < 2 else MOST + 3):
            if not mem[place] >= step and math.isfinite(step):
                mem[place] = step


@jit
def take_rows(
    mem: FloatArray, x: FloatArray, first: int, known: int, times: Any, bins: Any, commands: FloatArray, k: int
) -> int:
    """Take the next rows; put the bins that they complete from k on, return where they end.

    times: of rows and of rates. bins: where they end, (n,) [ns], and their values, (n, COUNT or more), in the order of
    `Condition`; nan where unknown. commands: (3, k) for what `COMMANDS` are so far, at each rate.
    """
    (t_ns, rates_ns), (end_ns, values), row_bin, row_until, number, until = times, bins, 0, 0, 0, 0
    for i in range(first, x.shape[1]):
        if t_ns[i - first] >= row_until:
            row_bin = t_ns[i - first] // BIN_NS
            row_until = (row_bin + 1) * BIN_NS
        _take_row(mem, row_bin, x, i)
        if i < known:
            continue
        if rates_ns[i - known] >= until:
            number = rates_ns[i - known] // BIN_NS
            until = (number + 1) * BIN_NS
        if mem[BIN] != number:
            if mem[BIN] >= 0.0:
                end_ns[k] = (int(mem[BIN]) + 1) * BIN_NS
                _finish(mem, values, k)
                k += 1
            mem[BIN], mem[MOST : MOST + 3] = number, math.nan
        _take_rate(mem, x, i)
        for j in range(3):
            commands[j, i - known] = mem[MOST + j]
    return k


@cached
def _measured(
    mem: FloatArray, x: FloatArray, first: int, known: int, times: Any, end_ns: IntArray, values: FloatArray
) -> int:
    return take_rows(mem, x, first, known, times, (end_ns, values), np.empty((3, len(times[1]))), 0)


class Conditions(NamedTuple):
    """Whole bins. end_ns: (n,) where they end. values: (n, COUNT) in the order of `Condition`; nan where unknown."""

    end_ns: IntArray
    values: FloatArray


def most_bins(rates_ns: IntArray) -> int:
    """How many bins rates of these times [ns] may complete."""
    return int((rates_ns[-1] - rates_ns[0]) // BIN_NS) + 2 if len(rates_ns) else 0


def measure(flight: Sequence[Rows]) -> Iterator[Conditions]:
    """The bins of rows that follow each other; a new segment begins anew."""
    mem = conditions_memory()
    for begins, rows in parted(flight):
        mem = conditions_memory() if begins else mem
        columns, most = col.columns_of(rows, col.no_past(ROOM)), most_bins(rows.rates_ns)
        end_ns, values = np.empty(most, dtype=np.int64), np.empty((most, COUNT))
        times = rows.block.t_ns, rows.rates_ns
        count = _measured(mem, columns.x, columns.first, columns.known, times, end_ns, values)
        yield Conditions(end_ns[:count], values[:count])
        del rows, columns


def bins_of(flights: Flights) -> list[list[Conditions]]:
    """The bins of each flight, from memory where the flight keeps them."""
    return of_each(flights, measure, lambda flight: list(measure(flight)))


def covered_by(flights: Flights) -> tuple[Covered, ...]:
    """What flights covered, of the conditions that their links carry."""
    bins = [one.values for each in bins_of(flights) for one in each]
    return covered_from(np.concatenate([np.empty((0, COUNT)), *bins]))
