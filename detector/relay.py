"""Further links that hang behind the daemon: they get the vehicle's frames and the daemon's own, and can answer.

Bytes are passed on as they came, cut between frames, so that nothing of ours gets into the middle of one of theirs.
What a ground station sends goes to the vehicle unchanged: whoever forwards to an endpoint gives it that right.
"""

from collections.abc import Iterable, Sequence

from mavdiag.link.ports import Chunk, Endpoint
from mavdiag.link.ports.stream import whole_frames

__all__ = ["Cutter", "Relay"]


class Cutter:
    """One direction of a byte stream, handed on in whole frames; at most 280 bytes wait."""

    def __init__(self) -> None:
        self._begun = b""

    def cut(self, data: bytes) -> bytes:
        """The next bytes in, those that end between frames out."""
        data = self._begun + data
        stop = whole_frames(data)
        self._begun = data[stop:]
        return data[:stop]


class Relay:
    """Between the vehicle's link and the links behind the daemon."""

    def __init__(self, main: Endpoint, behind: Sequence[Endpoint]) -> None:
        self._main, self._behind = main, tuple(behind)
        self._down = Cutter()
        self._up = [Cutter() for _ in behind]

    @property
    def addresses(self) -> tuple[str, ...]:
        """Of the links behind."""
        return tuple(endpoint.address for endpoint in self._behind)

    def pass_on(self, chunks: Iterable[Chunk]) -> None:
        """What the vehicle's link brought goes to every link behind; what they bring goes to the vehicle's link."""
        if not self._behind:
            return
        for data, _ in chunks:
            if whole := self._down.cut(data):
                for endpoint in self._behind:
                    endpoint.send(whole)
        for endpoint, cutter in zip(self._behind, self._up, strict=True):
            for data, _ in endpoint.receive(0.0):
                if whole := cutter.cut(data):
                    self._main.send(whole)

    def say(self, frame: bytes) -> None:
        """One frame of our own, to everybody."""
        for endpoint in (self._main, *self._behind):
            endpoint.send(frame)

    def ask(self, frame: bytes) -> None:
        """One frame of our own, to the vehicle's link only."""
        self._main.send(frame)
