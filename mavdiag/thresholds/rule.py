"""What a healthy vehicle allows: the threshold of a statistic from its own healthy flights, for a budget of alarms.

The maxima x of blocks of 10 s of judged time that no fit saw carry a Gumbel law (Coles, An Introduction to Statistical
Modeling of Extreme Values, 2001, ch. 3); that of a block of length L lies beta ln(L/B) above that of B = 10 s:

    beta = max(sd(x) sqrt(6)/pi, s |mean(x)|),    s = 0.1 min(1, sqrt(20/n)) for n blocks
    mu = mean(x) - 0.5772 sd(x) sqrt(6)/pi - beta mean(ln(L/B))                                   (moments)
    threshold = mu + beta ln(1/(r B)),    r alarms in a second of judged time

**Its price:** a budget of 0.05 alarms an hour from a minute of flight is an extrapolation by ten beta, not evidence.
T hours without an alarm exclude, at 95 %, only rates above 3/T (`demonstrated_per_hour`). The named alternative, the
largest healthy maximum, alarms in one of n + 1 equal healthy flights.
"""

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from mavdiag.errors import IdentificationError, UsageError
from mavdiag.thresholds.guard import Guard
from mavdiag.thresholds.heldout import BLOCK_S, Scores
from mavdiag.units import S_PER_H

BUDGET_PER_HOUR = 0.05  # of all monitors together (our choice)
EULER_GAMMA = 0.5772156649015329
GUMBEL_SCALE = math.sqrt(6.0) / math.pi  # beta over standard deviation
ENOUGH_BLOCKS = 20  # from here on the floor on beta fades (our choice)
WORTH_SAYING_PER_HOUR = 1.0  # a limit on the alarms that is above it tells nobody anything (our choice)
NO_GUARD = Guard()


class ThresholdRule(StrEnum):
    """How the threshold follows from the healthy maxima."""

    GUMBEL = "gumbel"  # extreme-value level for a budget of alarms per hour
    MAXIMUM = "max"  # the largest of them; the next flight beats it with probability 1/(n + 1)


@dataclass(frozen=True, slots=True)
class Threshold:
    """A threshold and what supports it.

    value: the monitor alarms when its statistic is strictly above it.
    location, scale, standard_error: mu and beta of the block maxima, and of the level; by the maximum rule mean and 0.
    allowance: what the guard added to that level. session_allowance: the part of the value that stands for what another
        session (battery, propellers, payload) may shift; in a session of the healthy flights the value is less by it.
    blocks, block_s: healthy blocks that support it, and judged time of a whole one [s]. exceeding: how many above it.
    flights, sessions, hours: that they come from, and judged healthy time.
    budget_per_hour: alarms asked for in an hour of judged time. demonstrated_per_hour: what it excludes at 95 %.
    false_alarms_per_flight: 1/(n + 1), the price of the maximum rule.
    """

    value: float
    rule: ThresholdRule
    location: float
    scale: float
    standard_error: float
    allowance: float
    session_allowance: float
    blocks: int
    block_s: float
    flights: int
    sessions: int
    hours: float
    exceeding: int
    budget_per_hour: float
    demonstrated_per_hour: float
    false_alarms_per_flight: float

    def within(self, *, same_session: bool) -> float:
        """The value that holds: less in a session of the healthy flights."""
        return self.value - (self.session_allowance if same_session else 0.0)

    def statement(self) -> str:
        """One sentence: what is asked for, and what is shown."""
        flights, sessions = (
            f"{count} {what}{'s' * (count != 1)}"
            for count, what in ((self.flights, "flight"), (self.sessions, "session"))
        )
        basis = f"{self.blocks} healthy blocks of {self.block_s:g} s from {flights} in {sessions} ({self.hours:.3g} h)"
        shown = f"{self.exceeding or 'none'} of them above it"
        if self.demonstrated_per_hour < WORTH_SAYING_PER_HOUR:
            shown += f", so at 95 % fewer than {self.demonstrated_per_hour:.2g} alarms/h"
        if self.rule is ThresholdRule.MAXIMUM:
            price = f"an equal healthy flight alarms with probability {self.false_alarms_per_flight:.3g}"
            return f"largest maximum of {basis}: {price}; {shown}"
        kind = "extrapolated" if self.budget_per_hour < self.demonstrated_per_hour else "demonstrated"
        return f"{kind} to {self.budget_per_hour:.3g} alarms/h from {basis}; {shown}"


def false_alarms_per_flight(flights: int) -> float:
    """Probability that a healthy flight exceeds the maximum of `flights` equal healthy ones."""
    return 1.0 / (flights + 1)


def threshold_of(
    scores: Scores,
    *,
    flights: int,
    sessions: int | None = None,
    budget_per_hour: float = BUDGET_PER_HOUR,
    guard: Guard = NO_GUARD,
    rule: ThresholdRule = ThresholdRule.GUMBEL,
) -> Threshold:
    """The threshold that scores of healthy flights allow.

    budget_per_hour: this monitor's share. sessions: that the flights were flown in; None for one each.
    Raises UsageError for a budget that is not positive, IdentificationError for scores that are not finite.
    """
    if not (math.isfinite(budget_per_hour) and budget_per_hour > 0):
        raise UsageError(f"the budget must be a positive number of alarms per hour, not {budget_per_hour}")
    x = scores.maxima
    if len(x) == 0 or not np.isfinite(x).all():
        raise IdentificationError("healthy statistics must be finite numbers, and there must be some")
    rate = budget_per_hour / S_PER_H * BLOCK_S
    mean, scale, level = float(np.mean(x)), 0.0, float(x.max())
    location = mean
    if rule is ThresholdRule.GUMBEL:
        location, scale = _gumbel(scores, guard.scale_share)
        level = location - scale * math.log(rate)
    sessions = flights if sessions is None else sessions
    least = max(mean + guard.above_mean, guard.least)
    few = level + guard.scales(flights) * scale
    within, value = max(few, least), max(few + guard.allowance(sessions), least)
    hours, exceeding = scores.judged_s / S_PER_H, int(np.count_nonzero(x > value))
    return Threshold(
        value=value,
        rule=rule,
        location=location,
        scale=scale,
        standard_error=_standard_error(scale, rate, len(x)),
        allowance=value - level,
        session_allowance=value - within,
        blocks=len(x),
        block_s=BLOCK_S,
        flights=flights,
        sessions=sessions,
        hours=hours,
        exceeding=exceeding,
        budget_per_hour=budget_per_hour,
        demonstrated_per_hour=poisson_upper(exceeding) / hours,
        false_alarms_per_flight=false_alarms_per_flight(flights),
    )


def poisson_upper(events: int, confidence: float = 0.95) -> float:
    """Upper limit on the expected number of events after `events` were seen: the m at which P(<= events | m) = 5 %."""
    from scipy.special import gammaincinv  # half the chi-squared quantile of 2 events + 2 degrees of freedom

    return float(gammaincinv(events + 1, confidence))


def flights_for_guarantee(false_alarms: float = 0.05, confidence: float = 0.95) -> int:
    """Healthy flights that bound the maximum rule's false-alarm share: METHOD section 4, 1 - 0.95^n >= 0.95, n = 59."""
    return math.ceil(math.log(1.0 - confidence) / math.log(1.0 - false_alarms))


def _gumbel(scores: Scores, scale_share: float) -> tuple[float, float]:
    """Location, of blocks of 10 s, and floored scale by moments. The location keeps the scale before the floor."""
    x, log_span = scores.maxima, np.log(scores.spans_s / BLOCK_S)
    mean, beta = float(np.mean(x)), 0.0
    for _ in range(3 if len(x) > 1 else 0):  # blocks of unlike length spread by beta ln(L/B) more
        beta = float(np.std(x - beta * log_span, ddof=1)) * GUMBEL_SCALE
    scale = max(beta, scale_share * math.sqrt(min(1.0, ENOUGH_BLOCKS / len(x))) * abs(mean))
    return mean - EULER_GAMMA * beta - scale * float(np.mean(log_span)), scale


def _standard_error(scale: float, rate: float, blocks: int) -> float:
    """Of the level by moments: sd/sqrt(n) sqrt(1 + 1.1396 K + 1.1 K^2), K = (level - mean)/sd (Kite, Frequency and
    Risk Analyses in Hydrology, 1977, for the extreme-value law of type 1)."""
    K = GUMBEL_SCALE * (-math.log(rate) - EULER_GAMMA)
    return scale / GUMBEL_SCALE / math.sqrt(blocks) * math.sqrt(max(1 + 1.1396 * K + 1.1 * K * K, 0.0))
