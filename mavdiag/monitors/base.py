"""What a monitor is: one file in this folder, and one line in `mavdiag.monitors.MONITORS`.

A monitor turns rows into a statistic. Everything that the rest of the project must know about it stands in its class:
its name, unit and label, the signals it needs, how its healthy scores differ, what it knows about rotors, how it is
fitted to healthy flights. The registry builds from that the baseline's schema, the chain, learning, isolation, the
texts, the streams that the detector asks for, and the contract tests.
"""

import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, ClassVar, Generic, TypeAlias, TypeVar

import numpy as np

from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.layout import RotorLayout
from mavdiag.errors import InputError
from mavdiag.identify import Method, Order
from mavdiag.monitors.columns import Columns, Kernel, columns_of
from mavdiag.rows.block import ALL
from mavdiag.rows.conditions import Condition
from mavdiag.rows.front import Rows
from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import Axis, FloatArray, Signal
from mavdiag.thresholds.rule import Prior

__all__ = [
    "FaultKind",
    "Feature",
    "Flights",
    "LearnContext",
    "Monitor",
    "RotorEvidence",
    "Rows",
    "segments",
]

Spec = TypeVar("Spec")


Flights: TypeAlias = Sequence[Sequence[Rows]]
"""Flights as monitors are fitted to them: for each flight its rows of flying, in order."""


def segments(flight: Sequence[Rows]) -> list[list[Rows]]:
    """The rows of each segment of a flight, in order."""
    return [list(rows) for _, rows in itertools.groupby(flight, key=lambda one: one.block.segment)]


@dataclass(frozen=True, slots=True)
class LearnContext:
    """What is known beside the flights.

    airframe: the vehicle, as far as it is known.
    imu_corner_hz: corner of the low-pass filter in the IMU stream; None if it has none.
    dt_s: row period [s].
    window: samples of the Savitzky-Golay filters.
    axes: the axes that the fsd monitor models.
    method, order: how ARX models are fitted.
    margin_rule: "p90" or "max", the margin of the fsd monitor (T 4.4.3, Algorithm 1).
    figures: standard errors and figures of fit are wanted; a fit that only scores flights needs none.
    near: the monitor's fits to all flights, for one to some of them to begin from.
    """

    airframe: Airframe
    imu_corner_hz: float | None
    dt_s: float
    window: int
    axes: tuple[Axis, ...] = (Axis.ROLL, Axis.PITCH)
    method: Method = Method.SRIV
    order: Order = (2, 2, 1)
    margin_rule: str = "p90"
    figures: bool = True
    near: tuple[Any, ...] = ()

    @property
    def layout(self) -> RotorLayout:
        """The rotor layout. Raises InputError if it is not known."""
        if self.airframe.layout is None:
            raise InputError("the rotor layout is not known; name the airframe")
        return self.airframe.layout

    def need_rate(self, least_hz: float) -> None:
        """Raises InputError if rows come more seldom."""
        if 1 / self.dt_s < least_hz:
            raise InputError(f"the gyro comes at {1 / self.dt_s:.3g} Hz; {least_hz:.0f} Hz are needed")


@dataclass(frozen=True, slots=True)
class RotorEvidence:
    """How a monitor's `rotors` count when a rotor is named.

    weight: logits per unit of evidence.
    relative: the evidence counts in units of the monitor's threshold.
    direct: it observes the damaged rotor itself. Evidence that is not direct counts only while no direct monitor that
    is above its threshold is sure of a rotor: a trim shows which rotor is commanded more, and a blade with more drag
    has the others commanded more.
    """

    weight: float
    relative: bool = False
    direct: bool = True


class FaultKind(StrEnum):
    """What is wrong with a vehicle, from the least to the gravest: of several the last one holds."""

    PROPELLER = "propeller fault"
    SENSOR = "sensor fault"
    LOSS_OF_CONTROL = "loss of control"
    GROSS_LOSS = "gross loss of thrust"

    @property
    def rank(self) -> int:
        """Place in that order."""
        return tuple(FaultKind).index(self)


class Feature:
    """Names of the figures that grading a fault needs; a monitor's `feature` names which its `level` gives."""

    UNBALANCE = "unbalance"  # g mm
    MOTION = "motion"  # rad/s
    RISE = "rise"  # share of the hover command, from `rotors`


class Monitor(ABC, Generic[Spec]):
    """One statistic; `axis` is None where it concerns the whole vehicle.

    name: key in the baseline, the journal and the scan report.
    label: how a text for a pilot calls it, at most 10 characters.
    phrase: what a text for a pilot says of its alarm, with {times} its threshold or {lost} percent of thrust, if any.
    needs: every signal that its value may rest on; a value is not valid where one is unknown (see `signals`).
    depends: the conditions that raise its statistic in healthy flight; outside of what the healthy flights covered of
        them it does not judge (`thresholds.envelope`).
    decides: its alarm is a fault by itself; else it is a suspicion that another monitor must confirm.
    kind: what its alarm means.
    clear_s: how long its statistic must have been back before its event closes.
    prior: how its healthy maxima differ before any flight tells.
    evidence: how it knows about rotors; None if it does not.
    feature: what its level means for the fault, a name of `Feature`; None if nothing.
    needs_layout: it cannot be fitted where the rotor layout is not known.
    doubt: what a verdict adds where no deciding monitor without a doubt has an alarm; empty if nothing.
    run: its equation, compiled (`monitors.columns`).
    by_rates: its values are about the times of rates, which are known half a filter window later than rows.
    spec_type: the frozen dataclass of its fit, with `kind: Literal[name]`; what the baseline stores.
    """

    name: ClassVar[str]
    label: ClassVar[str]
    phrase: ClassVar[str] = ""
    needs: ClassVar[frozenset[Signal]]
    depends: ClassVar[frozenset[Condition]] = frozenset()
    decides: ClassVar[bool] = True
    kind: ClassVar[FaultKind] = FaultKind.PROPELLER
    clear_s: ClassVar[float] = 2.0  # our choice
    prior: ClassVar[Prior] = Prior()
    evidence: ClassVar[RotorEvidence | None] = None
    needs_layout: ClassVar[bool] = False
    doubt: ClassVar[str] = ""
    run: ClassVar[Kernel]
    by_rates: ClassVar[bool] = False
    spec_type: ClassVar[type[Any]]

    def __init__(self, spec: Spec) -> None:
        self.spec = spec
        self._parameters: dict[float, FloatArray] = {}

    @classmethod
    @abstractmethod
    def fit(cls, flights: Flights, context: LearnContext) -> tuple[Spec, ...]:
        """Fit it to healthy flights: one specification, or one for each axis.

        Raises InputError or IdentificationError, with the reason as the operator reads it (without the monitor's
        name), if it cannot work on such flights.
        """

    def renewed(self, flights: Flights, context: LearnContext) -> tuple[Spec, float]:
        """Its fit once the propellers are new, and the factor of scores that the old ones gave.

        flights: healthy ones with the new propellers. Raises as `fit`. Most fits do not rest on propellers, and stay.
        """
        return self.spec, 1.0

    def extended(self, flights: Flights, sessions: int) -> Spec:
        """Its fit with a further session of healthy flights. sessions: how many it rests on. Raises as `fit`."""
        return self.spec

    @property
    @abstractmethod
    def unit(self) -> str:
        """Unit of the statistic and of its threshold."""

    @property
    def signals(self) -> frozenset[Signal]:
        """The signals that this fit rests on; fewer than `needs` where it chose between them."""
        return self.needs

    def columns(self, signal: Signal) -> slice:
        """Which columns of a signal it takes."""
        return ALL

    @property
    def axis(self) -> Axis | None:
        """The body axis that the statistic is about."""
        return None

    @property
    def reference(self) -> float:
        """What its `signal` is compared with, for a display; 0 if with nothing."""
        return 0.0

    @property
    def delay_s(self) -> float:
        """How much later than its time stamp a value is known [s]: the fit's `delay_s`, if it has one."""
        return float(getattr(self.spec, "delay_s", 0.0))

    @property
    def reach(self) -> float:
        """What the statistic can come to, whatever breaks; a threshold at or above it would never be passed."""
        return math.inf

    @property
    def memory_s(self) -> float:
        """How long what was flown stays in the statistic [s]."""
        return 1.0

    @property
    def feature(self) -> str | None:
        """What its level means for the fault, a name of `Feature`; None if nothing."""
        return None

    @property
    def rotors(self) -> int:
        """For how many rotors it gives evidence: those of the fit's layout, if it has one."""
        layout: RotorLayout | None = getattr(self.spec, "layout", None)
        return 0 if layout is None else layout.rotors

    def period_s(self, dt_s: float) -> float:
        """Span of flight that one value stands for [s], at a row period."""
        return dt_s

    @abstractmethod
    def parameters(self, dt_s: float) -> FloatArray:
        """What `run` reads of its fit, at a row period [s]."""

    @abstractmethod
    def memory(self, dt_s: float) -> FloatArray:
        """What `run` remembers, before the first row of a segment."""

    def parameters_at(self, dt_s: float) -> FloatArray:
        """`parameters`, computed once."""
        if dt_s not in self._parameters:
            self._parameters[dt_s] = self.parameters(dt_s)
        return self._parameters[dt_s]

    def start(self) -> FloatArray:
        """A fresh state, before the first row of a segment: nothing, until the row period is known."""
        return np.empty(0)

    def step(self, state: FloatArray, rows: Rows) -> tuple[FloatArray, Statistic]:
        """Take the next rows of the same segment. Any cut into chunks gives the same values.

        The chain calls `start` at the border of every segment and flight; a monitor need not look for it.
        """
        return self.judge(state, rows, columns_of(rows))

    def judge(self, state: FloatArray, rows: Rows, columns: Columns) -> tuple[FloatArray, Statistic]:
        """As `step`, with the columns of the rows at hand."""
        dt_s, n = rows.block.dt_s, columns.flags.shape[1]
        memory = state.copy() if len(state) else self.memory(dt_s)
        out, rotors, at = np.empty((4, n)), np.empty((n, self.rotors)), np.empty(n, dtype=np.int64)
        count = self.run(self.parameters_at(dt_s), memory, columns.x, columns.flags, columns.lag, out, rotors, at)
        t_ns = rows.rates.t_ns if self.by_rates else rows.block.t_ns
        value, sound, level, signal = out[:, :count]
        found = Statistic(t_ns[at[:count]], self.period_s(dt_s), value, sound > 0.5, level, signal, rotors[:count])
        return memory, found

    def over(self, flight: Sequence[Rows]) -> Iterator[Statistic]:
        """Judge a whole flight, from a fresh state at every segment."""
        for segment in segments(flight):
            state = self.start()
            for rows in segment:
                state, statistic = self.step(state, rows)
                yield statistic
