"""A small ground station (edge): it receives one link, keeps what a pilot would see, and may judge a vehicle itself."""

import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

from mavdiag.baseline import Baseline
from mavdiag.chain import Chain, ChainState, chain_of
from mavdiag.decision.diagnosis import Change, Diagnosis
from mavdiag.errors import BaselineError
from mavdiag.judging import why_not
from mavdiag.kernel import Piece, Slot
from mavdiag.link.codec import Decoder, Encoder, Frame
from mavdiag.link.link import Link
from mavdiag.link.messages import Autopilot, Component, MavType, MessageId, Severity
from mavdiag.link.ports import Endpoint, wait
from mavdiag.link.signing import Signing, stamp_at
from mavdiag.printable import printable
from mavdiag.telemetry import Telemetry
from mavdiag.units import NS_PER_S

GCS_SYSID = 255
BEAT_S = 1.0  # between our heartbeats
MAV_STATE_ACTIVE, MAVLINK_VERSION = 4, 3  # in HEARTBEAT
WANTED = (MessageId.STATUSTEXT, MessageId.NAMED_VALUE_FLOAT, MessageId.ATTITUDE)
TEXTS = 10_000  # that are kept (our choice)
FIGURES = ("PF_RES", "PF_MARG", "PF_FSD", "PF_FML")  # of the thesis rule, as a detector names them


@dataclass(frozen=True, slots=True)
class Line:
    """Something that happened: a STATUSTEXT of a detector, a change of a decision. t_s: vehicle's clock [s]."""

    t_s: float
    severity: Severity
    text: str

    @property
    def head(self) -> str:
        """When, and how grave it is."""
        return f"{self.t_s:8.2f} s  {self.severity.name:<8} "

    @property
    def alert(self) -> bool:
        """Whether it tells of a fault."""
        return self.severity <= Severity.CRITICAL

    @property
    def style(self) -> str:
        """Of rich."""
        if self.alert:
            return "bold red"
        return "yellow" if self.severity <= Severity.WARNING else ""


@dataclass(slots=True)
class LiveJudge:
    """The chain of a baseline at work on one vehicle."""

    baseline: Baseline
    span_s: float  # how much of the flight `pieces` holds
    began_ns: int = 0  # start of the flight, unix epoch
    pieces: tuple[Piece, ...] = ()  # what the chain made of the last seconds
    chain: Chain = field(init=False)
    _state: ChainState = field(init=False)
    _latest: dict[int, list[float]] = field(default_factory=dict)  # of each slot that has a value, by number

    def __post_init__(self) -> None:
        self.chain = chain_of(self.baseline, self.began_ns)
        self._state = self.chain.start()

    def judge(self, telemetry: Telemetry | None, profile: str | None = None) -> tuple[Change, ...]:
        """Judge what came next, None at the end of a log; return the changes of the decision.

        profile: of the link, once it is known. Raises BaselineError if the baseline is not for it.
        """
        if self.chain.profile is None and profile is not None:
            self.chain = replace(self.chain, profile=profile)
        chain, state = self.chain, self._state
        output = chain.finish(state) if telemetry is None else chain.step(state, telemetry)
        if state.refused:
            raise BaselineError(state.refused)
        for number in range(len(chain.slots) if output.pieces else 0):
            self._latest[number] = output.pieces[-1].latest(number) or self._latest.get(number, [])
        filled = [piece for piece in (*self.pieces, *output.pieces) if len(piece.rows.block)]
        since_ns = (filled[-1].rows.block.t_ns[-1] if filled else 0) - self.span_s * NS_PER_S
        self.pieces = tuple(piece for piece in filled if piece.rows.block.t_ns[-1] >= since_ns)
        return output.changes

    @property
    def now_s(self) -> float | None:
        """The vehicle's time of the latest row [s]; None before there is one."""
        return None if self._state.now_ns is None else self._state.now_ns / NS_PER_S

    @property
    def diagnosis(self) -> Diagnosis:
        """What is held of the vehicle now."""
        return self._state.diagnosis

    @property
    def values(self) -> Iterator[tuple[Slot, float, str]]:
        """Each slot, its latest value, 0 without one, and why it does not judge (empty if it does)."""
        for number, (slot, account) in enumerate(zip(self.chain.slots, self._state.accounts, strict=True)):
            value, sound, *_ = self._latest.get(number) or (0.0, 0.0)
            yield slot, value, "" if sound > 0.5 else why_not(self.chain, account) or "warming up"


@dataclass(slots=True)
class GroundStation:
    """What has been received so far."""

    endpoint: Endpoint
    judge: LiveJudge | None = None  # judges the vehicle here, too
    speak: bool = True  # send heartbeats, so that autopilots pass on texts to this link
    vehicle: int | None = None  # the system id that is listened to; None for all
    key: bytes | None = None  # lets only frames pass that are signed with it
    texts: list[Line] = field(default_factory=list)  # of the detectors, each with its own vehicle's time
    figures: dict[str, float] = field(default_factory=dict)  # latest `FIGURES` of the vehicle that is shown
    link: Link = field(init=False)  # to the vehicle that is judged here
    _times: dict[int, float] = field(default_factory=dict)
    _decoder: Decoder = field(init=False)
    _encoder: Encoder = field(default_factory=lambda: Encoder(GCS_SYSID, Component.MISSIONPLANNER))
    _beat_s: float = 0.0

    def __post_init__(self) -> None:
        self._decoder = Decoder(WANTED, signing=self._signing())
        self.link = Link(self.endpoint, self.vehicle, signing=self._signing())

    def _signing(self) -> Signing | None:
        return None if self.key is None else Signing(self.key, stamp=stamp_at(time.time_ns()))

    @property
    def link_line(self) -> str:
        """How the link to the judged vehicle is, or why it is not judged yet."""
        count = self.link.count
        if count is None:
            return self.link.absent
        lost = 100 * count.lost / max(count.received + count.lost, 1)
        return f"vehicle {self.link.vehicle}: {count.received} messages, {lost:.2f} % lost"

    def listen(self, timeout_s: float) -> list[Line | Change]:
        """Take in what comes within `timeout_s`, or sooner; return new texts, and changes of the judge's decision."""
        fresh: list[Line | Change] = []
        if self.speak and time.monotonic() >= self._beat_s:
            self._beat_s = time.monotonic() + BEAT_S
            beat = (MavType.GCS, Autopilot.INVALID, 0, 0, MAV_STATE_ACTIVE, MAVLINK_VERSION)
            self.endpoint.send(self._encoder.encode(MessageId.HEARTBEAT, *beat))
        wait([self.endpoint], timeout_s)
        chunks = self.endpoint.receive(0.0)
        for frame in self._decoder.take(chunks, datagrams=self.endpoint.datagrams):
            self._take(frame, fresh)
        if self.judge is not None:
            telemetry, stream = self.link.take(chunks, time.monotonic_ns()), self.link.stream
            if telemetry.series and stream is not None:
                fresh += self.judge.judge(telemetry, stream.profile.name)
        return fresh

    @property
    def heard(self) -> bool:
        """Whether any sound frame has come."""
        return bool(self._decoder.senders)

    @property
    def shown(self) -> int | None:
        """The vehicle whose time and figures are told: the one that was asked for, or the first that was heard."""
        return next(iter(self._times), None) if self.vehicle is None else self.vehicle

    @property
    def t_s(self) -> float:
        """The time of the vehicle that is shown [s]; 0 before it is heard."""
        return 0.0 if self.shown is None else self._times.get(self.shown, 0.0)

    def _take(self, frame: Frame, fresh: list[Line | Change]) -> None:
        if self.vehicle not in (None, frame.sysid):
            return
        match frame.compid, frame.msgid:
            case Component.AUTOPILOT1, MessageId.ATTITUDE:
                self._times[frame.sysid] = frame.value("time_boot_ms") / 1e3
            case Component.ONBOARD_COMPUTER, MessageId.STATUSTEXT:
                (severity,), t_s = frame.numbers("severity"), self._times.get(frame.sysid, 0.0)
                self.texts.append(Line(t_s, Severity(min(severity, Severity.DEBUG)), printable(frame.text("text"))))
                fresh.append(self.texts[-1])
                del self.texts[:-TEXTS]
            case Component.ONBOARD_COMPUTER, MessageId.NAMED_VALUE_FLOAT if self.shown in (None, frame.sysid):
                self.figures |= {name: frame.value("value") for name in FIGURES if name == frame.text("name")}
