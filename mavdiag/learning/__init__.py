"""From healthy flights to a baseline."""

from mavdiag.learning.flights import Flight, LearntFlight, airborne, front_for, gate_for, rows_of
from mavdiag.learning.learn import ALL_MONITORS, LearnOptions, learn, thesis_options
from mavdiag.learning.run_length import residuals_of, training_pieces

__all__ = [
    "ALL_MONITORS",
    "Flight",
    "LearnOptions",
    "LearntFlight",
    "airborne",
    "front_for",
    "gate_for",
    "learn",
    "residuals_of",
    "rows_of",
    "thesis_options",
    "training_pieces",
]
