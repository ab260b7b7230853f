"""Asking an autopilot for the streams that the monitors need, and saying plainly what came of it.

A stream that is missing, or whose measured rate lies outside of what will do, is asked for by SET_MESSAGE_INTERVAL: at
once, then every 5 s while nothing comes of it, and every 30 s after five tries. A stream that was right once is asked
for as if for the first time when it is wrong again (a ground station may have reset it). A refusal is an answer: it is
recorded and not asked again. Only what was *measured* counts as got.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

from detector.alerts import Kind, Notice
from detector.values import AskInterval, Effect, Note
from mavdiag.link.codec import message_name
from mavdiag.link.messages import MavCmd, MavResult, MessageId
from mavdiag.link.profiles import Profile
from mavdiag.link.vehicles import Ack
from mavdiag.telemetry import Instant, Signal

__all__ = ["LABELS", "Negotiation", "Want", "negotiate", "wants_of"]

AGAIN_S = 5.0
TRIES = 5
RARELY_S = 30.0
ACK_S = 3.0  # an acknowledgement that has not come by then is lost (our choice)
_US_PER_S = 1_000_000
_REFUSED = (MavResult.DENIED, MavResult.UNSUPPORTED, MavResult.FAILED)

# Rates of the slow streams [Hz]: what is asked for, and the least that will do (METHOD section 4; our choices).
_SLOW: Mapping[Signal, tuple[float, float]] = {
    Signal.ACTUATOR: (25.0, 10.0),
    Signal.VIBRATION: (5.0, 2.0),
    Signal.ROTOR_SPEED: (5.0, 1.0),
}

# What a signal that does not come is called in a text for an operator.
LABELS: Mapping[Signal, str] = {
    Signal.BODY_RATE: "gyro",
    Signal.SPECIFIC_FORCE: "accelerometer",
    Signal.ATTITUDE_SETPOINT: "set-points",
    Signal.ACTUATOR: "actuator outputs",
    Signal.VIBRATION: "VIBRATION",
    Signal.ROTOR_SPEED: "rotor speeds",
}


@dataclass(frozen=True, slots=True)
class Want:
    """One stream.

    signal: what it carries.
    msgid: its message.
    ask_hz: rate to ask for.
    least_hz, most_hz: measured rates that will do.
    """

    signal: Signal
    msgid: int
    ask_hz: float
    least_hz: float
    most_hz: float = float("inf")


def wants_of(
    profile: Profile, needs: Collection[Signal], imu_hz: tuple[float, float, float], setpoint_hz: float
) -> tuple[Want, ...]:
    """The streams to ask for, by the signals that are needed.

    imu_hz: rate to ask for, least and most that will do. setpoint_hz: least rate of the set-points.
    """
    wants = [Want(Signal.BODY_RATE, profile.imu, *imu_hz)]
    if Signal.ATTITUDE_SETPOINT in needs:
        wants.insert(0, Want(Signal.ATTITUDE_SETPOINT, profile.setpoint, imu_hz[0], setpoint_hz))
    messages = {Signal.ACTUATOR: profile.actuator, Signal.ROTOR_SPEED: profile.rotor_speed}
    if profile.vibration:
        messages[Signal.VIBRATION] = MessageId.VIBRATION
    wants += [Want(signal, messages[signal], *_SLOW[signal]) for signal in messages if signal in needs]
    return tuple(wants)


@dataclass(frozen=True, slots=True)
class _Ask:
    """What was asked for one message.

    tries: since its rate was right last.
    at: when it was asked for last.
    refused: whether the autopilot refused it.
    reported_hz: the rate that was reported last; None if none was.
    """

    tries: int = 0
    at: Instant | None = None
    refused: bool = False
    reported_hz: float | None = None


@dataclass(frozen=True, slots=True)
class Negotiation:
    """All that was asked so far.

    asks: by message.
    awaited: messages whose acknowledgement has not come, with the time, in the order asked.
    """

    asks: Mapping[int, _Ask] = field(default_factory=dict)
    awaited: tuple[tuple[int, Instant], ...] = ()


def negotiate(
    negotiation: Negotiation, wants: tuple[tuple[Want, float | None], ...], acks: tuple[Ack, ...], now: Instant
) -> tuple[Negotiation, tuple[Effect, ...], tuple[Notice, ...]]:
    """Take in acknowledgements and measured rates; return what to ask and what to say.

    wants: each stream with its measured rate: 0 if it does not come, None while it is being measured.
    """
    negotiation, notes = _acknowledged(negotiation, acks, now)
    effects: list[Effect] = [*notes]
    for want, rate_hz in wants:
        ask = negotiation.asks.get(want.msgid, _Ask())
        if rate_hz is None:
            continue
        if want.least_hz <= rate_hz <= want.most_hz:
            negotiation = _with(negotiation, want.msgid, replace(ask, tries=0, refused=False))
        elif _may_ask(ask, now):
            effects.append(AskInterval(want.msgid, round(_US_PER_S / want.ask_hz)))
            negotiation = _with(negotiation, want.msgid, replace(ask, tries=ask.tries + 1, at=now))
            negotiation = replace(negotiation, awaited=(*negotiation.awaited, (want.msgid, now)))
    negotiation, notices = _reported(negotiation, wants, now)
    return negotiation, tuple(effects), notices


def _acknowledged(negotiation: Negotiation, acks: tuple[Ack, ...], now: Instant) -> tuple[Negotiation, list[Note]]:
    """Acknowledgements are taken to come in the order of the requests; MAVLink has nothing better for them."""
    awaited = tuple(one for one in negotiation.awaited if now - one[1] <= ACK_S)
    notes: list[Note] = []
    for ack in acks:
        if ack.command != MavCmd.SET_MESSAGE_INTERVAL or not awaited:
            continue
        (msgid, _), *rest = awaited
        awaited = tuple(rest)
        notes.append(Note(f"{message_name(msgid)}: the autopilot answered {_result(ack.result)}"))
        if ack.result in _REFUSED:
            negotiation = _with(negotiation, msgid, replace(negotiation.asks[msgid], refused=True))
    return replace(negotiation, awaited=awaited), notes


def _may_ask(ask: _Ask, now: Instant) -> bool:
    pause_s = AGAIN_S if ask.tries < TRIES else RARELY_S
    return not ask.refused and (ask.at is None or now - ask.at >= pause_s)


def _reported(
    negotiation: Negotiation, wants: tuple[tuple[Want, float | None], ...], now: Instant
) -> tuple[Negotiation, tuple[Notice, ...]]:
    """Report the rates that were got, once whatever was asked for has been measured or has had its time."""
    asked = [(want.msgid, negotiation.asks.get(want.msgid, _Ask()), rate) for want, rate in wants]
    fresh = [(msgid, ask, rate) for msgid, ask, rate in asked if ask.at and rate and not _like(rate, ask.reported_hz)]
    if not fresh or any(ask.at is not None and now - ask.at < AGAIN_S / 2 for _, ask, _ in asked):
        return negotiation, ()
    words = ", ".join(f"{message_name(msgid)} {rate:.0f}" for msgid, _, rate in fresh)
    for msgid, ask, rate in fresh:
        negotiation = _with(negotiation, msgid, replace(ask, reported_hz=rate))
    return negotiation, (Notice(Kind.RATES, (words,)),)


def _like(rate_hz: float, reported_hz: float | None) -> bool:
    return reported_hz is not None and abs(rate_hz - reported_hz) <= 0.1 * reported_hz


def _with(negotiation: Negotiation, msgid: int, ask: _Ask) -> Negotiation:
    return replace(negotiation, asks={**negotiation.asks, msgid: ask})


def _result(number: int) -> str:
    return next((result.name for result in MavResult if result == number), f"result {number}")
