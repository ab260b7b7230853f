"""The streams of a vehicle: their measured rates, what is missing, and what is asked of the autopilot.

The gyro is mandatory, and so are set-points where nothing can be done without them. The lack of others is told only.

A stream that is missing, or whose measured rate will not do, is asked for by SET_MESSAGE_INTERVAL: at once, then after
the pauses of `PAUSES_S`. Tries are forgotten once a rate was right for 5 s; one that is changed again before is asked
for ever more seldom, for two that set the same rate must not fight. A refusal is an answer. Where the autopilot does
not send the IMU message of its profile, those of `Want.others` are asked for in turn.

An acknowledgement does not name the message. So one request waits for its answer at a time, for `ACK_S` at most, and
those with the fewest tries come first. Once an autopilot let that time pass without ever having answered, it is asked
for all at once, and an answer that may be that of several requests counts for none.
"""

from collections import defaultdict
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from detector.alerts import Kind, Notice
from detector.config import SessionSettings
from detector.values import Effect, Note, SendCommand
from mavdiag.baseline import RATE_TOLERANCE, Baseline
from mavdiag.link.codec import message_name
from mavdiag.link.messages import MavCmd, MavResult
from mavdiag.link.profiles import Profile, scale_doubt
from mavdiag.link.scale import gravity_of
from mavdiag.link.vehicles import Ack
from mavdiag.link.wants import LABELS, Want, remedy, wants_of
from mavdiag.monitors import MONITORS
from mavdiag.rows.gate import GateSpec
from mavdiag.rows.grid import steps_of, usual_step
from mavdiag.telemetry import FloatArray, Instant, IntArray, Series, Signal, Telemetry
from mavdiag.units import NS_PER_S

SILENT_S = 2.0  # without a sample for so long, a stream has stopped (our choice)
MEASURE_S = 1.0  # vehicle time over which a rate is measured (our choice: a change is known within 2 s)
METERED = (
    Signal.BODY_RATE,
    Signal.ATTITUDE_SETPOINT,
    Signal.ACTUATOR,
    Signal.VIBRATION,
    Signal.ROTOR_SPEED,
    Signal.ATTITUDE,
)
SLOWER = 8.0  # two steps in a row so many times the period are another rate: losses hardly make them (our choice)
WEIGH_S, WEIGH_SAMPLES = 1.0, 20  # of the accelerometer, before its scale is believed (our choice)
_MOST = 100_000  # samples of the accelerometer that are kept
_PIECES = 1000  # that are kept of one measurement: a clock that stands still ends none

PAUSES_S = (2.0, 2.0, 5.0, 5.0, 5.0, 30.0)  # least time to the next request after 0 (forgotten), 1, 2, ... tries
HELD_S = 5.0  # a rate that was right for so long was met; what came of a request is told after as long (our choice)
VAIN = 3  # tries after which a message that never came is not to be had (our choice)
OFTEN = 3  # changes by others after which the operator is told
SETTLE_S = 2.5  # after a request, before rates are reported (our choice)
ACK_S = 2.0  # an acknowledgement that has not come by then is lost; no later than the same request again (our choice)
_REFUSED = (MavResult.DENIED, MavResult.UNSUPPORTED, MavResult.FAILED)


class Reason(StrEnum):
    """Why learning or judging cannot go on, as the operator reads it (short: it shares a text of 50 bytes)."""

    NO_SETPOINTS = "no attitude set-points"
    NO_GYRO = "no gyro"
    SCALE = "IMU scale"
    MEASURING = "measuring the rates"
    SLOW_GYRO = "gyro rate too low"
    SLOW_SETPOINTS = "set-point rate too low"
    OTHER_RATE = "rate not the baseline's"
    NOT_ARMED = "not armed"
    NOT_AIRBORNE = "not airborne"


class Hindrance:
    """A reason, and the same with the figure that goes with it."""

    def __init__(self, reason: Reason, figure: str = "") -> None:
        self.reason, self.text = reason, f"{reason} {figure}".rstrip()


class Meter:
    """The rate of one stream, by the vehicle's stamps alone: a radio or a computer that stalls changes no rate."""

    def __init__(self, samples: int = 0) -> None:
        self.samples = samples  # all so far
        self.latest: Instant | None = None  # when one came last (host); None if none came, or none for `SILENT_S`
        self.periods_s: tuple[float, ...] = ()  # the last two measurements: one odd second is no change of rate
        self.rate_hz = 0.0  # 0 while unknown
        self._t_ns: list[IntArray] = []  # since the last measurement
        self._recent_ns: list[int] = []  # vehicle times of the last three samples

    def take(self, series: Series, now: Instant) -> None:
        """Measure the next samples."""
        t_ns = series.t_ns
        count, recent_ns = len(t_ns), t_ns[-3:].tolist()
        self.latest, self.samples = now, self.samples + count
        self._recent_ns = recent_ns if count > 2 else [*self._recent_ns, *recent_ns][-3:]
        self._t_ns.append(t_ns)
        span_ns = recent_ns[-1] - int(self._t_ns[0][0])
        if span_ns >= MEASURE_S * NS_PER_S:
            steps = steps_of(np.concatenate(self._t_ns))
            self.periods_s = (*self.periods_s, usual_step(steps) / NS_PER_S)[-2:] if len(steps) else ()
        # Measured; or a clock that jumped back, or stands still, starts the measurement anew.
        if not (0 <= span_ns < MEASURE_S * NS_PER_S and len(self._t_ns) <= _PIECES):
            self._t_ns = [t_ns[-1:]]
        self.rate_hz = self._rate_hz()

    def _rate_hz(self) -> float:
        """Measured rate. Two samples of a far lower rate tell at once that somebody set it."""
        if not self.periods_s:
            return 0.0
        period_s = self.periods_s[-1]
        if len(self._recent_ns) == 3:
            before_ns, at_ns, after_ns = self._recent_ns
            slow_s = min(at_ns - before_ns, after_ns - at_ns) / NS_PER_S
            period_s = slow_s if slow_s > SLOWER * period_s else period_s
        return 1.0 / period_s


class Streams:
    """The streams of one vehicle."""

    def __init__(self) -> None:
        self.began: Instant | None = None  # since when they are observed (host)
        self.armed = self.thrust = float("nan")  # 0 or 1; collective set-point, 0..1: as said last; nan if never said
        self.scale_doubt = ""  # what the accelerometer feels and the profile that would explain it, if it is not 1 g
        self.meters = {signal: Meter() for signal in METERED}
        self._weighed: list[FloatArray] = []  # of the accelerometer, until its scale is believed
        self._weighed_since_ns = 0
        self._scale_believed = False

    def observe(self, telemetry: Telemetry, now: Instant, profile: Profile) -> None:
        """Take in what came. profile: of the link, with the IMU message that is read."""
        self.began = self.began or now
        came = {series.signal: series for series in telemetry.series if series.t_ns.size}
        for signal, meter in self.meters.items():
            if (series := came.get(signal)) is not None:
                meter.take(series, now)
            elif meter.latest is not None and now - meter.latest > SILENT_S:
                self.meters[signal] = Meter(meter.samples)
        self.armed = _latest(self.armed, came.get(Signal.ARMED))
        self.thrust = _latest(self.thrust, came.get(Signal.THRUST_SETPOINT))
        if not self._scale_believed and (force := came.get(Signal.SPECIFIC_FORCE)) is not None:
            self._weigh(force, profile)

    def _weigh(self, force: Series, profile: Profile) -> None:
        known = np.isfinite(force.values).all(axis=1)  # a log may lack an axis
        if not known.any():
            return
        if not self._weighed:
            self._weighed_since_ns = int(force.t_ns[0])
        self._weighed.append(force.values[known][:_MOST])
        span_ns, samples = int(force.t_ns[-1]) - self._weighed_since_ns, sum(map(len, self._weighed))
        if (samples >= WEIGH_SAMPLES and span_ns >= WEIGH_S * NS_PER_S) or samples > _MOST:
            felt = np.concatenate(self._weighed).mean(axis=0)
            self.scale_doubt = scale_doubt(profile, gravity_of(felt[None, :]))
            self._scale_believed, self._weighed = not self.scale_doubt, []

    @property
    def gyro(self) -> Meter:
        """The gyro's meter."""
        return self.meters[Signal.BODY_RATE]

    def rate_hz(self, signal: Signal, now: Instant) -> float | None:
        """Measured rate of a stream; 0 if it does not come, None while it is being measured."""
        meter = self.meters[signal]
        if meter.latest is None:
            return 0.0 if self.began is not None and now - self.began > SILENT_S else None
        return meter.rate_hz if meter.periods_s else None

    def missing(self, signals: Container[Signal]) -> Signal | None:
        """The first of some signals that is metered and does not come."""
        return next((signal for signal in METERED if signal in signals and self.meters[signal].latest is None), None)

    def on_ground(self, gate: GateSpec) -> Hindrance | None:
        """Why the vehicle does not count as flying; None if it does, or never says."""
        if gate.need_armed and self.armed < 0.5:
            return Hindrance(Reason.NOT_ARMED)
        if gate.min_thrust is not None and self.thrust < gate.min_thrust:
            return Hindrance(Reason.NOT_AIRBORNE)
        return None


def _latest(old: float, series: Series | None) -> float:
    return old if series is None else float(series.values[-1, 0])


@dataclass(frozen=True, slots=True)
class Demand:
    """What a session needs of a vehicle's streams."""

    wants: tuple[Want, ...]  # the streams to ask for
    least_hz: float  # slowest gyro and set-points: `min_rate_hz`, or the baseline's rate where that is lower
    dt_s: float | None  # row period of the baseline; None without one
    setpoints: bool  # whether nothing can be done without set-points

    @classmethod
    def of(
        cls, settings: SessionSettings, profile: Profile, baseline: Baseline | None, judged: Sequence[Container[Signal]]
    ) -> "Demand":
        """What learning needs, or judging by a baseline. judged: the signals of each monitor at work."""
        least_hz, ask_hz = settings.min_rate_hz, settings.ask_hz or profile.rate_hz
        if baseline is None:
            needs = frozenset[Signal]().union(*(monitor.needs for monitor in MONITORS))
            return cls(wants_of(profile, needs, (ask_hz, least_hz, float("inf")), least_hz), least_hz, None, True)
        dt_s = baseline.link.dt_s
        slowest_hz, fastest_hz = 1.0 / dt_s / (1.0 + RATE_TOLERANCE), 1.0 / dt_s / (1.0 - RATE_TOLERANCE)
        setpoints = bool(judged) and all(Signal.ATTITUDE_SETPOINT in signals for signals in judged)
        imu_hz = (1.0 / dt_s, slowest_hz, fastest_hz)
        least_hz = min(least_hz, slowest_hz)
        wants = wants_of(profile, baseline.needs(), imu_hz, least_hz, setpoints)
        return cls(wants, least_hz, dt_s, setpoints)

    def lack(self, streams: Streams, *, judging: bool) -> Hindrance | None:
        """What the streams lack, None if they will do. judging: a rate must be wrong twice before it has changed."""
        gyro, setpoint = streams.gyro, streams.meters[Signal.ATTITUDE_SETPOINT]
        if gyro.latest is None:
            return Hindrance(Reason.NO_GYRO)
        if streams.scale_doubt:
            return Hindrance(Reason.SCALE, streams.scale_doubt)
        if self.setpoints and setpoint.latest is None:
            return Hindrance(Reason.NO_SETPOINTS)
        if not gyro.periods_s or (self.setpoints and not setpoint.periods_s):
            return Hindrance(Reason.MEASURING)
        periods_s = gyro.periods_s if judging else gyro.periods_s[-1:]
        if self._slow(periods_s):
            return Hindrance(Reason.SLOW_GYRO, f"({gyro.rate_hz:.0f} Hz)")
        if self.dt_s is not None:
            tolerance = (2.0 if judging else 1.0) * RATE_TOLERANCE
            if all(abs(period_s / self.dt_s - 1.0) > tolerance for period_s in periods_s):
                return Hindrance(Reason.OTHER_RATE, f"({gyro.rate_hz:.0f} Hz)")
        if self.setpoints and self._slow(setpoint.periods_s):
            return Hindrance(Reason.SLOW_SETPOINTS, f"({setpoint.rate_hz:.0f} Hz)")
        return None

    def _slow(self, periods_s: Sequence[float]) -> bool:
        return all(period_s * self.least_hz > 1.0 for period_s in periods_s)


@dataclass(slots=True)
class _Ask:
    tries: int = 0  # since its rate held last
    at: Instant | None = None  # when it was asked for last
    answer: int | None = None  # MAV_RESULT of the last acknowledgement; None if none came
    right_since: Instant | None = None  # since when its rate is right; None while it is not
    resets: int = 0  # how often others changed a rate that had been met
    told: set[str] = field(default_factory=set)  # what was said of it, once each: "lack", "resets", "rate"
    reported_hz: float = 0.0  # the rate that was reported last; 0 if none was

    @property
    def refused(self) -> bool:
        return self.answer in _REFUSED

    def due(self, now: Instant) -> bool:
        pause_s = PAUSES_S[min(self.tries, len(PAUSES_S) - 1)]
        return not self.refused and (self.at is None or now - self.at >= pause_s)

    def vain(self, now: Instant) -> bool:
        return self.refused or (self.tries >= VAIN and self.due(now))

    def look(self, right: bool, now: Instant) -> None:
        if not right:
            if self.right_since is not None:
                self.right_since = None
                self.resets += self.at is not None and self.tries == 0
        elif self.right_since is None:
            self.right_since = now
        elif now - self.right_since >= HELD_S:
            self.tries = 0
            self.answer = None if self.refused else self.answer


class Negotiation:
    """All that was asked so far of one autopilot. autopilot: MAV_AUTOPILOT."""

    def __init__(self, autopilot: int = 0) -> None:
        self._autopilot = autopilot
        self._asks: defaultdict[int, _Ask] = defaultdict(_Ask)
        self._awaited: tuple[int | None, Instant] | None = None  # message that waits for an answer; None for several
        self._answers: bool | None = None  # whether an answer ever came; None while the first request may have one

    @property
    def free(self) -> bool:
        """Whether a request may go out now."""
        return self._awaited is None or self._answers is False

    def step(
        self, wants: Sequence[Want], streams: Streams, acks: Sequence[Ack], now: Instant
    ) -> tuple[list[Effect], list[Notice]]:
        """Take in acknowledgements and measured rates; return what to ask and what to say."""
        effects, due = list[Effect](self._acknowledged(acks, now)), list[tuple[_Ask, int, float]]()
        rates_hz = {want.msgid: streams.rate_hz(want.signal, now) for want in wants}
        for want in wants:
            rate_hz = rates_hz[want.msgid]
            if rate_hz is None:  # it is being measured
                continue
            # Of the messages that carry the signal the first that may still come.
            others = () if rate_hz else want.others
            carriers = (msgid for msgid in (want.msgid, *others) if rate_hz or not self._asks[msgid].vain(now))
            msgid = next(carriers, want.msgid)
            ask, right = self._asks[msgid], want.least_hz <= rate_hz <= want.most_hz
            ask.look(right, now)
            if not right and ask.due(now):
                due.append((ask, msgid, want.ask_hz))
            effects += self._told(ask, msgid, want, rate_hz, now)
        for ask, msgid, ask_hz in sorted(due, key=lambda one: one[0].tries):
            if self.free:
                effects += self.ask_for(msgid, ask_hz, now)
                ask.tries, ask.at = ask.tries + 1, now
        return effects, self._reported(rates_hz, now)

    def ask_for(self, msgid: int, rate_hz: float, now: Instant) -> list[Effect]:
        """Ask once for a stream."""
        self._awaited = (msgid if self._awaited is None else None, now)
        interval_us = round(1e6 / rate_hz)
        told = Note(f"asked for {message_name(msgid)} at {1e6 / interval_us:.0f} Hz")
        return [SendCommand(MavCmd.SET_MESSAGE_INTERVAL, (msgid, interval_us)), told]

    def _acknowledged(self, acks: Sequence[Ack], now: Instant) -> list[Note]:
        notes = []
        for ack in acks:
            if ack.command == MavCmd.SET_MESSAGE_INTERVAL and self._awaited is not None:
                (msgid, _), self._answers = self._awaited, True
                if msgid is not None:
                    self._awaited, self._asks[msgid].answer = None, ack.result
                    notes.append(Note(f"{message_name(msgid)}: the autopilot answered {_result(ack.result)}"))
        if self._awaited is not None and now - self._awaited[1] > ACK_S:
            self._awaited, self._answers = None, bool(self._answers)
        return notes

    def _told(self, ask: _Ask, msgid: int, want: Want, rate_hz: float, now: Instant) -> list[Note]:
        name = message_name(msgid)
        if not rate_hz and "lack" not in ask.told and (ask.refused or ask.tries >= VAIN):
            ask.told.add("lack")
            return [Note(_lack(name, want, remedy(self._autopilot, msgid)))]
        if ask.resets >= OFTEN and "resets" not in ask.told:
            ask.told.add("resets")
            why = f"its rate was changed {ask.resets} times; does a ground station set it?"
            return [Note(f"{name}: {why} (MAVProxy: set streamrate -1)")]
        if rate_hz and ask.at is not None and now - ask.at >= HELD_S and "rate" not in ask.told:
            ask.told.add("rate")
            answer = "gave no clear answer" if ask.answer is None else f"answered {_result(ask.answer)}"
            return [Note(f"{name}: asked for {want.ask_hz:g} Hz, the autopilot {answer}, {rate_hz:.1f} Hz come")]
        return []

    def _reported(self, rates_hz: Mapping[int, float | None], now: Instant) -> list[Notice]:
        asked = [(msgid, self._asks[msgid], rate_hz) for msgid, rate_hz in rates_hz.items()]
        got = [(msgid, ask, hz) for msgid, ask, hz in asked if ask.at and hz]
        fresh = [(msgid, ask, hz) for msgid, ask, hz in got if abs(hz - ask.reported_hz) > 0.1 * ask.reported_hz]
        if not fresh or any(ask.at is not None and now - ask.at < SETTLE_S for _, ask, _ in asked):
            return []
        for _, ask, hz in fresh:
            ask.reported_hz = hz
        return [Notice(Kind.RATES, (", ".join(f"{message_name(msgid)} {hz:.0f}" for msgid, _, hz in fresh),))]


def _lack(name: str, want: Want, parameter: str) -> str:
    label = LABELS.get(want.signal, want.signal)
    what = "nothing can be judged" if want.mandatory else f"monitors that need the {label} do not judge"
    return f"{name} does not come: {what}" + (f"; what gives it: {parameter}" if parameter else "")


def _result(number: int) -> str:
    return next((result.name for result in MavResult if result == number), f"result {number}")
