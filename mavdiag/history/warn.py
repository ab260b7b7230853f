"""When to warn that a trend reaches its threshold. Pure; the policy is values, and its price is stated.

With a the present level, b its growth a flight, r the level of the stretch's first flights (all shares of the
threshold, `trend`), a statistic is warned of if it is so at each of the last three flights that it judged:

    a + b HORIZON >= 1                    the line reaches the threshold within the horizon,
    (a - r)/(1 - r) >= PROGRESS           most of the way from the first flights to the threshold is gone,
    a - r >= GROWN s                      and that is more than the scatter of a session.

Without the second a jump, which looks steep at first, would be warned of at once; without the third a healthy statistic
that is always near its threshold.

**Its price** (benchmarks/history_wear.py, docs/results.md): the figures were fitted to drawn histories whose wear
reaches the threshold after 150 flights, and judged by others. Of healthy airframes with scatter as recorded fewer than
1 in 100 are warned of in 200 flights, over all their statistics. Wear that jumps over its last fifth comes without a
warning, and wear that slows down is warned of early. The first 20 flights of a stretch are its first level, and not
warned of. A warning does not say which rotor it is, or why.
"""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from mavdiag.history.changes import Change, changes_of
from mavdiag.history.stretches import Series
from mavdiag.history.trend import Remaining, Trend, sessions_of, trend_of
from mavdiag.telemetry import FloatArray

__all__ = ["Outlook", "Policy", "Review", "review", "warned_at"]


@dataclass(frozen=True, slots=True)
class Policy:
    """The figures of the rule.

    horizon: flights ahead. progress: share of the way that must be gone. grown: scatters of a session.
    first: flights at the beginning of a stretch whose median is its first level.
    confirmed: flights that must agree.
    """

    horizon: float = 26.0
    progress: float = 0.82
    grown: float = 1.5
    first: int = 20
    confirmed: int = 3


POLICY = Policy()
SURE = 3.0  # standard errors of growth from which it is called growing (our choice)


class Outlook(StrEnum):
    """What the trend of a statistic says."""

    TOO_FEW = "too few flights for a trend"
    STEADY = "no growth"
    GROWING = "growing, and not near the threshold"
    WARNING = "reaches the threshold soon"
    REACHED = "has reached the threshold"


@dataclass(frozen=True, slots=True)
class Review:
    """What is found of one statistic in one stretch.

    outlook: in one word.
    trend: at the newest flight that it judged; None with too few.
    remaining: flights from then until it reaches the threshold; None if it does not grow.
    changes: where it jumped.
    """

    outlook: Outlook
    trend: Trend | None
    remaining: Remaining | None
    changes: tuple[Change, ...]


def review(series: Series, policy: Policy = POLICY) -> Review:
    """Trend, outlook and change points of a series as it stands."""
    share = series.share
    judged = np.flatnonzero(np.isfinite(share))
    changes = changes_of(sessions_of(series.number, series.session, share))
    trend = _trend_at(series, share, int(judged[-1])) if len(judged) else None
    if trend is None:
        return Review(Outlook.TOO_FEW, None, None, changes)
    remaining = trend.remaining()
    if trend.level >= 1.0:
        outlook = Outlook.REACHED
    elif len(judged) >= policy.confirmed and all(
        _near(series, share, int(at), policy) for at in judged[-policy.confirmed :]
    ):
        outlook = Outlook.WARNING
    else:
        outlook = Outlook.GROWING if trend.significance > SURE else Outlook.STEADY
    return Review(outlook, trend, remaining, changes)


def warned_at(series: Series, policy: Policy = POLICY, *, before: int | None = None) -> int | None:
    """Number of the first flight after which the series was warned of; None if it never was.

    before: look at no flight from this number on.
    """
    share, row = series.share, 0
    for at in np.flatnonzero(np.isfinite(share)).tolist():
        if before is not None and series.number[at] >= before:
            return None
        row = row + 1 if _near(series, share, at, policy) else 0
        if row >= policy.confirmed:
            return int(series.number[at])
    return None


def _near(series: Series, share: FloatArray, at: int, policy: Policy) -> bool:
    """Whether the rule holds by what was known after a flight, by its place."""
    known = share[: policy.first]
    known = known[np.isfinite(known)]
    if at + 1 < policy.first or len(known) == 0:
        return False
    trend = _trend_at(series, share, at)
    if trend is None:
        return False
    first = float(np.median(known))
    grown = trend.level - first
    return (
        trend.level + trend.slope * policy.horizon >= 1.0
        and grown >= policy.progress * (1.0 - first)
        and grown >= policy.grown * trend.scale
    )


def _trend_at(series: Series, share: FloatArray, at: int) -> Trend | None:
    cut = slice(0, at + 1)
    return trend_of(sessions_of(series.number[cut], series.session[cut], share[cut]), float(series.number[at]))
