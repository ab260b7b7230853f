"""Evidence over flights: by what odds a rotor has changed since the flights that taught.

The unit is the flight: its whole roll, pitch or yaw trim y [fraction of hover]. For each of them

    y = mu + p_set + a_session + e_flight + [flight >= k] c_j r

p, a and e are normal, mu is anything. The standard deviations of a and e lie on a grid, weighted by the prior of each,
scaled inverse chi-squared (`thresholds.rule`); p, of another set of propellers than the first, has that of the prior
for sessions. A flight that is shorter than those that taught has an e of so much more variance. r: rise of rotor j from
flight k on; c_j: its entry of the layout's unmixing C. With m(y) the likelihood of all flights, where mu, p, a, e and
the deviations are integrated out,

    e_kj = mean over r of the product over axes of m(y | k, j, r) / m(y | healthy)
    E    = sum_k w_k mean_j e_kj + 1/(n + 1),    w_k = 1/(k (k + 1)), k = 1 ... n new flights

The flights that taught are in every m, before each k, so they cancel but for what they tell of mu and the deviations.
Flights of one session share a, and count as little as that leaves. Under health e_kj is a ratio of predictive
densities of what comes next, given all before: a martingale of mean 1, and so is E, a mixture over the beginning of the
change (Shin, Ramdas and Rinaldo, E-detectors, 2022, for the sum over k). By Ville's inequality E exceeds 50 in one
healthy set of propellers in 50, however often it is looked at. The rotor that is named has the largest e_kj.

**Its price.** It holds for airframes whose deviations come from the prior. Where k, j and r are known, E is less
than could be by the number of rotors, by k (k + 1) and by the number of rises. Flights of one session never say more
than their session may shift. What moves no trim is not seen.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mavdiag.errors import UsageError
from mavdiag.telemetry import FloatArray, IntArray
from mavdiag.thresholds.rule import DEGREES, Prior

SURE = 50.0  # to 1: from here on a change is told (our choice)
# Rises that are looked for, of hover, equally likely (our choice): a larger one is declared by any flight alone, and is
# no further from 0.2 than from health.
RISES = (0.03, 0.05, 0.08, 0.12, 0.2)
STEPS = 2.0 ** np.arange(-1.5, 4.1, 0.5)  # standard deviations that are believed, over the prior's (our choice)


@dataclass(frozen=True, slots=True)
class Evidence:
    """Odds that a rotor has changed, against health; shares: of each rotor; since: number of the new flight, from 0."""

    odds: float
    shares: tuple[float, ...]
    since: int


@dataclass(frozen=True, slots=True, eq=False)
class Flown:
    """Flights of an airframe, those that taught in front.

    trims: (n, axes). sessions, propellers: (n,) number of the session and of the propeller set of each. spans_s: (n,)
    time that its trim is of [s]. learnt: how many taught, at least one.
    """

    trims: FloatArray
    sessions: IntArray
    propellers: IntArray
    spans_s: FloatArray
    learnt: int


def evidence_of(flights: Flown, columns: FloatArray, priors: Sequence[Prior]) -> Evidence:
    """What the flights say that did not teach. columns: (axes, rotors), the trim by a rise of 1 of each rotor.

    priors: of each axis, standard deviations in the unit of the trims. Raises UsageError if there are no such flights.
    """
    new = len(flights.trims) - flights.learnt
    if flights.learnt < 1 or new < 1:
        raise UsageError("evidence over flights needs some that taught, and others")
    rises = np.array(RISES)
    found = np.zeros((new, len(rises), columns.shape[1]))
    for y, column, prior in zip(flights.trims.T, columns, priors, strict=True):
        found += _likelihoods(y, flights, prior, rises[:, None] * column)
    k = np.arange(1, new + 1)
    log_e = found - (np.log(k * (k + 1)) + math.log(found[0].size))[:, None, None]
    top = max(float(log_e.max()), 0.0)
    e = np.exp(log_e - top)
    rotors, begins = e.sum(axis=(0, 1)), e.sum(axis=(1, 2))
    odds = (float(e.sum()) + math.exp(-top) / (new + 1)) * math.exp(min(top, 600.0))
    return Evidence(odds, tuple((rotors / rotors.sum()).tolist()), int(begins.argmax()))


def _likelihoods(y: FloatArray, flights: Flown, prior: Prior, shifts: FloatArray) -> FloatArray:
    """ln m(y | k, shift) - ln m(y | healthy) of one axis, (new flights, *shifts.shape).

    With h_k the flights from k on, V the covariance of a + e, X columns of ones for all flights and for each other set,
    D the precision of their coefficients, <u, v> = u' (V^-1 - V^-1 X (X' V^-1 X + D)^-1 X' V^-1) v:

        ln m(y | k, s) = const - (<y, y> - 2 s <h_k, y> + s^2 <h_k, h_k> + ln |V| + ln |X' V^-1 X + D|)/2

    With v = var(e), u its inverse shares by flight and M their sum over a session, V^-1 of the session is
    (diag(u) - rho u u')/v, rho = var(a)/(v + M var(a)): a product is a sum over flights less one over sessions.
    """
    n, others = len(y), np.unique(flights.propellers)[1:]
    u = np.minimum(1.0, flights.spans_s / np.median(flights.spans_s[: flights.learnt]))
    F = np.column_stack([y - y.mean(), np.ones(n), *(flights.propellers == one for one in others)]).astype(float)
    H = np.tri(n, n)[:, flights.learnt :]  # h_k
    _, place = np.unique(flights.sessions, return_inverse=True)
    session = u * (np.arange(place.max() + 1)[:, None] == place)
    M, F_sums, H_sums = session.sum(axis=1), session @ F, session @ H
    a_sd, e_sd = (scale.ravel() for scale in np.meshgrid(prior.session * STEPS, prior.flight * STEPS))
    v = np.square(e_sd)
    rho = np.square(a_sd)[:, None] / (v[:, None] + M * np.square(a_sd)[:, None])
    FF = ((F.T * u) @ F - np.einsum("gs,sk,sl->gkl", rho, F_sums, F_sums)) / v[:, None, None]
    FH = ((F.T * u) @ H - np.einsum("gs,sk,sh->gkh", rho, F_sums, H_sums)) / v[:, None, None]
    HH = (u @ H - rho @ np.square(H_sums)) / v[:, None]
    inner = FF[:, 1:, 1:] + np.diag([0.0, *[prior.session**-2] * len(others)])
    fit_y, fit_h = np.linalg.solve(inner, FF[:, 1:, :1])[..., 0], np.linalg.solve(inner, FH[:, 1:])
    yy = FF[:, 0, 0] - (FF[:, 0, 1:] * fit_y).sum(axis=1)
    yh = FH[:, 0] - np.einsum("gk,gkh->gh", FF[:, 0, 1:], fit_h)
    hh = HH - (FH[:, 1:] * fit_h).sum(axis=1)
    size = n * np.log(v) - np.log1p(-rho * M).sum(axis=1) + np.linalg.slogdet(inner)[1]
    ratios = a_sd / prior.session, e_sd / prior.flight
    belief = -DEGREES * sum(np.log(ratio) + 0.5 / np.square(ratio) for ratio in ratios)
    healthy = belief - 0.5 * (yy + size)
    s = shifts[:, :, None, None]
    changed = healthy + s * yh.T - 0.5 * np.square(s) * hh.T  # (*shifts.shape, new, grid)
    log_odds = np.logaddexp.reduce(changed, axis=-1) - np.logaddexp.reduce(healthy, axis=-1)
    return np.asarray(np.moveaxis(log_odds, -1, 0))
