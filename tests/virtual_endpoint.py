"""An endpoint whose other end a test makes, on a clock that stands still until somebody receives."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from unittest.mock import patch

from mavdiag.link.datagrams import Datagrams, as_columns
from mavdiag.link.ports.base import Endpoint
from mavdiag.units import NS_PER_S

START_NS = 1000 * NS_PER_S


class Clock:
    """In place of the module `time`."""

    def __init__(self) -> None:
        self.ns = START_NS

    def monotonic_ns(self) -> int:
        return self.ns

    def time_ns(self) -> int:
        return 1_777_600_000 * NS_PER_S + self.ns

    def monotonic(self) -> float:
        return self.ns / NS_PER_S

    def time(self) -> float:
        return self.time_ns() / NS_PER_S


class VirtualEndpoint(Endpoint):
    """Always connected. What is made of it sends, and makes in `receive` what comes while the clock goes on."""

    datagrams = True

    def __init__(self, clock: Clock) -> None:
        super().__init__("memory:near")
        self.clock = clock

    @property
    def connected(self) -> bool:
        return True

    def filenos(self) -> tuple[int, ...]:
        return ()

    def close(self) -> None:
        """It goes on."""

    def _drain(self) -> Datagrams:
        return as_columns(())


@contextmanager
def linked(endpoint: VirtualEndpoint) -> Iterator[None]:
    """Whatever link a command opens meanwhile is this one, on its clock."""
    with ExitStack() as stack:
        for place in ("mavdiag.link.link", "mavdiag.commands.inspect", "mavdiag.commands.setup"):
            stack.enter_context(patch(f"{place}.time", endpoint.clock))
        stack.enter_context(patch("mavdiag.link.link.open_endpoint", lambda address: endpoint))
        yield
