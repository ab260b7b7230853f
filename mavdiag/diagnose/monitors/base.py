"""What a monitor is: a scalar statistic of the aligned rows, to be held against a threshold.

A monitor turns consecutive rows into a `Reading`, `step(state, rows) -> (state, reading)`; the threshold belongs to
the baseline and the comparison to `mavdiag.diagnose.events`. A monitor that cannot work on the rows it gets marks
them invalid; it never guesses.
"""

from dataclasses import dataclass
from typing import Protocol, TypeVar

from mavdiag.diagnose.events import Reading
from mavdiag.quantities import Axis
from mavdiag.signal.block import Block
from mavdiag.signal.rates import RateBlock

__all__ = ["Monitor", "Rows"]

State = TypeVar("State")


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """The next aligned rows of one segment, and the filtered rates that they complete (m rows later)."""

    block: Block
    rates: RateBlock


class Monitor(Protocol[State]):
    """One statistic. `axis` is None where it concerns the whole vehicle."""

    @property
    def name(self) -> str:
        """Key in the baseline, the journal and the scan report."""

    @property
    def unit(self) -> str:
        """Unit of the statistic and of its threshold."""

    @property
    def axis(self) -> Axis | None:
        """The body axis that the statistic is about."""

    def start(self) -> State:
        """A fresh state, before the first row."""

    def step(self, state: State, rows: Rows) -> tuple[State, Reading]:
        """Take the next rows; return one reading a judged time. Any chunking gives the same readings."""
