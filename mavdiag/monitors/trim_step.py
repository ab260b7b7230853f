"""The trim-step monitor: within a flight one rotor came to be commanded more than the minute before.

A session's own offset is in the trim from the first second, and a battery moves it slowly; a blade that breaks at once.
"""

from collections.abc import Sequence
from typing import Literal

import numpy as np

import mavdiag.monitors.rotor_trim as trim
from mavdiag.airframe.trim import BESIDE, spread_of
from mavdiag.errors import IdentificationError
from mavdiag.jit import cached, jit
from mavdiag.monitors.base import Flights
from mavdiag.monitors.spec import Positive, Span, spec
from mavdiag.rows.block import SOUND, TRACE, Floats, Ints
from mavdiag.telemetry import FloatArray, Three

MEMORY_S = 30.0  # of the reference (our choice)
DRIFT_PER_S = 3e-4  # of hover: no faster does the reference follow. A pack empties some 1e-5 a second (our choice)
HOLD = 0.012  # of hover: the reference waits while a shift is larger, so that a fault is not taken in (our choice)
HOLD_S = 120.0  # of judged flight it waits, for what a vehicle has carried so long is its own (our choice)
SESSION = 0.06  # of hover: a rise against the healthy trim that a session explains (our choice)
# Places of its own: in the parameters how fast and how far the reference follows in a tick, and the length of a
# tick; in the memory the reference (a window's means), the way back from it to where the trim was healthy
# (zero while that is the reference itself), judged flight since it waits, 1 if there is one.
FOLLOW, MOST, TICK_S = trim.OWN, trim.OWN + 1, trim.OWN + 2
REFERENCE, BACK, HELD, THERE = trim.MINE, trim.MINE + 7, trim.MINE + 10, trim.MINE + 11


@spec
class TrimStepSpec(trim.TrimSpec):
    """How much the trim moves within a healthy flight.

    memory_s: of the reference [s]. drift_per_s: largest drift that is followed [fraction of hover a second].
    """

    kind: Literal["trim_step"] = "trim_step"
    memory_s: Span = MEMORY_S
    drift_per_s: Positive = DRIFT_PER_S


@jit
def _share(par: Floats, mem: Floats, shift: Floats) -> float:
    """How far along the way back a shift lies, 0..1: its nearest point, in units of the spreads."""
    length, along = 0.0, 0.0
    for j in range(3):
        weighed = mem[BACK + j] / par[trim.SPREAD + j] ** 2
        length, along = length + weighed * mem[BACK + j], along + weighed * shift[j]
    return min(max(along / length, 0.0), 1.0) if length > 0.0 else 0.0


@jit
def _take_window(par: Floats, mem: Floats, shift: Floats, before: Floats) -> bool:
    """After a tick: the shift of the present window from the reference, (7,), zero where it is not judged.

    before: room for that of the window before.
    """
    window = int(par[trim.WINDOW])
    shift[:] = 0.0
    if mem[trim.RUN] < 2 * window:
        return False
    trim.window_means(par, mem, 0, before)
    trim.window_means(par, mem, 1, shift)
    shift[trim.LIFT] = before[trim.LIFT]  # the height's loop answers a load later than the trim
    trim.window_means(par, mem, window, before)
    if mem[THERE] < 0.5:
        for j in range(trim.MEANS):
            mem[REFERENCE + j] = before[j]
            before[j] = before[j] - par[trim.MEAN + j] if j < trim.LIFT else 0.0
        far = trim.best_rise(par, before) > SESSION
        for j in range(trim.MEANS):
            if j < 3:
                mem[BACK + j] = -before[j] if far else 0.0
            before[j] = mem[REFERENCE + j]
        mem[HELD], mem[THERE] = 0.0, 1.0
    for j in range(trim.MEANS):
        shift[j], before[j] = shift[j] - mem[REFERENCE + j], before[j] - mem[REFERENCE + j]
    share = _share(par, mem, shift)
    for j in range(3):
        shift[j] -= share * mem[BACK + j]
    mem[HELD] = mem[HELD] + par[TICK_S] if max(trim.best_rise(par, shift), trim.best_rise(par, before)) > HOLD else 0.0
    if mem[HELD] == 0.0:
        fastest, early, late = par[MOST], BESIDE * before[trim.LIFT], BESIDE * shift[trim.LIFT]
        carried = min(abs(early), abs(late)) > HOLD >= abs(late - early)
        for j in (0, 1, 2, trim.LIFT):
            fastest = max(fastest, abs(before[j]) * par[FOLLOW])
        for j in range(trim.MEANS):  # what a load moves together goes back together; it moves no yaw (2)
            mem[REFERENCE + j] += shift[j] if carried and j != 2 else before[j] * par[FOLLOW] * par[MOST] / fastest
    elif mem[HELD] > HOLD_S:
        for j in range(trim.MEANS):
            mem[REFERENCE + j] += before[j]
        for j in range(3):
            mem[BACK + j] -= before[j]
        mem[HELD] = 0.0
    return True


@cached
def run(par: Floats, mem: Floats, x: Floats, first: int, known: int, out: Floats, rotors: Floats, at: Ints) -> int:
    """The best single-rotor rise at the end of each tick."""
    k, begin, shift, before = 0, first, np.empty(trim.MEANS), np.empty(trim.MEANS)
    while begin < x.shape[1]:
        begin, ended = trim.take_rows(par, mem, x, begin)
        if ended:
            trim.write(par, mem, shift, _take_window(par, mem, shift, before), out, rotors, k)
            at[k] = begin - 1 - first
            k += 1
    return k


class TrimStep(trim.TrimMonitor[TrimStepSpec]):
    """Statistic: the rise of ONE rotor's command against the same flight before [fraction of hover].

        m: trim averaged over 5 s, 0.5 s older than o, for o answers a load later,    a_j: rise of rotor j for m - m_ref
        statistic = the larger of: a_j of the rotor with the largest a_j |c_j|; max_j b_j
        b_j = max(0, min(g_j, n l) - 3 s_j)/(1 - 3 s_j/(n l)),    n: rotors,    l = ln(o/o_ref),    s_j: sd of g_j
        g_j = (c_j . d - |c_j x d|)/|c_j|^2 of roll and pitch alone,    d = m - m_ref
        m_ref <- m_ref + (m(t - 5 s) - m_ref) dt/30 s, at most 0.0003 dt,    while both are within 0.012
        m_ref <- m but for yaw, o_ref <- o,    if 0.3 l is above 0.012 in both, and differs by no more: a load stays
        var(m_roll), var(m_pitch): their spread^2 + (0.3 ln(o/o_ref))^2,    o: mean output, which has a reference, too

    A load lies at 0.3 of the rotors' distance, usually; a weak rotor is at 1. Thrust lost without drag moves no yaw:
    b_j is what roll, pitch and o tell beyond any load.

    m_ref begins as the first 5 s of a flight that the envelope covers. What was there from the start does not count,
    and of a rise of r a second only 37 r is seen: a session's offset, a battery, wear. A shift that stays for two
    minutes of judged flight becomes the reference. From then on, and where a flight begins with more than a session
    explains, m - m_ref is taken from the nearest point of the way back to where the trim was healthy, so that a repair
    in flight is no fault of the other rotors. `level` equals the statistic. `rotors` are the a_j by the spreads as they
    are, where drag may change apart from thrust, by as much (sd): a blade with more of it names no other rotor.

    Warm-up: 10 s of unbroken valid flight as the envelope covers it. Latency: up to 5.5 s. False alarms: a load that is
    hung under one rotor, or slips. Blind spots: damage that was there at take-off (the rotor-trim monitor sees it) or
    grows slowly, what yaw does not show for 10 s after a load came or went, and hops shorter than 10 s.
    """

    name = "trim_step"
    label = "trim step"
    observes = "one rotor commanded more than a minute ago"
    least = 0.01  # half of what a trim must allow for wind (our choice)
    drag = 1.0  # lost with the thrust, as it was, or more (our choice)
    spec_type = TrimStepSpec
    run = staticmethod(run)

    @classmethod
    def spread(cls, flights: Sequence[Sequence[FloatArray]], mean: Three) -> Three:
        """Of healthy shifts within flights, in which no session's load counts."""
        shifts = [one[TRACE + trim.SHIFT :, one[SOUND] > 0.5] for flight in flights for one in flight]
        found = np.concatenate([np.empty((3, 0)), *shifts], axis=1).T
        if len(found) == 0:
            raise IdentificationError(f"no unbroken {2 * trim.WINDOW_S:g} s of flight to compare trims in; fly longer")
        return spread_of(found, 1.0)

    def extended(self, flights: Flights, count: int) -> tuple[TrimStepSpec, float]:
        """As of the trim; a flight's own reference stays."""
        return super().extended(flights, count)[0], 0.0

    def own(self, tick_s: float) -> tuple[float, float, float]:
        """See `TICK_S`."""
        return tick_s / self.spec.memory_s, self.spec.drift_per_s * tick_s, tick_s
