"""From healthy flights to a baseline."""

from mavdiag.learning.flights import LearntFlight, airborne, front_for, rows_of
from mavdiag.learning.learn import ALL_MONITORS, LearnOptions, learn, thesis_options

__all__ = [
    "ALL_MONITORS",
    "LearnOptions",
    "LearntFlight",
    "airborne",
    "front_for",
    "learn",
    "rows_of",
    "thesis_options",
]
