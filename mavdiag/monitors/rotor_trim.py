"""The rotor-trim monitor: one rotor is commanded more, against the others, than it was when all were healthy.

A controller with an integrator hides a weak rotor from its own attitude error: it commands more. That command is the
evidence, and it names the rotor (METHOD section 5). It does not show why: a changed propeller, a payload hung off
the centre or a damaged blade all shift the trim.
"""

from collections.abc import Sequence
from typing import Literal

import numpy as np

import mavdiag.monitors.trim as trim
from mavdiag.airframe.trim import spread_of
from mavdiag.jit import cached
from mavdiag.monitors.base import Feature
from mavdiag.monitors.columns import COVERED, LEVEL, SIGNAL, SOUND, TRACE, VALID, VALUE, Floats, Ints
from mavdiag.monitors.spec import spec
from mavdiag.telemetry import FloatArray, Three
from mavdiag.thresholds.rule import Prior


@spec
class RotorTrimSpec(trim.TrimSpec):
    """Healthy trim. spread: of the 5 s means of roll, pitch and yaw trim about `mean` [fraction of hover]."""

    kind: Literal["rotor_trim"] = "rotor_trim"


@cached
def run(par: Floats, mem: Floats, x: Floats, flags: Floats, lag: int, out: Floats, rotors: Floats, at: Ints) -> int:
    """The best single-rotor rise at the end of each tick."""
    k, shift = 0, np.empty(5)
    for i in range(x.shape[1]):
        if not trim.take_row(par, mem, x, i, flags[VALID, i] > 0.5):
            continue
        trim.take_tick(par, mem, mem[trim.KNOWN] > 0.5 and flags[COVERED, i] > 0.5)
        sound = mem[trim.RUN] >= par[trim.WINDOW]
        for j in range(5):
            healthy = par[trim.MEAN + j] if j < 3 else 0.0
            shift[j] = trim.window_mean(par, mem, 0, j) - healthy if sound else 0.0
        value = trim.highest_rise(par, shift, True)
        for rotor in range(rotors.shape[1]):
            rotors[k, rotor] = trim.rise(par, rotor, shift, False)
        out[VALUE, k], out[SOUND, k], out[LEVEL, k], out[SIGNAL, k], at[k] = value, sound, value, shift[2], i
        if out.shape[0] > TRACE:
            trim.trace_tick(par, mem, out, k)
        k += 1
    return k


class RotorTrim(trim.TrimMonitor[RotorTrimSpec]):
    """Statistic: the rise of ONE rotor's command that explains the trim shift best [fraction of hover].

        m: trim averaged over 5 s,    mu: the healthy one,    a_j: rise of rotor j that explains m - mu (`trim`)
        statistic = max_j a_j,    rotor = argmax_j a_j

    m is the mean of ten ticks, each the median of half a second without what a turn takes of the yaw trim
    (`monitors.trim`), so that a few wild samples move nothing; the more a turn takes, the less its tick counts.

    A payload, a weak battery or a shifted centre of mass move roll and pitch, not yaw; these have at least three times
    yaw's spread, so the evidence is mostly yaw, and roll and pitch settle which rotor it is. Wind that holds the
    vehicle tilted tips the rotor discs too: the spread of roll and pitch has 0.3 times the commanded tilt of the same
    5 s added in squares, but not where a rotor is named. `level` is the same amplitude, which grades the damage;
    `signal` is the yaw trim's shift; `rotors` are the a_j. In a session of the healthy flights the
    threshold is lower (`Threshold.session_allowance`).

    Warm-up: 5 s of unbroken valid flight. Latency: up to 5 s. False alarms: see `thresholds`; two flights from two
    sessions are the worst basis. Blind spots: hops shorter than 5 s; vibration without loss of thrust; all rotors
    ageing alike; a rotor whose outputs saturate. A change of propellers or of the centre of mass raises it without a
    fault.

    >>> from mavdiag.airframe.layout import layout_named
    >>> from mavdiag.testing import example_rows
    >>> outputs = np.random.default_rng(3).normal([0.5, 0.55, 0.5, 0.5], 0.02, (1000, 4))   # rotor 2 works harder
    >>> x, still = layout_named("x"), (0.0, 0.0, 0.0)
    >>> healthy = RotorTrimSpec(layout=x, source="actuator", mean=still, spread=(0.03, 0.03, 0.01))
    >>> monitor = RotorTrim(healthy)
    >>> _, found = monitor.step(monitor.start(), example_rows(1000, 0.01, actuator=outputs))
    >>> float(found.value[-1].round(2)), int(found.rotors[-1].argmax()) + 1, found.valid[[8, 9]].tolist()
    (0.1, 2, [False, True])
    """

    name = "rotor_trim"
    label = "rotor trim"
    phrase = "lost {lost}% thrust"
    # Emulated quad- and hexarotors have 0.007 to 0.019 between sessions with new propellers, whose thrust differs by
    # up to 3 %, and 0.001 between flights of one session; other winds make more (our choice). 0.02 is what wind makes.
    prior = Prior(0.013, 0.004, 0.001, shares=False, least=0.02)
    spec_type = RotorTrimSpec
    feature = Feature.RISE
    doubt = "trim shift: propeller, payload or session"  # a trim alone tells no more

    @classmethod
    def spread_of(cls, flights: Sequence[Sequence[FloatArray]], mean: Three) -> Three:
        """Of all windows of all flights about the mean.

        sd_yaw is widened by 0.002, sd_roll and sd_pitch are at least 3 sd_yaw.
        """
        return spread_of(np.concatenate([trim.windows_of(flight) for flight in flights]) - mean)

    run = staticmethod(run)
