"""What a monitor adds to a threshold because its few healthy flights cannot show it."""

from dataclasses import dataclass

from mavdiag.errors import UsageError


@dataclass(frozen=True, slots=True)
class Guard:
    """What a monitor knows that its few healthy flights cannot show; in the statistic's unit.

    few_sessions: added with flights of one session, and linearly less up to `enough_sessions`, where it is zero.
    few_flights: the same for flights, in scales (beta) of the healthy maxima.
    above_mean, least: least distance from the mean healthy maximum, and least threshold at all.
    scale_share: least beta as a share of the mean maximum.
    """

    few_sessions: float = 0.0
    enough_sessions: int = 5
    few_flights: float = 0.0
    enough_flights: int = 5
    above_mean: float = 0.0
    least: float = 0.0
    scale_share: float = 0.1

    def __post_init__(self) -> None:
        if min(self.few_sessions, self.few_flights, self.above_mean, self.least, self.scale_share) < 0:
            raise UsageError("a guard's figures must not be negative")

    def scales(self, flights: int) -> float:
        """How many scales are added for having only that many flights."""
        return self.few_flights * max(0, self.enough_flights - flights) / (self.enough_flights - 1)

    def allowance(self, sessions: int) -> float:
        """What is added for knowing only that many sessions."""
        return self.few_sessions * max(0, self.enough_sessions - sessions) / (self.enough_sessions - 1)
