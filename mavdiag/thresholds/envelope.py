"""The envelope of a baseline: the conditions that its healthy flights covered, and what holds beside them.

For a condition c with the largest healthy value C (or what counts as nothing, if that is more), and e = (c - C)/(R C):

    e <= 0         inside: the threshold as it was learnt
    0 < e <= 1     near: the threshold times 1 + R e = c/C; what a linear model leaves grows no faster than its input
    e > 1          outside, from (1 + R) C on: not judged

R is the room of the condition. A statistic that is a time (FSD) does not grow so: it is judged inside alone. A
condition that no healthy flight told of, or that the link does not carry now, restricts nothing.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mavdiag.errors import InputError
from mavdiag.jit import jit
from mavdiag.rows.conditions import Condition
from mavdiag.telemetry import FloatArray, IntArray

ORDER = tuple(Condition)
OUTLIER = 2.0  # times as far from the median as the next largest: a wrong sample, and no manoeuvre (our choice)
EVENT_BINS = 50  # on each side of the largest; the longest memory of a condition is 5 s


@dataclass(frozen=True, slots=True)
class _Rule:
    """How a condition is compared: which side is limited, the unit in a text, and what to fly to cover more.

    least: what counts as covered anyway: up to here, from here on, or so large a share about the middle of a span
        (our choices; below half a metre the ground blows back).
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
    Condition.COMMANDED_RATE: _Rule("upper", 0.1, "rad/s", "fly sharper turns and stops", 1.0),
    Condition.COMMANDED_ACCELERATION: _Rule("upper", 5.0, "rad/s^2", "fly sharper turns and stops", 1.0),
    Condition.YAW_ACCELERATION: _Rule("upper", 0.1, "rad/s^2", "turn the nose, steadily and along the path", 1.0),
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

    def borders(self) -> tuple[float, float, float]:
        """Where e is 0 below and above, infinite on a side that is not limited, and how far from there it is 1."""
        rule, middle = RULES[self.condition], 0.5 * (self.low + self.high)
        if rule.side == "upper":
            high = max(self.high, rule.least)
            return -np.inf, high, rule.room * high
        if rule.side == "lower":
            low = min(self.low, rule.least)
            return (low, np.inf, rule.room * low) if low > 0 else (-np.inf, np.inf, 1.0)
        reach = max(0.5 * (self.high - self.low), rule.least * abs(middle), 1e-9)
        low, high = middle - reach, middle + reach
        return low, high, rule.room * (high - low)

    def sentence(self, value: float) -> str:
        """What was flown and what was learnt: "yaw rate 1.8 rad/s, learnt up to 0.3"."""
        rule = RULES[self.condition]
        return f"{self.condition} {_figure(value, rule)} {rule.unit}".rstrip() + f", learnt {self._span()}"

    def __str__(self) -> str:
        return f"{self.condition} {self._span()} {RULES[self.condition].unit}".rstrip()

    def _span(self) -> str:
        rule, (low, high, _) = RULES[self.condition], self.borders()
        if rule.side == "both":
            return f"{_figure(low, rule)} to {_figure(high, rule)}"
        return f"up to {_figure(high, rule)}" if rule.side == "upper" else f"from {_figure(max(low, 0.0), rule)}"

    def advice(self) -> str | None:
        """What would widen it; None if the flights covered more than nothing."""
        rule = RULES[self.condition]
        spread = {"upper": self.high, "both": (self.high - self.low) / (self.high + self.low or 1.0)}
        return rule.remedy if spread.get(rule.side, np.inf) <= rule.least else None


def _figure(value: float, rule: _Rule) -> str:
    """A value to two digits, of a span to three, and never with an exponent for a large one."""
    digits = 3 if rule.side == "both" else 2
    return f"{value:.0f}" if abs(value) >= 10**digits else f"{value:.{digits}g}"


def covered_from(values: FloatArray) -> tuple[Covered, ...]:
    """What bins of healthy flights covered, (n, conditions), of the conditions that their links carry."""
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


def limits_of(covered: Sequence[Covered]) -> FloatArray:
    """Borders and room of every condition, (conditions, 4): low, high, reach, R; infinite for what is not covered."""
    limits = np.tile([-np.inf, np.inf, 1.0, 0.0], (len(ORDER), 1))
    for one in covered:
        limits[ORDER.index(one.condition)] = *one.borders(), RULES[one.condition].room
    return limits


@jit
def excess_of(value: float, limits: FloatArray, condition: int) -> float:
    """e of a condition's value: 0 inside, up to 1 near, above 1 outside; 0 where unknown."""
    beyond = max(value - limits[condition, 1], limits[condition, 0] - value) / limits[condition, 2]
    return float(beyond) if beyond > 0.0 else 0.0


@jit
def farthest(bins: FloatArray, first: int, stop: int, depends: int) -> tuple[int, int]:
    """Bin and condition of the largest excess in [first, stop), of conditions whose bits are set; -1 if there is none.

    bins: (n, 2 conditions), their values and excess.
    """
    far, at, conditions = 0.0, (-1, 0), bins.shape[1] // 2
    for number in range(first, stop):
        for condition in range(conditions):
            if depends >> condition & 1 and bins[number, conditions + condition] > far:
                far, at = bins[number, conditions + condition], (number, condition)
    return at


@jit
def seen_from(end_ns: IntArray, first: int, count: int, t_ns: int, span_ns: int) -> int:
    """The first bin from `first` on that ends later than so long before a time."""
    while first < count and end_ns[first] + span_ns <= t_ns:
        first += 1
    return first
