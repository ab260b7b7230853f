"""The machine as the daemon sees it (edge): its clocks, and a place for log lines."""

import time
from collections.abc import Callable
from datetime import UTC, datetime

__all__ = ["Host"]


class Host:
    """Clocks, and a place for log lines. Tests bring their own."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self.say = say

    def now_ns(self) -> int:
        """The monotonic clock [ns]."""
        return time.monotonic_ns()

    def utc(self) -> datetime:
        """The wall clock."""
        return datetime.now(UTC)

    def cpu_s(self) -> float:
        """Processor time used so far [s]."""
        return time.process_time()

    def sleep(self, span_s: float) -> None:
        """Wait."""
        time.sleep(span_s)
