"""The rotor-trim monitor: one rotor is commanded more, against the others, than it was when all were healthy.

A controller with an integrator hides a weak rotor from its own attitude error: it commands more. That command is the
evidence, and it names the rotor (METHOD section 5). It does not show why: a changed propeller, a payload hung off
the centre or a damaged blade all shift the trim.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from mavdiag.airframe.layout import RotorLayout
from mavdiag.airframe.trim import SOURCES, Source, rises, source_among, sources_of, spread_from, tilt_of, trim_of
from mavdiag.errors import IdentificationError, InputError
from mavdiag.monitors.base import Feature, Flights, LearnContext, Summaries, Summary, segments
from mavdiag.monitors.healthy import Three, joined_moments, moments, three
from mavdiag.monitors.trim import WINDOW_S, TrimMonitor, TrimSpec
from mavdiag.rows.front import Rows
from mavdiag.rows.statistic import Statistic
from mavdiag.rows.windows import MeanState, row_max, sliding_mean, start_mean, window_rows
from mavdiag.telemetry import FloatArray
from mavdiag.thresholds.guard import Guard

__all__ = ["RotorTrim", "RotorTrimSpec"]

NONE = np.empty((0, 3))


@dataclass(frozen=True, slots=True, kw_only=True)
class RotorTrimSpec(TrimSpec):
    """Healthy trim.

    mean, spread: of the 5 s means of roll, pitch and yaw trim [fraction of hover].
    Raises InputError if they do not describe a vehicle.
    """

    kind: Literal["rotor_trim"] = "rotor_trim"
    mean: Three
    spread: Three

    def __post_init__(self) -> None:
        if not all(math.isfinite(x) for x in (*self.mean, *self.spread)) or min(*self.spread, self.window_s) <= 0:
            raise InputError("rotor_trim: the healthy trim must be finite, its spread and the window positive")
        self.check()


class RotorTrim(TrimMonitor[RotorTrimSpec, MeanState]):
    """Statistic: the rise of ONE rotor's command that explains the trim shift best [fraction of hover].

        m: trim averaged over 5 s,    mu: the healthy one,    a_j: rise of rotor j that explains m - mu (`trim`)
        statistic = max_j a_j,    rotor = argmax_j a_j

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
    >>> float(found.value[-1].round(2)), int(found.rotors[-1].argmax()) + 1, found.valid[[498, 499]].tolist()
    (0.1, 2, [False, True])
    """

    name = "rotor_trim"
    label = "rotor trim"
    phrase = "lost {lost}% thrust"
    # An estimate from subsets of the five healthy recorded flights of one airframe: few sessions do not show how the
    # trim changes from one to the next, 0.06 more with one session, nothing more from five on; and one flight's scale
    # does not show what the next flight of a session has, 12 scales more (a simulated vehicle has hardly any). And a
    # shift of less than 0.02 is what wind and new propellers make (thrust coefficients differ by 0.8 %, METHOD 3).
    guard = Guard(few_sessions=0.06, few_flights=12.0, least=0.02)
    spec_type = RotorTrimSpec
    feature = Feature.RISE
    doubt = "trim shift: propeller, payload or session"  # a trim alone tells no more

    @classmethod
    def gather(cls, flight: Sequence[Rows], context: LearnContext) -> Summary:
        """Which sources show a trim, and for each of them the moments of the window means."""
        layout, shown = context.layout, sources_of(flight, context.layout)
        found = [_moments(flight, layout, source) if shown[i] else moments(NONE) for i, source in enumerate(SOURCES)]
        return (shown, *found[0], *found[1])

    @classmethod
    def settle(cls, summaries: Summaries, context: LearnContext) -> tuple[RotorTrimSpec, ...]:
        """Healthy trim: mean over flights of their means, spread of all their windows about it.

        sd_yaw is widened by 0.002, sd_roll and sd_pitch are at least 3 sd_yaw.
        """
        layout, source = context.layout, source_among([one[0] for one in summaries], context.layout)
        first = 1 + 3 * SOURCES.index(source)
        found = [one[first : first + 3] for one in summaries]
        mu = _mean(found)
        spread = spread_from(joined_moments(found).about(mu))
        return (RotorTrimSpec(layout=layout, source=source, mean=three(mu), spread=spread),)

    def renewed(self, flights: Flights, context: LearnContext) -> tuple[RotorTrimSpec, float]:
        """With the trim of the new propellers; how much it varies stays."""
        mean = _mean([_moments(flight, self.spec.layout, self.spec.source) for flight in flights])
        return replace(self.spec, mean=three(mean)), 1.0

    def extended(self, flights: Flights, sessions: int) -> RotorTrimSpec:
        """With the mean over sessions, the new one among them."""
        mean = np.array(self.spec.mean)
        fresh = _mean([_moments(flight, self.spec.layout, self.spec.source) for flight in flights])
        return replace(self.spec, mean=three(mean + (fresh - mean) / (sessions + 1)))

    def start(self) -> MeanState:
        """An empty mean."""
        return start_mean(5)

    def step(self, state: MeanState, rows: Rows) -> tuple[MeanState, Statistic]:
        """The best single-rotor rise at each of the next rows."""
        spec, block = self.spec, rows.block
        trim, known = trim_of(block, spec.layout, spec.source)
        both = np.concatenate((trim, tilt_of(block)), axis=1)
        state, mean, full = sliding_mean(state, both, known, window_rows(spec.window_s, block.dt_s))
        shift = mean[:, :3] - spec.mean
        rise = row_max(rises(shift, spec.layout, spec.spread, mean[:, 3:]))
        rotors = rises(shift, spec.layout, spec.spread)
        return state, Statistic(block.t_ns, block.dt_s, rise, full, rise, shift[:, 2], rotors)


def _mean(flights: Sequence[Sequence[FloatArray]]) -> FloatArray:
    """The mean over flights of their means, (3,), by their moments. Raises IdentificationError."""
    means = [mean for count, mean, _ in flights if count[0]]
    if not means:
        raise IdentificationError(f"no unbroken {WINDOW_S:g} s of flight to average the trim over; fly longer")
    return np.asarray(np.mean(means, axis=0), dtype=np.float64)


def _moments(flight: Sequence[Rows], layout: RotorLayout, source: Source) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Of the full window means of a flight."""
    found = [NONE]
    for segment in segments(flight):
        state = start_mean(3)
        for block in (rows.block for rows in segment):
            trim, known = trim_of(block, layout, source)
            state, mean, full = sliding_mean(state, trim, known, window_rows(WINDOW_S, block.dt_s))
            found.append(mean[full])
    return moments(np.concatenate(found))
