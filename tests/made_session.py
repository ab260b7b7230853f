"""A vehicle and its session on a virtual clock: flights made beforehand, fed chunk by chunk, everything kept."""

from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
from made_telemetry import body_rates
from scipy.signal import lfilter

from detector.config import SessionSettings
from detector.session import Session
from detector.states import State
from detector.values import Effect, FitOutcome, SendText, SessionSpec, StateChanged
from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.layout import layout_named
from mavdiag.baseline import Baseline, Link, MonitorEntry, Provenance, SourceLog, Window, sealed
from mavdiag.identify import Method
from mavdiag.identify.arx import ModelRecord
from mavdiag.link.profiles import PROFILES
from mavdiag.link.vehicles import Ack, Received
from mavdiag.monitors.rotor_trim import RotorTrimSpec
from mavdiag.monitors.run_length import RunLengthSpec
from mavdiag.monitors.unbalance import UnbalanceSpec
from mavdiag.monitors.vibration_level import VibrationLevelSpec
from mavdiag.rows.align import Grid
from mavdiag.rows.gate import GateSpec
from mavdiag.telemetry import Axis, FloatArray, Instant, Series, Signal, Telemetry
from mavdiag.thresholds.heldout import Scores
from mavdiag.thresholds.rule import ThresholdRule, threshold_of
from mavdiag.units import NS_PER_S

RATE_HZ = 100
A = np.array([1.0, -0.8])  # a rate loop of 45 ms at 100 Hz, gain 1
B = np.array([0.0, 0.2])
NOISE = 0.01  # rad/s, white
MARGIN, FML_S = 0.02, 0.3  # about 4 sd of the smoothed noise; far longer than any run that it makes


@cache
def _attitude_and_rate(seconds: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """(n, 3) set-points [rad], smooth random steps, and the rates [rad/s] that the airframe answers with."""
    n, rng = seconds * RATE_HZ, np.random.default_rng(seed)
    steps = np.repeat(rng.normal(0, 0.1, (n // 50 + 1, 3)), 50, axis=0)[:n]
    setpoint = np.asarray(lfilter([0.01], np.poly([0.9, 0.9]), steps, axis=0), dtype=np.float64)
    clean = np.asarray(lfilter(B, A, body_rates(setpoint, 1 / RATE_HZ), axis=0), dtype=np.float64)
    return setpoint, clean + NOISE * rng.standard_normal((n, 3))


def _specs(name: str, axes: tuple[Axis, ...]) -> list[tuple[Any, float]]:
    match name:
        case "fsd":
            model = ModelRecord(
                a=tuple(A.tolist()), b=tuple(B.tolist()), dt_s=1 / RATE_HZ, order=(1, 1, 1), method=Method.SRIV
            )
            return [(RunLengthSpec(axis=axis, model=model, margin_rad_s=MARGIN), FML_S) for axis in axes]
        case "rotor_trim":
            still, spread = (0.0, 0.0, 0.0), (0.03, 0.03, 0.01)
            return [(RotorTrimSpec(layout=layout_named("x"), source="actuator", mean=still, spread=spread), 0.1)]
        case "vibration_level":
            return [(VibrationLevelSpec(healthy=0.4), 1.5)]
        case _:
            spec = UnbalanceSpec(
                dt_s=1 / RATE_HZ,
                corner_hz=20.0,
                layout=None,
                covariance=(0.0, 0.0),
                spread=(1.0, 1.0),
                turning=0.0,
                power=1.0,
            )
            return [(spec, 10.0)]


def baseline_for(
    profile: str = "qdrone2",
    rate_hz: float = RATE_HZ,
    axes: tuple[Axis, ...] = (Axis.ROLL,),
    names: tuple[str, ...] = ("fsd",),
) -> Baseline:
    """A baseline that knows the made airframe exactly, with these monitors."""
    monitors = tuple(
        MonitorEntry(
            spec=spec,
            threshold=threshold_of(
                Scores(np.array([limit]), np.array([3600.0]), np.array([0])),
                sessions=[0],
                budget_per_hour=0.05,
                rule=ThresholdRule.MAXIMUM,
            ),
        )
        for name in names
        for spec, limit in _specs(name, axes)
    )
    return sealed(
        Baseline(
            airframe=Airframe(name="made"),
            link=Link(
                profile=profile,
                dt_s=1 / rate_hz,
                grid=Grid.NATIVE,
                max_gap_s=0.035,
                gate=GateSpec(min_thrust=0.1, need_armed=True),
            ),
            window=Window(samples=11, order=2),
            monitors=monitors,
            not_judgeable=(),
            healthy_hours=1.0,
            provenance=Provenance(
                logs=(SourceLog(name="made", sha256="0" * 64, judged_s=3600.0),), created="2026-01-01", tool="test"
            ),
        )
    )


LEARNING = SessionSpec(PROFILES["qdrone2"], None, SessionSettings(learn=20.0))


@dataclass
class Story:
    """One session and its vehicle. `fly` lets time pass; `log` keeps every effect with the time it came at [s]."""

    spec: SessionSpec = LEARNING
    seconds: int = 120
    seed: int = 1
    chunk_s: float = 0.1
    parameters: dict[str, float] = field(default_factory=dict)
    session: Session = field(init=False)
    log: list[tuple[float, Effect]] = field(default_factory=list)
    passed: int = 0  # samples' worth of time
    reboots: int = 0

    def __post_init__(self) -> None:
        self.session = Session(self.spec, self.now)

    @property
    def state(self) -> Session:
        return self.session

    @property
    def now(self) -> Instant:
        return Instant(round(1e12) + self.passed * NS_PER_S // RATE_HZ)

    @property
    def s(self) -> float:
        return self.passed / RATE_HZ

    def fly(
        self,
        seconds: float,
        *,
        push: float = 0.0,
        armed: bool = True,
        thrust: float = 0.5,
        without: tuple[Signal, ...] = (),
        every: int = 1,
        outputs: bool = False,
    ) -> list[Effect]:
        """Let it send for a while. push [rad/s]: of the roll rate; every: such sample; outputs: of the motors, too."""
        chunk, before = round(self.chunk_s * RATE_HZ), len(self.log)
        for _ in range(round(seconds * RATE_HZ / chunk)):
            telemetry = self._chunk(chunk, push, armed, thrust, every)
            kept = tuple(one for one in telemetry.series if one.signal not in without)
            if outputs:
                t_ns = telemetry.series[0].t_ns
                held = 0.5 + 0.001 * np.sin(np.outer(t_ns / 1e8, [1.0, 1.1, 1.2, 1.3]))
                kept = (*kept, Series(Signal.ACTUATOR, t_ns, t_ns, held))
            self.passed += chunk
            self.give(Received(Telemetry(kept), alive=True, reboots=self.reboots, parameters=self.parameters))
        return [effect for _, effect in self.log[before:]]

    def silence(self, seconds: float) -> list[Effect]:
        """Let time pass while nothing comes from the vehicle."""
        chunk, before = round(self.chunk_s * RATE_HZ), len(self.log)
        for _ in range(round(seconds * RATE_HZ / chunk)):
            self.passed += chunk
            self.give(Received(reboots=self.reboots))
        return [effect for _, effect in self.log[before:]]

    def give(self, received: Received, outcome: FitOutcome | None = None) -> list[Effect]:
        effects = self.session.step(received, self.now, outcome)
        self.log += [(self.s, effect) for effect in effects]
        return list(effects)

    def answer(self, outcome: FitOutcome) -> list[Effect]:
        return self.give(Received(alive=True, reboots=self.reboots), outcome)

    def acknowledge(self, ack: Ack) -> list[Effect]:
        return self.give(Received(alive=True, reboots=self.reboots, acks=(ack,)))

    def at(self, state: State) -> bool:
        return self.session.state is state

    @property
    def texts(self) -> list[str]:
        return [effect.text for _, effect in self.log if isinstance(effect, SendText)]

    @property
    def states(self) -> list[State]:
        return [effect.new for _, effect in self.log if isinstance(effect, StateChanged)]

    def _chunk(self, n: int, push: float, armed: bool, thrust: float, every: int) -> Telemetry:
        setpoint, rate = _attitude_and_rate(self.seconds, self.seed)
        rows = slice(self.passed, self.passed + n, every)
        t_ns = NS_PER_S + np.arange(self.passed, self.passed + n, every, dtype=np.int64) * (NS_PER_S // RATE_HZ)

        def made(signal: Signal, values: FloatArray) -> Series:
            return Series(signal, t_ns, t_ns, values)

        k = len(t_ns)
        return Telemetry(
            (
                made(Signal.ATTITUDE_SETPOINT, setpoint[rows]),
                made(Signal.BODY_RATE, rate[rows] + np.array([push, 0.0, 0.0])),
                made(Signal.THRUST_SETPOINT, np.full((k, 1), thrust)),
                made(Signal.ARMED, np.full((k, 1), float(armed))),
            )
        )


def outcome_of(story: Story) -> Baseline:
    return baseline_for(story.spec.profile.name)
