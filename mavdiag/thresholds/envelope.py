"""The envelope of a baseline: the conditions that its healthy flights covered, and what holds beside them.

A threshold speaks for the conditions under which it was learnt. For a condition c with the largest healthy value C (or
what counts as nothing, if that is more), and e = (c - C)/(R C):

    e <= 0         inside: the threshold as it was learnt
    0 < e <= 1     near: the threshold times 1 + R e = c/C; what a linear model leaves grows no faster than its input
    e > 1          outside, from (1 + R) C on: not judged

R is the room of the condition. It counts what was flown in the memory of the monitor's statistic. A statistic that is a
time (FSD) does not grow so: near, its threshold stays as it was learnt. A value that was reached once and lies far
beyond all others was no manoeuvre: a wrong sample widens nothing. A condition that no healthy flight told of, or that
the link does not carry now, restricts nothing.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from mavdiag.errors import InputError
from mavdiag.rows.conditions import BIN_S, Condition, Conditions, ConditionState, measure, start_conditions
from mavdiag.rows.front import Rows
from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import BoolArray, FloatArray, IntArray
from mavdiag.units import NS_PER_S

__all__ = ["Covered", "Dependence", "Envelope", "EnvelopeState", "Outside", "covered_by"]

ORDER = tuple(Condition)
OUTLIER = 2.0  # times as far from the median as the next largest: a wrong sample, and no manoeuvre (our choice)
EVENT_BINS = 50  # on each side of the largest; the longest memory of a condition is 5 s


@dataclass(frozen=True, slots=True)
class _Rule:
    """How a condition is compared.

    side: which side is limited; "both" takes the span between.
    least: what counts as covered anyway: up to here, from here on, or so large a share about the middle of a span
        (our choices; below half a metre the ground blows back).
    unit: as a text gives it.
    remedy: what to fly to cover more.
    room: R, how far "near" reaches, as a share of what is covered (our choices).
    """

    side: Literal["upper", "lower", "both"]
    least: float
    unit: str
    remedy: str
    room: float = 0.5


RULES: dict[Condition, _Rule] = {
    Condition.TILT: _Rule("upper", 0.2, "rad", "fly in steady wind"),
    Condition.THROTTLE: _Rule("both", 0.25, "", "fly with payload, and with a battery that empties"),
    Condition.COMMANDED_RATE: _Rule("upper", 0.3, "rad/s", "fly sharper turns and stops", 1.0),
    Condition.COMMANDED_ACCELERATION: _Rule("upper", 5.0, "rad/s^2", "fly sharper turns and stops", 1.0),
    Condition.YAW_RATE: _Rule("upper", 0.15, "rad/s", "turn the nose, steadily and along the path"),
    Condition.HEIGHT: _Rule("lower", 0.5, "m", "fly as low as it is to be judged"),
}


@dataclass(frozen=True, slots=True)
class Covered:
    """What the healthy flights covered of a condition, least to most. Raises InputError if that is no span."""

    condition: Condition
    low: float
    high: float

    def __post_init__(self) -> None:
        if not (np.isfinite(self.low) and np.isfinite(self.high) and self.low <= self.high):
            raise InputError(f"envelope: {self.condition} from {self.low} to {self.high} is no span")

    def excess(self, values: FloatArray) -> FloatArray:
        """e of values: 0 inside, up to 1 near, above 1 outside; 0 where unknown."""
        low, high, reach = self.borders()
        return _excess(values, low, high, reach)

    def borders(self) -> tuple[float, float, float]:
        """Where e is 0 below and above, infinite on a side that is not limited, and how far from there it is 1."""
        rule = RULES[self.condition]
        low, high = self._limits()
        if rule.side == "both":
            return low, high, rule.room * (high - low)
        if rule.side == "upper":
            return -np.inf, high, rule.room * high
        return (low, np.inf, rule.room * low) if low > 0 else (-np.inf, np.inf, 1.0)

    def sentence(self, value: float) -> str:
        """What was flown and what was learnt: "yaw rate 1.8 rad/s, learnt up to 0.3".

        >>> Covered(Condition.YAW_RATE, 0.0, 0.3).sentence(1.81)
        'yaw rate 1.8 rad/s, learnt up to 0.3'
        """
        rule = RULES[self.condition]
        unit = f" {rule.unit}" if rule.unit else ""
        return f"{self.condition} {_figure(value, 3 if rule.side == 'both' else 2)}{unit}, learnt {self._span()}"

    def __str__(self) -> str:
        unit = RULES[self.condition].unit
        return f"{self.condition} {self._span()}" + (f" {unit}" if unit else "")

    def advice(self) -> str | None:
        """What would widen it; None if the flights covered more than nothing."""
        rule = RULES[self.condition]
        if rule.side == "upper":
            return rule.remedy if self.high <= rule.least else None
        narrow = rule.side == "both" and self.high - self.low <= 2 * rule.least * self._middle
        return rule.remedy if narrow else None

    def _span(self) -> str:
        side, (low, high) = RULES[self.condition].side, self._limits()
        if side == "both":
            return f"{_figure(low, 3)} to {_figure(high, 3)}"
        return f"up to {_figure(high, 2)}" if side == "upper" else f"from {_figure(low, 2)}"

    def _limits(self) -> tuple[float, float]:
        """What counts as covered."""
        rule = RULES[self.condition]
        if rule.side == "upper":
            return self.low, max(self.high, rule.least)
        if rule.side == "lower":
            return min(self.low, rule.least), self.high
        reach = max(0.5 * (self.high - self.low), rule.least * abs(self._middle), 1e-9)
        return self._middle - reach, self._middle + reach

    @property
    def _middle(self) -> float:
        return 0.5 * (self.low + self.high)


def _excess(
    values: FloatArray, low: float | FloatArray, high: float | FloatArray, reach: float | FloatArray
) -> FloatArray:
    return np.fmax(np.fmax(values - high, low - values) / reach, 0.0)


def _figure(value: float, digits: int) -> str:
    """A value to so many digits, and never with an exponent for a large one."""
    return f"{value:.0f}" if abs(value) >= 10**digits else f"{value:.{digits}g}"


def covered_by(flights: Iterable[Sequence[Rows]]) -> tuple[Covered, ...]:
    """What flights covered, of the conditions that their links carry."""
    found = [np.empty((0, len(ORDER)))]
    for flight in flights:
        segment, state = None, start_conditions()
        for rows in flight:
            if rows.block.segment != segment:
                segment, state = rows.block.segment, start_conditions()
            state, bins = measure(state, rows)
            found.append(bins.values)
    values = np.concatenate(found)
    known = np.isfinite(values)
    columns = {condition: values[known[:, i], i] for i, condition in enumerate(ORDER) if known[:, i].any()}
    return tuple(Covered(condition, -_end(-column), _end(column)) for condition, column in columns.items())


def _end(values: FloatArray) -> float:
    """The largest value, in order of time; the largest of any other five seconds where that is an outlier."""
    if len(values) < 4 * EVENT_BINS:
        return float(values.max())
    top, middle = int(values.argmax()), float(np.median(values))
    others = np.delete(values, slice(max(0, top - EVENT_BINS), top + EVENT_BINS + 1))
    largest, following = float(values[top]), float(others.max())
    return following if largest - middle > OUTLIER * (following - middle) else largest


@dataclass(frozen=True, slots=True)
class Dependence:
    """What a slot's statistic depends on.

    conditions: those that raise it in healthy flight.
    memory_s: how long what was flown stays in it [s].
    grows: it grows with a condition as an amplitude does; a time does not.
    """

    conditions: frozenset[Condition]
    memory_s: float
    grows: bool = True


@dataclass(frozen=True, slots=True)
class Outside:
    """Time that a slot did not judge for a condition [s], and the condition's farthest value."""

    span_s: float
    value: float
    excess: float

    def plus(self, other: "Outside") -> "Outside":
        """Both together."""
        far = self if self.excess >= other.excess else other
        return Outside(self.span_s + other.span_s, far.value, far.excess)


@dataclass(frozen=True, slots=True, eq=False)
class EnvelopeState:
    """Memory: of the conditions, and the bins that may still count: end_ns (h,), values and excess (h, covered)."""

    conditions: ConditionState
    end_ns: IntArray
    values: FloatArray
    excess: FloatArray


@dataclass(frozen=True, slots=True)
class Envelope:
    """The covered conditions and what each slot depends on. delay_s: half the window of the rate filters."""

    covered: tuple[Covered, ...] = ()
    slots: tuple[Dependence, ...] = ()
    delay_s: float = 0.0
    _order: list[int] = field(init=False, repr=False, compare=False)
    _borders: FloatArray = field(init=False, repr=False, compare=False)
    _longest_ns: int = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        longest_s = max((slot.memory_s for slot in self.slots), default=0.0) + self.delay_s + 2 * BIN_S
        object.__setattr__(self, "_order", [ORDER.index(one.condition) for one in self.covered])
        object.__setattr__(self, "_borders", np.array([one.borders() for one in self.covered]).reshape(-1, 3).T)
        object.__setattr__(self, "_longest_ns", round(longest_s * NS_PER_S))

    def start(self) -> EnvelopeState:
        """Before the first row of a segment."""
        none = np.empty((0, len(self.covered)))
        return EnvelopeState(start_conditions(), np.empty(0, dtype=np.int64), none, none)

    def step(self, state: EnvelopeState, rows: Rows) -> EnvelopeState:
        """Take the next rows of the same segment."""
        if not self.covered:
            return state
        conditions, bins = measure(state.conditions, rows)
        if len(bins.end_ns) == 0:
            return EnvelopeState(conditions, state.end_ns, state.values, state.excess)
        values, excess = self._compared(bins)
        keep_ns = int(rows.block.t_ns[0]) - self._longest_ns
        first = int(state.end_ns.searchsorted(keep_ns))
        return EnvelopeState(
            conditions,
            np.concatenate((state.end_ns[first:], bins.end_ns)),
            np.concatenate((state.values[first:], values)),
            np.concatenate((state.excess[first:], excess)),
        )

    def apply(self, number: int, found: Statistic, state: EnvelopeState) -> tuple[Statistic, dict[Condition, Outside]]:
        """A slot's statistic as the envelope lets it count, and what it does not let judge."""
        slot = self.slots[number] if self.covered else None
        if slot is None or len(found) == 0:
            return found, {}
        if not np.count_nonzero(state.excess):
            return found, {}
        columns = [i for i, one in enumerate(self.covered) if one.condition in slot.conditions]
        if not columns or not np.count_nonzero(state.excess[:, columns]):
            return found, {}
        far = _farthest(state, columns, found.t_ns, slot.memory_s, self.delay_s + BIN_S)
        if not np.count_nonzero(far.excess):
            return found, {}
        outside: BoolArray = far.excess > 1.0
        reasons = {}
        for column in columns:
            here = outside & (far.column == column)
            if here.any():
                farthest = int(np.argmax(np.where(here, far.excess, -1.0)))
                span_s = float(far.counts[here].sum()) * found.period_s
                value = float(state.values[far.place[farthest], column])
                reasons[self.covered[column].condition] = Outside(span_s, value, float(far.excess[farthest]))
        rooms = np.array([RULES[one.condition].room for one in self.covered])
        grown = 1.0 if not slot.grows else np.repeat(1.0 + rooms[far.column] * np.minimum(far.excess, 1.0), far.counts)
        valid = found.valid & ~np.repeat(outside, far.counts) if reasons else found.valid
        return replace(found, value=found.value / grown, valid=valid), reasons

    def covers(self, state: EnvelopeState, conditions: frozenset[str], memory_s: float, t_ns: IntArray) -> BoolArray:
        """At which times (n,) none of these conditions was outside in the last so many seconds."""
        columns = [i for i, one in enumerate(self.covered) if one.condition in conditions]
        if len(t_ns) == 0 or not columns or not np.count_nonzero(state.excess[:, columns]):
            return np.ones(len(t_ns), dtype=np.bool_)
        far = _farthest(state, columns, t_ns, memory_s, self.delay_s + BIN_S)
        return np.repeat(far.excess <= 1.0, far.counts)

    def sentence(self, condition: Condition, value: float) -> str:
        """Why a slot does not judge."""
        return next(one for one in self.covered if one.condition is condition).sentence(value)

    def _compared(self, bins: Conditions) -> tuple[FloatArray, FloatArray]:
        values = bins.values[:, self._order]
        return values, _excess(values, *self._borders)


@dataclass(frozen=True, slots=True, eq=False)
class _Far:
    """Runs of consecutive values with the same bins behind them: how many values, the largest excess, its column and
    bin; (k,) each."""

    counts: IntArray
    excess: FloatArray
    column: IntArray
    place: IntArray


def _farthest(state: EnvelopeState, columns: Sequence[int], t_ns: IntArray, memory_s: float, delay_s: float) -> _Far:
    """What lies farthest outside behind each value. There is at least one bin.

    Bins count that end within the memory, up to `delay_s` before the value: by then each of them is known.
    """
    enters = t_ns.searchsorted(state.end_ns + round(delay_s * NS_PER_S))  # the first value that a bin counts for
    leaves = t_ns.searchsorted(state.end_ns + round(memory_s * NS_PER_S))  # and from where on it does not
    begins = np.sort(np.concatenate(([0], enters, leaves)), kind="stable")
    begins = begins[(np.diff(begins, prepend=-1) > 0) & (begins < len(t_ns))]
    first, stop = leaves.searchsorted(begins, side="right"), enters.searchsorted(begins, side="right")
    chosen = state.excess[:, columns]
    worst = chosen.argmax(axis=1)  # of each bin
    most = chosen[np.arange(len(chosen)), worst]
    many = np.add.accumulate(np.concatenate(([0], most > 0)))
    some = np.flatnonzero(many[np.maximum(stop, first)] > many[first])  # the others have nothing outside behind them
    excess, place = np.zeros(len(begins)), np.zeros(len(begins), dtype=np.int64)
    if len(some):
        bins = first[some, None] + np.arange(int((stop - first)[some].max()))
        behind = np.where(bins < stop[some, None], most.take(bins, mode="clip"), 0.0)
        at = behind.argmax(axis=1)
        excess[some], place[some] = behind[np.arange(len(at)), at], first[some] + at
    return _Far(np.diff(begins, append=len(t_ns)), excess, np.array(columns)[worst[place]], place)
