"""Asking an autopilot for the streams that the monitors need, and saying plainly what came of it.

A stream that is missing, or whose measured rate lies outside of what will do, is asked for by SET_MESSAGE_INTERVAL: at
once, then after the pauses of `PAUSES_S`, every 30 s in the end. Tries are forgotten once a rate was right for 5 s, so
that a ground station that sets its own rates now and then is answered at once each time; but never is one message asked
for more than once in 2 s, and one that is changed again before it held for 5 s is asked for ever more seldom: two that
set the same rate must not fight. A refusal is an answer: it is not asked again. Where the autopilot does not send the
IMU message of its profile, those of `Want.others` are asked for in turn. Only what was *measured* counts as got.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum

from detector.alerts import Kind, Notice
from detector.values import AskInterval, Effect, Note
from mavdiag.link.codec import message_name
from mavdiag.link.messages import MavCmd, MavResult
from mavdiag.link.vehicles import Ack
from mavdiag.link.wants import LABELS, Want, remedy
from mavdiag.telemetry import Instant

__all__ = ["Negotiation", "Seen", "Told", "negotiate"]

PAUSES_S = (2.0, 2.0, 5.0, 5.0, 5.0, 30.0)  # least time to the next request after 0 (forgotten), 1, 2, ... tries
HELD_S = 5.0  # a rate that was right for so long was met; what came of a request is told after as long (our choice)
VAIN = 3  # tries after which a message that never came is not to be had (our choice)
OFTEN = 3  # changes by others after which the operator is told
SETTLE_S = 2.5  # after a request, before rates are reported (our choice)
ACK_S = 2.0  # an acknowledgement that has not come by then is lost; no later than the next request (our choice)
_US_PER_S = 1_000_000
_REFUSED = (MavResult.DENIED, MavResult.UNSUPPORTED, MavResult.FAILED)


@dataclass(frozen=True, slots=True)
class Seen:
    """A stream that is wanted, as it comes.

    rate_hz: as measured last; 0 if it does not come, None while it is being measured.
    steady_hz: over the last 5 s.
    """

    want: Want
    rate_hz: float | None
    steady_hz: float = 0.0

    @property
    def right(self) -> bool:
        """Whether its rate will do."""
        return self.rate_hz is not None and self.want.least_hz <= self.rate_hz <= self.want.most_hz


class Told(StrEnum):
    """What is said of a message, once."""

    LACK = "it does not come"
    RESETS = "others change its rate"
    RATE = "what came of the first request"


@dataclass(frozen=True, slots=True)
class _Ask:
    """What was asked for one message.

    tries: since its rate held last.
    at: when it was asked for last.
    hz: the rate that was asked for.
    answer: MAV_RESULT of the last acknowledgement; None if none came.
    right_since: since when its rate is right; None while it is not.
    resets: how often others changed a rate that had been met.
    told: what was said of it.
    reported_hz: the rate that was reported last; None if none was.
    """

    tries: int = 0
    at: Instant | None = None
    hz: float = 0.0
    answer: int | None = None
    right_since: Instant | None = None
    resets: int = 0
    told: frozenset["Told"] = frozenset()
    reported_hz: float | None = None

    @property
    def refused(self) -> bool:
        """Whether the autopilot refused it."""
        return self.answer in _REFUSED

    def pause_s(self) -> float:
        """Least time from the last request to the next."""
        return PAUSES_S[min(self.tries, len(PAUSES_S) - 1)]

    def due(self, now: Instant) -> bool:
        """Whether it may be asked for."""
        return not self.refused and (self.at is None or now - self.at >= self.pause_s())

    def vain(self, now: Instant) -> bool:
        """Whether a message that does not come is not to be had."""
        return self.refused or (self.tries >= VAIN and self.due(now))

    def after(self, right: bool, now: Instant) -> "_Ask":
        """With another look at its rate."""
        if not right:
            if self.right_since is None:
                return self
            return replace(self, right_since=None, resets=self.resets + (self.at is not None and self.tries == 0))
        if self.right_since is None:
            return replace(self, right_since=now)
        if now - self.right_since < HELD_S or (self.tries == 0 and not self.refused):
            return self
        return replace(self, tries=0, answer=None if self.refused else self.answer)


@dataclass(frozen=True, slots=True)
class Negotiation:
    """All that was asked so far.

    asks: by message.
    awaited: messages whose acknowledgement has not come, with the time, in the order asked.
    """

    asks: Mapping[int, _Ask] = field(default_factory=dict)
    awaited: tuple[tuple[int, Instant], ...] = ()

    def of(self, msgid: int) -> _Ask:
        """What was asked for one message."""
        return self.asks.get(msgid, _Ask())


def negotiate(
    negotiation: Negotiation, seen: tuple[Seen, ...], acks: tuple[Ack, ...], now: Instant, autopilot: int = 0
) -> tuple[Negotiation, tuple[Effect, ...], tuple[Notice, ...]]:
    """Take in acknowledgements and measured rates; return what to ask and what to say.

    autopilot: MAV_AUTOPILOT, whose parameters are named where a stream does not come.
    """
    negotiation, notes = _acknowledged(negotiation, acks, now)
    effects: list[Effect] = [*notes]
    for one in seen:
        if one.rate_hz is None:
            continue
        msgid = _message(negotiation, one, now)
        before = negotiation.of(msgid)
        ask = before.after(one.right, now)
        if not one.right and ask.due(now):
            effects.append(AskInterval(msgid, round(_US_PER_S / one.want.ask_hz)))
            ask = replace(ask, tries=ask.tries + 1, at=now, hz=one.want.ask_hz)
            negotiation = replace(negotiation, awaited=(*negotiation.awaited, (msgid, now)))
        ask, notes = _told(ask, msgid, one, autopilot, now)
        effects += notes
        negotiation = negotiation if ask is before else _with(negotiation, msgid, ask)
    negotiation, notices = _reported(negotiation, seen, now)
    return negotiation, tuple(effects), notices


def _message(negotiation: Negotiation, seen: Seen, now: Instant) -> int:
    """The message to ask for: of those that carry the signal the first that may still come."""
    if seen.rate_hz:
        return seen.want.msgid
    all_of_them = (seen.want.msgid, *seen.want.others)
    return next((msgid for msgid in all_of_them if not negotiation.of(msgid).vain(now)), seen.want.msgid)


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
        negotiation = _with(negotiation, msgid, replace(negotiation.of(msgid), answer=ack.result))
    return replace(negotiation, awaited=awaited), notes


def _told(ask: _Ask, msgid: int, seen: Seen, autopilot: int, now: Instant) -> tuple[_Ask, list[Note]]:
    """What came of the requests for a message: each thing once."""
    name = message_name(msgid)
    if not seen.rate_hz and Told.LACK not in ask.told and (ask.refused or ask.tries >= VAIN):
        return _telling(ask, Told.LACK, _lack(name, seen.want, remedy(autopilot, msgid)))
    if ask.resets >= OFTEN and Told.RESETS not in ask.told:
        why = f"its rate was changed {ask.resets} times; does a ground station set it? (MAVProxy: set streamrate -1)"
        return _telling(ask, Told.RESETS, f"{name}: {why}")
    if seen.rate_hz and ask.at is not None and now - ask.at >= HELD_S and Told.RATE not in ask.told:
        answer = "did not answer" if ask.answer is None else f"answered {_result(ask.answer)}"
        came = f"asked for {ask.hz:g} Hz, the autopilot {answer}, {seen.steady_hz:.1f} Hz come"
        return _telling(ask, Told.RATE, f"{name}: {came}")
    return ask, []


def _telling(ask: _Ask, what: "Told", words: str) -> tuple[_Ask, list[Note]]:
    return replace(ask, told=ask.told | {what}), [Note(words)]


def _lack(name: str, want: Want, parameter: str) -> str:
    label = LABELS.get(want.signal, want.signal)
    what = "nothing can be judged" if want.mandatory else f"monitors that need the {label} do not judge"
    return f"{name} does not come: {what}" + (f"; what gives it: {parameter}" if parameter else "")


def _reported(negotiation: Negotiation, seen: tuple[Seen, ...], now: Instant) -> tuple[Negotiation, tuple[Notice, ...]]:
    """Report the rates that were got, once whatever was asked for has been measured or has had its time."""
    asked = [(one.want.msgid, negotiation.of(one.want.msgid), one.rate_hz) for one in seen]
    fresh = [(msgid, ask, rate) for msgid, ask, rate in asked if ask.at and rate and not _like(rate, ask.reported_hz)]
    if not fresh or any(ask.at is not None and now - ask.at < SETTLE_S for _, ask, _ in asked):
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
