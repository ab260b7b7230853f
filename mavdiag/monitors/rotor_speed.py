"""The rotor-speed monitor: one rotor turns faster or slower for its command, against the others, than it did in health.

A motor's voltage is used up by its speed and, in its resistance, by the drag torque of its propeller (steady state of a
brushless motor: Leishman, Principles of Helicopter Aerodynamics, ch. 6; Drela, First-Order DC Electric Motor Model):

    u V = w/K_v + R k_q w^2/K_t,      dw/w = -e/(1 + e) dk_q/k_q       at a given u V

u: its output 0..1, V: the battery's voltage, k_q w^2: the drag, e: share of the voltage that the resistance takes, 0.15
to 0.25 of small motors in hover (estimate). A blade that lost a piece has less drag, so its rotor turns faster for its
command; one that is bent or fouled has more. The voltage is common to all rotors and cancels:

    y_j = ln w_j - s_j c r/w - mean_k(..),    v_j = ln u_j - mean_k ln u_k,    x_j = (v_j, dv_j/dt),
    y_j = a_j + (x_j - x0_j)' b

dv/dt: a rotor lags behind its command, and its ESC behind the rotor; over a tick it is what v rises by from end to end.
s_j c r/w: an ESC tells the speed against the frame, which turns at r; s_j = 1 of rotors that turn against it. c is
2 e/(1 + e) of a motor by its voltage, 0.3, and 1 of one by its torque.

b is common to all rotors and fitted to ticks by least squares with a prior, and to the means of flights, between which
other days lie; P is its covariance. What the law leaves beyond SCATTER, or as much, may go with one of x in all ticks
(`fitting.updated`). Where a command changes swiftly the law is poor, so all means are weighted by 1/(1 + (s/SWIFT)^2):
s is dv/dt and, for what rises and falls within the tick, the mean slope of a parabola, 3 (v - (v_first + v_last)/2)/T,
together.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Literal, TypeAlias

import numpy as np

import mavdiag.rows.block as col
from mavdiag.airframe.layout import RotorLayout
from mavdiag.airframe.trim import MIN_OUTPUT
from mavdiag.errors import IdentificationError, InputError
from mavdiag.jit import cached, jit
from mavdiag.monitors.base import Begin, Flights, LearnContext, Monitor, RotorEvidence
from mavdiag.monitors.fitting import held_law, of_each, traced
from mavdiag.monitors.spec import Positive, Span, spec
from mavdiag.rows.block import Floats, Ints
from mavdiag.rows.conditions import TRIM_CONDITIONS
from mavdiag.rows.front import Rows
from mavdiag.telemetry import FloatArray, Signal
from mavdiag.units import RPM

WINDOW_S = 5.0  # our choice, as of the trim
TICK_S = 0.5  # a value twice a second; longer than a rotor's lag and an ESC's delay (our choice)
SCATTER = 1e-3  # of the speed, as a tick scatters; what manoeuvres repeat is no smaller (our choice)
SWIFT = 0.01  # 1/s: a lag that is 0.1 s off makes SCATTER of so fast a change, whose tick counts half (our choice)
TURN = 0.65  # c, between what the voltage and what the torque makes of it (our choice)
MADE_UP_RAD_S = 6000 * RPM  # that PX4 tells of full output in simulation (SimulatorMavlink: ESC_STATUS)
MADE_UP = 0.01  # so near to it no motor is (our choice)
# What is held of b before any flight, and its standard deviation. 1/(1 + e) is 0.8 to 0.87, an ESC's dead band adds to
# it; a lag is 0.05 s of a rotor and up to 0.1 s of an ESC at 10 Hz (estimates).
LAW, LAW_SD = np.array([0.85, 0.0]), np.array([0.15, 0.1])
APART = 7e-4  # of the speed: by which flights of other days differ, and least spread (sd; `thresholds/priors.json`)
FLOOR = 2e-4  # of the speed: least scatter that is believed, a seventh of a step of 14 rpm at 10,000 (our choice)
COLUMNS = 2  # of x
# Places in the parameters: rotors, rows of a tick and of an end of it, row period, ticks of a window, spread, b, P; of
# each rotor a, x0, s. In the memory: rows of the tick, known ones, usable ticks in a row, ticks so far; sums of the
# tick: of each rotor u, u at its first end and its last, w; r; of the window's ticks each rotor's residual, x - x0, s.
ROTORS, ROWS, ENDS, DT, WINDOW, SPREAD, LAWS, ERRORS, EACH = *range(7), 8, 12
PULSE = 3.0  # mean slope of a parabola that begins and ends at 0, times its length, over its mean
OF_ROTOR, EACH_OF = 2 + COLUMNS, 2 + COLUMNS  # of a tick y, x and s
ROW, KNOWN, RUN, TICKS, SUMS = range(5)
END = 10  # so many times as long as an end of a tick is the whole (our choice)
TOLD = 3  # of a tick behind y, x and s of each rotor: mean ln w/u, whether it is usable, its number in the segment


Pair: TypeAlias = tuple[float, float]


@spec
class RotorSpeedSpec:
    """Healthy speeds. Raises InputError if there is not one of each for each rotor."""

    kind: Literal["rotor_speed"] = "rotor_speed"
    layout: RotorLayout
    mean: tuple[float, ...]  # a: of each rotor [share of its speed]
    about: tuple[Pair, ...]  # x0: of each rotor
    law: Pair = (LAW.item(0), LAW.item(1))  # b
    errors: tuple[Pair, Pair]  # P
    spread: Positive  # rms of the healthy rotors about the law [share of speed]
    window_s: Span = WINDOW_S

    def __post_init__(self) -> None:
        if not len(self.mean) == len(self.about) == self.layout.rotors:
            raise InputError(f"{self.kind}: {self.layout.rotors} rotors, but means of {len(self.mean)}")


@jit
def _take_row(par: Floats, mem: Floats, x: Floats, i: int) -> bool:
    """Take a row; True where it completes a tick."""
    n = int(par[ROTORS])
    if mem[ROW] == 0.0:
        mem[KNOWN] = 0.0
        mem[SUMS : SUMS + 4 * n + 1] = 0.0
    known = x[col.VALID, i] > 0.5 and x.shape[0] >= col.SPEEDS + n
    for j in range(n if known else 0):
        u, w = x[col.OUTPUTS + j, i], x[col.SPEEDS + j, i]
        known = known and u > MIN_OUTPUT and w > 0.0 and math.isfinite(u + w)
    if known:
        mem[KNOWN] += 1.0
        for j in range(n):
            mem[SUMS + j] += x[col.OUTPUTS + j, i]
            if mem[ROW] < par[ENDS]:
                mem[SUMS + n + j] += x[col.OUTPUTS + j, i]
            if mem[ROW] >= par[ROWS] - par[ENDS]:
                mem[SUMS + 2 * n + j] += x[col.OUTPUTS + j, i]
            mem[SUMS + 3 * n + j] += x[col.SPEEDS + j, i]
        mem[SUMS + 4 * n] += x[col.RATE + 2, i]
    mem[ROW] += 1.0
    if mem[ROW] < par[ROWS]:
        return False
    mem[ROW] = 0.0
    return True


@jit
def _find(par: Floats, mem: Floats, out: Floats) -> None:
    """y, x and s of each rotor from the sums of a whole tick, (n, OF_ROTOR); then mean ln w/u."""
    n, rows, speed = int(par[ROTORS]), int(par[ROWS]), 0.0
    span_s = (rows - par[ENDS]) * par[DT]  # between the middles of the ends
    for j in range(n):
        to = OF_ROTOR * j
        out[to], out[to + 1] = math.log(mem[SUMS + 3 * n + j] / rows), math.log(mem[SUMS + j] / rows)
        first, last = math.log(mem[SUMS + n + j] / par[ENDS]), math.log(mem[SUMS + 2 * n + j] / par[ENDS])
        out[to + 2], out[to + 3] = (last - first) / span_s, PULSE * (out[to + 1] - (first + last) / 2) / span_s
        speed += mem[SUMS + 3 * n + j] / n
    for j in range(n):
        out[OF_ROTOR * j] -= TURN * par[EACH + EACH_OF * j + 1 + COLUMNS] * mem[SUMS + 4 * n] / speed
    for p in range(OF_ROTOR):  # against the others
        mean = 0.0
        for j in range(n):
            mean += out[OF_ROTOR * j + p] / n
        for j in range(n):
            out[OF_ROTOR * j + p] -= mean
        if p < 2:
            out[OF_ROTOR * n] += mean if p == 0 else -mean
    for j in range(n):
        out[OF_ROTOR * j + 3] = math.hypot(out[OF_ROTOR * j + 2], out[OF_ROTOR * j + 3])


@jit
def _weighed(values: Floats, weights: Floats) -> tuple[float, float]:
    """Weighted mean of values, unbiased variance; without the least and the largest, as a wild ESC frame spoils one."""
    least, most, mean, total, square, own = values.argmin(), values.argmax(), 0.0, 0.0, 0.0, 0.0
    for again in range(2):
        for i in range(len(values)):
            if i not in (least, most):
                if again == 0:
                    mean, total, own = mean + weights[i] * values[i], total + weights[i], own + weights[i] ** 2
                else:
                    square += weights[i] * (values[i] - mean / total) ** 2
    return mean / total, square / (total**2 - own)


@jit
def _take_tick(
    par: Floats, mem: Floats, tick: Floats, covered: bool, scratch: Floats, out: Floats, rotors: Floats, k: int
) -> None:
    """Put a tick into the window, where usable ones in a row count, and judge that."""
    n, window, best, least = int(par[ROTORS]), int(par[WINDOW]), 0.0, 1.0
    place, weights, away = int(mem[TICKS]) % window, scratch[0], scratch[1]
    for j in range(n):
        own, of, error, total = EACH + EACH_OF * j, SUMS + 4 * n + 1 + OF_ROTOR * window * j, 0.0, 0.0
        mem[of + place] = tick[OF_ROTOR * j] - par[own]
        for p in range(COLUMNS):
            to, away[p] = of + (1 + p) * window, 0.0
            mem[to + place] = tick[OF_ROTOR * j + 1 + p] - par[own + 1 + p]
            mem[of + place] -= par[LAWS + p] * mem[to + place]
        swift = of + (1 + COLUMNS) * window
        mem[swift + place] = tick[OF_ROTOR * j + 1 + COLUMNS]
        for i in range(window):
            weights[i] = 1.0 / (1.0 + (mem[swift + i] / SWIFT) ** 2)
            total += weights[i]
            for p in range(COLUMNS):
                away[p] += weights[i] * mem[of + (1 + p) * window + i]
        for p in range(COLUMNS):
            for q in range(COLUMNS):
                error += away[p] * par[ERRORS + COLUMNS * p + q] * away[q] / total**2
        found, variance = _weighed(mem[of : of + window], weights)
        sure, found = par[SPREAD] / math.sqrt(par[SPREAD] ** 2 + max(error, 0.0) + variance), found * n / (n - 1.0)
        rotors[k, j], least = abs(found), min(least, sure)
        best = sure * found if abs(sure * found) > abs(best) else best
    for j in range(n):
        rotors[k, j] *= least
    out[col.VALUE, k], out[col.LEVEL, k] = abs(best), best
    mem[TICKS] += 1.0
    mem[RUN] = mem[RUN] + 1.0 if covered and tick[OF_ROTOR * n + 1] > 0.5 else 0.0
    out[col.SOUND, k] = mem[RUN] >= window


@cached
def run(par: Floats, mem: Floats, x: Floats, first: int, known: int, out: Floats, rotors: Floats, at: Ints) -> int:
    """The rotor that is farthest from its speed at the end of each tick."""
    n, k = int(par[ROTORS]), 0
    tick, scratch = np.zeros(OF_ROTOR * n + TOLD), np.empty((2, int(par[WINDOW])))
    for i in range(first, x.shape[1]):
        if not _take_row(par, mem, x, i):
            continue
        tick[:] = 0.0
        tick[OF_ROTOR * n + 2] = mem[TICKS]
        if mem[KNOWN] >= par[ROWS]:
            _find(par, mem, tick)
            tick[OF_ROTOR * n + 1] = 1.0
        _take_tick(par, mem, tick, x[col.COVERED, i] > 0.5, scratch, out, rotors, k)
        at[k] = i - first
        for j in range(len(tick) if out.shape[0] > col.TRACE else 0):
            out[col.TRACE + j, k] = tick[j]
        k += 1
    return k


@cached
def _again(par: Floats, mem: Floats, ticks: Floats) -> Floats:
    """Distances of all rotors in the full windows of ticks that `run` has traced, (k, n)."""
    n, found, scratch = int(par[ROTORS]), 0, np.empty((2, int(par[WINDOW])))
    out, rotors = np.empty((col.LEVEL + 1, 1)), np.empty((len(ticks) + 1, n))
    for tick in ticks:
        if tick[OF_ROTOR * n + 2] == 0.0:  # a segment begins
            mem[:] = 0.0
        _take_tick(par, mem, tick, True, scratch, out, rotors[found:], 0)
        found += int(out[col.SOUND, 0])
    return rotors[:found]


class RotorSpeed(Monitor[RotorSpeedSpec]):
    """Statistic: how far ONE rotor's speed is from what its command gives, against the others [share of its speed].

        d_j = y_j - a_j - (x_j - x0_j)' b of each 0.5 s,    D_j = weighted mean over 5 s,    n: rotors
        statistic = max_j n/(n - 1) |D_j| sigma/sqrt(sigma^2 + (x_j - x0_j)' P (x_j - x0_j) + var(D_j))

    sigma: the healthy rms, no less than APART. A window whose ticks scatter, or have little weight, says less.
    If rotor j alone turns a share d faster, the mean has d/n of it: so n/(n - 1) D_j = d, and the others are d/(n - 1).
    `level` has the sign, above 0 for less drag. `rotors` are n/(n - 1) |D_j|, all times the least of these factors, so
    that no rotor is named for a surer command. Lowest rate: 10 Hz of the gyro, and each ESC once in 1.5 s.

    Warm-up: 5 s of unbroken valid flight with the outputs and speeds of all rotors. Latency: up to 5 s. False alarms:
    propellers that were changed and not told (`baseline extend --new-propellers`), for a new one differs as much as a
    damaged one; a motor that is hotter than the others. Blind spots: thrust that is lost with the drag as it was; all
    rotors alike; motors under an ESC that holds their speed; PX4's simulator, which makes its speeds up.
    """

    name = "rotor_speed"
    label = "speed"
    observes = "one rotor that turns faster or slower for its command than the others"
    phrase = "turns off its command {times}x"
    needs = frozenset({Signal.ACTUATOR, Signal.ROTOR_SPEED})
    depends = TRIM_CONDITIONS
    evidence = RotorEvidence(10.0, relative=True)  # at the threshold the others are a third of it or less
    least_hz = 10.0  # of the rows; ESCs at 1 Hz are seen, at 10 Hz as ArduPilot and PX4 send them they scatter less
    needs_layout = True
    tick_s = TICK_S
    spec_type = RotorSpeedSpec
    unit = "share of speed"
    run = staticmethod(run)

    def __init__(self, spec: RotorSpeedSpec) -> None:
        super().__init__(spec)
        own = slice(0, spec.layout.rotors)
        self.takes = MappingProxyType({Signal.ACTUATOR: own, Signal.ROTOR_SPEED: own})

    @classmethod
    def fit(cls, flights: Flights, context: LearnContext) -> tuple[RotorSpeedSpec, ...]:
        """The law of the healthy speeds, and how far healthy rotors are from it.

        Raises InputError without the outputs and speeds of all rotors, or if the speeds are made up of the outputs.
        """
        n, layout = context.layout.rotors, context.layout
        no = ((0.0, 0.0), (0.0, 0.0))
        still = RotorSpeedSpec(layout=layout, mean=(0.0,) * n, about=((0.0, 0.0),) * n, errors=no, spread=FLOOR)
        ticks = of_each(flights, (cls.name, layout), lambda flight: _ticks(cls(still), flight))
        joined = np.concatenate([np.empty((0, OF_ROTOR * n + TOLD)), *ticks])
        told = joined[joined[:, -2] > 0.5]
        if not len(told):
            raise InputError(f"it needs the outputs and the ESC telemetry of {n} rotors")
        if np.median(np.abs(np.exp(told[:, -TOLD]) / MADE_UP_RAD_S - 1.0)) < MADE_UP:
            raise InputError("the speeds are made up of the outputs, as a simulator does")
        seen = [usable for flight in ticks if len(usable := _usable(flight, n))]
        means = np.array([_mean(flight) for flight in seen])
        days, apart = means - means.mean(axis=0), np.concatenate([one - one.mean(axis=0) for one in seen])
        (y, *x), (dy, *dx) = (one.reshape(-1, OF_ROTOR)[:, : 1 + COLUMNS].T for one in (apart, days))
        known = held_law(dy, np.column_stack(dx), LAW, np.diag(LAW_SD**2), APART, 1)
        law, P = held_law(y, np.column_stack(x), *known, FLOOR, 1, SCATTER)
        beyond = math.sqrt(max(float(np.square(y - law @ x).mean()) - SCATTER**2, 0.0))
        law, P = held_law(y, np.column_stack(x), *known, FLOOR, 1, max(SCATTER, beyond))
        still = replace(still, law=_pair(law), errors=(_pair(P[0]), _pair(P[1])))
        learnt = _at(still, means.mean(axis=0))
        begun = cls(replace(learnt, spread=1.0)).begin(context.dt_s)
        found = _again(begun.par, begun.mem, joined)
        if not len(found):
            raise IdentificationError(f"no unbroken {WINDOW_S:g} s of flight with rotor speeds; fly longer")
        return (replace(learnt, spread=float(math.hypot(np.sqrt(np.mean(np.square(found))), APART))),)

    def renewed(self, flights: Flights, context: LearnContext) -> tuple[RotorSpeedSpec, float]:
        """With the speeds of the new propellers; how they follow the command, and vary, stays."""
        return _at(self.spec, self._means(flights).mean(axis=0)), 1.0

    def extended(self, flights: Flights, count: int) -> tuple[RotorSpeedSpec, float]:
        """With the means over all flights; no distance that is not damped grows by more than they are off the law."""
        n, means = self.rotors, self._means(flights)
        old, means = np.column_stack((self.spec.mean, self.spec.about)), means[:, :, : 1 + COLUMNS]
        moved = (means - old).sum(axis=0) / (count + len(means))
        apart = np.abs(moved[:, 0] - moved[:, 1:] @ self.spec.law).max()
        return _at(self.spec, old + moved), float(apart) * n / (n - 1)

    def _means(self, flights: Flights) -> FloatArray:
        """Mean y, x and s of the flights that show them, (k, n, OF_ROTOR). Raises IdentificationError if none does."""
        ticks = (_usable(_ticks(self, one), self.rotors) for one in flights)
        means = [_mean(one) for one in ticks if len(one)]
        if not means:
            raise IdentificationError("no flight with the outputs and speeds of all rotors; fly longer")
        return np.array(means)

    def begin(self, dt_s: float) -> Begin:
        """No row yet."""
        spec, n, rows = self.spec, self.rotors, self.tick(dt_s)
        window = max(3, round(spec.window_s / self.period_s(dt_s)))
        head = [n, rows, max(1, rows // END), dt_s, window, spec.spread, *spec.law, *np.ravel(spec.errors)]
        each = np.column_stack((spec.mean, np.array(spec.about), np.sign(spec.layout.unmixing[2])))
        return Begin(np.array([*head, *each.ravel()]), np.zeros(SUMS + 4 * n + 1 + OF_ROTOR * window * n))


def _at(spec: RotorSpeedSpec, means: FloatArray) -> RotorSpeedSpec:
    """The fit with these mean y and x of each rotor, (n, OF_ROTOR)."""
    return replace(spec, mean=tuple(means[:, 0].tolist()), about=tuple(map(_pair, means[:, 1 : 1 + COLUMNS])))


def _mean(ticks: FloatArray) -> FloatArray:
    """Weighted mean y, x and s of each rotor, (n, OF_ROTOR)."""
    weights = 1.0 / (1.0 + np.square(ticks[:, :, 1 + COLUMNS :] / SWIFT))
    return np.asarray((weights * ticks).sum(axis=0) / weights.sum(axis=0))


def _pair(values: FloatArray) -> Pair:
    return float(values[0]), float(values[1])


def _ticks(monitor: RotorSpeed, flight: Sequence[Rows]) -> FloatArray:
    """The ticks of a flight with what `TOLD` says of them, (k, OF_ROTOR n + TOLD)."""
    return traced(monitor, flight, OF_ROTOR * monitor.rotors + TOLD)[col.TRACE :].T


def _usable(ticks: FloatArray, n: int) -> FloatArray:
    """y, x and s of each of n rotors in the usable ticks, (k, n, OF_ROTOR)."""
    return ticks[ticks[:, -2] > 0.5, :-TOLD].reshape(-1, n, OF_ROTOR)
