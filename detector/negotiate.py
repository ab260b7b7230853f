"""Asking an autopilot for the streams that are needed, and saying plainly what came of it.

A stream that is missing, or whose measured rate lies outside of what will do, is asked for by SET_MESSAGE_INTERVAL: at
once, again every 5 s while nothing comes of it (a ground station may have reverted it), and every minute after five
tries. A refusal is an answer: it is told and not asked again. Only what was *measured* counts as got.
"""

from dataclasses import dataclass, replace

from detector.alerts import Kind, Notice
from detector.effects import AskInterval, Effect, Note
from mavdiag.link.codec import message_name
from mavdiag.link.messages import MavCmd, MavResult
from mavdiag.telemetry import Instant

__all__ = ["Ack", "Negotiation", "Want", "in_hand", "negotiate"]

AGAIN_S = 5.0
TRIES = 5
RARELY_S = 60.0
_US_PER_S = 1_000_000
_REFUSED = (MavResult.DENIED, MavResult.UNSUPPORTED, MavResult.FAILED)


@dataclass(frozen=True, slots=True)
class Want:
    """One stream: its message, the rate to ask for, and the rates [Hz] that will do."""

    msgid: int
    ask_hz: float
    least_hz: float
    most_hz: float = float("inf")

    def met_by(self, rate_hz: float) -> bool:
        """Whether a measured rate will do."""
        return self.least_hz <= rate_hz <= self.most_hz


@dataclass(frozen=True, slots=True)
class Ack:
    """A COMMAND_ACK from the autopilot. It does not tell which message it was for."""

    command: int
    result: int


@dataclass(frozen=True, slots=True)
class _Ask:
    """What was asked for one message. told_hz: the rate that was told last, None if none was."""

    msgid: int
    tries: int = 0
    at: Instant | None = None
    refused: bool = False
    told_hz: float | None = None


@dataclass(frozen=True, slots=True)
class Negotiation:
    """All that was asked so far. awaited: messages in the order asked whose acknowledgement has not come."""

    asks: tuple[_Ask, ...] = ()
    awaited: tuple[int, ...] = ()


def in_hand(negotiation: Negotiation, msgid: int) -> bool:
    """Whether asking for this message may still help: not refused, and not in vain all the times."""
    ask = _of(negotiation, msgid)
    return not ask.refused and ask.tries < TRIES


def negotiate(
    negotiation: Negotiation, wants: tuple[tuple[Want, float | None], ...], acks: tuple[Ack, ...], now: Instant
) -> tuple[Negotiation, tuple[Effect, ...], tuple[Notice, ...]]:
    """Take in acknowledgements and measured rates; return what to ask and what to tell.

    wants: each stream with its measured rate: 0 if it does not come, None while it is being measured.
    """
    negotiation, notes = _heard(negotiation, acks)
    effects: list[Effect] = [*notes]
    for want, rate_hz in wants:
        ask = _of(negotiation, want.msgid)
        if rate_hz is not None and not want.met_by(rate_hz) and _may_ask(ask, now):
            effects.append(AskInterval(want.msgid, round(_US_PER_S / want.ask_hz)))
            negotiation = _with(negotiation, replace(ask, tries=ask.tries + 1, at=now))
            negotiation = replace(negotiation, awaited=(*negotiation.awaited, want.msgid)[-8:])
    negotiation, notices = _told(negotiation, wants, now)
    return negotiation, tuple(effects), notices


def _heard(negotiation: Negotiation, acks: tuple[Ack, ...]) -> tuple[Negotiation, list[Note]]:
    """Acknowledgements are taken to come in the order of the requests; MAVLink has nothing better for them."""
    notes: list[Note] = []
    for ack in acks:
        if ack.command != MavCmd.SET_MESSAGE_INTERVAL or not negotiation.awaited:
            continue
        msgid, *rest = negotiation.awaited
        negotiation = replace(negotiation, awaited=tuple(rest))
        name, answer = message_name(msgid), _result(ack.result)
        notes.append(Note(f"{name}: the autopilot answered {answer}"))
        if ack.result in _REFUSED:
            negotiation = _with(negotiation, replace(_of(negotiation, msgid), refused=True))
    return negotiation, notes


def _may_ask(ask: _Ask, now: Instant) -> bool:
    pause_s = AGAIN_S if ask.tries < TRIES else RARELY_S
    return not ask.refused and (ask.at is None or now - ask.at >= pause_s)


def _told(
    negotiation: Negotiation, wants: tuple[tuple[Want, float | None], ...], now: Instant
) -> tuple[Negotiation, tuple[Notice, ...]]:
    """Tell the rates that were got, once everything that was asked for is answered by a measurement."""
    asked = [(_of(negotiation, want.msgid), want, rate) for want, rate in wants]
    asked = [one for one in asked if one[0].tries]
    news = any(rate and not _like(rate, ask.told_hz) for ask, _, rate in asked)
    settled = all(rate and ask.at is not None and now - ask.at >= AGAIN_S / 2 for ask, _, rate in asked)
    if not asked or not news or not settled:
        return negotiation, ()
    words = ", ".join(f"{message_name(want.msgid)} {rate:.0f}" for _, want, rate in asked)
    for ask, _, rate in asked:
        negotiation = _with(negotiation, replace(ask, told_hz=rate))
    return negotiation, (Notice(Kind.RATES, (words,)),)


def _like(rate_hz: float, told_hz: float | None) -> bool:
    return told_hz is not None and abs(rate_hz - told_hz) <= 0.1 * told_hz


def _of(negotiation: Negotiation, msgid: int) -> _Ask:
    return next((ask for ask in negotiation.asks if ask.msgid == msgid), _Ask(msgid))


def _with(negotiation: Negotiation, ask: _Ask) -> Negotiation:
    others = tuple(one for one in negotiation.asks if one.msgid != ask.msgid)
    return replace(negotiation, asks=(*others, ask))


def _result(number: int) -> str:
    return next((result.name for result in MavResult if result == number), f"result {number}")
