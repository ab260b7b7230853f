"""What the two monitors of the trim share: where it comes from, the signals they rest on, how it names a rotor."""

from dataclasses import dataclass
from typing import TypeVar

from mavdiag.airframe.layout import RotorLayout
from mavdiag.airframe.trim import SIGNALS, Source
from mavdiag.errors import InputError
from mavdiag.monitors.base import Monitor, RotorEvidence
from mavdiag.rows.block import ALL, Block
from mavdiag.rows.conditions import Condition
from mavdiag.telemetry import BoolArray, Signal

__all__ = ["WINDOW_S", "TrimMonitor", "TrimSpec"]

MOST_RISE = 2**0.5 - 1  # of hover: 1/sqrt(1 - e) - 1 for e = 0.5; motors are chosen for twice the weight (our choice)
WINDOW_S = 5.0  # our choice; 3.5 s works as well on the recorded flights

State = TypeVar("State")
Spec = TypeVar("Spec", bound="TrimSpec")


@dataclass(frozen=True, slots=True, kw_only=True)
class TrimSpec:
    """What every fit of the trim holds.

    layout: where the rotors are.
    source: where the trim comes from: the motors' outputs, or the torque commands over the thrust.
    window_s: length of the means [s].
    """

    kind: str
    layout: RotorLayout
    source: Source
    window_s: float = WINDOW_S

    def check(self) -> None:
        """Raises InputError if the layout gives no trim of that source."""
        if self.source == "torque" and self.layout.torque_gain is None:
            lacking = f"what a torque command does to the motors of {self.layout.name}"
            raise InputError(f"{self.kind}: {lacking} is not known")


class TrimMonitor(Monitor[Spec, State]):
    """A monitor of the trim; its `rotors` are the rises that would explain a shift."""

    needs = frozenset({Signal.ACTUATOR, Signal.TORQUE_COMMAND, Signal.THRUST_SETPOINT})
    depends = frozenset({Condition.TILT, Condition.THROTTLE, Condition.YAW_RATE, Condition.HEIGHT})
    evidence = RotorEvidence(10.0, relative=True, direct=False)  # a lead of 0.12 was right in each of 35 recorded cuts
    needs_layout = True
    unit = "fraction of hover"

    @property
    def signals(self) -> frozenset[Signal]:
        """The outputs, or torque and thrust."""
        return SIGNALS[self.spec.source]

    def known(self, block: Block, signal: Signal) -> BoolArray:
        """Of the outputs those that move a rotor."""
        return block.known(signal, slice(0, self.spec.layout.rotors) if signal is Signal.ACTUATOR else ALL)

    @property
    def reach(self) -> float:
        """A rotor that lost half of its thrust; with more than twice the thrust of hover no output can answer."""
        return MOST_RISE

    @property
    def memory_s(self) -> float:
        """Its window [s]."""
        return self.spec.window_s
