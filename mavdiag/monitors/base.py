"""What a monitor is: it turns rows into a statistic, and its class says all that the rest of the project must know."""

import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from types import MappingProxyType
from typing import Any, ClassVar, Generic, NamedTuple, Protocol, TypeAlias, TypeVar

import numpy as np

from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.layout import Motor, RotorLayout
from mavdiag.errors import InputError
from mavdiag.identify import Method, Order
from mavdiag.rows.block import SOUND, VALUE, Columns, Floats, Ints, columns_of, no_past
from mavdiag.rows.conditions import Condition
from mavdiag.rows.front import Rows
from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import Axis, FloatArray, Signal
from mavdiag.thresholds.rule import Prior, prior_of

SLACK = 0.98  # a nominal rate is met within 2 % (our choice)
ROOM = 256  # columns in front of rows that are put aside: more than any monitor looks back at 1 kHz (our choice)
Spec = TypeVar("Spec")
Flights: TypeAlias = Sequence[Sequence[Rows]]
"""Flights as monitors are fitted to them: for each flight its rows of flying, in order."""


def segments(flight: Sequence[Rows]) -> Iterator[Iterator[Rows]]:
    """The rows of each segment of a flight, in order, made as they are taken."""
    return (rows for _, rows in itertools.groupby(flight, key=lambda one: one.block.segment))


@dataclass(frozen=True, slots=True)
class LearnContext:
    """What is known beside the flights."""

    airframe: Airframe
    imu_corner_hz: float | None  # of the low-pass filter in the IMU stream; None if it has none
    dt_s: float  # row period
    window: int  # rows of the Savitzky-Golay filters
    axes: tuple[Axis, ...] = (Axis.ROLL, Axis.PITCH)  # that the fsd monitor models
    method: Method = Method.SRIV  # of ARX models
    order: Order = (2, 2, 1)
    margin_rule: str = "p90"  # or "max", the margin of the fsd monitor (T 4.4.3, Algorithm 1)
    figures: bool = True  # standard errors and figures of fit are wanted; a fit that only scores flights needs none
    near: tuple[Any, ...] = ()  # the monitor's fits to all flights, for one to some of them to begin from

    @property
    def layout(self) -> RotorLayout:
        """The rotor layout. Raises InputError if it is not known."""
        if self.airframe.layout is None:
            raise InputError("the rotor layout is not known; name the airframe")
        return self.airframe.layout

    @property
    def delay_s(self) -> float:
        """Half the window of the rate filters [s]."""
        return self.window // 2 * self.dt_s


@dataclass(frozen=True, slots=True)
class RotorEvidence:
    """How a monitor's `rotors` count when a rotor is named."""

    weight: float  # logits per unit of evidence
    relative: bool = False  # the evidence counts in units of the monitor's threshold
    least: float = 0.0  # the smallest such unit
    arms: tuple[Motor, ...] = ()  # what is named, and the evidence is the highest of its rotors; empty: each rotor
    direct: bool = True  # it observes the rotor itself; else it counts only while no direct one is sure of a rotor


class FaultKind(StrEnum):
    """What is wrong with a vehicle, from the least to the gravest: of several the last one holds."""

    PROPELLER = "propeller fault"
    SENSOR = "sensor fault"
    LOSS_OF_CONTROL = "loss of control"
    GROSS_LOSS = "gross loss of thrust"

    @property
    def rank(self) -> int:
        """Place in that order."""
        return list(FaultKind).index(self)


class Feature:
    """Figures that grading a fault needs."""

    UNBALANCE = "unbalance"  # g mm
    MOTION = "motion"  # rad/s
    RISE = "rise"  # share of the hover command, from `rotors`


class Loop(Protocol):
    """A compiled monitor: columns from `first` on in, values out; returns how many.

    par, mem: see `Begin`; mem is changed in place. x: see `rows.block.VALID`; from column `known` on rates are there.
    out: (4, n), see `VALUE`. rotors: (n, R). at: (n,) number of the row, or of the rates, that each value is about.
    """

    def __call__(
        self, par: Floats, mem: Floats, x: Floats, first: int, known: int, out: Floats, rotors: Floats, at: Ints, /
    ) -> int:
        """Take the next columns."""


class Begin(NamedTuple):
    """What a loop reads of its fit, what it remembers before a segment, and how many earlier columns it looks at."""

    par: FloatArray
    mem: FloatArray
    back: int = 0


class Monitor(ABC, Generic[Spec]):
    """One statistic; of one body axis, or of the whole vehicle. What depends on the fit is set in `__init__`."""

    name: ClassVar[str]  # key in the baseline, the journal and the scan report
    label: ClassVar[str]  # how a text for a pilot calls it, at most 10 characters
    observes: ClassVar[str] = ""  # what it looks at, in a few words for a reader
    phrase: ClassVar[str] = ""  # what it says of its alarm, with {times} its threshold or {lost} percent of thrust
    needs: ClassVar[frozenset[Signal]]  # that its value may rest on; a value is not valid where one is unknown
    depends: ClassVar[frozenset[Condition]] = frozenset()  # conditions that raise it in health (`thresholds.envelope`)
    decides: ClassVar[bool] = True  # its alarm is a fault by itself; else it is a suspicion, to be confirmed
    kind: ClassVar[FaultKind] = FaultKind.PROPELLER  # what its alarm means
    clear_s: ClassVar[float] = 2.0  # how long it must have been back before its event closes (our choice)
    prior: ClassVar[Prior]  # how its healthy maxima differ, before any flight tells (`thresholds.rule.prior_of`)
    least: ClassVar[float] = 0.0  # the smallest threshold that means anything, in its unit
    evidence: ClassVar[RotorEvidence | None] = None  # how it knows about rotors; None if it does not
    least_hz: ClassVar[float] = 0.0  # the slowest gyro that it can work with
    why_hz: ClassVar[str] = "{:.0f} Hz are needed"  # how that is said
    needs_layout: ClassVar[bool] = False  # it cannot be fitted where the rotor layout is not known
    doubt: ClassVar[str] = ""  # what a verdict adds where no deciding monitor without a doubt has an alarm
    run: ClassVar[Loop]  # its equation, compiled
    by_rates: ClassVar[bool] = False  # its values are about the times of rates, known half a filter window later
    shown: ClassVar[int] = VALUE  # row of its values that a display draws
    spec_type: ClassVar[type[Any]]  # the frozen dataclass of its fit, with `kind: Literal[name]`, in the baseline
    unit: str  # of the statistic and of its threshold
    feature: str | None = None  # what its level means for the fault, a name of `Feature`
    reach: float = math.inf  # what the statistic can come to; a threshold there would never be passed
    memory_s: float = 1.0  # how long what was flown stays in the statistic
    tick_s: ClassVar[float] = 0.0  # of how much flight it makes one value; 0: of each row
    takes: Mapping[Signal, slice] = MappingProxyType({})  # which columns of a signal it takes, where not all
    axis: Axis | None = None  # the body axis that it is about
    reference: float = 0.0  # what a display compares it with; 0 if nothing

    def __init_subclass__(cls) -> None:
        """Give each monitor its prior."""
        super().__init_subclass__()
        cls.prior = replace(prior_of(getattr(cls, "name", "")), least=cls.least)

    def __init__(self, spec: Spec) -> None:
        layout: RotorLayout | None = getattr(spec, "layout", None)
        self.spec, self.signals = spec, self.needs  # signals: that this fit rests on, where it chose between them
        self.rotors = 0 if layout is None else layout.rotors  # for how many it gives evidence
        self.delay_s = float(getattr(spec, "delay_s", 0.0))  # how much later than its time stamp a value is known
        self.memory_s = max(self.memory_s, getattr(spec, "window_s", 0.0) + self.tick_s)

    @classmethod
    def need_stream(cls, rate_hz: float, imu_corner_hz: float | None = None, hover_rad_s: float | None = None) -> None:
        """Raises InputError if such a stream does not carry what it looks for; asked before `fit`.

        rate_hz: of the gyro. imu_corner_hz: as of `LearnContext`. hover_rad_s: rotor speed at hover, if known.
        """
        if rate_hz < SLACK * cls.least_hz:
            raise InputError(f"the gyro comes at {rate_hz:.3g} Hz; {cls.why_hz.format(cls.least_hz)}")

    @classmethod
    @abstractmethod
    def fit(cls, flights: Flights, context: LearnContext) -> tuple[Spec, ...]:
        """Fit it to healthy flights: one specification, or one for each axis.

        Raises InputError or IdentificationError, with the reason as the operator reads it (without the monitor's
        name), if it cannot work on such flights.
        """

    @abstractmethod
    def begin(self, dt_s: float) -> Begin:
        """What `run` works with, at a row period [s]."""

    def renewed(self, flights: Flights, context: LearnContext) -> tuple[Spec, float]:
        """Its fit of healthy flights with new propellers, and the factor of scores that the old ones gave."""
        return self.spec, 1.0

    def extended(self, flights: Flights, count: int) -> tuple[Spec, float]:
        """Its fit with further healthy flights, and what that adds to scores of the old ones at most.

        count: how many flights its level rests on.
        """
        return self.spec, 0.0

    def blindness(self, threshold: float) -> str:
        """What it does not notice at a threshold, in half a sentence; empty where nothing is to be said."""
        return ""

    @classmethod
    def tick(cls, dt_s: float) -> int:
        """How many rows one value is about."""
        return max(1, round(cls.tick_s / dt_s))

    def period_s(self, dt_s: float) -> float:
        """Span of flight that one value stands for [s], at a row period."""
        return self.tick(dt_s) * dt_s

    def judge(self, begun: Begin, rows: Rows, columns: Columns, more: int) -> tuple[Statistic, FloatArray]:
        """Its statistic of some rows, and what the loop wrote, with so many inner figures, (4 + more, k)."""
        n = len(rows.block)
        out, rotors, at = np.empty((4 + more, n)), np.empty((n, self.rotors)), np.empty(n, dtype=np.int64)
        count = self.run(begun.par, begun.mem, columns.x, columns.first, columns.known, out, rotors, at)
        found = out[:, :count], rotors[:count], at[:count]
        if 2 * count < n:  # a value now and then does not keep the room of all rows
            found = (out[:, :count].copy(), rotors[:count].copy(), at[:count].copy())
        return self.statistic(rows, *found), found[0]

    def statistic(self, rows: Rows, out: FloatArray, rotors: FloatArray, at: Any) -> Statistic:
        """What a loop wrote, with its times."""
        t_ns, dt_s = rows.rates_ns if self.by_rates else rows.block.t_ns, rows.block.dt_s
        return Statistic(t_ns[at], self.period_s(dt_s), out[VALUE], out[SOUND] > 0.5, out[2], out[self.shown], rotors)

    def over(self, flight: Sequence[Rows]) -> Iterator[Statistic]:
        """Judge a whole flight, from a fresh state at every segment."""
        return (found for ((found, _),) in walk([self], flight))


def parted(flight: Sequence[Rows]) -> Iterator[tuple[bool, Rows]]:
    """The rows of a flight one after the other, and whether a segment begins with them."""
    segment = None
    for rows in flight:
        begins, segment = rows.block.segment != segment, rows.block.segment
        yield begins, rows
        del rows  # before the next ones are made


def walk(
    monitors: Sequence[Monitor[Any]], flight: Sequence[Rows], more: int = 0
) -> Iterator[Iterator[tuple[Statistic, FloatArray]]]:
    """Of each piece of a flight what each monitor judges (`Monitor.judge`), from a fresh state at every segment.

    One monitor's answer is made as it is taken, so that few of them and one piece of rows are in memory.
    """
    begun, past = list[Begin](), no_past(0)
    for begins, rows in parted(flight):
        if begins:
            begun = [monitor.begin(rows.block.dt_s) for monitor in monitors]
            past = no_past(max([ROOM, *(one.back for one in begun)]))
        columns = columns_of(rows, past)
        past = columns.past
        yield (monitor.judge(one, rows, columns, more) for monitor, one in zip(monitors, begun, strict=True))
        del rows, columns
