"""What a healthy vehicle allows: the thresholds of a statistic from its own healthy flights, by two promises.

One law for every monitor. The statistic is scored on flights that its fit did not see, cut into blocks of 10 s of
judged time. The maximum x of block b of flight f in session s has three components of variance:

    x = mu + a_s + e_f + g_b,    sd(a) between sessions (battery, propellers, payload), sd(e) between flights,
    g Gumbel with scale beta within a flight (maxima of light-tailed statistics tend to it; Coles 2001, ch. 3)

Few flights do not show them, so each has a prior (`Prior`, of the monitor) that counts as `DEGREES` observations:

    s^2 = (nu s0^2 + SS)/(nu + n)                          scaled inverse chi-squared, its posterior (Gelman, BDA, 2.6)

A threshold is the posterior predictive level that K healthy flights of d seconds, flown in one session that is not
among the healthy ones, exceed with probability 1 - exp(-r). An offset of a session or a flight is no news with every
block. With t_n the quantile of Student's law with n degrees of freedom,

    A = t_{nu+S-1}(exp(-r)) sd(a) sqrt(1 + 1/S)                       offset of the session
    e(q) = t_{nu+N-S}(q^(1/K)) sd(e) sqrt(1 + 1/N)                    highest offset of K flights
    M = e(1/2) + beta (ln(d/10 s) + 0.3665 - 0.5772)                  what they show usually
    threshold = mu + M + sqrt(A^2 + (e(exp(-r)) - e(1/2))^2 + (beta (ln(K/r) - 0.3665))^2)

and in a session of these flights the same with the highest mean of a session for mu, and without A. The medians add;
what is rare adds in squares, for the three are rarely rare together (`tests/property` holds it against simulation). A
block of length L lies beta ln(L/10 s) above one of 10 s, so a short one counts as what it is. The law makes two levels:

    fault       r alarms in an hour of flight: a session counts as an hour, so K = 3600 s/d, and d is an hour at most
    suspected   one flight in n like the healthy ones: K = 1, r = -ln(1 - 1/n), d their mean; never above the first

**Its price.** A budget of 0.05 alarms an hour from a minute of flight is an extrapolation, not evidence. What the
flights themselves show is `demonstrated_per_hour`: T hours without an alarm exclude, at 95 %, only rates above 3/T. The
named alternative, the largest healthy maximum, alarms in one of n + 1 equal healthy flights.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from mavdiag.errors import IdentificationError, UsageError
from mavdiag.telemetry import IntArray
from mavdiag.thresholds.heldout import BLOCK_S, Scores
from mavdiag.units import S_PER_H

BUDGET_PER_HOUR = 0.05  # alarms of all monitors together (our choice)
FLIGHTS_PER_SUSPICION = 50.0  # healthy flights, of all monitors together (our choice)
EULER_GAMMA = 0.5772156649015329
GUMBEL_SCALE = math.sqrt(6.0) / math.pi  # beta over standard deviation
GUMBEL_MEDIAN = -math.log(math.log(2.0))
DEGREES = 6  # observations that a prior counts for (our choice)
WORTH_SAYING_PER_HOUR = 1.0  # a limit on the alarms that is above it tells nobody anything (our choice)


class ThresholdRule(StrEnum):
    """How the threshold follows from the healthy maxima."""

    GUMBEL = "gumbel"  # extreme-value level for a budget of alarms per hour
    MAXIMUM = "max"  # the largest of them; the next flight beats it with probability 1/(n + 1)


@dataclass(frozen=True, slots=True)
class Prior:
    """Standard deviations of a monitor's block maxima that are believed before any flight (`thresholds.priors`).

    session, flight, block: between sessions, between flights of one, within a flight; in the statistic's unit, or as
        shares of its healthy mean. least: the smallest threshold that means anything, in the statistic's unit.
    """

    session: float = 0.2
    flight: float = 0.1
    block: float = 0.1
    shares: bool = True
    least: float = 0.0


USUAL = Prior()  # of a statistic that nothing else is known of (our choice)


@dataclass(frozen=True, slots=True)
class Threshold:
    """A threshold and what supports it.

    value: the monitor alarms when its statistic is strictly above it.
    mean: of the healthy block maxima. session_sd, flight_sd, block_scale: sd(a), sd(e) and beta; by the maximum rule 0.
    session_allowance: the part of the value that stands for what another session may shift; in a session of the
        healthy flights the value is less by it.
    blocks, block_s: healthy blocks that support it, and judged time of a whole one [s]. exceeding: how many above it.
    flights, sessions, hours: that they come from, and judged healthy time.
    budget_per_hour: alarms asked for in an hour of judged time. demonstrated_per_hour: what it excludes at 95 %.
    suspected: from where on a fault is suspected, as shares of `value` and of `within(same_session=True)`, up to 1.
    flights_per_suspicion: healthy flights of which one may come there; 0 if only the alarm itself is a suspicion.
    false_alarms_per_flight: 1/(n + 1), the price of the maximum rule.
    """

    value: float
    rule: ThresholdRule
    mean: float
    session_sd: float
    flight_sd: float
    block_scale: float
    session_allowance: float
    blocks: int
    block_s: float
    flights: int
    sessions: int
    hours: float
    exceeding: int
    budget_per_hour: float
    demonstrated_per_hour: float
    suspected: tuple[float, float]
    flights_per_suspicion: float
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
        low, one_in = self.suspected[0] * self.value, self.flights_per_suspicion
        suspected = f"; suspected from {low:.3g}, as one flight in {one_in:.3g}" if self.suspected[0] < 1.0 else ""
        kind = "extrapolated" if self.budget_per_hour < self.demonstrated_per_hour else "demonstrated"
        return f"{kind} to {self.budget_per_hour:.3g} alarms/h from {basis}; {shown}{suspected}"


def false_alarms_per_flight(flights: int) -> float:
    """Probability that a healthy flight exceeds the maximum of `flights` equal healthy ones."""
    return 1.0 / (flights + 1)


def threshold_of(
    scores: Scores,
    *,
    sessions: Sequence[int],
    budget_per_hour: float = BUDGET_PER_HOUR,
    flights_per_suspicion: float = FLIGHTS_PER_SUSPICION,
    prior: Prior = Prior(),
    rule: ThresholdRule = ThresholdRule.GUMBEL,
) -> Threshold:
    """The threshold that scores of healthy flights allow.

    sessions: that each flight was flown in. budget_per_hour, flights_per_suspicion: this monitor's shares; of the
    latter 0 if a fault is suspected by the alarm alone.
    Raises UsageError for a budget that is not positive or flights that are not more than 1, IdentificationError for
    scores that are not finite.

    >>> rng = np.random.default_rng(5)
    >>> maxima = 1.0 + rng.gumbel(0.0, 0.02, 400)     # 20 flights alike, in 5 sessions, and 20 blocks of each
    >>> flights = np.repeat(np.arange(20), 20)
    >>> found = threshold_of(Scores(maxima, np.full(400, 10.0), flights), sessions=[n // 4 for n in range(20)])
    >>> round(found.mean, 2), round(found.block_scale, 2), round(found.value, 1), round(found.demonstrated_per_hour, 1)
    (1.01, 0.03, 1.5, 2.7)
    """
    if not (math.isfinite(budget_per_hour) and budget_per_hour > 0):
        raise UsageError(f"the budget must be a positive number of alarms per hour, not {budget_per_hour}")
    if flights_per_suspicion != 0 and not flights_per_suspicion > 1:
        raise UsageError(f"a suspicion must be one of more than 1 flight, not of {flights_per_suspicion}")
    x, suspected, suspected_within = scores.maxima, 1.0, 1.0
    if len(x) == 0 or not np.isfinite(x).all():
        raise IdentificationError("healthy statistics must be finite numbers, and there must be some")
    if rule is ThresholdRule.GUMBEL:
        parts = _components(scores, np.array(sessions), prior)
        flown_s = min(parts.flight_s, S_PER_H)
        value, within = (max(level, prior.least) for level in parts.levels(budget_per_hour, S_PER_H / flown_s, flown_s))
        if flights_per_suspicion:
            rare = -math.log1p(-1.0 / flights_per_suspicion)
            low, low_within = (max(level, prior.least) for level in parts.levels(rare, 1.0, parts.flight_s))
            suspected = min(low / value, 1.0) if value > 0 else 1.0
            suspected_within = min(low_within / within, 1.0) if within > 0 else 1.0
    else:
        parts, value, within = _Components(float(x.mean())), float(x.max()), float(x.max())
    hours, exceeding = scores.judged_s / S_PER_H, int(np.count_nonzero(x > value))
    return Threshold(
        value=value,
        rule=rule,
        mean=parts.mean,
        session_sd=parts.session_sd,
        flight_sd=parts.flight_sd,
        block_scale=parts.beta,
        session_allowance=max(0.0, value - within),
        blocks=len(x),
        block_s=BLOCK_S,
        flights=len(sessions),
        sessions=len(set(sessions)),
        hours=hours,
        exceeding=exceeding,
        budget_per_hour=budget_per_hour,
        demonstrated_per_hour=poisson_upper(exceeding) / hours,
        suspected=(suspected, suspected_within),
        flights_per_suspicion=flights_per_suspicion,
        false_alarms_per_flight=false_alarms_per_flight(len(sessions)),
    )


@dataclass(frozen=True, slots=True)
class _Components:
    """mu, the highest mean of a session, sd(a), sd(e), beta; N and S; mean judged time of a flight [s]."""

    mean: float
    highest: float = 0.0
    session_sd: float = 0.0
    flight_sd: float = 0.0
    beta: float = 0.0
    flights: int = 1
    sessions: int = 1
    flight_s: float = BLOCK_S

    def levels(self, rare: float, flown: float, flight_s: float) -> tuple[float, float]:
        """The level r that so many flights of this length exceed, in any session and in one of the flights."""
        N, S = self.flights, self.sessions
        degrees, spread = DEGREES + N - S, self.flight_sd * math.sqrt(1 + 1 / N)
        session = self.session_sd * math.sqrt(1 + 1 / S) * student(DEGREES + S - 1, math.exp(-rare))
        median = spread * student(degrees, 0.5 ** (1 / flown))
        flight = spread * student(degrees, math.exp(-rare / flown)) - median
        usual = median + self.beta * (math.log(flight_s / BLOCK_S) + GUMBEL_MEDIAN - EULER_GAMMA)
        block = self.beta * (math.log(flown / rare) - GUMBEL_MEDIAN)
        rest = math.hypot(max(flight, 0.0), max(block, 0.0))
        return self.mean + usual + math.hypot(max(session, 0.0), rest), self.highest + usual + rest


def student(degrees: int, q: float) -> float:
    """The quantile of Student's law."""
    from scipy.special import stdtrit

    return float(stdtrit(degrees, q))


def shown_spreads(scores: Scores, sessions: Sequence[int], prior: Prior) -> tuple[tuple[float, int], ...]:
    """What healthy flights alone show, in the prior's unit: standard deviation between sessions, between flights and
    within a flight, each with its degrees of freedom; with none the prior's own."""
    found = _components(scores, np.array(sessions), prior, degrees=1e-9)
    unit = abs(float(scores.maxima.mean())) if prior.shares else 1.0
    sds = found.session_sd, found.flight_sd, found.beta / GUMBEL_SCALE
    degrees = found.sessions - 1, found.flights - found.sessions, len(scores.maxima) - found.flights
    return tuple((sd / unit, count) for sd, count in zip(sds, degrees, strict=True))


def _components(scores: Scores, sessions: IntArray, prior: Prior, degrees: float = DEGREES) -> _Components:
    """The components of variance of block maxima, by their sums of squares and the prior."""
    x, log_span, flights = scores.maxima, np.log(scores.spans_s / BLOCK_S), np.unique(scores.flights)
    unit, nu = abs(float(x.mean())) if prior.shares else 1.0, degrees
    blocks = [x[scores.flights == flight] for flight in flights]
    within = sum(float(np.square(one - one.mean()).sum()) for one in blocks)
    beta = GUMBEL_SCALE * math.sqrt((nu * (prior.block * unit) ** 2 + within) / (nu + len(x) - len(flights)))
    level = np.array([float(np.mean((x - beta * log_span)[scores.flights == flight])) for flight in flights])
    whose = sessions[flights]
    groups = [level[whose == session] for session in np.unique(whose)]
    means, N, S = np.array([one.mean() for one in groups]), len(flights), len(groups)
    between = sum(float(np.square(one - one.mean()).sum()) for one in groups)
    flight_variance = (nu * (prior.flight * unit) ** 2 + between) / (nu + N - S)
    # what flights alone scatter the means of sessions is no component of sessions
    scatter = (S - 1) * flight_variance * float(np.mean([1 / len(one) for one in groups]))
    apart = max(float(np.square(means - means.mean()).sum()) - scatter, 0.0)
    session_sd = math.sqrt((nu * (prior.session * unit) ** 2 + apart) / (nu + S - 1))
    flight_s = scores.judged_s / N
    return _Components(
        float(means.mean()), float(means.max()), session_sd, math.sqrt(flight_variance), beta, N, S, flight_s
    )


def poisson_upper(events: int, confidence: float = 0.95) -> float:
    """Upper limit on the expected number of events after `events` were seen: the m at which P(<= events | m) = 5 %.

    >>> [round(poisson_upper(k), 2) for k in (0, 1, 5)]
    [3.0, 4.74, 10.51]
    """
    from scipy.special import gammaincinv  # half the chi-squared quantile of 2 events + 2 degrees of freedom

    return float(gammaincinv(events + 1, confidence))


def flights_for_guarantee(false_alarms: float = 0.05, confidence: float = 0.95) -> int:
    """Healthy flights after which, with this confidence, the maximum rule's false-alarm share is below the bound.

    The 95/95 guarantee of METHOD section 4: 1 - 0.95^n >= 0.95, n = 59.
    """
    return math.ceil(math.log(1.0 - confidence) / math.log(1.0 - false_alarms))
