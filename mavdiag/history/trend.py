"""Where a statistic is heading from flight to flight, when it would reach its threshold, and where it jumped. Pure.

A series holds the share z = peak/threshold of each flight. The c flights of a session share an error, so they become
one value y, their median, at their mean flight number x, with

    var(y) = s^2 (1 + 1/c)/2                    (errors within and between sessions of like size; measured: 0.5 to 3)

The present level a and the growth b of a flight are a line, fitted by weighted least squares with older sessions
discounted, x_n the newest flight, and Huber's weights h against single odd sessions (Huber, Robust Statistics, 1981,
ch. 7: k = 1.345 standard deviations):

    [ y ] ~ [ 1  x - x_n ] [ a ]        w = h(r) 2c/(1 + c) exp((x - x_n)/MEMORY)
                           [ b ]        cov(a, b) = s^2 (X'WX)^-1 X'W V W X (X'WX)^-1,    V = diag((1 + 1/c)/2)

s is the larger of two robust scales: of the residuals, and of the steps between sessions that follow each other. The
flights that remain until the line reaches 1 are R = (1 - a)/b; their interval is Fieller's (J. R. Stat. Soc. B 16
(1954) 175): all R at which (1 - a - b R)^2 <= q^2 (Vaa + 2 R Vab + R^2 Vbb).

**Change points.** At each border k between sessions a step d is tested in a line over the sessions of at most WINDOW
flights on either side, least squares with the weights of `Sessions`:

    [ y ] ~ [ 1  x - x_k  (x > x_k) ] (a, b, d)',    t_k = d / se(d), se(d) by the scatter of neighbours' steps

y is held within ODD scales of the running median of five sessions. The border with the largest |t_k| is a change point
if it is above LIMIT and the step above LEAST_STEP; its windows then end there, and the search goes on. **Its price**:
one false change point in a hundred series of 200 healthy flights (`benchmarks/history_wear.py`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mavdiag.telemetry import FloatArray, IntArray

MEMORY = 14.0  # flights after which a session counts 1/e (tuned, see `warn`)
LEAST_SESSIONS = 5  # fewer show no trend (our choice)
LEAST_SCALE = 0.01  # of the threshold: smallest scatter that is believed (our choice)
HUBER = 1.345
ROUNDS = 4  # of reweighting: the fit changes no more by then (our choice)
MAD = 1.4826  # standard deviations in a median absolute deviation of the normal law
NORMAL_90 = 1.645  # of a two-sided interval

LIMIT = 5.0  # of |t| (tuned on emulated and drawn healthy histories)
WINDOW = 30.0  # flights on either side (our choice)
LEAST_BESIDE = 3  # sessions on either side
LEAST_STEP = 0.05  # of the threshold (our choice)
ODD = 3.0  # scales from the running median beyond which a session is held


@dataclass(frozen=True, slots=True, eq=False)
class Sessions:
    """Flights put together by session; (m,) mean flight number, median of peak/threshold, and how many they were."""

    number: FloatArray
    share: FloatArray
    flights: FloatArray

    def __len__(self) -> int:
        return len(self.number)

    @property
    def weight(self) -> FloatArray:
        """(m,) one over the variance, 1 for a session of one flight."""
        return 2 * self.flights / (1 + self.flights)


class Remaining(NamedTuple):
    """Flights until the threshold: the estimate, and its 90 % interval. high is infinite where no end is certain."""

    flights: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Trend:
    """The line at the newest flight: share of the threshold now, its growth a flight, and variances of both.

    scale: standard deviation of a session of one flight.
    """

    level: float
    slope: float
    level_variance: float
    covariance: float
    slope_variance: float
    scale: float

    def remaining(self) -> Remaining | None:
        """Flights until the level is the threshold; None if it does not grow."""
        if self.slope <= 0:
            return None
        gap, q2 = 1.0 - self.level, NORMAL_90**2
        # (b^2 - q^2 Vbb) R^2 - 2 (gap b + q^2 Vab) R + gap^2 - q^2 Vaa <= 0
        square = self.slope**2 - q2 * self.slope_variance
        linear = gap * self.slope + q2 * self.covariance
        constant = gap**2 - q2 * self.level_variance
        estimate = max(gap / self.slope, 0.0)
        root = linear**2 - square * constant
        if root < 0:  # no R at all is excluded
            return Remaining(estimate, 0.0, math.inf)
        first = (linear - math.sqrt(root)) / square if square else constant / (2 * linear)
        second = (linear + math.sqrt(root)) / square if square > 0 else math.inf
        return Remaining(estimate, min(max(first, 0.0), estimate), max(second, estimate))


def sessions_of(session: Sequence[int] | IntArray, share: FloatArray) -> Sessions:
    """Put flights 1 to n, in order of time, together by session; those without a share (NaN) are left out."""
    known = np.flatnonzero(np.isfinite(share))
    x, y, group = known + 1.0, share[known], np.asarray(session)[known]
    cuts = np.flatnonzero(np.diff(group)) + 1
    parts = [part for part in zip(np.split(x, cuts), np.split(y, cuts), strict=True) if len(part[0])]
    found = np.array([(xs.mean(), np.median(ys), len(xs)) for xs, ys in parts]).reshape(-1, 3)
    return Sessions(*found.T)


def trend_of(sessions: Sessions, now: float) -> Trend | None:
    """The trend at flight number `now`; None with fewer than five sessions."""
    if len(sessions) < LEAST_SESSIONS:
        return None
    x, y, base = sessions.number - now, sessions.share, sessions.weight
    X, recent = np.column_stack((np.ones(len(x)), x)), base * np.exp(x / MEMORY)
    steps = scale_of_steps(sessions)
    h = np.ones(len(y))
    for _ in range(ROUNDS):
        w = h * recent
        inverse = np.linalg.inv((X.T * w) @ X)
        line = inverse @ (X.T @ (w * y))
        r = (y - X @ line) * np.sqrt(base)
        median = np.quantile(np.abs(r), 0.5, weights=recent, method="inverted_cdf")
        scale = max(MAD * float(median), steps, LEAST_SCALE)
        h = np.minimum(1.0, HUBER * scale / np.maximum(np.abs(r), 1e-12))
    root = X * (w / np.sqrt(base))[:, None]
    (a, b), (_, c) = (scale**2 * inverse @ (root.T @ root) @ inverse).tolist()
    return Trend(float(line[0]), float(line[1]), a, b, c, scale)


def scale_of_steps(sessions: Sessions) -> float:
    """Standard deviation of a session of one flight, from the steps between neighbours."""
    spread = np.sqrt(1 / sessions.weight[1:] + 1 / sessions.weight[:-1])
    return MAD * float(np.median(np.abs(np.diff(sessions.share)) / spread))


@dataclass(frozen=True, slots=True)
class Change:
    """A jump. number: of the first flight after it; step: in shares of the threshold; t: in its standard errors."""

    number: int
    step: float
    t: float


def changes_of(sessions: Sessions) -> tuple[Change, ...]:
    """The change points, in order."""
    m = len(sessions)
    if m < 2 * LEAST_BESIDE:
        return ()
    scale = max(scale_of_steps(sessions), 1e-6)
    room, found = ODD * scale / np.sqrt(sessions.weight), dict[int, Change]()
    near = np.lib.stride_tricks.sliding_window_view(np.pad(sessions.share, 2, mode="edge"), 5)
    middle = np.median(near, axis=1)
    y = np.clip(sessions.share, middle - room, middle + room)
    while True:
        cuts = (0, *found, m)
        borders = range(LEAST_BESIDE, m - LEAST_BESIDE + 1)
        tests = {k: step for k in borders if (step := _step_at(sessions, y, scale, k, cuts)) is not None}
        best = max(tests, key=lambda k: abs(tests[k].t), default=None)
        if best is None or abs(tests[best].t) < LIMIT:
            return tuple(sorted(found.values(), key=lambda change: change.number))
        found[best] = tests[best]


def _step_at(sessions: Sessions, y: FloatArray, scale: float, k: int, cuts: Sequence[int]) -> Change | None:
    """The step at the border before session k; None if it is too small or has too few sessions beside it."""
    x = sessions.number
    first = max(*(cut for cut in cuts if cut <= k), int(np.searchsorted(x, x[k] - WINDOW)))
    end = min(*(cut for cut in cuts if cut >= k), int(np.searchsorted(x, x[k - 1] + WINDOW, side="right")))
    if k - first < LEAST_BESIDE or end - k < LEAST_BESIDE:
        return None
    part = slice(first, end)
    root = np.sqrt(sessions.weight[part])
    X = np.column_stack((np.ones(end - first), x[part] - x[k], np.arange(first, end) >= k)) * root[:, None]
    inverse = np.linalg.pinv(X.T @ X)
    step = float((inverse @ (X.T @ (y[part] * root)))[2])
    if abs(step) < LEAST_STEP:
        return None
    before = int(sessions.number[k - 1] + (sessions.flights[k - 1] - 1) / 2)
    return Change(before + 1, step, step / (scale * float(np.sqrt(inverse[2, 2]))))
