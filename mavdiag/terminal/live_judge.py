"""A vehicle on a link judged as it comes, with the last seconds kept for a display."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

from mavdiag.baseline import Baseline
from mavdiag.chain import Chain, ChainState, chain_of
from mavdiag.decision.alarm import Change
from mavdiag.decision.diagnosis import Diagnosis
from mavdiag.errors import BaselineError, InputError
from mavdiag.judging import why_not
from mavdiag.kernel import Gauge, Piece
from mavdiag.link.sequence import LinkCount, Source
from mavdiag.link.signing import Signing
from mavdiag.link.vehicles import LinkDecoder
from mavdiag.telemetry import Axis
from mavdiag.units import NS_PER_S


@dataclass(slots=True)
class LiveJudge:
    """The chain of a baseline at work on one vehicle of a link."""

    baseline: Baseline
    span_s: float  # how much of the flight `pieces` holds
    vehicle: int | None = None  # its system id; None takes the only one there is
    datagrams: bool = True  # what the link's chunks are
    began_ns: int = 0  # start of the flight, unix epoch
    signing: Signing | None = None  # lets only genuine frames pass
    pieces: tuple[Piece, ...] = ()  # what the chain made of the last seconds
    chain: Chain = field(init=False)
    _state: ChainState = field(init=False)
    _decoder: LinkDecoder = field(init=False)
    _gauges: dict[tuple[str, Axis | None], Gauge] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.chain = chain_of(self.baseline, self.began_ns)
        self._state = self.chain.start()
        self._decoder = LinkDecoder(None, self.vehicle, self.datagrams, signing=self.signing)

    def take(
        self, chunks: Iterable[tuple[bytes, int]], now_ns: int, sources: Sequence[Source] = ()
    ) -> tuple[Change, ...]:
        """Take bytes of the link, each with its time of arrival [ns]; return the changes of the decision."""
        received = self._decoder.feed(chunks, now_ns, sources)
        known = sorted(self._decoder.vehicles)
        if self.vehicle is None and len(known) > 1:
            raise InputError(f"there are the vehicles {', '.join(map(str, known))}; choose one with --vehicle")
        self.vehicle = next(iter(known), None) if self.vehicle is None else self.vehicle
        if self.chain.profile is None and self.vehicle in self._decoder.vehicles:
            self.chain = replace(self.chain, profile=self._decoder.vehicles[self.vehicle].profile.name)
        found = None if self.vehicle is None else received.get(self.vehicle)
        if found is None or not found.telemetry.series:
            return ()
        self._state, output = self.chain.step(self._state, found.telemetry)
        if self._state.refused:
            raise BaselineError(self._state.refused)
        self._gauges.update({(gauge.monitor, gauge.axis): gauge for gauge in output.gauges})
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
    def count(self) -> LinkCount | None:
        """What came from the vehicle's autopilot so far, and what was lost."""
        return None if self.vehicle is None else self._decoder.count(self.vehicle)

    @property
    def link_line(self) -> str:
        """How the link is, or why the vehicle is not judged yet."""
        count = self.count
        if count is None:
            return next(iter(self._decoder.waiting.values()), "") or "no vehicle yet"
        lost = 100 * count.lost / max(count.received + count.lost, 1)
        return f"vehicle {self.vehicle}: {count.received} messages, {lost:.2f} % lost"

    @property
    def gauges(self) -> tuple[tuple[str, Axis | None, Gauge | None, str], ...]:
        """Of each slot: monitor, axis, its latest value, and why it does not judge (empty if it does)."""
        found = []
        for slot, account in zip(self.chain.slots, self._state.accounts, strict=True):
            gauge = self._gauges.get(slot.key)
            judges = gauge is not None and gauge.valid
            found.append((*slot.key, gauge, "" if judges else why_not(self.chain, account) or "warming up"))
        return tuple(found)
