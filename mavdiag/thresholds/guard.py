"""What a monitor adds to a threshold because its few healthy flights cannot show it."""

from dataclasses import dataclass

from mavdiag.errors import UsageError

__all__ = ["Guard"]


@dataclass(frozen=True, slots=True)
class Guard:
    """What a monitor knows that its few healthy flights cannot show; in the statistic's unit.

    few_flights: added with one flight, and linearly less up to `enough_flights`, where it is zero.
    enough_flights: from so many flights on nothing is added.
    above_mean: least distance from the mean healthy maximum.
    least: least threshold at all.
    scale_share: least beta as a share of the mean maximum.
    Raises UsageError if one is negative.
    """

    few_flights: float = 0.0
    enough_flights: int = 5
    above_mean: float = 0.0
    least: float = 0.0
    scale_share: float = 0.1

    def __post_init__(self) -> None:
        if min(self.few_flights, self.above_mean, self.least, self.scale_share) < 0 or self.enough_flights < 2:
            raise UsageError("a guard's figures must not be negative, and enough flights are at least 2")

    def allowance(self, flights: int) -> float:
        """What is added for having only that many flights."""
        return self.few_flights * max(0, self.enough_flights - flights) / (self.enough_flights - 1)
