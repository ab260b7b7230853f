"""Which kind of fault left this trace, and how severe: the thesis's plane of duration against excess (T 5.5.2-5.5.3).

A fault is a point (longest FSD, highest |r| - margin during it); runs that do not exceed the FML are noise and are left
out (T 5.5.2, Fig 5.10, Table 5.2). The thesis reads the plane by eye. These choices are **ours**:

    x = ln(FSD / FML),  y = ln(peak / margin)
    d_k^2    = sum over x, y of ((value - centroid_k) / s)^2 / (1 + 1/n_k)
    weight_k = (1 + d_k^2 / nu)^-((nu + 2) / 2)
    tail     = (1 + d^2 / nu)^-(nu / 2)

Ratios have no units, so a plane learnt on one airframe reads another's points; in logarithms equal ratios are equal
distances. s is the spread within the types, pooled, with nu degrees of freedom; n_k the examples of type k. The weight
is Student's law for a new point of a type, its share among the weights the confidence. The tail is the chance that a
point of the nearest type lies farther out. A point is of the nearest type, unless its tail is below 1 % (no known
fault) or its share below 60 % (between two).

Severity (T 5.5.3, Fig 5.12): per type, a line of peak/margin on unbalance. T finds it rising for F3 and nearly flat for
F1 and F2. A new peak is weighed against what the line predicts for each severity, with the line's own uncertainty; on
a flat or uncertain line no severity reaches 60 %, and it stays unknown.

**Price.** On 72 simulated flights of the nine faults with their fitted term (`benchmarks/thesis_plane.py`), each judged
by a plane of the others, 54 types were named rightly, 9 wrongly, 9 not at all, and no severity was ever certain enough:
the highest excess of one flight scatters more than the severities differ. A hint for the mechanic, no diagnosis. The
plane knows only the types that it was shown, and with three flights a type it refuses little and is sure of little.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import TypeAlias

from thesis_runs import Run

from mavdiag.airframe.propellers import FaultType
from mavdiag.errors import InputError, UsageError

__all__ = [
    "Classification",
    "Cluster",
    "Example",
    "FaultPoint",
    "HealthyScale",
    "Outcome",
    "SeverityLevel",
    "SeverityTrend",
    "ThesisPlane",
    "classify",
    "fault_point",
    "fit_plane",
]

Pair: TypeAlias = tuple[float, float]

FAR_TAIL = 0.01  # share of a known type's own points that is refused (our choice)
MIN_SHARE = 0.6  # confidence below which nothing is named (our choice)
MIN_SPREAD = 0.05  # no type repeats better than 5 % (our choice); keeps a spread of zero out
SEVERITIES = (1, 2, 3)  # T Table 3.1


@dataclass(frozen=True, slots=True)
class HealthyScale:
    """What an airframe's healthy flights give: fml_s [s] and margin_rad_s [rad/s].

    An FML of zero, as the margin rule `max` makes it, has no scale to give: use the sample time instead.
    Raises UsageError unless both are positive and finite.
    """

    fml_s: float
    margin_rad_s: float

    def __post_init__(self) -> None:
        for name, value in (("FML", self.fml_s), ("margin", self.margin_rad_s)):
            if not (math.isfinite(value) and value > 0.0):
                raise UsageError(f"the {name} must be positive to scale by, not {value}")


@dataclass(frozen=True, slots=True)
class FaultPoint:
    """A fault's trace without units.

    duration: longest FSD over the FML. excess: highest |r| - margin during it, over the margin.
    Raises UsageError unless both are positive and finite.
    """

    duration: float
    excess: float

    def __post_init__(self) -> None:
        for value in (self.duration, self.excess):
            if not (math.isfinite(value) and value > 0.0):
                raise UsageError(f"duration and excess of a fault must be positive, not {self.duration}, {self.excess}")

    @classmethod
    def scaled(cls, fsd_s: float, excess_rad_s: float, scale: HealthyScale) -> "FaultPoint":
        """The point of a run of fsd_s [s] that rose excess_rad_s [rad/s] above the margin. Raises UsageError."""
        return cls(fsd_s / scale.fml_s, excess_rad_s / scale.margin_rad_s)

    @property
    def significant(self) -> bool:
        """Whether the run is longer than any healthy one, FSD > FML."""
        return self.duration > 1.0

    @property
    def logs(self) -> Pair:
        """ln duration, ln excess: where the point lies in the plane."""
        return math.log(self.duration), math.log(self.excess)


def fault_point(runs: Sequence[Run], scale: HealthyScale) -> FaultPoint | None:
    """The point of a flight: its longest run above the margin, the higher one of equals; None if none exceeds the FML.

    >>> runs = [Run(0, 1, 0.05, 0.9), Run(5, 9, 0.30, 0.06)]
    >>> fault_point(runs, HealthyScale(fml_s=0.12, margin_rad_s=0.02))
    FaultPoint(duration=2.5, excess=3.0)
    """
    longest = max(runs, key=lambda run: (run.fsd_s, run.peak), default=None)
    if longest is None or longest.fsd_s <= scale.fml_s:
        return None
    return FaultPoint.scaled(longest.fsd_s, longest.peak, scale)


@dataclass(frozen=True, slots=True)
class Example:
    """A point whose cause is known. unbalance_g_mm: of the propeller (T Table 3.2), nan if it was not weighed.

    Raises UsageError unless the severity is 1, 2 or 3 and the unbalance zero or more, or nan.
    """

    point: FaultPoint
    fault_type: FaultType
    severity: int
    unbalance_g_mm: float = math.nan

    def __post_init__(self) -> None:
        if self.severity not in SEVERITIES or self.unbalance_g_mm < 0.0 or math.isinf(self.unbalance_g_mm):
            raise UsageError(f"an example needs severity 1-3 and a finite unbalance, not {self.severity}")


@dataclass(frozen=True, slots=True)
class Cluster:
    """One fault type in the plane. centroid: mean of ln duration and ln excess. points: how many it rests on."""

    fault_type: FaultType
    centroid: Pair
    points: int


@dataclass(frozen=True, slots=True)
class SeverityLevel:
    """A severity and the mean unbalance [g mm] of its examples."""

    severity: int
    unbalance_g_mm: float


@dataclass(frozen=True, slots=True)
class SeverityTrend:
    """Least-squares line excess = intercept + slope U of one fault type (T Fig 5.12, over the margin).

    slope, slope_error: per g mm. deviation: of the examples about the line, `freedom` degrees of freedom.
    mean_g_mm, squares: mean of U and sum of squares about it, for the error of a prediction.
    """

    fault_type: FaultType
    intercept: float
    slope: float
    slope_error: float
    deviation: float
    freedom: int
    points: int
    mean_g_mm: float
    squares: float
    levels: tuple[SeverityLevel, ...]

    def predicted(self, unbalance_g_mm: float) -> float:
        """Expected excess over the margin of a fault with this unbalance."""
        return self.intercept + self.slope * unbalance_g_mm

    def prediction_error(self, unbalance_g_mm: float) -> float:
        """Standard error of one new excess at this unbalance."""
        apart = (unbalance_g_mm - self.mean_g_mm) ** 2 / self.squares
        return self.deviation * math.sqrt(1.0 + 1.0 / self.points + apart)


@dataclass(frozen=True, slots=True)
class ThesisPlane:
    """The learnt plane.

    spread: pooled standard deviation within types, of ln duration and ln excess, with `freedom` degrees of freedom.
    trends: of the types whose examples carry one. ignored: examples that did not exceed the FML.
    """

    clusters: tuple[Cluster, ...]
    spread: Pair
    freedom: int
    trends: tuple[SeverityTrend, ...]
    ignored: int = 0


class Outcome(Enum):
    """What came of a classification, as a sentence."""

    NAMED = "the trace fits one fault type"
    NOT_SIGNIFICANT = "the trace is not longer than the longest healthy one"
    FAR = "no known fault leaves such a trace"
    BETWEEN = "the trace fits more than one fault type"


@dataclass(frozen=True, slots=True)
class Classification:
    """The answer. What could not be said is None.

    confidence: share of the named type among all, 0.6..1. distance: to the nearest type, in spreads.
    severity_confidence: share of the named severity among those of the type.
    """

    outcome: Outcome
    fault_type: FaultType | None = None
    confidence: float | None = None
    distance: float | None = None
    severity: int | None = None
    severity_confidence: float | None = None


def fit_plane(examples: Iterable[Example]) -> ThesisPlane:
    """Learn the plane from faults of known type. Their order does not matter.

    Raises InputError unless two types or more have examples longer than the FML, and one of them has several.
    """
    given = tuple(examples)
    used = [example for example in given if example.point.significant]
    types = [one for one in FaultType if any(example.fault_type is one for example in used)]
    freedom = len(used) - len(types)
    if len(types) < 2 or freedom < 1:
        raise InputError(
            f"{len(used)} usable examples of {len(types)} fault types: give two types and several flights of each"
        )
    groups = [[example for example in used if example.fault_type is one] for one in types]
    clusters = tuple(_cluster(group) for group in groups)
    spread_x, spread_y = (_pooled_spread(groups, axis, freedom) for axis in (0, 1))
    trends = tuple(trend for group in groups if (trend := _trend(group)) is not None)
    return ThesisPlane(clusters, (spread_x, spread_y), freedom, trends, len(given) - len(used))


def classify(plane: ThesisPlane, point: FaultPoint) -> Classification:
    """Name the fault type of a point, and its severity where the type has a usable trend."""
    if not point.significant:
        return Classification(Outcome.NOT_SIGNIFICANT)
    squared = [_distance_squared(plane, cluster, point) for cluster in plane.clusters]
    nearest = squared.index(min(squared))
    distance = math.sqrt(squared[nearest])
    if (1.0 + squared[nearest] / plane.freedom) ** (-plane.freedom / 2) < FAR_TAIL:
        return Classification(Outcome.FAR, distance=distance)
    share = _shares([_log_weight(d2, plane.freedom, 2) for d2 in squared])[nearest]
    if share < MIN_SHARE:
        return Classification(Outcome.BETWEEN, distance=distance)
    fault_type = plane.clusters[nearest].fault_type
    severity, severity_share = _severity(plane, fault_type, point)
    return Classification(Outcome.NAMED, fault_type, share, distance, severity, severity_share)


def _cluster(group: Sequence[Example]) -> Cluster:
    x, y = zip(*(example.point.logs for example in group), strict=True)
    return Cluster(group[0].fault_type, (_mean(x), _mean(y)), len(group))


def _pooled_spread(groups: Sequence[Sequence[Example]], axis: int, freedom: int) -> float:
    squares: list[float] = []
    for group in groups:
        values = [example.point.logs[axis] for example in group]
        mean = _mean(values)
        squares += [(value - mean) ** 2 for value in values]
    return max(MIN_SPREAD, math.sqrt(math.fsum(squares) / freedom))


def _distance_squared(plane: ThesisPlane, cluster: Cluster, point: FaultPoint) -> float:
    total = 0.0
    for value, centre, spread in zip(point.logs, cluster.centroid, plane.spread, strict=True):
        total += ((value - centre) / spread) ** 2
    return total / (1.0 + 1.0 / cluster.points)


def _trend(examples: Sequence[Example]) -> SeverityTrend | None:
    """The line of one type; None with under three weighed examples or under two severities or unbalances."""
    weighed = [one for one in examples if not math.isnan(one.unbalance_g_mm)]
    severities = sorted({one.severity for one in weighed})
    if len(weighed) < 3 or len(severities) < 2 or len({one.unbalance_g_mm for one in weighed}) < 2:
        return None
    U = [one.unbalance_g_mm for one in weighed]
    y = [one.point.excess for one in weighed]
    mean_U, mean_y = _mean(U), _mean(y)
    squares = math.fsum((u - mean_U) ** 2 for u in U)
    slope = math.fsum((u - mean_U) * (v - mean_y) for u, v in zip(U, y, strict=True)) / squares
    intercept = mean_y - slope * mean_U
    error = math.fsum((v - intercept - slope * u) ** 2 for u, v in zip(U, y, strict=True))
    freedom = len(weighed) - 2
    deviation = max(math.sqrt(error / freedom), MIN_SPREAD * mean_y)
    levels = tuple(
        SeverityLevel(level, _mean([one.unbalance_g_mm for one in weighed if one.severity == level]))
        for level in severities
    )
    return SeverityTrend(
        fault_type=examples[0].fault_type,
        intercept=intercept,
        slope=slope,
        slope_error=deviation / math.sqrt(squares),
        deviation=deviation,
        freedom=freedom,
        points=len(weighed),
        mean_g_mm=mean_U,
        squares=squares,
        levels=levels,
    )


def _severity(plane: ThesisPlane, fault_type: FaultType, point: FaultPoint) -> tuple[int | None, float | None]:
    """The severity whose predicted excess fits best, and its share; None, None if none stands out."""
    trend = next((one for one in plane.trends if one.fault_type is fault_type), None)
    if trend is None or trend.slope <= 0.0:  # a falling line says nothing of severity (T 5.5.3)
        return None, None
    logs = []
    for level in trend.levels:
        error = trend.prediction_error(level.unbalance_g_mm)
        miss = (point.excess - trend.predicted(level.unbalance_g_mm)) / error
        logs.append(_log_weight(miss * miss, trend.freedom, 1) - math.log(error))
    shares = _shares(logs)
    best = shares.index(max(shares))
    if shares[best] < MIN_SHARE:
        return None, None
    return trend.levels[best].severity, shares[best]


def _log_weight(squared: float, freedom: int, axes: int) -> float:
    """Log density, up to a constant, of Student's law at a squared distance in spreads."""
    return -(freedom + axes) / 2 * math.log1p(squared / freedom)


def _shares(log_weights: Sequence[float]) -> list[float]:
    highest = max(log_weights)
    weights = [math.exp(one - highest) for one in log_weights]
    total = math.fsum(weights)
    return [weight / total for weight in weights]


def _mean(values: Sequence[float]) -> float:
    return math.fsum(values) / len(values)
