"""Asking an autopilot for the streams that the monitors need, and saying plainly what came of it.

A stream that is missing, or whose measured rate will not do, is asked for by SET_MESSAGE_INTERVAL: at once, then after
the pauses of `PAUSES_S`. Tries are forgotten once a rate was right for 5 s; one that is changed again before is asked
for ever more seldom, for two that set the same rate must not fight. A refusal is an answer. Where the autopilot does
not send the IMU message of its profile, those of `Want.others` are asked for in turn. Only what was *measured* counts.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from detector.alerts import Kind, Notice
from detector.streams import Streams
from detector.values import AskInterval, Effect, Note
from mavdiag.link.codec import message_name
from mavdiag.link.messages import MavCmd, MavResult
from mavdiag.link.vehicles import Ack
from mavdiag.link.wants import LABELS, Want, remedy
from mavdiag.telemetry import Instant

PAUSES_S = (2.0, 2.0, 5.0, 5.0, 5.0, 30.0)  # least time to the next request after 0 (forgotten), 1, 2, ... tries
HELD_S = 5.0  # a rate that was right for so long was met; what came of a request is told after as long (our choice)
VAIN = 3  # tries after which a message that never came is not to be had (our choice)
OFTEN = 3  # changes by others after which the operator is told
SETTLE_S = 2.5  # after a request, before rates are reported (our choice)
CALM_S = 1.0  # between two looks while nothing is to be asked or told soon and no rate changes (our choice)
ACK_S = 2.0  # an acknowledgement that has not come by then is lost; no later than the next request (our choice)
_US_PER_S = 1_000_000
_REFUSED = (MavResult.DENIED, MavResult.UNSUPPORTED, MavResult.FAILED)


@dataclass(slots=True)
class _Ask:
    """What was asked for one message."""

    tries: int = 0  # since its rate held last
    at: Instant | None = None  # when it was asked for last
    answer: int | None = None  # MAV_RESULT of the last acknowledgement; None if none came
    right_since: Instant | None = None  # since when its rate is right; None while it is not
    resets: int = 0  # how often others changed a rate that had been met
    told: set[str] = field(default_factory=set)  # what was said of it, once each: "lack", "resets", "rate"
    reported_hz: float | None = None  # the rate that was reported last; None if none was

    @property
    def refused(self) -> bool:
        return self.answer in _REFUSED

    def due(self, now: Instant) -> bool:
        pause_s = PAUSES_S[min(self.tries, len(PAUSES_S) - 1)]
        return not self.refused and (self.at is None or now - self.at >= pause_s)

    def pressing(self, now: Instant) -> bool:
        """Whether something may be asked or told of it before long."""
        if self.right_since is None:
            return self.due(now + CALM_S)
        return self.at is not None and now - self.at < HELD_S + CALM_S

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
    """All that was asked so far of one autopilot. autopilot: MAV_AUTOPILOT. calm: the next look may wait `CALM_S`."""

    def __init__(self, autopilot: int = 0) -> None:
        self._autopilot, self.calm = autopilot, False
        self._asks: defaultdict[int, _Ask] = defaultdict(_Ask)
        self._awaited: list[tuple[int, Instant]] = []  # messages whose acknowledgement has not come, in order

    def step(
        self, wants: Sequence[Want], streams: Streams, acks: Sequence[Ack], now: Instant
    ) -> tuple[list[Effect], list[Notice]]:
        """Take in acknowledgements and measured rates; return what to ask and what to say."""
        effects: list[Effect] = [*self._acknowledged(acks, now)]
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
                effects.append(AskInterval(msgid, round(_US_PER_S / want.ask_hz)))
                ask.tries, ask.at = ask.tries + 1, now
                self._awaited.append((msgid, now))
            effects += self._told(ask, msgid, want, streams, rate_hz, now)
        notices, told = self._reported(rates_hz, now), None not in rates_hz.values()
        self.calm = told and not (effects or notices or any(ask.pressing(now) for ask in self._asks.values()))
        return effects, notices

    def ask_for(self, msgid: int, rate_hz: float, now: Instant) -> AskInterval:
        """Ask once for a stream that is not measured here."""
        self._awaited.append((msgid, now))
        return AskInterval(msgid, round(_US_PER_S / rate_hz))

    def _acknowledged(self, acks: Sequence[Ack], now: Instant) -> list[Note]:
        """Acknowledgements are taken to come in the order of the requests; MAVLink has nothing better for them."""
        notes = []
        if self._awaited:
            self._awaited = [(msgid, at) for msgid, at in self._awaited if now - at <= ACK_S]
        for ack in acks:
            if ack.command == MavCmd.SET_MESSAGE_INTERVAL and self._awaited:
                msgid, _ = self._awaited.pop(0)
                self._asks[msgid].answer = ack.result
                notes.append(Note(f"{message_name(msgid)}: the autopilot answered {_result(ack.result)}"))
        return notes

    def _told(self, ask: _Ask, msgid: int, want: Want, streams: Streams, rate_hz: float, now: Instant) -> list[Note]:
        """What came of the requests for a message: each thing once. rate_hz: 0 if it does not come."""
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
            answer = "did not answer" if ask.answer is None else f"answered {_result(ask.answer)}"
            steady_hz = streams.meter(want.signal).steady_hz or rate_hz
            came = f"the autopilot {answer}, {steady_hz:.1f} Hz come"
            return [Note(f"{name}: asked for {want.ask_hz:g} Hz, {came}")]
        return []

    def _reported(self, rates_hz: Mapping[int, float | None], now: Instant) -> list[Notice]:
        """Report the rates that were got, once whatever was asked for has been measured or has had its time."""
        asked = [(msgid, self._asks[msgid], rate_hz) for msgid, rate_hz in rates_hz.items()]
        fresh = [(msgid, ask, hz) for msgid, ask, hz in asked if ask.at and hz and not _like(hz, ask.reported_hz)]
        if not fresh or any(ask.at is not None and now - ask.at < SETTLE_S for _, ask, _ in asked):
            return []
        for _, ask, hz in fresh:
            ask.reported_hz = hz
        return [Notice(Kind.RATES, (", ".join(f"{message_name(msgid)} {hz:.0f}" for msgid, _, hz in fresh),))]


def _lack(name: str, want: Want, parameter: str) -> str:
    label = LABELS.get(want.signal, want.signal)
    what = "nothing can be judged" if want.mandatory else f"monitors that need the {label} do not judge"
    return f"{name} does not come: {what}" + (f"; what gives it: {parameter}" if parameter else "")


def _like(rate_hz: float, reported_hz: float | None) -> bool:
    return reported_hz is not None and abs(rate_hz - reported_hz) <= 0.1 * reported_hz


def _result(number: int) -> str:
    return next((result.name for result in MavResult if result == number), f"result {number}")
