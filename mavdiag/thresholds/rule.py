"""What a healthy vehicle allows: the thresholds of a statistic from its own healthy flights, by two promises.

One law for every monitor. The statistic is scored on flights that its fit did not see, cut into blocks of 10 s of
judged time. The maximum x of block b of flight f in session s has three components of variance:

    x = mu + a_s + e_f + g_b,    sd(a) between sessions (battery, propellers, payload), sd(e) between flights,
    g Gumbel with scale beta within a flight (maxima of light-tailed statistics tend to it; Coles 2001, ch. 3)

Few flights do not show them, so each has a prior (`Prior`, of the monitor) that counts as `DEGREES` observations:

    s^2 = (nu s0^2 + SS)/(nu + n)                          scaled inverse chi-squared, its posterior (Gelman, BDA, 2.6)

A prior may have two classes of airframes, each with its own s0 of the three. Quiet flights tell of quiet sessions then:
the law is the mean over both by their posterior probabilities, with the marginal likelihood of the sums of squares

    p(class | SS) ~ p(class) prod s0^-n (1 + SS/(nu s0^2))^(-(nu + n)/2)         over the three components

A threshold is the posterior predictive level that K healthy flights of d seconds, flown in one session that is not
among the healthy ones, exceed with probability 1 - exp(-r). An offset of a session or a flight is no news with every
block. S sessions of N flights with B blocks taught. D is what sd(e), G what beta may be after them; n = (B - N)/2.2,
for the sample variance of a Gumbel law scatters as that of so many normal deviations:

    D      = sd(e) sqrt(1 + 1/N) sqrt((nu + N - S)/chi2_{nu+N-S})
    G      = beta sqrt((nu + n)/chi2_{nu+n})
    F(y)   = E over z of exp(-exp(-(y - D z - m)/G)),          z normal, m = G (ln(d/10 s) - 0.5772)
    exp(-r) = E over a, D and G of F(threshold - mu - a)^K     a = t_{nu+S-1} sd(a) sqrt(1 + 1/S)

and in a session of these flights the same with the highest mean of a session for mu, and without a. The K flights have
one D and one G, which are not known; drawn for each of them anew, short flights would be given 15 to 20 % too much. A
block of length L lies beta ln(L/10 s) above one of 10 s, so a short one counts as what it is. The law has two levels:

    fault       r alarms in an hour of flight, flown in one session: K = 3600 s/d
    suspected   one flight in n like the healthy ones: K = 1, r = 1/n; never above the first

So the first is a promise for a session of up to an hour: by the clock, sessions of 2.5 minutes may alarm up to 24 times
as often in an hour. To promise it by the clock, the trim would be allowed 1.7 times as much after one session, and 1.3
times after ten, for one session in 2,400 is farther out than one in 100.

Monitors share both promises (`shared_out`): one rate for all, of which a monitor whose least threshold makes it rarer
uses only what it can; the others may have the rest.

**Its price.** A budget of 0.05 alarms an hour from a minute of flight is an extrapolation, not evidence. What the
flights themselves show is `demonstrated_per_hour`: T hours without an alarm exclude, at 95 %, only rates above 3/T. The
named alternative, the largest healthy maximum, alarms in one of n + 1 equal healthy flights.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cache, cached_property, lru_cache
from importlib import resources
from typing import Any

import numpy as np

from mavdiag.errors import IdentificationError, InputError
from mavdiag.printable import counted
from mavdiag.telemetry import FloatArray
from mavdiag.thresholds.heldout import BLOCK_S, Scores
from mavdiag.units import S_PER_H

BUDGET_PER_HOUR = 0.05  # alarms of all monitors together (our choice)
FLIGHTS_PER_SUSPICION = 50.0  # healthy flights, of all monitors together (our choice)
EULER_GAMMA = 0.5772156649015329
GUMBEL_SCALE = math.sqrt(6.0) / math.pi  # beta over standard deviation
GUMBEL_WEIGHT = 2.2  # (5.4 - 1)/(3 - 1): the kurtosis of the Gumbel law less 1, over that of the normal law
DEGREES = 6  # observations that a prior counts for (our choice)
OTHERS = 0.02  # probability of a prior's other class, to which no real vehicle of the pool belongs (our choice)
TINY = 1e-12  # no statistic differs by less
REACH = 6.0  # arsinh of how many spreads a flight may lie apart
ANGLES = np.linspace(0.0, 0.5 * math.pi, 25)  # arctan(D/G)
RAREST, SUREST = 1e-6, 10.0  # rates -ln(1 - probability) that are told apart (our choice: once in a century of flight)
# Healthy flights after which the maximum rule's false-alarm share is below 5 % with a confidence of 95 %.
GUARANTEE_FLIGHTS = 59  # METHOD section 4: 1 - 0.95^n >= 0.95
WORTH_SAYING_PER_HOUR = 1.0  # a limit on the alarms that is above it tells nobody anything (our choice)


class ThresholdRule(StrEnum):
    """How the threshold follows from the healthy maxima."""

    GUMBEL = "gumbel"  # extreme-value level for a budget of alarms per hour
    MAXIMUM = "max"  # the largest of them, and the prior's least; the next flight beats it with probability 1/(n + 1)


@dataclass(frozen=True, slots=True)
class Prior:
    """Standard deviations of a monitor's block maxima that are believed before any flight (`prior_of`).

    session, flight, block: between sessions, between flights of one, within a flight; in the statistic's unit, or as
        shares of its healthy mean. least: the smallest threshold that means anything, in the statistic's unit.
    other: the same three of another class of airframes, of which one is with the probability `OTHERS`.
    """

    session: float = 0.2
    flight: float = 0.1
    block: float = 0.1
    shares: bool = True
    least: float = 0.0
    other: tuple[float, float, float] | None = None


USUAL = Prior()  # of a statistic that nothing else is known of (our choice)


@cache
def priors_file() -> Mapping[str, Any]:
    """By monitor what `benchmarks/make_priors.py` pooled of airframes, and what is estimated by hand, and why."""
    text = resources.files("mavdiag.thresholds").joinpath("priors.json").read_text(encoding="utf-8")
    content: Mapping[str, Any] = json.loads(text)
    return content


def prior_of(monitor: str) -> Prior:
    """The prior of a monitor of that name, the usual one if the file has none: the wider of the pool and the estimate.

    Where a statistic is compared with its own mean and the pool differs by less, the pool is a class of its own.
    """
    known = priors_file()["priors"].get(monitor)
    if known is None:
        return USUAL
    shown: tuple[float, float, float] = tuple(known["emulated"]) or (0.0, 0.0, 0.0)
    session, flight, block = map(max, known["estimate"], shown)
    narrower = known["shares"] and any(shown) and shown != (session, flight, block)
    return Prior(session, flight, block, known["shares"], other=shown if narrower else None)


@dataclass(frozen=True, slots=True)
class Threshold:
    """A threshold and what supports it. Raises InputError for one that a statistic cannot be compared with.

    value: the monitor alarms when its statistic is strictly above it.
    mean: of the healthy block maxima. session_sd, flight_sd, block_scale: sd(a), sd(e) and beta; by the maximum rule 0.
    session_allowance: the part of the value that stands for what another session may shift; in a session of the
        healthy flights the value is less by it.
    blocks, block_s: healthy blocks that support it, and judged time of a whole one [s]. exceeding: how many above it.
    flights, sessions, hours: that they come from, and judged healthy time.
    budget_per_hour: alarms asked for in an hour of judged time. demonstrated_per_hour: what it excludes at 95 %.
    suspected: from where on a fault is suspected, as shares of `value` and of `within(same_session=True)`, up to 1.
    flights_per_suspicion: healthy flights of which one may come there.
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

    def __post_init__(self) -> None:
        levels = self.within(same_session=True), self.session_allowance, *self.suspected
        if not (min(levels) >= 0.0 < min(self.budget_per_hour, self.flights_per_suspicion - 1.0)):
            raise InputError("a threshold, also in a session of its flights, and what it promises must be positive")

    def within(self, *, same_session: bool) -> float:
        """The value that holds: less in a session of the healthy flights."""
        return self.value - (self.session_allowance if same_session else 0.0)

    def statement(self) -> str:
        """One sentence: what is asked for, and what is shown."""
        blocks, sessions = counted(self.blocks, "healthy block"), counted(self.sessions, "session")
        flights = f"{counted(self.flights, 'flight')} in {sessions} ({self.hours:.3g} h)"
        basis = f"{blocks} of {self.block_s:g} s from {flights}"
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

    sessions: that each flight was flown in. budget_per_hour, flights_per_suspicion: this monitor's shares.
    Raises IdentificationError for scores that are not finite.

    >>> rng = np.random.default_rng(5)
    >>> maxima = 1.0 + rng.gumbel(0.0, 0.02, 400)     # 20 flights alike, in 5 sessions, and 20 blocks of each
    >>> flights = np.repeat(np.arange(20), 20)
    >>> found = threshold_of(Scores(maxima, np.full(400, 10.0), flights), sessions=[n // 4 for n in range(20)])
    >>> round(found.mean, 2), round(found.block_scale, 2), round(found.value, 1), round(found.demonstrated_per_hour, 1)
    (1.01, 0.03, 1.5, 2.7)
    """
    x, suspected, suspected_within = scores.maxima, 1.0, 1.0
    if len(x) == 0 or not np.isfinite(x).all():
        raise IdentificationError("healthy statistics must be finite numbers, and there must be some")
    law = law_of(scores, tuple(sessions), prior)
    mean, spreads = law.mean_of("mean"), [law.mean_of(name, 2) for name in ("session_sd", "flight_sd", "beta")]
    if rule is ThresholdRule.GUMBEL:
        value, within = (law.level(budget_per_hour, law.per_hour, same) for same in (False, True))
        suspected, suspected_within = (
            min(law.level(1.0 / flights_per_suspicion, 1.0, same) / level, 1.0) if level > 0 else 1.0
            for level, same in ((value, False), (within, True))
        )
    else:
        value = within = max(prior.least, float(x.max()))
        mean, spreads = float(x.mean()), [0.0, 0.0, 0.0]
    hours, exceeding = scores.judged_s / S_PER_H, int(np.count_nonzero(x > value))
    flights = np.unique(scores.flights)  # one that gave no score supports nothing
    return Threshold(
        value=value,
        rule=rule,
        mean=mean,
        session_sd=spreads[0],
        flight_sd=spreads[1],
        block_scale=spreads[2],
        session_allowance=max(0.0, value - within),
        blocks=len(x),
        block_s=BLOCK_S,
        flights=len(flights),
        sessions=len(np.unique(np.array(sessions)[flights])),
        hours=hours,
        exceeding=exceeding,
        budget_per_hour=budget_per_hour,
        demonstrated_per_hour=poisson_upper(exceeding) / hours,
        suspected=(suspected, suspected_within),
        flights_per_suspicion=flights_per_suspicion,
        false_alarms_per_flight=1.0 / (len(flights) + 1),
    )


@dataclass(frozen=True, eq=False)
class Part:
    """What the flights foretell if the airframe is of one class: mu, the highest mean of a session, sd(a), sd(e), beta,
    the degrees that the blocks show, N, S and the mean judged time of a flight [s]."""

    mean: float
    highest: float
    session_sd: float
    flight_sd: float
    beta: float
    shown: float
    flights: int
    sessions: int
    flight_s: float

    def beyond(self, level: float, below: FloatArray, same_session: bool) -> float:
        """Probability that the highest of the flights of `below` is above a level."""
        from scipy.special import stdtr

        y = self._highest
        if same_session:
            return 1.0 - float(np.interp(level - self.highest, y, below))
        spread = self.session_sd * math.sqrt(1 + 1 / self.sessions)
        offset = (0.5 * (y[1:] + y[:-1]) - (level - self.mean)) / spread
        return float(np.diff(below) @ stdtr(DEGREES + self.sessions - 1, offset))

    def below(self, flights: float) -> FloatArray:
        """(y,) probability that of so many flights none lies above."""
        likely, rates = self._table
        return np.asarray(likely @ np.exp(-flights * rates))

    @property
    def unit(self) -> float:
        """How far flights of a session lie apart."""
        return math.hypot(self.flight_sd, self.beta)

    @property
    def _usual(self) -> float:
        """How many beta the highest block of a flight lies above the mean of them."""
        return math.log(self.flight_s / BLOCK_S) - EULER_GAMMA

    @cached_property
    def _highest(self) -> FloatArray:
        """(y,) what the highest of a flight may lie above its session, densest about the usual."""
        return np.asarray(self.beta * self._usual + self.unit * np.sinh(np.linspace(-REACH, REACH, 241)))

    @cached_property
    def _table(self) -> tuple[FloatArray, FloatArray]:
        """(p,) how likely pairs of D and G are, and (p, y) how often a flight with them has its highest above."""
        from scipy.ndimage import map_coordinates

        likely_d, D = _spread(self.flight_sd * math.sqrt(1 + 1 / self.flights), self.flights - self.sessions)
        likely_g, G = _spread(self.beta, self.shown)
        D, G = (one.reshape(-1, 1) for one in np.meshgrid(D, G))
        u = (self._highest - G * self._usual) / np.hypot(D, G)
        shape = _log_rates()
        angles, steps = (size - 1 for size in shape.shape)
        at = np.broadcast_arrays(angles * np.arctan2(D, G) / ANGLES[-1], steps * (0.5 + 0.5 * np.arcsinh(u) / REACH))
        return np.outer(likely_g, likely_d).ravel(), np.exp(map_coordinates(shape, at, order=1, mode="nearest"))


def _spread(sd: float, shown: float) -> tuple[FloatArray, FloatArray]:
    """(s,) how likely values of a standard deviation are and these, by its posterior after so many deviations."""
    from scipy.special import gammaincinv

    degrees = DEGREES + shown
    least, most = np.log(2.0 * gammaincinv(0.5 * degrees, np.array([1e-8, 1.0 - 1e-8])))
    chi2 = np.exp(np.linspace(least, most, 14))
    likely = np.exp(0.5 * degrees * np.log(chi2 / degrees) - 0.5 * (chi2 - degrees))  # of ln chi2
    return likely / likely.sum(), sd * np.sqrt(degrees / chi2)


@cache
def _log_rates() -> FloatArray:
    """(angle, v) ln of how often cos(angle) g + sin(angle) z is above sinh(v), g of the law exp(-exp(-g)), z normal.

    The angles are `ANGLES`, v are equal steps to +-`REACH`; a rate is -ln of the probability of not being above.
    """
    z = np.linspace(-7.0, 7.0, 141)
    normal = np.exp(-0.5 * np.square(z))
    u = np.sinh(np.linspace(-REACH, REACH, 161))[:, None] - np.sin(ANGLES[:, None, None]) * z
    log_below = -np.exp(np.minimum(-u / np.maximum(np.cos(ANGLES[:, None, None]), 0.05), 600.0))
    below, above = (law @ (normal / normal.sum()) for law in (np.exp(log_below), -np.expm1(log_below)))
    rates = np.where(above < 0.5, -np.log1p(-above.clip(1e-30, 0.5)), -np.log(below.clip(1e-300)))
    return np.asarray(np.log(rates))


@dataclass(frozen=True, slots=True, eq=False)
class Law:
    """What healthy flights foretell of a statistic in others, whatever class of airframes theirs is of.

    weights: how likely each class is after these flights. least: the smallest threshold that means anything. Rates are
    of K flights in one session: -ln of the probability that none is above a level.
    """

    parts: tuple[Part, ...]
    weights: FloatArray
    least: float

    @property
    def per_hour(self) -> float:
        """Flights in an hour."""
        return S_PER_H / self.parts[0].flight_s

    def mean_of(self, component: str, power: int = 1) -> float:
        """The mean over the classes of a field of their parts, of its square for a power of 2."""
        values = np.array([getattr(part, component) for part in self.parts])
        return math.pow(float(self.weights @ values**power), 1 / power)

    def rate(self, level: float, flights: float) -> float:
        """How often so many flights exceed a level."""
        return max(RAREST, self._rate(level, [part.below(flights) for part in self.parts], same_session=False))

    def level(self, rate: float, flights: float, same_session: bool = False) -> float:
        """The level that so many flights exceed so often, and at least the smallest that means anything."""
        from scipy.optimize import brentq

        middle = self.mean_of("highest" if same_session else "mean")
        below = [part.below(flights) for part in self.parts]
        unit = max(math.hypot(part.unit, part.session_sd) for part in self.parts)
        target = min(max(rate, RAREST), SUREST)

        def excess(u: float) -> float:
            return math.log(self._rate(middle + unit * math.sinh(u), below, same_session) / target)

        return max(self.least, middle + unit * math.sinh(float(brentq(excess, -REACH, 2 * REACH, xtol=1e-13))))

    def _rate(self, level: float, below: Sequence[FloatArray], same_session: bool) -> float:
        each = zip(self.parts, below, strict=True)
        beyond = float(self.weights @ [part.beyond(level, own, same_session) for part, own in each])
        return -math.log1p(-min(max(beyond, 1e-300), 1.0 - 1e-12))


@lru_cache(maxsize=64)
def law_of(scores: Scores, sessions: tuple[int, ...], prior: Prior) -> Law:
    """The law of healthy flights by their components of variance, each with its prior. sessions: that of each."""
    classes = [prior] if prior.other is None else [prior, Prior(*prior.other, prior.shares)]
    parts, likelihoods = zip(*(part_of(scores, sessions, one) for one in classes), strict=True)
    weights = np.array([1.0 - OTHERS, OTHERS])[: len(parts)] * np.exp(np.array(likelihoods) - max(likelihoods))
    return Law(parts, weights / weights.sum(), prior.least)


def shared_out(
    laws: Sequence[Law], decides: Sequence[bool], alarms_per_hour: float, flights_per_suspicion: float
) -> list[tuple[float, float]]:
    """Each monitor's share of both promises, as `threshold_of` takes it. decides: whose alarms declare a fault.

    One rate for all. At its least threshold a monitor is over it at most so often, and uses no more of a promise:

        sum over monitors of min(r, rate at the least threshold) = the promise

    One that does not decide alarms as seldom as the others, and its alarms are suspicions.
    """
    most = [law.rate(law.least, law.per_hour) if own else 0.0 for law, own in zip(laws, decides, strict=True)]
    alarms, common = _filled(alarms_per_hour, np.array(most))
    least = [law.least if own else law.level(common, law.per_hour) for law, own in zip(laws, decides, strict=True)]
    most = [law.rate(level, 1.0) for law, level in zip(laws, least, strict=True)]
    suspicions, _ = _filled(1.0 / flights_per_suspicion, np.array(most))
    shares = zip(np.where(decides, alarms, common).tolist(), suspicions.tolist(), strict=True)
    return [(alarm, 1.0 / suspicion) for alarm, suspicion in shares]


def _filled(total: float, most: FloatArray) -> tuple[FloatArray, float]:
    """The shares of a total, one rate or the most of each, and that rate. What none can use is noted in equal parts."""
    rates = np.concatenate(([0.0], np.sort(most)))
    rate = float(np.interp(total, np.minimum(rates[:, None], most).sum(axis=1), rates))
    shares = np.minimum(rate, most)
    spare = max(0.0, total - float(shares.sum()))
    return shares + np.where(most > 0.0, spare / np.count_nonzero(most), 0.0), rate


def part_of(scores: Scores, sessions: Sequence[int], prior: Prior, nu: float = DEGREES) -> tuple[Part, float]:
    """The components of variance of block maxima, by their sums of squares and the prior, and ln of how likely these
    sums are with it, but for a constant."""
    x, log_span, flights = scores.maxima, np.log(scores.spans_s / BLOCK_S), np.unique(scores.flights)
    unit = abs(float(x.mean())) if prior.shares else 1.0
    session, flight, block = (max((sd * unit) ** 2, TINY**2) for sd in (prior.session, prior.flight, prior.block))
    blocks = [x[scores.flights == number] for number in flights]
    within = sum(float(np.square(one - one.mean()).sum()) for one in blocks) / GUMBEL_WEIGHT
    n = (len(x) - len(flights)) / GUMBEL_WEIGHT
    beta = max(GUMBEL_SCALE * math.sqrt((nu * block + within) / (nu + n)), TINY)
    level = np.array([float(np.mean((x - beta * log_span)[scores.flights == number])) for number in flights])
    whose = np.array(sessions)[flights]
    groups = [level[whose == number] for number in np.unique(whose)]
    means, N, S = np.array([one.mean() for one in groups]), len(flights), len(groups)
    between = sum(float(np.square(one - one.mean()).sum()) for one in groups)
    flight_variance = (nu * flight + between) / (nu + N - S)
    # what flights alone scatter the means of sessions is no component of sessions
    scatter, apart = flight_variance * float(np.mean([1 / len(one) for one in groups])), np.square(means - means.mean())
    session_variance = (nu * session + max(float(apart.sum()) - (S - 1) * scatter, 0.0)) / (nu + S - 1)
    known = (within, n, block), (between, N - S, flight), (float(apart.sum()), S - 1, session + scatter)
    likelihood = sum(-0.5 * (n * math.log(s2) + (nu + n) * math.log1p(squares / (nu * s2))) for squares, n, s2 in known)
    a, e = (max(math.sqrt(variance), TINY) for variance in (session_variance, flight_variance))
    mean, highest = float(means.mean()), float(means.max())
    return Part(mean, highest, a, e, beta, n, N, S, scores.judged_s / N), likelihood


def poisson_upper(events: int) -> float:
    """Upper limit on the expected number of events after `events` were seen: the m at which P(<= events | m) = 5 %.

    >>> [round(poisson_upper(k), 2) for k in (0, 1, 5)]
    [3.0, 4.74, 10.51]
    """
    from scipy.special import gammaincinv  # half the chi-squared quantile of 2 events + 2 degrees of freedom

    return float(gammaincinv(events + 1, 0.95))
