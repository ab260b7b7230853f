"""Further links behind the daemon: they get the vehicle's frames, but for those refused, and the daemon's own.

What a ground station sends goes to the vehicle unchanged: whoever forwards to an endpoint gives it that right.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import groupby
from operator import itemgetter

from mavdiag.link.codec import split_frames
from mavdiag.link.ports import Endpoint
from mavdiag.link.sequence import Source

LOOK_BYTES = 65_536  # of a link behind in one look, as of strangers on the vehicle's (our choice); the rest is dropped
DATAGRAM_BYTES = 1_400  # what every network carries in one piece (Ethernet's 1,500 less the headers and a tunnel's)


def packed(frames: Iterable[bytes]) -> Iterator[bytes]:
    """Frames joined to messages of at most `DATAGRAM_BYTES`."""
    message = b""
    for frame in frames:
        if message and len(message) + len(frame) > DATAGRAM_BYTES:
            yield message
            message = b""
        message += frame
    if message:
        yield message


class Relay:
    """Between the vehicle's link and the links behind the daemon.

    upward: sees what a link behind brought, and returns what of it goes to the vehicle.
    """

    def __init__(
        self,
        main: Endpoint,
        behind: Sequence[Endpoint],
        upward: Callable[[list[bytes], Endpoint], Iterable[bytes]] = lambda frames, behind: frames,
    ) -> None:
        self._main, self._behind, self._upward = main, tuple(behind), upward
        self._begun = [b""] * len(self._behind)  # of a frame whose rest has not come from a byte stream
        # Frames of our own that wait; whether they are for everybody; which sender of the vehicle's link they are for.
        self._own: list[tuple[bytes, bool, Source]] = []

    def pass_on(self, frames: Sequence[tuple[bytes, int]]) -> None:
        """Pass frames, each with its time of arrival [ns], on, and back what comes."""
        for message in packed(frame for frame, _ in frames) if self._behind else ():
            for endpoint in self._behind:
                endpoint.send(message)
        for number, endpoint in enumerate(self._behind):
            brought, taken = list[bytes](), 0
            for data, _ in endpoint.receive(0.0):
                if taken >= LOOK_BYTES:
                    endpoint.traffic.overflowed += 1
                    continue
                whole, begun = split_frames(self._begun[number] + data)
                self._begun[number] = b"" if endpoint.datagrams else begun
                brought += whole
                taken += len(data)
            for message in packed(self._upward(brought, endpoint)) if brought else ():
                self._main.send(message)

    def send(self, frame: bytes, *, to_all: bool = True, source: Source = None) -> None:
        """One frame of our own, to everybody or to the vehicle's link alone, with the next `flush`.

        source: the sender on that link that alone gets it, None for all of them.
        """
        self._own.append((frame, to_all, source))

    def flush(self) -> None:
        """Send our own frames that wait, in their order; do so before anything else is sent of ours."""
        own, self._own = self._own, []
        for source, some in groupby(own, itemgetter(2)):
            for message in packed(frame for frame, *_ in some):
                if source is None:
                    self._main.send(message)
                else:
                    self._main.answer(message, source)
        for endpoint in self._behind if own else ():
            for message in packed(frame for frame, to_all, _ in own if to_all):
                endpoint.send(message)
