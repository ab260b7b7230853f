"""Whether a watched vehicle flies although the gate passes no rows: `hidden_flight` of a log, for the latest flight."""

from dataclasses import dataclass

from mavdiag.chain import Chain, ChainOutput
from mavdiag.link.samples import joined
from mavdiag.rows.gate import HIDDEN_S, SHOWS_FLIGHT, hidden_flight
from mavdiag.rows.quality import believed
from mavdiag.telemetry import Telemetry
from mavdiag.units import NS_PER_S

__all__ = ["Sight"]

FLOWN_NS = 20 * NS_PER_S  # of what flew last, which shows what is usual in flight (our choice)
LATEST_NS = 6 * NS_PER_S  # of what came last: twice `HIDDEN_S`, and no touch-down takes so long (our choice)
LOOK_NS = 2 * NS_PER_S  # between two looks (our choice)


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """What is kept of a vehicle to see that it flies.

    pieces: what tells flight from ground, each with its newest time [ns]: of what flew last, and of what came last.
    spans: first and last row of each part of it that flew [ns].
    looked_ns: vehicle time of the latest look [ns].
    hidden: why nothing is judged although it flies; empty if it is judged, or does not fly.
    """

    pieces: tuple[tuple[int, Telemetry], ...] = ()
    spans: tuple[tuple[int, int], ...] = ()
    looked_ns: int = 0
    hidden: str = ""

    def step(self, chain: Chain, telemetry: Telemetry, output: ChainOutput) -> "Sight":
        """Take in what came, and what the chain made of it."""
        series = tuple(one for one in telemetry.series if one.signal in SHOWS_FLIGHT and len(one))
        if not series:
            return self
        now_ns = max(int(one.t_ns[-1]) for one in series)
        blocks = [piece.rows.block for piece in output.pieces if len(piece.rows.block)]
        spans = (*self.spans, *((int(block.t_ns[0]), int(block.t_ns[-1])) for block in blocks))
        pieces = (*self.pieces, (now_ns, Telemetry(series)))
        if now_ns - self.looked_ns < LOOK_NS:
            return Sight(pieces, spans, self.looked_ns, self.hidden)
        flown_ns = spans[-1][1] if spans else now_ns
        since_ns = flown_ns - FLOWN_NS
        spans = tuple(span for span in spans if span[1] >= since_ns)
        pieces = tuple(one for one in pieces if since_ns <= one[0] <= flown_ns or one[0] >= now_ns - LATEST_NS)
        seen = now_ns - flown_ns < HIDDEN_S * NS_PER_S
        return Sight(pieces, spans, now_ns, "" if seen else _hidden(chain, pieces, spans))


def _hidden(chain: Chain, pieces: tuple[tuple[int, Telemetry], ...], spans: tuple[tuple[int, int], ...]) -> str:
    """Why the latest part of the flight is hidden; empty if it is not."""
    telemetry = believed(chain.front.align.quality, joined([piece for _, piece in pieces]))
    found = hidden_flight(telemetry, chain.front.gate, spans)
    return found[-1].reason if found and pieces[-1][0] / NS_PER_S - found[-1].end_s < 1.0 else ""
