"""What must not matter does not: teachers and judged flight are changed alike, and the verdict follows.

Flights are made (`flying_telemetry`): a healthy one, one with a weak rotor, and one whose roll rate also trembles from
12 s on. Time scaled by two is left out: windows, gates and clearing times are seconds of the vehicle. Instead, outputs
come half as often and gyro stamps are stretched by 0.1 %.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from flying_telemetry import flying
from made_baselines import FRAME, NOW, healthy, kept, logged
from made_telemetry import START_NS
from scipy.spatial.transform import Rotation

import mavdiag as md
from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.layout import RotorLayout
from mavdiag.baseline import Baseline
from mavdiag.judging import JudgedFlight, LogVerdict, Verdict, judge_in_full
from mavdiag.learning import LearnOptions, learn
from mavdiag.link.codec import Decoder, Encoder
from mavdiag.link.messages import MessageId
from mavdiag.link.profiles import PROFILES
from mavdiag.link.samples import SampleDecoder, SampleState
from mavdiag.monitors.rotor_trim import TICK_S
from mavdiag.telemetry import Axis, FloatArray, IntArray, Signal, Telemetry
from mavdiag.units import NS_PER_S

SAMPLES, DAY_NS = 3000, 86_400 * NS_PER_S
WEAK, RISE = 2, 0.15
ORDER = (3, 2, 0, 1)  # rotor j + 1 becomes what rotor ORDER[j] + 1 was
ROUNDING = 1e-6  # of a statistic, relative: the same sums in another order, through filters and fitted models
TURNED = 0.01  # relative: rates from the derivative of Euler angles do not commute with the turn
RUN_S = 0.02  # two rows: residuals near the margin may fall on its other side
QUANTUM = 0.002  # of a trim: outputs in whole microseconds are steps of 0.001 about 0.5
LOOK_S = 0.1  # between two looks of the decision
SLOWER = 1  # thousandths of the period
QUARTER = Rotation.from_euler("z", 90, degrees=True)
Transform = Callable[[Telemetry], Telemetry]
Columns = Callable[[FloatArray], FloatArray]


def trembling() -> Telemetry:
    """A weak rotor, and from 12 s on 0.3 rad/s at 20 Hz about the roll axis."""
    flight = flying(SAMPLES, 7, weak_rotor=WEAK, rise=RISE)
    t_s = flight.need(Signal.BODY_RATE).t_s
    roll = 0.3 * np.sin(2 * np.pi * 20 * t_s) * (t_s > 12.0)
    return with_columns(flight, {Signal.BODY_RATE: lambda rate: rate + roll[:, None] * [1.0, 0.0, 0.0]})


FLIGHTS: dict[str, Callable[[], Telemetry]] = {
    "healthy": lambda: flying(SAMPLES, 7),
    "weak": lambda: flying(SAMPLES, 7, weak_rotor=WEAK, rise=RISE),
    "trembling": trembling,
}
of_each_flight = pytest.mark.parametrize("name", FLIGHTS)


@cache
def taught(change: Transform = lambda telemetry: telemetry, frame: Airframe = FRAME) -> Baseline:
    teachers = [replace(log, telemetry=change(log.telemetry)) for log in healthy(3, SAMPLES)]
    key = " ".join(log.telemetry.digest for log in teachers)
    return kept(f"{frame} {key}", lambda: learn(teachers, LearnOptions(airframe=frame), created=NOW))


@cache
def expected(name: str) -> LogVerdict:
    """The verdict on a flight that nothing was done to; it shows that the flights are what they are taken for."""
    verdict = md.judge(logged(FLIGHTS[name]()), taught())
    found = (verdict.verdict, verdict.rotor, {one.monitor for one in verdict.events})
    assert found == {
        "healthy": (Verdict.HEALTHY, None, set()),
        "weak": (Verdict.FAULT, WEAK, {"rotor_trim"}),
        "trembling": (Verdict.FAULT, WEAK, {"innovation", "rotor_trim"}),
    }.get(name), verdict.reason
    return verdict


def judged(name: str, change: Transform, frame: Airframe = FRAME) -> LogVerdict:
    return md.judge(logged(change(FLIGHTS[name]())), taught(change, frame))


def with_columns(telemetry: Telemetry, columns: Mapping[Signal, Columns]) -> Telemetry:
    """The same samples at the same times, the values of some signals computed anew."""
    return Telemetry(
        tuple(
            replace(one, values=columns[one.signal](one.values)) if one.signal in columns else one for one in telemetry
        )
    )


def maxima(verdict: LogVerdict) -> dict[str, float]:
    return {one.name: one.maximum for one in verdict.monitors if one.maximum is not None}


def assert_same(found: LogVerdict, name: str, late_s: float = 0.0, rotors: Mapping[int, int] | None = None) -> None:
    """The same verdict and kind, first alarms at most late_s apart, and the rotors that these have become."""
    wanted = expected(name)
    assert (found.verdict, found.kind, found.notes) == (wanted.verdict, wanted.kind, wanted.notes), found.reason
    assert (found.since_s is None) == (wanted.since_s is None)
    if found.since_s is not None and wanted.since_s is not None:
        assert found.since_s == pytest.approx(wanted.since_s, abs=late_s + 1e-9)
    assert [one.rotor for one in found.rotors] == [(rotors or {}).get(one.rotor, one.rotor) for one in wanted.rotors]
    assert {one.monitor for one in found.events} == {one.monitor for one in wanted.events}


def permuted(telemetry: Telemetry) -> Telemetry:
    return with_columns(
        telemetry, dict.fromkeys((Signal.ACTUATOR, Signal.ROTOR_SPEED), lambda of_each: of_each[:, ORDER])
    )


@of_each_flight
def test_rotors_renumbered(name: str) -> None:
    assert FRAME.layout is not None
    layout = RotorLayout("permuted", tuple(FRAME.layout.signs[rotor] for rotor in ORDER))
    found = judged(name, permuted, replace(FRAME, layout=layout))
    assert_same(found, name, rotors={was + 1: now for now, was in enumerate(ORDER, start=1)})
    assert maxima(found) == pytest.approx(maxima(expected(name)), rel=ROUNDING)


@of_each_flight
def test_outputs_rewired(name: str) -> None:
    """The layout is as told, its rotors on other outputs: the flights show which, and rotors keep their numbers."""
    assert taught(permuted).airframe.outputs == tuple(ORDER.index(rotor) + 1 for rotor in range(4))
    assert_same(judged(name, permuted), name)


def turned(telemetry: Telemetry) -> Telemetry:
    """The same motion in body axes turned by 90 degrees to the right: x' is y, y' is -x."""

    def vector(values: FloatArray) -> FloatArray:
        return values[:, [1, 0, 2]] * [1.0, -1.0, 1.0]

    def angles(values: FloatArray) -> FloatArray:
        return np.ascontiguousarray((Rotation.from_euler("ZYX", values[:, ::-1]) * QUARTER).as_euler("ZYX")[:, ::-1])

    vectors = (Signal.BODY_RATE, Signal.SPECIFIC_FORCE, Signal.TORQUE_COMMAND)
    attitudes = (Signal.ATTITUDE, Signal.ATTITUDE_SETPOINT)
    levels: dict[Signal, Columns] = {Signal.VIBRATION: lambda values: values[:, [1, 0, 2]]}
    return with_columns(telemetry, levels | dict.fromkeys(vectors, vector) | dict.fromkeys(attitudes, angles))


def longest_runs(flight: JudgedFlight) -> dict[Axis | None, float]:
    """The maximum of the thesis's monitor on each axis [s]; the verdict has that of one axis only."""
    assert flight.chain is not None
    return {
        slot.monitor.axis: max(piece.found[k].value[piece.found[k].valid].max(initial=0.0) for piece in flight.pieces)
        for k, slot in enumerate(flight.chain.slots)
        if slot.monitor.name == "fsd"
    }


@of_each_flight
def test_frame_turned(name: str) -> None:
    assert FRAME.layout is not None
    layout = RotorLayout("turned", tuple((pitch, -roll, yaw) for roll, pitch, yaw in FRAME.layout.signs))
    log, baseline = logged(turned(FLIGHTS[name]())), taught(turned, replace(FRAME, layout=layout))
    assert (baseline.airframe.layout, baseline.airframe.outputs) == (layout, None)
    found = judge_in_full(log, baseline)
    assert_same(found.verdict, name, late_s=LOOK_S)
    others = {one: maximum for one, maximum in maxima(expected(name)).items() if one != "fsd"}
    assert {one: maxima(found.verdict)[one] for one in others} == pytest.approx(others, rel=TURNED)
    runs, wanted = longest_runs(found), longest_runs(judge_in_full(logged(FLIGHTS[name]()), taught()))
    assert runs[Axis.PITCH] == pytest.approx(wanted[Axis.ROLL], abs=RUN_S)
    assert runs[Axis.ROLL] == pytest.approx(wanted[Axis.PITCH], abs=RUN_S)


def shifted(telemetry: Telemetry) -> Telemetry:
    return Telemetry(tuple(replace(one, t_ns=one.t_ns + DAY_NS, host_ns=one.host_ns + DAY_NS) for one in telemetry))


@of_each_flight
def test_clock_a_day_on(name: str) -> None:
    found, wanted = judged(name, shifted), expected(name)
    back = found if found.since_s is None else replace(found, since_s=found.since_s - DAY_NS / NS_PER_S)
    assert_same(back, name)
    assert maxima(found) == pytest.approx(maxima(wanted), rel=ROUNDING)
    assert [one.start_ns - DAY_NS for one in found.events] == [one.start_ns for one in wanted.events]


def halved(telemetry: Telemetry) -> Telemetry:
    """Every second sample of the outputs, which hold in between."""
    outputs = telemetry.need(Signal.ACTUATOR)
    half = outputs.where(slice(None, None, 2))
    return Telemetry(tuple(half if one is outputs else one for one in telemetry))


@of_each_flight
def test_outputs_half_as_often(name: str) -> None:
    assert_same(judged(name, halved), name, late_s=LOOK_S)


def slowed(telemetry: Telemetry) -> Telemetry:
    def later(t_ns: IntArray) -> IntArray:
        return START_NS + (t_ns - START_NS) * (1000 + SLOWER) // 1000

    return Telemetry(tuple(replace(one, t_ns=later(one.t_ns), host_ns=later(one.host_ns)) for one in telemetry))


@of_each_flight
def test_clock_slightly_slow(name: str) -> None:
    """The flight alone: a baseline holds for a rate that is a thousandth off. The first tick of a trim may count."""
    found = md.judge(logged(slowed(FLIGHTS[name]())), taught())
    assert_same(found, name, late_s=TICK_S + LOOK_S)
    assert found.rate_hz == pytest.approx(expected(name).rate_hz / (1 + SLOWER / 1000), rel=1e-5)


def sent(profile: str, message: MessageId, head: tuple[int, ...], low: float, high: float) -> Transform:
    """Outputs as a vehicle sends them between low and high: through bytes of a message and back.

    head: the fields between time and outputs. The IMU comes first, for it tells the time since boot, then idle motors.
    """

    def arrived(outputs: FloatArray) -> FloatArray:
        encoder, decoder = Encoder(1, 1), Decoder()
        frames = list(decoder.feed(encoder.encode(PROFILES[profile].imu, 10_000), 10_000_000))
        for k, row in enumerate((low + (high - low) * np.vstack((outputs[:1] / 9, outputs))).tolist()):
            fields = (row + [0.0] * 28,) if message == MessageId.ACTUATOR_OUTPUT_STATUS else map(round, row)
            frames += decoder.feed(encoder.encode(message, 20_000 * (k + 1), *head, *fields), 20_000_000 * (k + 1))
        return SampleDecoder(PROFILES[profile]).step(SampleState(), frames).need(Signal.ACTUATOR).values[1:]

    return lambda telemetry: with_columns(telemetry, {Signal.ACTUATOR: arrived})


STATUS, SERVO = MessageId.ACTUATOR_OUTPUT_STATUS, MessageId.SERVO_OUTPUT_RAW
UNITS: dict[str, Transform] = {
    "of a larger full scale": lambda telemetry: with_columns(
        telemetry, {Signal.ACTUATOR: lambda outputs: 0.8 * outputs}
    ),
    "dshot": sent("px4", STATUS, (8,), 0.0, 1999.0),
    "whole microseconds": sent("ardupilot", SERVO, (0,), 1000.0, 2000.0),
}


@of_each_flight
@pytest.mark.parametrize("unit", UNITS)
def test_outputs_in_another_unit(name: str, unit: str) -> None:
    found = judged(name, UNITS[unit])
    assert_same(found, name, late_s=LOOK_S)
    assert maxima(found)["rotor_trim"] == pytest.approx(maxima(expected(name))["rotor_trim"], abs=QUANTUM)
